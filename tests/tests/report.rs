//! Tests of `sightline report`: the error, the cells over a budget, and the responsible opening.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use sightline_tests::{Browser, Sandbox, across, house};

/// Returns a house of two rooms with a door, and an object of many triangles in the eastern room. The door is
/// at y 0 to 1 and z 0.8 to 1.2.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    let mut parts: Vec<(String, [[f32; 3]; 4])> = vec![
        ("south".to_owned(), across(2.0, [0.0, 2.0], [0.0, 0.8])),
        ("north".to_owned(), across(2.0, [0.0, 2.0], [1.2, 2.0])),
        ("lintel".to_owned(), across(2.0, [1.0, 2.0], [0.8, 1.2])),
    ];
    for k in 0..60 {
        let (y, z) = (0.15 * (k % 6) as f32, 0.9 + 0.02 * (k / 6) as f32);
        parts.push((
            "carving".to_owned() + &k.to_string(),
            across(3.6, [y, y + 0.1], [z, z + 0.015]),
        ));
    }
    let named: Vec<(&str, [[f32; 3]; 4])> = parts
        .iter()
        .map(|(name, quad)| (name.as_str(), *quad))
        .collect();
    sandbox.write("house.obj", house(&named));
    let west = "--view-box 0.1,0.1,0.1,1.9,1.9,1.9 --cells 3x2x3";
    sandbox.ok(&format!(
        "bake house.obj -o house.pvs --target-error 0.00001 --backend cpu {west}"
    ));
    sandbox
}

#[test]
fn report_names_responsible_door() {
    let sandbox = sandbox();
    let line =
        "report house.pvs house.obj -o report.html --viewpoints 40 --resolution 64 --backend cpu";
    let found = sandbox.json(line);
    let openings = found["blame"]["openings"].as_array().unwrap();
    // The reported boxes are in the door or behind it, on the way to the carvings, and not above it or at its
    // sides.
    let is_on_the_way = |o: &serde_json::Value| {
        let at =
            |corner: usize, axis: usize| o["opening"]["bounds"][corner][axis].as_f64().unwrap();
        at(0, 0) >= 1.6 && at(1, 0) <= 3.6 && at(0, 1) <= 1.0 && at(0, 2) <= 1.1 && at(1, 2) >= 0.9
    };
    assert!(
        !openings.is_empty() && openings.iter().all(is_on_the_way),
        "{openings:?}"
    );
    let objects = found["blame"]["objects"].as_array().unwrap();
    let carving = objects
        .iter()
        .find(|o| o["name"].as_str().unwrap().starts_with("carving"))
        .unwrap();
    assert!(
        carving["cells"].as_u64().unwrap() > 4 && carving["joined"].as_u64().unwrap() > 4,
        "{carving}"
    );
    assert!(openings[0]["saves"].as_f64().unwrap() > 0.0);
    // The report does not depend on the schedule of threads.
    assert_eq!(sandbox.json(line)["blame"], found["blame"]);
    let page = String::from_utf8(sandbox.read("report.html")).unwrap();
    assert!(page.contains("<svg") && page.contains("carving"));
    if let Some(browser) = Browser::start([1000, 900]) {
        browser.open(&format!("file://{}", sandbox.path("report.html").display()));
        let count = browser.run("return document.querySelectorAll('svg, table tr').length");
        assert!(count.as_u64().unwrap() > 10, "{count}");
        assert_eq!(browser.messages(), Vec::<String>::new());
    }
}

#[test]
fn budget_names_cells_and_fails_build() {
    let sandbox = sandbox();
    let line = "report house.pvs house.obj -o report.html --viewpoints 4 --resolution 32 \
                --backend cpu --budget";
    sandbox.write("small.json", r#"{"triangles": 20, "objects": 1000}"#);
    let over = sandbox.json(&format!("{line} small.json"))["over_budget"].clone();
    let dump = sandbox.dump("house.pvs");
    let expected = dump
        .cells
        .iter()
        .filter(|cell| cell.visible.len() > 20)
        .count();
    assert!(expected > 0);
    let over = over.as_array().unwrap();
    assert_eq!(over.len(), expected);
    assert!(over.is_sorted_by(|a, b| a["times"].as_f64() >= b["times"].as_f64()));
    let first = over[0]["cell"].as_u64().unwrap() as usize;
    assert_eq!(
        over[0]["triangles"].as_u64().unwrap(),
        dump.cells[first].visible.len() as u64
    );
    let failed = sandbox
        .run(&format!("{line} small.json --fail-over-budget"))
        .code(6);
    assert!(failed.err.contains("over the budget"), "{}", failed.err);
    sandbox.write("large.json", r#"{"bytes": 100000000}"#);
    sandbox
        .run(&format!("{line} large.json --fail-over-budget"))
        .code(0);
    for (name, text) in [
        ("typo.json", r#"{"triangle": 3}"#),
        ("none.json", "{}"),
        ("bad.json", "{"),
    ] {
        sandbox.write(name, text);
        sandbox
            .run(&format!("{line} {name}"))
            .code(3)
            .says("give --budget a JSON object");
    }
    sandbox.write("other.obj", house(&[]));
    sandbox
        .run("report house.pvs other.obj -o report.html")
        .code(3);
}
