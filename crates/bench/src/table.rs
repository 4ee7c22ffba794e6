//! The tables, as Markdown that is also readable in a terminal.

use crate::curves::SceneCurves;
use crate::frontier::{ERRORS, Needed, Ratio, geometric_mean, seconds};
use crate::growth::Grown;
use crate::ladder::{Sampler, Shows};
use crate::percent::percent;
use crate::timing::Times;

/// A header and rows of equal length.
#[derive(Debug)]
pub struct Table {
    pub header: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new<const N: usize>(header: [&str; N]) -> Self {
        Self {
            header: header.map(str::to_owned).to_vec(),
            rows: Vec::new(),
        }
    }

    /// Returns Markdown with columns of even width. The first column is left-aligned, and the others, mostly
    /// numbers, are right-aligned.
    pub fn markdown(&self) -> String {
        let all = || std::iter::once(&self.header).chain(&self.rows);
        let escaped = |text: &str| text.replace('|', "\\|");
        let width = |column: usize| {
            let widths = all()
                .filter_map(|r| r.get(column))
                .map(|c| escaped(c).chars().count());
            widths.max().unwrap_or(0).max(3)
        };
        let widths: Vec<_> = (0..self.header.len()).map(width).collect();
        let line = |row: &Vec<String>| {
            let cells = row
                .iter()
                .zip(&widths)
                .enumerate()
                .map(|(i, (cell, &width))| match i {
                    0 => format!(" {:<width$} |", escaped(cell)),
                    _ => format!(" {:>width$} |", escaped(cell)),
                });
            format!("|{}\n", cells.collect::<String>())
        };
        let rule = widths.iter().enumerate().map(|(i, &width)| match i {
            0 => format!("-{}-|", "-".repeat(width)),
            _ => format!("-{}:|", "-".repeat(width)),
        });
        let rule = format!("|{}\n", rule.collect::<String>());
        std::iter::once(line(&self.header))
            .chain([rule])
            .chain(self.rows.iter().map(line))
            .collect()
    }
}

pub fn megabytes(mb: Option<f64>) -> String {
    mb.map_or("?".to_owned(), |mb| format!("{mb:.0}"))
}

fn times(ratio: Option<Ratio>) -> String {
    ratio.map_or("-".to_owned(), Ratio::text)
}

/// Returns, for each of [`ERRORS`], the mean ratio of the baseline's time to the time of lines. The mean is
/// geometric, over the scenes with a known ratio. The third value is the number of these scenes. The mean is
/// `None` if the baseline reaches the error on some scene and lines do not.
pub fn mean_ratios(scenes: &[SceneCurves]) -> Vec<(f64, Option<Ratio>, usize)> {
    let lost = |s: &SceneCurves, error| {
        matches!(
            s.needed(Sampler::Guided, error),
            Needed::Seconds(_) | Needed::AtMost(_)
        ) && matches!(s.needed(Sampler::Lines, error), Needed::MoreThan(_))
    };
    let mean = |error| {
        let ratios: Vec<_> = scenes.iter().filter_map(|s| s.ratio(error)).collect();
        let known = !scenes.iter().any(|s| lost(s, error));
        (
            error,
            geometric_mean(&ratios).filter(|_| known),
            ratios.len(),
        )
    };
    ERRORS.map(mean).to_vec()
}

/// Returns true if a scene has a curve of time against error.
pub fn has_errors(scenes: &[SceneCurves]) -> bool {
    scenes.iter().any(|s| !s.showing(Shows::Error).is_empty())
}

/// Returns the table of the seconds that each sampler needs for an error.
pub fn needed(scenes: &[SceneCurves]) -> Table {
    let samplers = scenes
        .first()
        .map_or(Vec::new(), |s| s.showing(Shows::Error));
    let compares = [Sampler::Guided, Sampler::Lines]
        .iter()
        .all(|s| samplers.contains(s));
    let mut table = Table::new(["scene", "mean error"]);
    table
        .header
        .extend(samplers.iter().map(|s| format!("{} s", s.name())));
    if compares {
        table.header.push("guided / lines".to_owned());
    }
    for scene in scenes {
        for error in ERRORS {
            let mut row = vec![scene.scene.clone(), target(error)];
            row.extend(samplers.iter().map(|&s| scene.needed(s, error).text()));
            if compares {
                row.push(times(scene.ratio(error)));
            }
            table.rows.push(row);
        }
    }
    if compares && scenes.len() > 1 {
        for (error, mean, count) in mean_ratios(scenes) {
            let mut row = vec![format!("geometric mean of {count} scenes"), target(error)];
            row.extend(samplers.iter().map(|_| String::new()));
            row.push(times(mean));
            table.rows.push(row);
        }
    }
    table
}

/// Formats one of [`ERRORS`] without trailing zeros.
fn target(error: f64) -> String {
    format!("{} %", (error * 1e6).round() / 1e4)
}

/// Returns the table of the growth of time and memory.
pub fn growth(rows: &[Grown]) -> Table {
    let mut table = Table::new([
        "grows",
        "scene",
        "triangles",
        "cells",
        "workers",
        "s",
        "spread",
        "CPU s",
        "MB",
        "B/cell",
    ]);
    table.rows.extend(rows.iter().map(|g| {
        vec![
            g.grows.name().to_owned(),
            g.scene.clone(),
            g.triangles.to_string(),
            g.cells.to_string(),
            g.workers
                .map_or("one per core".to_owned(), |w| w.to_string()),
            seconds(g.times.seconds),
            spread(&g.times),
            cpu(g.times.cpu_seconds),
            megabytes(g.peak_mb),
            format!("{:.0}", g.bytes_per_cell),
        ]
    }));
    table
}

/// Returns the spread of the runs of a point, or `-` for one run.
pub fn spread(times: &Times) -> String {
    times.spread().map_or("-".to_owned(), percent)
}

/// Returns CPU seconds, or `?` if they are unknown.
pub fn cpu(seconds_known: Option<f64>) -> String {
    seconds_known.map_or("?".to_owned(), seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_are_short() {
        assert_eq!(
            ERRORS.map(target),
            ["1 %", "0.3 %", "0.1 %", "0.03 %", "0.01 %"]
        );
    }

    #[test]
    fn columns_are_even_and_bars_escaped() {
        let mut table = Table::new(["scene", "s"]);
        table.rows.push(vec!["a|b".to_owned(), "12.5".to_owned()]);
        assert_eq!(
            table.markdown(),
            "| scene |    s |\n|-------|-----:|\n| a\\|b  | 12.5 |\n"
        );
    }
}
