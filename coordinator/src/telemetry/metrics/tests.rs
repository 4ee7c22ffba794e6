//! Tests that the table of metrics in the manual equals the served metrics.

use std::collections::BTreeMap;

use sightline_scheduler::{Counts, WorkerStatus};
use sightline_store::Carried;

use super::*;

const MANUAL: &str = include_str!("../../../../docs/operations.md");

fn readings() -> FarmReadings {
    FarmReadings {
        ready: true,
        jobs: Vec::new(),
        members: Vec::new(),
        quarantined: 0,
        data_dir: None,
        carried: Some(Carried::default()),
    }
}

/// Returns the names of the served metrics as in samples, with their types.
fn served() -> BTreeMap<String, String> {
    let metrics = Metrics::default();
    // A metric with labels is served only after it has a value.
    metrics.committed("cpu/x", 1, 1);
    metrics.phase_done("cpu/x", Duration::from_millis(1));
    metrics.job_ended("done");
    metrics.transferred("in").inc();
    metrics.cache_request("scene", CacheOutcome::Hit);
    metrics.spot_check("same");
    metrics.request("Jobs/List", "OK", Duration::ZERO);
    metrics.refused("jobs");
    metrics.addressed("read");
    metrics.went_directly("read", 1);
    metrics.fell_back("read");
    let directory = tempfile::tempdir().unwrap();
    let member = WorkerStatus {
        name: "ada".to_owned(),
        version: String::new(),
        profiles: vec!["cpu/x".to_owned()],
        connected_at: 0,
        heard_at: 0,
        draining: false,
        trouble: None,
        tiles: Vec::new(),
        helps: None,
        done: Default::default(),
    };
    let job = Counts {
        state: "running",
        profile: "cpu/x".to_owned(),
        ready: 1,
        leased: 1,
        waiting: 1,
    };
    let (jobs, members) = (vec![job], vec![member]);
    let text = metrics.text(FarmReadings {
        jobs,
        members,
        data_dir: Some(directory.path().to_owned()),
        ..readings()
    });
    let text = text.unwrap();
    let name_and_kind = |line: &str| {
        let (name, kind) = line.strip_prefix("# TYPE ")?.split_once(' ')?;
        let name = if kind == "counter" {
            format!("{name}_total")
        } else {
            name.to_owned()
        };
        Some((
            name,
            if kind == "info" {
                "gauge".to_owned()
            } else {
                kind.to_owned()
            },
        ))
    };
    text.lines()
        .filter_map(name_and_kind)
        .map(|(name, kind)| match name.as_str() {
            "sightline_build" => ("sightline_build_info".to_owned(), kind),
            _ => (name, kind),
        })
        .collect()
}

#[test]
fn manual_lists_exactly_served_metrics() {
    let row = |line: &str| {
        let mut cells = line.strip_prefix("| `sightline_")?.split('|');
        let name = cells
            .next()?
            .trim()
            .trim_end_matches('`')
            .split(['{', '`'])
            .next()?
            .to_owned();
        Some((format!("sightline_{name}"), cells.next()?.trim().to_owned()))
    };
    let manual: BTreeMap<String, String> = MANUAL.lines().filter_map(row).collect();
    assert_eq!(manual, served());
}

#[test]
fn recorded_values_are_served() {
    let metrics = Metrics::default();
    metrics.committed("cpu/x", 17, 2500);
    metrics.request("Jobs/Submit", "OK", Duration::from_millis(20));
    metrics.phase_done("cpu/x", Duration::from_millis(250));
    // Workers of earlier versions do not report the duration.
    metrics.phase_done("cpu/x", Duration::ZERO);
    metrics.refused("rate");
    metrics.cache_request("scene", CacheOutcome::Miss);
    metrics.syncs()(Duration::from_millis(2));
    let text = metrics.text(readings()).unwrap();
    for line in [
        "sightline_samples_total{profile=\"cpu/x\"} 17",
        "sightline_tile_seconds_sum{profile=\"cpu/x\"} 2.5",
        "sightline_phases_total 2",
        "sightline_phase_seconds_sum{profile=\"cpu/x\"} 0.25",
        "sightline_phase_seconds_count{profile=\"cpu/x\"} 1",
        "sightline_requests_total{method=\"Jobs/Submit\",code=\"OK\"} 1",
        "sightline_refused_total{limit=\"rate\"} 1",
        "sightline_cache_requests_total{cache=\"scene\",outcome=\"miss\"} 1",
        "sightline_sync_seconds_count 1",
        "sightline_ready 1",
        "sightline_jobs{state=\"running\"} 0",
    ] {
        assert!(text.contains(line), "{line} in {text}");
    }
}
