//! The tables of one scene: the measured points, by the quantities that their curves show.

use crate::curves::{Point, SceneCurves};
use crate::frontier::seconds;
use crate::ladder::Shows;
use crate::percent::percent;
use crate::table::{Table, cpu, megabytes, spread};

/// Returns the points of a scene whose curves show `shows`.
fn showing(scene: &SceneCurves, shows: Shows) -> impl Iterator<Item = &Point> {
    scene
        .points
        .iter()
        .filter(move |p| p.sampler.shows() == shows)
}

/// Returns the table of time against error.
pub fn errors(scene: &SceneCurves) -> Table {
    let bounded = showing(scene, Shows::Error).any(|p| p.greatest_bound.is_some());
    let mut table = Table::new([
        "sampler",
        "parameter",
        "s",
        "spread",
        "CPU s",
        "mean",
        "p99",
        "max",
    ]);
    table.header.extend(bounded.then(|| "bound".to_owned()));
    table
        .header
        .extend(["MB", "B/cell", "samples", "visible"].map(str::to_owned));
    for p in showing(scene, Shows::Error) {
        let mut row = vec![
            p.sampler.name().to_owned(),
            p.parameter.clone(),
            seconds(p.times.seconds),
            spread(&p.times),
            cpu(p.times.cpu_seconds),
            percent(p.mean_error),
            percent(p.p99_error),
            percent(p.max_error),
        ];
        row.extend(bounded.then(|| p.greatest_bound.map_or("-".to_owned(), percent)));
        row.extend([
            megabytes(p.peak_mb),
            format!("{:.0}", p.bytes_per_cell),
            format!("{:.0}", p.samples),
            format!("{:.0}", p.mean_visible),
        ]);
        table.rows.push(row);
    }
    table
}

/// Returns the table of undecided triangles over time.
pub fn undecided(scene: &SceneCurves) -> Table {
    let mut table = Table::new([
        "parameter",
        "s",
        "spread",
        "CPU s",
        "undecided",
        "to draw",
        "MB",
    ]);
    table.rows.extend(showing(scene, Shows::Undecided).map(|p| {
        vec![
            p.parameter.clone(),
            seconds(p.times.seconds),
            spread(&p.times),
            cpu(p.times.cpu_seconds),
            percent(p.undecided_share),
            format!("{:.0}", p.mean_visible),
            megabytes(p.peak_mb),
        ]
    }));
    table
}

/// Returns the table of the time of exact cells.
pub fn cell_times(scene: &SceneCurves) -> Table {
    let mut table = Table::new([
        "cells",
        "s",
        "spread",
        "CPU s",
        "s/cell",
        "CPU s/cell",
        "undecided",
        "visible",
        "MB",
    ]);
    table.rows.extend(showing(scene, Shows::CellTime).map(|p| {
        vec![
            format!("{:.0}", p.cells),
            seconds(p.times.seconds),
            spread(&p.times),
            cpu(p.times.cpu_seconds),
            seconds(p.cell_seconds()),
            cpu(p.cell_cpu_seconds()),
            percent(p.undecided_share),
            format!("{:.0}", p.mean_visible),
            megabytes(p.peak_mb),
        ]
    }));
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curves::tests::example;
    use crate::ladder::Sampler;

    #[test]
    fn every_point_is_in_one_table() {
        let scene = example("a");
        let tables = [errors(&scene), undecided(&scene), cell_times(&scene)];
        assert_eq!(
            tables.iter().map(|t| t.rows.len()).sum::<usize>(),
            scene.points.len()
        );
        for table in tables {
            assert!(table.rows.iter().all(|row| row.len() == table.header.len()));
        }
    }

    #[test]
    fn bound_column_exists_only_for_bounded_points() {
        let mut scene = example("a");
        assert!(errors(&scene).header.contains(&"bound".to_owned()));
        scene.points.retain(|p| p.sampler != Sampler::MaxError);
        assert!(!errors(&scene).header.contains(&"bound".to_owned()));
    }

    #[test]
    fn tables_show_spread_of_runs_and_time_per_cell() {
        let scene = example("a");
        // The runs last 1, 1.25 and 1.5 times 0.4 s for one cell, and three times as long for eight cells.
        let rows = cell_times(&scene).rows;
        assert_eq!(
            rows[0][..6],
            ["1", "0.50", "40.0 %", "0.80", "0.50", "0.80"]
        );
        assert_eq!(
            rows[1][..6],
            ["8", "1.50", "40.0 %", "2.40", "0.19", "0.30"]
        );
        assert_eq!(undecided(&scene).rows[0][4], "10.0 %");
    }
}
