//! Files of viewpoints, for example from telemetry or a camera path: each line is `x y z` or `x y z weight`.

use std::io::{BufRead, Read as _};

use crate::ViewpointsError;

/// Maximum length of a line in bytes. No viewpoint needs more.
const MOST_LINE: u64 = 4096;
/// Maximum number of viewpoints of a file.
const MOST_POINTS: usize = 10_000_000;

/// A viewpoint and its weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedViewpoint {
    /// The position in world space.
    pub point: [f32; 3],
    /// The weight, above 0. Default: 1.
    pub weight: f64,
}

/// Reads a file of viewpoints. Spaces, tabs or commas separate numbers. Empty lines, comments after `#`, and
/// viewpoints of weight 0 are skipped.
///
/// # Errors
/// [`ViewpointsError::Read`] or [`ViewpointsError::Line`] with the number of an unreadable or invalid line.
/// [`ViewpointsError::None`] if the file has no viewpoint with a weight above 0.
pub fn read(mut from: impl BufRead) -> Result<Vec<WeightedViewpoint>, ViewpointsError> {
    let (mut points, mut bytes) = (Vec::new(), Vec::new());
    for line in 1.. {
        bytes.clear();
        let read = (&mut from)
            .take(MOST_LINE + 1)
            .read_until(b'\n', &mut bytes);
        if read.map_err(|source| ViewpointsError::Read { line, source })? == 0 {
            break;
        }
        let bad = |reason: &str| ViewpointsError::Line {
            line,
            reason: reason.to_owned(),
        };
        if bytes.len() as u64 > MOST_LINE {
            return Err(bad("the line is longer than 4096 bytes"));
        }
        let text = std::str::from_utf8(&bytes).map_err(|_| bad("the line is not UTF-8 text"))?;
        let text = text.split('#').next().unwrap_or_default();
        let words = text
            .split(|c: char| c == ',' || c.is_whitespace())
            .filter(|w| !w.is_empty());
        let numbers: Vec<f64> = words
            .map(|w| {
                w.parse()
                    .map_err(|_| bad(&format!("“{w}” is not a number")))
            })
            .collect::<Result<_, _>>()?;
        let (point, weight) = match numbers.as_slice() {
            [] => continue,
            [x, y, z] => ([*x, *y, *z], 1.0),
            [x, y, z, weight] => ([*x, *y, *z], *weight),
            some => return Err(bad(&format!("the line has {} numbers", some.len()))),
        };
        let point = point.map(|c| c as f32);
        if point.iter().any(|c| !c.is_finite()) {
            return Err(bad("a coordinate is not finite"));
        }
        if !weight.is_finite() || weight < 0.0 {
            return Err(bad("the weight is negative or not finite"));
        }
        if points.len() == MOST_POINTS {
            return Err(bad(
                "the file has more than 10 000 000 viewpoints; remove some",
            ));
        }
        if weight > 0.0 {
            points.push(WeightedViewpoint { point, weight });
        }
    }
    match points.is_empty() {
        true => Err(ViewpointsError::None(
            "the file has no viewpoints with a weight above 0".to_owned(),
        )),
        false => Ok(points),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_with_and_without_weights_are_read() {
        let text = "# telemetry\n1 2 3\n\n4,5,6 , 0.5 # often\r\n0 0 0 0\n";
        let points = read(text.as_bytes()).unwrap();
        let expected = [([1.0, 2.0, 3.0], 1.0), ([4.0, 5.0, 6.0], 0.5)];
        assert_eq!(
            points,
            expected.map(|(point, weight)| WeightedViewpoint { point, weight })
        );
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, part) in [
            ("0 0 3\n0 0", "line 2"),
            ("1 2 3 4 5", "5 numbers"),
            ("0 zero 3", "“zero”"),
            ("0 0 nan", "finite"),
            ("0 0 1e99", "finite"),
            ("0 0 0 -1", "weight"),
            ("0 0 0 inf", "weight"),
            ("# none", "no viewpoints"),
            ("1 1 1 0", "no viewpoints"),
        ] {
            let message = read(text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        assert!(read(&b"1 1 \xff"[..]).is_err() && read("7".repeat(5000).as_bytes()).is_err());
    }
}
