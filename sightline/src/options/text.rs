//! Parsers of option values in the form of the command line.

use std::time::Duration;

use glam::Vec3;
use sightline_scene::Aabb;

/// Maximum duration: 366 days.
const MOST_DURATION: Duration = Duration::from_secs(366 * 24 * 3600);

/// Parses `N` finite numbers, separated by commas.
fn numbers<const N: usize>(text: &str) -> Option<[f32; N]> {
    let parts = text
        .split(',')
        .map(|p| p.trim().parse::<f32>())
        .collect::<Result<Vec<_>, _>>()
        .ok()?;
    <[f32; N]>::try_from(parts)
        .ok()
        .filter(|all| all.iter().all(|x| x.is_finite()))
}

/// Parses a point, as in `1.5,0,-2`.
///
/// # Errors
/// The remedy, if the text is not a point.
pub fn parse_point(text: &str) -> Result<[f32; 3], String> {
    numbers(text).ok_or_else(|| "give three numbers, such as 1.5,0,-2".to_owned())
}

/// Parses two heights in ascending order, as in `1.2,1.8`.
///
/// # Errors
/// The remedy, if the text is not a pair of heights.
pub fn parse_heights(text: &str) -> Result<[f32; 2], String> {
    let wrong = || "give the minimum and the maximum height, such as 1.2,1.8".to_owned();
    numbers(text).filter(|[lo, hi]| lo <= hi).ok_or_else(wrong)
}

/// Parses a length above 0, as in `2.5`.
///
/// # Errors
/// The remedy, if the text is not a length.
pub fn parse_length(text: &str) -> Result<f32, String> {
    let length = text.parse::<f32>().ok();
    length
        .filter(|r| r.is_finite() && *r > 0.0)
        .ok_or_else(|| "give a length above 0, as in 2.5".to_owned())
}

/// Parses the length of a cell's side, as in `2.5`.
///
/// # Errors
/// The remedy, if the text is not a length.
pub fn parse_size(text: &str) -> Result<f64, String> {
    let size = text.parse::<f64>().ok();
    size.filter(|s| s.is_finite() && *s > 0.0)
        .ok_or_else(|| "give a length above 0, as in 2.5".to_owned())
}

/// Parses a box, as in `-1,0,-1,1,2,1`.
///
/// # Errors
/// The remedy, if the text is not a box.
pub fn parse_box(text: &str) -> Result<Aabb, String> {
    let parts = text
        .split(',')
        .map(|p| p.trim().parse())
        .collect::<Result<Vec<f32>, _>>();
    match parts.as_deref() {
        Ok([x0, y0, z0, x1, y1, z1]) => Ok(Aabb::new(
            Vec3::new(*x0, *y0, *z0),
            Vec3::new(*x1, *y1, *z1),
        )),
        _ => Err("give six numbers x0,y0,z0,x1,y1,z1, such as -1,0,-1,1,2,1".to_owned()),
    }
}

// The crate `humantime` rejects a number without a unit, which the command line permits.
/// Parses a duration, as in `500ms`, `30s`, `30`, `5m` or `2h`. A number without a unit is in seconds.
///
/// # Errors
/// The remedy, if the text is not a duration, or the duration is 0 or more than 366 days.
pub fn parse_duration(text: &str) -> Result<Duration, String> {
    let wrong = || {
        "give a duration above 0 and of at most 366 days, such as 500ms, 30s (or 30), 5m or \
         2h"
        .to_owned()
    };
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &text[digits.len()..] {
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(wrong()),
    };
    let seconds = digits.trim().parse::<f64>().map_err(|_| wrong())? * unit;
    Duration::try_from_secs_f64(seconds)
        .ok()
        .filter(|d| !d.is_zero() && *d <= MOST_DURATION)
        .ok_or_else(wrong)
}

/// Parses a grid of cells, as in `8x8x8`.
///
/// # Errors
/// The remedy, if the text is not a grid.
pub fn parse_grid(text: &str) -> Result<[u32; 3], String> {
    let parts = text
        .split(['x', 'X'])
        .map(|p| p.trim().parse())
        .collect::<Result<Vec<u32>, _>>();
    parts
        .ok()
        .and_then(|p| p.try_into().ok())
        .ok_or_else(|| "give three whole numbers, such as 8x8x8".to_owned())
}
