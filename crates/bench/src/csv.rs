//! The measurements as CSV (RFC 4180 with plain line ends).

use csv::Writer;

use crate::curves::SceneCurves;
use crate::error::BenchError;
use crate::growth::Grown;

/// A file with a header and rows of the same length.
fn file<const N: usize>(
    header: [&str; N],
    rows: impl Iterator<Item = [String; N]>,
) -> Result<String, BenchError> {
    let mut writer = Writer::from_writer(Vec::new());
    writer.write_record(header).map_err(BenchError::internal)?;
    for row in rows {
        writer.write_record(row).map_err(BenchError::internal)?;
    }
    let bytes = writer.into_inner().map_err(BenchError::internal)?;
    String::from_utf8(bytes).map_err(BenchError::internal)
}

/// A number, or nothing where it is unknown.
fn optional(n: Option<impl ToString>) -> String {
    n.map_or(String::new(), |n| n.to_string())
}

/// All points. Errors are fractions, times are in seconds.
pub fn curves(scenes: &[SceneCurves]) -> Result<String, BenchError> {
    let header = [
        "scene",
        "sampler",
        "parameter",
        "seconds",
        "mean_error",
        "p99_error",
        "max_error",
        "peak_mb",
        "bytes_per_cell",
        "samples",
        "mean_visible",
    ];
    let points = scenes.iter().flat_map(|scene| scene.points.iter().map(move |p| (scene, p)));
    file(
        header,
        points.map(|(scene, p)| {
            [
                scene.scene.clone(),
                p.sampler.name().to_owned(),
                p.parameter.clone(),
                p.seconds.to_string(),
                p.mean_error.to_string(),
                p.p99_error.to_string(),
                p.max_error.to_string(),
                optional(p.peak_mb),
                p.bytes_per_cell.to_string(),
                p.samples.to_string(),
                p.mean_visible.to_string(),
            ]
        }),
    )
}

/// How time and memory grow.
pub fn growth(rows: &[Grown]) -> Result<String, BenchError> {
    let header = ["grows", "scene", "triangles", "cells", "workers", "seconds", "peak_mb", "bytes_per_cell"];
    file(
        header,
        rows.iter().map(|g| {
            [
                g.grows.name().to_owned(),
                g.scene.clone(),
                g.triangles.to_string(),
                g.cells.to_string(),
                optional(g.workers),
                g.seconds.to_string(),
                optional(g.peak_mb),
                g.bytes_per_cell.to_string(),
            ]
        }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_a_comma_is_quoted_and_lines_end_plainly() {
        let scenes = [crate::svg::tests::example("a,b")];
        let text = curves(&scenes).unwrap();
        assert!(text.starts_with("scene,sampler,parameter,seconds,"));
        assert!(text.contains("\n\"a,b\",") && !text.contains('\r'), "{text}");
        assert_eq!(text.lines().count(), 1 + scenes[0].points.len());
    }
}
