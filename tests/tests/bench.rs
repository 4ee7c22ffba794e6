//! Tests of `sightline bench`: a small run writes every file, and its table of points is complete and
//! correct.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::collections::BTreeMap;

use sightline_tests::Sandbox;

/// Parses the rows of a CSV file without quotes, by the names of the header.
fn rows(text: &str) -> Vec<BTreeMap<&str, &str>> {
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    lines
        .map(|line| {
            assert_eq!(line.len(), header.len(), "{line:?}");
            header.iter().copied().zip(line).collect()
        })
        .collect()
}

fn number(row: &BTreeMap<&str, &str>, column: &str) -> f64 {
    row[column]
        .parse()
        .unwrap_or_else(|e| panic!("{column} is {:?}: {e}", row[column]))
}

#[test]
fn small_run_writes_points_with_repeats_and_all_curves() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 3x3 -o maze.glb");
    // The coarsest point of each sampler is accurate enough.
    let report = sandbox.json(
        "bench maze.glb --samplers lines,max-error,verified,exact --cells 4x1x4 --viewpoints 4 \
         --resolution 16 --least-error 1 --repeat 2 --out out --results out/RESULTS.md",
    );
    let csv = String::from_utf8(sandbox.read("out/curves.csv")).unwrap();
    let rows = rows(&csv);
    for row in &rows {
        assert_eq!((row["scene"], row["repeats"]), ("maze", "2"), "{row:?}");
        let [fastest, median, slowest] =
            ["seconds_min", "seconds", "seconds_max"].map(|c| number(row, c));
        assert!(
            0.0 < fastest && fastest <= median && median <= slowest,
            "{row:?}"
        );
        assert!(
            (fastest + slowest - 2.0 * median).abs() < 1e-9,
            "the median of two is their mean: {row:?}"
        );
        if cfg!(target_os = "linux") {
            assert!(number(row, "cpu_seconds") > 0.0, "{row:?}");
            assert!(
                number(row, "cpu_seconds_min") <= number(row, "cpu_seconds_max"),
                "{row:?}"
            );
        }
    }
    let rows_of = |sampler: &str| {
        rows.iter()
            .filter(|r| r["sampler"] == sampler)
            .collect::<Vec<_>>()
    };

    let [lines] = rows_of("lines")[..] else {
        panic!("{csv}")
    };
    assert_eq!((lines["cells"], lines["greatest_bound"]), ("16", ""));
    let [bounded] = rows_of("max-error")[..] else {
        panic!("{csv}")
    };
    assert_eq!(bounded["parameter"], "--max-error 0.03");
    assert!(number(bounded, "greatest_bound") <= 0.03, "{bounded:?}");

    // Sixteen cells of a maze are decided before the smallest time budget ends.
    let verified = rows_of("verified");
    assert_eq!(
        number(verified.last().unwrap(), "undecided_share"),
        0.0,
        "{csv}"
    );
    assert!(
        verified
            .iter()
            .all(|r| (0.0..1.0).contains(&number(r, "undecided_share"))),
        "{csv}"
    );

    // A block does not have more layers than the grid.
    let cells: Vec<_> = rows_of("exact").iter().map(|r| r["cells"]).collect();
    assert_eq!(cells, ["1", "4"]);
    assert!(
        rows_of("exact")
            .iter()
            .all(|r| number(r, "undecided_share") == 0.0)
    );

    let page = String::from_utf8(sandbox.read("out/RESULTS.md")).unwrap();
    for part in [
        "other work: ",
        "Each point was run 2 times",
        "CPU s/cell",
        "--time-budget 1s",
        " bound |",
    ] {
        assert!(page.contains(part), "{part} is not in {page}");
    }
    let points = report["scenes"][0]["points"].as_array().unwrap();
    assert_eq!(points.len(), rows.len());
    for (point, row) in points.iter().zip(&rows) {
        // The last digit of a number that is read from JSON may differ.
        assert!(
            (point["seconds"].as_f64().unwrap() - number(row, "seconds")).abs() < 1e-9,
            "{point}"
        );
    }
}

#[test]
fn growth_is_repeated_and_zero_repeats_are_rejected() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 2x2 -o maze.glb");
    sandbox.ok("bench maze.glb --grow workers --grow-error 1 --cells 2x1x2 --repeat 3 --out out");
    let csv = String::from_utf8(sandbox.read("out/growth.csv")).unwrap();
    let rows = rows(&csv);
    assert_eq!(
        rows.iter().map(|r| r["workers"]).collect::<Vec<_>>(),
        ["1", "2", "4"]
    );
    assert!(rows.iter().all(|r| r["repeats"] == "3"), "{csv}");
    sandbox.run("bench maze.glb --repeat 0").code(2);
}
