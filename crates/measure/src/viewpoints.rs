//! Viewpoints: points drawn uniformly from the view box, or a camera path from a file.

use std::io::{BufRead, Read};

use glam::Vec3;
use sightline_numbers::random::SplitMix64;

use crate::error::MeasureError;

/// The maximum length of a line of a camera path in bytes. No viewpoint needs more.
const MAX_LINE: u64 = 4096;

/// The viewpoints in world space, one per frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Viewpoints {
    /// The points, in the order of the frames.
    pub points: Vec<Vec3>,
    /// The weight of each point in the means; empty if all points have equal weight.
    pub weights: Vec<f64>,
    /// True if consecutive points are consecutive frames of a walk, so that durations of errors are
    /// meaningful.
    pub is_path: bool,
}

impl Viewpoints {
    /// Creates `n` points uniform in the view box (min, max). Equal seeds give equal points on every machine.
    ///
    /// The generator is SplitMix64 (Steele, Lea and Flood 2014) starting at `seed`. For each coordinate of
    /// each point, in the order x, y, z, the upper 24 bits of one output are a fraction s of 2²⁴. The
    /// coordinate is min + (max − min)·s in f64, rounded to f32.
    pub fn random(n: u32, seed: u64, view_box: [[f32; 3]; 2]) -> Self {
        let [min, max] = view_box;
        let mut stream = SplitMix64::new(seed);
        let mut coordinate = |axis: usize| {
            let (lo, hi) = (f64::from(min[axis]), f64::from(max[axis]));
            // Rounding may move a point onto the border, which still belongs to the view box.
            (lo + (hi - lo) * f64::from(stream.unit_f32())) as f32
        };
        let points = (0..n)
            .map(|_| Vec3::new(coordinate(0), coordinate(1), coordinate(2)))
            .collect();
        Self {
            points,
            weights: Vec::new(),
            is_path: false,
        }
    }

    /// Creates points like [`Self::random`], but only points for which `is_place` returns true. Draws at most
    /// 1000·`n` points and keeps the first `n` that qualify. The result has fewer points if fewer qualify.
    pub fn random_where(
        n: u32,
        seed: u64,
        view_box: [[f32; 3]; 2],
        is_place: impl Fn([f32; 3]) -> bool,
    ) -> Self {
        const TRIES: u64 = 1000;
        let [min, max] = view_box;
        let mut stream = SplitMix64::new(seed);
        let mut points = Vec::new();
        for _ in 0..u64::from(n) * TRIES {
            if points.len() == n as usize {
                break;
            }
            let mut coordinate = |axis: usize| {
                let (lo, hi) = (f64::from(min[axis]), f64::from(max[axis]));
                (lo + (hi - lo) * f64::from(stream.unit_f32())) as f32
            };
            let point = [coordinate(0), coordinate(1), coordinate(2)];
            if is_place(point) {
                points.push(point.into());
            }
        }
        Self {
            points,
            weights: Vec::new(),
            is_path: false,
        }
    }

    /// Creates viewpoints from points with weights. If there are more than `n` points, draws `n` of them by
    /// their weights, at equal steps of the cumulative sum of the weights. The drawn points have equal
    /// weight.
    pub fn weighted(all: &[([f32; 3], f64)], n: u32, seed: u64) -> Self {
        if all.len() <= n as usize {
            let (points, weights) = all.iter().map(|(p, w)| (Vec3::from(*p), *w)).unzip();
            return Self {
                points,
                weights,
                is_path: false,
            };
        }
        let sum: f64 = all.iter().map(|(_, w)| w).sum();
        let start = f64::from(SplitMix64::new(seed).unit_f32());
        let (mut points, mut before) = (Vec::new(), 0.0);
        for (point, weight) in all {
            before += weight;
            while points.len() < n as usize
                && (points.len() as f64 + start) * sum / f64::from(n) < before
            {
                points.push(Vec3::from(*point));
            }
        }
        Self {
            points,
            weights: Vec::new(),
            is_path: false,
        }
    }

    /// Reads a camera path with one viewpoint per line. The form of a line is `x y z` (separated by spaces or
    /// commas) or `{"position":[x,y,z]}` (other keys are ignored). Skips empty lines, and the text after `#`
    /// in a plain line.
    ///
    /// # Errors
    /// [`MeasureError::Read`], [`MeasureError::Line`] and [`MeasureError::PathOutside`], each with its line.
    /// [`MeasureError::NoViewpoints`] if the path is empty.
    pub fn path(mut reader: impl BufRead, view_box: [[f32; 3]; 2]) -> Result<Self, MeasureError> {
        let [min, max] = view_box;
        let mut points = Vec::new();
        let mut bytes = Vec::new();
        for line in 1.. {
            bytes.clear();
            let read = (&mut reader)
                .take(MAX_LINE + 1)
                .read_until(b'\n', &mut bytes);
            if read.map_err(|source| MeasureError::Read { line, source })? == 0 {
                break;
            }
            let bad = |reason: String| MeasureError::Line { line, reason };
            if bytes.len() as u64 > MAX_LINE {
                return Err(bad(format!("the line is longer than {MAX_LINE} bytes")));
            }
            let text = std::str::from_utf8(&bytes)
                .map_err(|_| bad("the line is not UTF-8 text".to_owned()))?
                .trim();
            let Some(point) = parse_line(text).map_err(bad)? else {
                continue;
            };
            if !(0..3).all(|a| min[a] <= point[a] && point[a] <= max[a]) {
                return Err(MeasureError::PathOutside {
                    line,
                    point,
                    min,
                    max,
                });
            }
            points.push(Vec3::from(point));
        }
        if points.is_empty() {
            Err(MeasureError::NoViewpoints)
        } else {
            Ok(Self {
                points,
                weights: Vec::new(),
                is_path: true,
            })
        }
    }
}

/// A JSON line of a camera path.
#[derive(serde::Deserialize)]
struct JsonLine {
    position: [f32; 3],
}

/// Parses the point of a line. Returns `None` for a line without a point.
fn parse_line(text: &str) -> Result<Option<[f32; 3]>, String> {
    let point = if text.starts_with('{') {
        serde_json::from_str::<JsonLine>(text)
            .map_err(|e| e.to_string())?
            .position
    } else {
        let text = text.split('#').next().unwrap_or_default();
        let mut numbers = text
            .split(|c: char| c == ',' || c.is_whitespace())
            .filter(|word| !word.is_empty());
        let mut point = [0.0f32; 3];
        for (i, coordinate) in point.iter_mut().enumerate() {
            match numbers.next() {
                None if i == 0 => return Ok(None),
                None => return Err(format!("the line has {i} numbers in place of 3")),
                Some(word) => {
                    *coordinate = word
                        .parse()
                        .map_err(|_| format!("“{word}” is not a number"))?
                }
            }
        }
        if numbers.next().is_some() {
            return Err("the line has more than 3 numbers".to_owned());
        }
        point
    };
    if point.iter().all(|c| c.is_finite()) {
        Ok(Some(point))
    } else {
        Err("a coordinate is not finite".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: [[f32; 3]; 2] = [[-1.0, 0.0, 2.0], [1.0, 0.0, 5.0]];

    #[test]
    fn random_points_lie_in_box_and_depend_only_on_seed() {
        let a = Viewpoints::random(500, 7, BOX);
        assert_eq!(a, Viewpoints::random(500, 7, BOX));
        assert_ne!(a, Viewpoints::random(500, 8, BOX));
        assert!(
            a.points
                .iter()
                .all(|p| (-1.0..=1.0).contains(&p.x) && p.y == 0.0 && (2.0..=5.0).contains(&p.z))
        );
        // The number of points below 0 is near half, which suffices to notice a wrong shift.
        let below = a.points.iter().filter(|p| p.x < 0.0).count();
        assert!((200..300).contains(&below), "{below}");
        // The first output of SplitMix64 for seed 0 is 0xe220a8397b1dcdaf.
        let first = Viewpoints::random(1, 0, [[0.0; 3], [1.0; 3]]).points[0];
        assert_eq!(first.x, 0xe220a8 as f32 / 16_777_216.0);
    }

    #[test]
    fn path_reads_both_kinds_of_lines() {
        let text =
            "# a walk\n0 0 3\n\n 0.5,0,  4 # stop\r\n{\"position\":[-1,0,5],\"t\":2}\n1\t0\t2";
        let path = Viewpoints::path(text.as_bytes(), BOX).unwrap();
        assert!(path.is_path);
        let expected = [
            [0.0, 0.0, 3.0],
            [0.5, 0.0, 4.0],
            [-1.0, 0.0, 5.0],
            [1.0, 0.0, 2.0],
        ];
        assert_eq!(path.points, expected.map(Vec3::from));
    }

    #[test]
    fn errors_report_bad_lines() {
        let why = |text: &str| {
            Viewpoints::path(text.as_bytes(), BOX)
                .unwrap_err()
                .to_string()
        };
        for (text, line, part) in [
            ("0 0 3\n0 0", 2, "2 numbers"),
            ("0 0 3 4", 1, "more than 3"),
            ("\n\n0 zero 3", 3, "“zero”"),
            ("0 0 nan", 1, "finite"),
            ("{\"position\":[1,2]}", 1, "length"),
            ("{\"pos\":[1,2,3]}", 1, "position"),
            ("{\"position\":[0,0,1e99]}", 1, ""),
            ("0 0 3\n0 0 9", 2, "outside the view box"),
            (&"7".repeat(5000), 1, "longer"),
        ] {
            let message = why(text);
            assert!(
                message.contains(&format!("line {line} ")) && message.contains(part),
                "{message}"
            );
        }
        assert!(matches!(
            Viewpoints::path(&b"# none\n"[..], BOX),
            Err(MeasureError::NoViewpoints)
        ));
        assert!(matches!(
            Viewpoints::path(&b"0 0 3\n\xff\xfe"[..], BOX),
            Err(MeasureError::Line { line: 2, .. })
        ));
    }
}
