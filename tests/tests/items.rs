//! Tests of results whose sets contain clusters or objects, of the guarantee for a minimum share, and of
//! contributions.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests"
)]

use std::collections::BTreeSet;

use serde_json::Value;
use sightline_tests::{Sandbox, assert_same};

const CELLS: &str = "--cells 3x2x3";

fn town() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --triangles 900 -o rooms.glb");
    sandbox
}

fn sets(sandbox: &Sandbox, file: &str, items: &str) -> Vec<BTreeSet<u64>> {
    let text = sandbox.ok(&format!("dump {file} --items {items}"));
    let lines = text
        .lines()
        .skip(1)
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines
        .map(|l| {
            l["visible"]
                .as_array()
                .unwrap()
                .iter()
                .map(|id| id.as_u64().unwrap())
                .collect()
        })
        .collect()
}

#[test]
fn objects_and_clusters_match_exact_result() {
    let sandbox = town();
    sandbox.ok(&format!(
        "bake rooms.glb -o exact.pvs --data-dir e {CELLS} --method exact"
    ));
    let exact = sets(&sandbox, "exact.pvs", "objects");
    let triangles = sets(&sandbox, "exact.pvs", "triangles");
    for (name, flags) in [
        ("lines", "--complete off --backend cpu"),
        ("gpu", "--complete off --backend gpu --target-error 0.01"),
        ("guided", "--sampler guided --rays 5000"),
        ("cubes", "--sampler cubes --resolution 32 --backend cpu"),
    ] {
        let job = format!("bake rooms.glb {CELLS} --granularity objects {flags}");
        sandbox.ok(&format!(
            "{job} -o {name}.pvs --data-dir {name} --workers 1"
        ));
        let found = sets(&sandbox, &format!("{name}.pvs"), "objects");
        assert!(
            found.iter().zip(&exact).all(|(f, e)| f.is_subset(e)),
            "{name}"
        );
        // All triangles of the visible objects are drawn.
        let drawn = sets(&sandbox, &format!("{name}.pvs"), "triangles");
        assert!(drawn.iter().zip(&found).all(|(t, o)| t.len() >= o.len()));
    }
    sandbox.ok(&format!(
        "bake rooms.glb {CELLS} --granularity objects -o b.pvs --data-dir b --workers 4 --backend cpu \
         --complete off"
    ));
    assert_same(
        &sandbox.read("lines.pvs"),
        &sandbox.read("b.pvs"),
        "one worker and four",
    );
    sandbox.ok(&format!(
        "bake rooms.glb {CELLS} --granularity clusters -o clusters.pvs --data-dir c"
    ));
    let text = sandbox.ok("dump clusters.pvs --items clusters");
    let header: Value = serde_json::from_str(text.lines().next().unwrap()).unwrap();
    let clusters: Vec<Vec<u64>> = serde_json::from_value(header["clusters"].clone()).unwrap();
    assert!(clusters.iter().all(|c| (1..=128).contains(&c.len())));
    let mut all: Vec<u64> = clusters.iter().flatten().copied().collect();
    all.sort_unstable();
    assert!(
        all.windows(2).all(|w| w[0] < w[1]),
        "no triangle is in two clusters"
    );
    // Whole clusters are drawn, and a set contains a cluster only if the exact set contains a part of it.
    let drawn = sets(&sandbox, "clusters.pvs", "triangles");
    for ((listed, drawn), exact) in sets(&sandbox, "clusters.pvs", "clusters")
        .iter()
        .zip(&drawn)
        .zip(&triangles)
    {
        let expected: BTreeSet<u64> = listed
            .iter()
            .flat_map(|c| clusters[*c as usize].clone())
            .collect();
        assert_eq!(&expected, drawn);
        assert!(
            listed
                .iter()
                .all(|c| clusters[*c as usize].iter().any(|t| exact.contains(t)))
        );
    }
    let report = sandbox.json("measure rooms.glb clusters.pvs --viewpoints 30 --resolution 32");
    assert!(report["mean_error"].as_f64().unwrap() < 2e-3, "{report}");
    sandbox
        .run("dump lines.pvs --items clusters")
        .code(3)
        .says("--granularity clusters");
    sandbox
        .run(&format!(
            "bake rooms.glb -o x.pvs {CELLS} --granularity objects --method exact"
        ))
        .code(2)
        .says("--method aggressive");
}

#[test]
fn bake_of_objects_finds_small_ones() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate town --triangles 60000 -o town.glb");
    let job = "bake town.glb --cells 4x4x1 --target-error 0.001 --backend cpu";
    sandbox.ok(&format!("{job} -o triangles.pvs --data-dir t"));
    sandbox.ok(&format!(
        "{job} -o objects.pvs --data-dir o --granularity objects"
    ));
    let [triangles, objects] =
        ["triangles", "objects"].map(|name| sets(&sandbox, &format!("{name}.pvs"), "objects"));
    let count = |sets: &[BTreeSet<u64>]| sets.iter().map(BTreeSet::len).sum::<usize>();
    let both: usize = objects
        .iter()
        .zip(&triangles)
        .map(|(o, t)| o.intersection(t).count())
        .sum();
    let (objects, triangles) = (count(&objects), count(&triangles));
    // The sets of two seeds of a bake of triangles have 88 % in common. In eight pairs of bakes, with both
    // backends, three seeds and two target errors, the bake of objects found 83 to 90 % as many objects as
    // the bake of triangles, and 77 to 83 % of the same.
    assert!(
        triangles > 500 && both * 4 > triangles * 3,
        "{both} of {triangles}"
    );
    assert!(
        objects * 5 > triangles * 4,
        "{objects} instead of {triangles}"
    );
}

#[test]
fn items_of_minimum_share_are_missed_within_guarantee() {
    const SHARE: f64 = 0.005;
    let sandbox = town();
    // The share of each object in each cell, measured with many lines.
    sandbox.ok(&format!(
        "bake rooms.glb {CELLS} --granularity objects --contributions -o all.pvs --data-dir a"
    ));
    let text = sandbox.ok("dump all.pvs --items objects --contributions");
    let large: Vec<BTreeSet<u64>> = text
        .lines()
        .skip(1)
        .map(|line| {
            let line: Value = serde_json::from_str(line).unwrap();
            let ids = line["visible"].as_array().unwrap().iter();
            let shares = line["contributions"].as_array().unwrap().iter();
            // The lower bound of the mean is above the share: the minimum of its level.
            let above = |c: &Value| c["mean"][0].as_f64().unwrap() >= SHARE;
            ids.zip(shares)
                .filter(|(_, c)| above(c))
                .map(|(id, _)| id.as_u64().unwrap())
                .collect()
        })
        .collect();
    let (mut pairs, mut missed) = (0, 0);
    let mut runs = Vec::new();
    for seed in 0..6 {
        let name = format!("s{seed}");
        sandbox.ok(&format!(
            "bake rooms.glb {CELLS} --granularity objects --min-share {SHARE} --seed {seed} -o {name}.pvs \
             --data-dir {name}"
        ));
        let found = sets(&sandbox, &format!("{name}.pvs"), "objects");
        for (found, large) in found.iter().zip(&large) {
            pairs += large.len();
            missed += large.difference(found).count();
        }
        runs.push(found);
    }
    assert!(pairs > 100, "{pairs}");
    assert!(missed * 20 <= pairs, "{missed} of {pairs}");
    // The sets of two seeds differ only in smaller items.
    for (found, large) in runs[0].iter().zip(&runs[1]).zip(&large) {
        let other: BTreeSet<u64> = found.0.symmetric_difference(found.1).copied().collect();
        assert!(other.intersection(large).count() * 20 <= large.len());
    }
    sandbox
        .run(&format!(
            "bake rooms.glb -o x.pvs {CELLS} --min-share 0.1 --sampler guided"
        ))
        .code(2);
}

#[test]
fn contributions_are_shares_of_the_view() {
    let sandbox = town();
    sandbox.ok(&format!(
        "bake rooms.glb {CELLS} --contributions -o t.pvs --data-dir t"
    ));
    sandbox.ok(&format!("bake rooms.glb {CELLS} -o plain.pvs --data-dir p"));
    assert_eq!(
        sets(&sandbox, "t.pvs", "triangles"),
        sets(&sandbox, "plain.pvs", "triangles")
    );
    let text = sandbox.ok("dump t.pvs --contributions");
    for line in text
        .lines()
        .skip(1)
        .map(|l| serde_json::from_str::<Value>(l).unwrap())
    {
        let all = line["contributions"].as_array().unwrap();
        assert_eq!(all.len(), line["visible"].as_array().unwrap().len());
        let sum = |measure: &str, end: usize| {
            all.iter()
                .map(|c| c[measure][end].as_f64().unwrap())
                .sum::<f64>()
        };
        // The rooms are closed except for windows: nearly every direction meets one item, and none meets two.
        assert!(
            sum("mean", 0) <= 1.0 && sum("mean", 1) >= 0.5,
            "{} {}",
            sum("mean", 0),
            sum("mean", 1)
        );
        assert!(
            all.iter()
                .all(|c| c["mean"][0].as_f64() <= c["greatest"][1].as_f64())
        );
    }
    sandbox
        .run("dump plain.pvs --contributions")
        .code(3)
        .says("bake with --contributions");
    sandbox
        .run("dump t.pvs --items objects --contributions")
        .code(3)
        .says("--granularity objects");
}
