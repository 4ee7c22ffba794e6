//! The measurements as CSV (RFC 4180, but with line ends of one line feed).

use csv::Writer;

use crate::curves::SceneCurves;
use crate::error::BenchError;
use crate::growth::Grown;

/// Returns a file with a header and rows of equal length.
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

/// Returns a number as text, or an empty text if the number is unknown.
fn optional(n: Option<impl ToString>) -> String {
    n.map_or(String::new(), |n| n.to_string())
}

/// Returns all points as CSV. Errors and shares are fractions, and times are in seconds. The first eleven
/// columns are older than the other columns and keep their positions.
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
        "repeats",
        "seconds_min",
        "seconds_max",
        "cpu_seconds",
        "cpu_seconds_min",
        "cpu_seconds_max",
        "others_share",
        "cells",
        "undecided_share",
        "greatest_bound",
    ];
    let points = scenes
        .iter()
        .flat_map(|scene| scene.points.iter().map(move |p| (scene, p)));
    file(
        header,
        points.map(|(scene, p)| {
            [
                scene.scene.clone(),
                p.sampler.name().to_owned(),
                p.parameter.clone(),
                p.times.seconds.to_string(),
                p.mean_error.to_string(),
                p.p99_error.to_string(),
                p.max_error.to_string(),
                optional(p.peak_mb),
                p.bytes_per_cell.to_string(),
                p.samples.to_string(),
                p.mean_visible.to_string(),
                p.times.repeats.to_string(),
                p.times.seconds_min.to_string(),
                p.times.seconds_max.to_string(),
                optional(p.times.cpu_seconds),
                optional(p.times.cpu_seconds_min),
                optional(p.times.cpu_seconds_max),
                optional(p.times.others_share),
                p.cells.to_string(),
                p.undecided_share.to_string(),
                optional(p.greatest_bound),
            ]
        }),
    )
}

/// Returns the growth of time and memory as CSV.
pub fn growth(rows: &[Grown]) -> Result<String, BenchError> {
    let header = [
        "grows",
        "scene",
        "triangles",
        "cells",
        "workers",
        "seconds",
        "peak_mb",
        "bytes_per_cell",
        "repeats",
        "seconds_min",
        "seconds_max",
        "cpu_seconds",
        "others_share",
    ];
    file(
        header,
        rows.iter().map(|g| {
            [
                g.grows.name().to_owned(),
                g.scene.clone(),
                g.triangles.to_string(),
                g.cells.to_string(),
                optional(g.workers),
                g.times.seconds.to_string(),
                optional(g.peak_mb),
                g.bytes_per_cell.to_string(),
                g.times.repeats.to_string(),
                g.times.seconds_min.to_string(),
                g.times.seconds_max.to_string(),
                optional(g.times.cpu_seconds),
                optional(g.times.others_share),
            ]
        }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_commas_are_quoted_and_lines_end_with_lf() {
        let scenes = [crate::curves::tests::example("a,b")];
        let text = curves(&scenes).unwrap();
        assert!(text.starts_with("scene,sampler,parameter,seconds,"));
        assert!(
            text.contains("\n\"a,b\",") && !text.contains('\r'),
            "{text}"
        );
        assert_eq!(text.lines().count(), 1 + scenes[0].points.len());
    }

    #[test]
    fn old_columns_keep_places_and_rows_are_complete() {
        let text = curves(&[crate::curves::tests::example("a")]).unwrap();
        let old = "scene,sampler,parameter,seconds,mean_error,p99_error,max_error,peak_mb,bytes_per_cell,\
                   samples,mean_visible,repeats,";
        assert!(text.starts_with(old), "{text}");
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let header = reader.headers().unwrap().clone();
        let at = |name: &str| header.iter().position(|h| h == name).unwrap();
        let rows: Vec<_> = reader.records().map(Result::unwrap).collect();
        for row in &rows {
            let number = |name: &str| row[at(name)].parse::<f64>().unwrap();
            assert!(number("seconds_min") <= number("seconds"), "{row:?}");
            assert!(number("seconds") <= number("seconds_max"), "{row:?}");
            assert_eq!(number("repeats"), 3.0);
            assert_eq!(row[at("greatest_bound")].is_empty(), &row[1] != "max-error");
        }
    }
}
