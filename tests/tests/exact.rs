//! Tests of bakes by exact queries, in one process and in a cluster with failures. Results are verified,
//! altered, queried for reasons, and cut short by a time budget.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::sync::OnceLock;

use serde_json::Value;
use sightline_pvs::{Builder, Header, Pvs};
use sightline_tests::{Sandbox, across, assert_same, house};

/// The scene: three walls with slits of a thousandth of their size. Triangles beyond the walls are visible
/// through at most two slits.
const SCENE: &str = "generate slits --grid 3x2 --slit-width 0.001 -o slits.glb";
const JOB: &str =
    "slits.glb --cells 3x2x2 --block-cells 1 --backend cpu --method exact --certificates";

/// Returns a folder with the scene and with `exact.pvs`.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    sandbox.write("exact.pvs", alone());
    sandbox
}

/// Returns the result of [`JOB`] in one process.
fn alone() -> &'static [u8] {
    static ALONE: OnceLock<Vec<u8>> = OnceLock::new();
    ALONE.get_or_init(|| {
        let sandbox = Sandbox::new();
        sandbox.ok(SCENE);
        sandbox.ok(&format!("bake {JOB} -o alone.pvs --data-dir data"));
        sandbox.read("alone.pvs")
    })
}

#[test]
fn disturbed_cluster_gives_same_bytes() {
    let sandbox = sandbox();
    let coordinator = sandbox.coordinator("data", "127.0.0.1:0");
    let job = coordinator.submit(JOB);
    let victim = coordinator.worker();
    coordinator.until(job, "a first tile", |job| {
        job["tiles_done"].as_u64().unwrap() > 0
    });
    victim.kill();
    let _heirs = [coordinator.worker(), coordinator.worker()];
    assert_same(
        &coordinator.finish(job),
        alone(),
        "after a worker was killed",
    );
}

#[test]
fn exact_result_is_decided_and_verified_and_contains_sampled_sets() {
    let sandbox = sandbox();
    let exact = sandbox.dump("exact.pvs");
    assert_eq!(exact.header["method"], "exact");
    assert!(exact.cells.iter().all(|c| c.undecided.is_empty()));
    sandbox.ok(
        "bake slits.glb --cells 3x2x2 --backend cpu --complete off -o sampled.pvs --data-dir data",
    );
    for (cell, sampled) in exact.cells.iter().zip(sandbox.dump("sampled.pvs").cells) {
        let seen = |t: &u64| cell.visible.binary_search(t).is_ok();
        assert!(
            sampled.visible.iter().all(seen),
            "sampling showed what is hidden"
        );
    }
    let report = sandbox.json("verify slits.glb exact.pvs");
    assert_eq!(report["accepted"], true);
    for kind in ["witnesses", "certificates", "meeting"] {
        assert!(report[kind].as_u64().unwrap() > 0, "{report}");
        assert_eq!(report[kind], report[format!("{kind}_checked")], "{report}");
    }
    let sampled = sandbox.json("verify slits.glb exact.pvs --sample 40 --seed 3");
    assert_eq!(sampled["witnesses"], report["witnesses"]);
    let checked = |r: &Value| r["witnesses_checked"].as_u64().unwrap();
    assert!(checked(&sampled) < checked(&report), "{sampled}");
    // The query statistics are part of the result.
    let info = sandbox.json("info exact.pvs");
    let decided = &info["decided"];
    let all = exact.cells.len() as u64 * exact.header["triangles"].as_u64().unwrap();
    let seen: u64 = exact.cells.iter().map(|c| c.visible.len() as u64).sum();
    assert_eq!(decided["hidden"], all - seen, "{info}");
    assert_eq!(decided["evidence_bytes"], report["evidence_bytes"]);
    assert_eq!(decided["cells_open"], 0);
    let lines = sandbox.ok("info exact.pvs");
    assert!(
        lines.lines().any(|l| l == "missed sight lines: none"),
        "{lines}"
    );
    assert!(sandbox.json("info sampled.pvs")["decided"].is_null());
    let cells = sandbox.json("info exact.pvs --cells");
    assert!(
        cells["per_cell"]
            .as_array()
            .unwrap()
            .iter()
            .any(|c| c["exact_queries"].as_u64() > Some(0)),
        "{cells}"
    );
}

#[test]
fn description_of_result_agrees_with_its_contents() {
    let sandbox = sandbox();
    let pvs = Pvs::from_bytes(alone()).unwrap();
    let said = |method: &str, info: &str, flags: u32| {
        let mut builder = Builder::new(Header {
            triangles: pvs.triangle_count(),
            method: method.to_owned(),
            tree: pvs.tree().clone(),
            objects: pvs.objects().to_vec(),
            info_json: info.to_owned(),
        })
        .unwrap();
        let mut visible = Vec::new();
        for cell in 0..pvs.cells() {
            pvs.visible(cell, &mut visible).unwrap();
            builder.push_cell(&visible, &[], flags).unwrap();
            builder
                .push_certificate(pvs.certificate(cell).unwrap().unwrap())
                .unwrap();
        }
        builder
            .set_pairs(pvs.cell_pairs().unwrap().unwrap())
            .unwrap();
        let mut file = Vec::new();
        builder.finish(&mut file).unwrap();
        sandbox.write("said.pvs", &file);
    };
    let info = pvs.info_json();
    said("exact", info, 0);
    assert!(
        sandbox
            .ok("verify slits.glb said.pvs")
            .starts_with("accepted: ")
    );
    let sampled = sandbox.ok("verify slits.glb said.pvs --sample 7");
    assert!(
        sampled.starts_with("accepted by a sample of 7 pairs: "),
        "{sampled}"
    );
    for (method, info, flags, why) in [
        (
            "trust",
            info.to_owned(),
            0,
            "the method \"trust\" has no certificates",
        ),
        (
            "verified",
            info.to_owned(),
            0,
            "the result states the method verified",
        ),
        (
            "exact",
            info.replace("\"z\":2", "\"z\":3"),
            0,
            "the result's parameters state 3x2x3 cells",
        ),
        ("exact", info.to_owned(), 4, "cell 0 has flags 0x4"),
    ] {
        said(method, &info, flags);
        let refused = sandbox.run("verify slits.glb said.pvs").code(3).err;
        assert!(
            refused.contains("REFUSED") && refused.contains(why),
            "{refused}"
        );
    }
}

#[test]
fn cell_groups_have_sets_of_single_cells_and_share_certificates() {
    let sandbox = Sandbox::new();
    sandbox.ok(SCENE);
    let bake = |blocks: &str, out: &str| {
        let job =
            format!("slits.glb --cells 4x4x2 --backend cpu --method exact --certificates {blocks}");
        sandbox.ok(&format!("bake {job} -o {out} --data-dir {out}.data"));
        (
            sandbox.dump(out),
            sandbox.json(&format!("verify slits.glb {out}")),
            sandbox.json(&format!("info {out} --cells")),
        )
    };
    let (alone, claims_alone, _) = bake("--block-cells 1", "alone.pvs");
    for blocks in ["", "--block-cells 32"] {
        let (joint, claims, info) = bake(blocks, "joint.pvs");
        for (a, j) in alone.cells.iter().zip(&joint.cells) {
            assert_eq!((&a.visible, &a.undecided), (&j.visible, &j.undecided));
        }
        assert_eq!(claims["accepted"], true);
        assert_eq!(
            claims["certificates"], claims["certificates_checked"],
            "{claims}"
        );
        assert!(
            claims["certificates"].as_u64() < claims_alone["certificates"].as_u64(),
            "{claims} {claims_alone}"
        );
        assert!(
            claims["evidence_bytes"].as_u64() < claims_alone["evidence_bytes"].as_u64(),
            "{claims}"
        );
        let above = |c: &Value| c["exact_above"].as_u64() > Some(0);
        assert!(
            info["per_cell"].as_array().unwrap().iter().all(above),
            "{info}"
        );
    }
    // The number of workers does not affect the bytes.
    for workers in [1, 4] {
        let job =
            "slits.glb --cells 4x4x2 --backend cpu --method exact --certificates --block-cells 8";
        sandbox.ok(&format!(
            "bake {job} --workers {workers} -o by{workers}.pvs --data-dir by{workers}.data"
        ));
    }
    assert_same(
        &sandbox.read("by1.pvs"),
        &sandbox.read("by4.pvs"),
        "by one worker and by four",
    );
    // A sample looks up the certificate of a cell group, which is stored with the group's first cell.
    let sampled = sandbox.json("verify slits.glb joint.pvs --sample 60");
    assert!(
        sampled["certificates_checked"].as_u64() > Some(0),
        "{sampled}"
    );
    // `query --why` finds a group's certificate that is stored with another cell.
    let triangles = alone.header["triangles"].as_u64().unwrap();
    let middle = alone.cells[5].middle().map(|c| c.to_string()).join(" ");
    let boxes = (0..triangles)
        .map(|t| sandbox.json(&format!("query joint.pvs {middle} --why {t}")))
        .filter(|why| why["from"].is_array())
        .inspect(|why| {
            assert!(
                why["state"] == "hidden" && !why["blockers"].as_array().unwrap().is_empty(),
                "{why}"
            )
        })
        .count();
    assert!(
        boxes > 0,
        "something is hidden from the box around the cell"
    );
    // Cells without their group's certificate are rejected, and so are exchanged certificates.
    let joint = sandbox.read("joint.pvs");
    let pvs = Pvs::from_bytes(joint.clone()).unwrap();
    let all: Vec<Vec<u8>> = (0..pvs.cells())
        .map(|c| pvs.certificate(c).unwrap().unwrap().to_vec())
        .collect();
    let refused = |others: &[Vec<u8>]| {
        let altered = changed(&joint, |cell, _, evidence| {
            evidence.clone_from(&others[cell as usize])
        });
        sandbox.write("altered.pvs", altered);
        let err = sandbox.run("verify slits.glb altered.pvs").code(3).err;
        assert!(err.contains("REFUSED"), "{err}");
        err
    };
    let mut first_gone = all.clone();
    first_gone[0] = Vec::new();
    refused(&first_gone);
    let mut rotated = all.clone();
    rotated.rotate_left(1);
    assert!(refused(&rotated).contains("before cell 0"));
    let mut swapped = all.clone();
    swapped.swap(0, 8);
    refused(&swapped);
}

#[test]
fn cells_of_an_adaptive_tree_are_decided_and_verified() {
    let sandbox = sandbox();
    let tree = "--triangle-budget 12 --max-depth 5 --backend cpu";
    sandbox.ok(&format!(
        "bake slits.glb {tree} --method exact --certificates -o tree.pvs --data-dir data"
    ));
    let report = sandbox.json("verify slits.glb tree.pvs");
    assert_eq!(
        (&report["accepted"], &report["undecided"]),
        (&Value::from(true), &Value::from(0)),
        "{report}"
    );
    sandbox.ok(&format!(
        "bake slits.glb {tree} --complete off -o sampled.pvs --data-dir data"
    ));
    let [exact, sampled] = ["tree.pvs", "sampled.pvs"].map(|name| sandbox.dump(name).cells);
    // The tree is deeper than the splits that are always made. Sampling determines it, so it is the same for
    // both methods.
    assert!(exact.len() > 8, "{} cells", exact.len());
    assert_eq!(exact.len(), sampled.len());
    for (cell, sampled) in exact.iter().zip(sampled) {
        assert!(
            sampled
                .visible
                .iter()
                .all(|t| cell.visible.binary_search(t).is_ok())
        );
    }
}

/// Returns the result with its sets and certificates altered by `change`, under correct checksums.
fn tampered(change: impl Fn(u32, &mut Vec<u32>, &mut Vec<u8>)) -> Vec<u8> {
    changed(alone(), change)
}

/// Returns any result with its sets and certificates altered by `change`, under correct checksums.
fn changed(result: &[u8], change: impl Fn(u32, &mut Vec<u32>, &mut Vec<u8>)) -> Vec<u8> {
    let pvs = Pvs::from_bytes(result).unwrap();
    let mut builder = Builder::new(Header {
        triangles: pvs.triangle_count(),
        method: pvs.method().to_owned(),
        tree: pvs.tree().clone(),
        objects: pvs.objects().to_vec(),
        info_json: pvs.info_json().to_owned(),
    })
    .unwrap();
    let mut visible = Vec::new();
    for cell in 0..pvs.cells() {
        pvs.visible(cell, &mut visible).unwrap();
        let mut evidence = pvs.certificate(cell).unwrap().unwrap().to_vec();
        change(cell, &mut visible, &mut evidence);
        builder.push_cell(&visible, &[], 0).unwrap();
        builder.push_certificate(&evidence).unwrap();
    }
    builder.set_columns(pvs.columns().unwrap()).unwrap();
    builder
        .set_pairs(pvs.cell_pairs().unwrap().unwrap())
        .unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    file
}

#[test]
fn altered_result_is_rejected_with_cell() {
    let sandbox = sandbox();
    assert_same(&tampered(|_, _, _| ()), alone(), "nothing changed");
    let refuse = |what: &str, file: Vec<u8>| {
        sandbox.write("other.pvs", file);
        sandbox.run("verify slits.glb other.pvs").code(3).says(what);
        let report: Value =
            serde_json::from_str(&sandbox.run("verify slits.glb other.pvs --json").code(3).out)
                .unwrap();
        assert_eq!(report["accepted"], false);
    };
    // A visible triangle reported as hidden, a hidden one reported as visible, the certificate of another
    // cell, an empty certificate, a truncated one.
    refuse(
        "cell 5",
        tampered(|cell, visible, _| {
            if cell == 5 {
                visible.remove(1);
            }
        }),
    );
    refuse(
        "cell 5",
        tampered(|cell, visible, _| {
            if cell == 5 {
                let hidden = (0..).find(|t| visible.binary_search(t).is_err()).unwrap();
                visible.push(hidden);
                visible.sort_unstable();
            }
        }),
    );
    let pvs = Pvs::from_bytes(alone()).unwrap();
    let others = pvs.certificate(4).unwrap().unwrap().to_vec();
    refuse(
        "cell 5",
        tampered(|cell, _, evidence| {
            if cell == 5 {
                evidence.clone_from(&others);
            }
        }),
    );
    refuse(
        "cell 5",
        tampered(|cell, _, evidence| {
            if cell == 5 {
                evidence.clear();
            }
        }),
    );
    refuse(
        "cell 5",
        tampered(|cell, _, evidence| {
            if cell == 5 {
                let raw = zstd::decode_all(evidence.as_slice()).unwrap();
                *evidence = zstd::encode_all(&raw[..raw.len() - 1], 3).unwrap();
            }
        }),
    );
}

#[test]
fn why_query_returns_witness_or_blockers() {
    let sandbox = sandbox();
    let dump = sandbox.dump("exact.pvs");
    let cell = &dump.cells[0];
    let [x, y, z] = [0, 1, 2].map(|k| (cell.min[k] + cell.max[k]) / 2.0);
    let triangles = dump.header["triangles"].as_u64().unwrap();
    let (mut seen, mut hidden) = (0, 0);
    for t in (0..triangles).step_by(7) {
        let visible = cell.visible.binary_search(&t).is_ok();
        let kept = sandbox.json(&format!("query exact.pvs {x} {y} {z} --why {t}"));
        let asked = sandbox.json(&format!(
            "query exact.pvs {x} {y} {z} --why {t} --scene slits.glb"
        ));
        assert_eq!(
            (&kept["state"], &kept["meets"]),
            (&asked["state"], &asked["meets"]),
            "{kept} {asked}"
        );
        if !visible && kept["surface"] != true {
            assert!(!kept["blockers"].as_array().unwrap().is_empty(), "{kept}");
        }
        assert_eq!(kept["state"], if visible { "visible" } else { "hidden" });
        if visible && kept["meets"] != true {
            let from: Vec<f64> = serde_json::from_value(kept["witness"][0].clone()).unwrap();
            assert!(
                (0..3).all(|k| cell.min[k] <= from[k] && from[k] <= cell.max[k]),
                "{kept}"
            );
            seen += 1;
        }
        hidden += usize::from(!visible);
    }
    assert!(seen > 0 && hidden > 0);
    sandbox
        .run(&format!("query exact.pvs {x} {y} {z} --why 100000"))
        .code(2)
        .says("there is no triangle 100000");
    let words = sandbox
        .run(&format!(
            "query exact.pvs {x} {y} {z} --why {}",
            cell.visible[0]
        ))
        .code(0);
    assert!(words.out.contains("visible"), "{}", words.out);
}

#[test]
fn object_is_visible_with_one_triangle_and_picture_shows_reason() {
    let sandbox = Sandbox::new();
    // A wall at x = 2 leaves y from 1 to 2 open; the shelf is behind the wall, below the opening.
    let shelf = [
        [2.2, 0.1, 0.5],
        [2.5, 0.1, 0.5],
        [2.5, 0.1, 1.0],
        [2.2, 0.1, 1.0],
    ];
    sandbox.write(
        "house.obj",
        house(&[
            ("wall", across(2.0, [0.0, 1.0], [0.0, 2.0])),
            ("shelf", shelf),
        ]),
    );
    let boxes = "--view-box 0.25,0.25,0.25,3.65,0.9,1.75 --cells 2x1x1";
    sandbox.ok(&format!(
        "bake house.obj -o house.pvs --method exact --certificates --backend cpu {boxes}"
    ));
    let dump = sandbox.dump("house.pvs");
    let info = sandbox.json("info house.pvs");
    let (mut seen, mut hidden) = (0, 0);
    for (i, object) in info["objects"].as_array().unwrap().iter().enumerate() {
        let [first, count] = ["first", "count"].map(|key| object[key].as_u64().unwrap());
        let visible =
            (first..first + count).any(|t| dump.cells[0].visible.binary_search(&t).is_ok());
        let kept = sandbox.json(&format!("query house.pvs --cell 0 --why object:{i}"));
        let picture = format!("why-{i}.png");
        let asked = sandbox.json(&format!(
            "query house.pvs 0.5 0.8 1 --why object:{i} --scene house.obj --picture {picture}"
        ));
        for answer in [&kept, &asked] {
            assert_eq!(
                answer["state"],
                if visible { "visible" } else { "hidden" },
                "{answer}"
            );
            assert_eq!(
                (&answer["name"], &answer["object"]),
                (&object["name"], &i.into()),
                "{answer}"
            );
        }
        let file = std::fs::File::open(sandbox.path(&picture)).unwrap();
        let mut reader = png::Decoder::new(std::io::BufReader::new(file))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let drawn = |like: fn([i32; 3]) -> bool| {
            pixels
                .chunks(3)
                .filter(|p| like([p[0], p[1], p[2]].map(i32::from)))
                .count()
        };
        // In the picture, the target is green, its blockers are red, and the end of a witness is a yellow
        // frame.
        let green = drawn(|[r, g, b]| g > r + 30 && g > b + 30);
        let red = drawn(|[r, g, b]| r > g + 60 && r > b + 60);
        if visible {
            let ends = drawn(|p| p == [250, 220, 0]);
            assert!(
                green > 1000 && red == 0 && (ends > 40) == asked["witness"].is_array(),
                "{asked}"
            );
            seen += 1;
        } else {
            assert!(
                green == 0 && red > 1000 && asked["blockers"].as_array().unwrap().len() > 1,
                "{asked}"
            );
            hidden += 1;
        }
    }
    assert!(seen > 4 && hidden == 1, "{seen} {hidden}");
    let shelf = sandbox.json("query house.pvs --cell 0 --why shelf");
    assert_eq!(
        (&shelf["state"], &shelf["triangles"]),
        (&"hidden".into(), &2.into()),
        "{shelf}"
    );
    sandbox
        .run("query house.pvs --cell 0 --why nothing")
        .code(2)
        .says("no object");
    sandbox
        .run("query house.pvs --cell 0 --why 3 --picture x.png")
        .code(2)
        .says("--scene");
}

#[test]
fn time_budget_leaves_valid_bounds() {
    let sandbox = sandbox();
    let exact = sandbox.dump("exact.pvs");
    let job = "slits.glb --cells 3x2x2 --backend cpu --method verified --certificates";
    sandbox.ok(&format!(
        "bake {job} --time-budget 20ms -o short.pvs --data-dir data"
    ));
    let short = sandbox.dump("short.pvs");
    assert_eq!(short.header["method"], "verified");
    for (whole, cut) in exact.cells.iter().zip(&short.cells) {
        let drawn = |t: &u64| cut.visible.binary_search(t).is_ok();
        assert!(
            whole.visible.iter().all(drawn),
            "something visible is missing"
        );
        let sure = cut
            .visible
            .iter()
            .filter(|t| cut.undecided.binary_search(t).is_err());
        sure.for_each(|t| assert!(whole.visible.binary_search(t).is_ok(), "{t} is hidden"));
    }
    assert!(
        short.cells.iter().any(|c| !c.undecided.is_empty()),
        "there was time for everything"
    );
    let lines = sandbox.ok("info short.pvs");
    assert!(
        lines.contains("visible from a cell: between ")
            && lines.contains("because undecided triangles are drawn"),
        "{lines}"
    );
    let report = sandbox.json("verify slits.glb short.pvs");
    assert_eq!(
        report["undecided"],
        short
            .cells
            .iter()
            .map(|c| c.undecided.len() as u64)
            .sum::<u64>()
    );
}

#[test]
fn unverifiable_results_are_rejected_with_reason() {
    let sandbox = sandbox();
    sandbox
        .run("bake slits.glb --certificates -o x.pvs")
        .code(2)
        .says("--method exact");
    sandbox.ok("bake slits.glb --cells 1x1x1 --backend cpu -o sampled.pvs --data-dir data");
    sandbox
        .run("verify slits.glb sampled.pvs")
        .code(3)
        .says("no certificates");
    sandbox
        .run("query sampled.pvs 0 0 0.1 --why 3")
        .code(3)
        .says("--scene");
    sandbox.ok("generate slits --grid 2x2 -o others.glb");
    sandbox
        .run("verify others.glb exact.pvs")
        .code(3)
        .says("another scene");
    sandbox
        .run("query exact.pvs 0 0 0.1 --why 3 --scene others.glb")
        .code(3)
        .says("another scene");
}
