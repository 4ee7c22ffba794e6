//! Where to look from: points drawn uniformly from the view box, or a camera path from a file.

use std::io::{BufRead, Read};

use glam::Vec3;
use sightline_numbers::random::SplitMix64;

use crate::error::MeasureError;

/// The longest line of a camera path in bytes; no viewpoint needs more.
const MAX_LINE: u64 = 4096;

/// Viewpoints in world space, one a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Viewpoints {
    /// The points, in the order of the frames.
    pub points: Vec<Vec3>,
    /// How much each point counts in the means; empty when all count alike.
    pub weights: Vec<f64>,
    /// Whether consecutive points are consecutive frames of a walk, so that it means something how long an
    /// error lasts.
    pub is_path: bool,
}

impl Viewpoints {
    /// `n` points uniform in the view box (min, max). The same `seed` gives the same points on every machine.
    ///
    /// SplitMix64 (Steele, Lea and Flood 2014) starting at `seed`; for each point x, y, z in turn take the
    /// upper 24 bits of one output as a fraction s of 2²⁴, and min + (max − min)·s in f64, rounded to f32.
    pub fn random(n: u32, seed: u64, view_box: [[f32; 3]; 2]) -> Self {
        let [min, max] = view_box;
        let mut stream = SplitMix64::new(seed);
        let mut coordinate = |axis: usize| {
            let (lo, hi) = (f64::from(min[axis]), f64::from(max[axis]));
            // Rounding may lift a point onto the border, which still belongs to the view box.
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

    /// The same where `is_place` holds: of up to a thousand times as many points as wanted, the first `n`
    /// such points, or fewer when hardly any are.
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

    /// Given points with weights. When there are more than `n`, `n` of them are drawn by their weights, at
    /// equal steps of the sum of all weights before them; these count alike.
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

    /// A camera path: a viewpoint a line, as `x y z` (spaces or commas between) or as `{"position":[x,y,z]}`
    /// (other keys are ignored). Empty lines and what follows `#` in a plain line are skipped.
    ///
    /// # Errors
    /// [`MeasureError::Read`], [`MeasureError::Line`], [`MeasureError::PathOutside`], each with its line, and
    /// [`MeasureError::NoViewpoints`].
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
                return Err(bad(format!("it is longer than {MAX_LINE} bytes")));
            }
            let text = std::str::from_utf8(&bytes)
                .map_err(|_| bad("it is not text".to_owned()))?
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

/// The point of a line, `None` for a line without one.
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
                None => return Err(format!("it has {i} numbers instead of 3")),
                Some(word) => {
                    *coordinate = word
                        .parse()
                        .map_err(|_| format!("“{word}” is not a number"))?
                }
            }
        }
        if numbers.next().is_some() {
            return Err("it has more than 3 numbers".to_owned());
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
    fn random_points_lie_in_the_box_and_depend_on_the_seed_alone() {
        let a = Viewpoints::random(500, 7, BOX);
        assert_eq!(a, Viewpoints::random(500, 7, BOX));
        assert_ne!(a, Viewpoints::random(500, 8, BOX));
        assert!(
            a.points
                .iter()
                .all(|p| (-1.0..=1.0).contains(&p.x) && p.y == 0.0 && (2.0..=5.0).contains(&p.z))
        );
        // Halves, quarters: uniform enough to notice a wrong shift.
        let below = a.points.iter().filter(|p| p.x < 0.0).count();
        assert!((200..300).contains(&below), "{below}");
        // The first output of SplitMix64 for seed 0 is 0xe220a8397b1dcdaf.
        let first = Viewpoints::random(1, 0, [[0.0; 3], [1.0; 3]]).points[0];
        assert_eq!(first.x, 0xe220a8 as f32 / 16_777_216.0);
    }

    #[test]
    fn both_kinds_of_line_are_read() {
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
    fn bad_lines_are_named() {
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
