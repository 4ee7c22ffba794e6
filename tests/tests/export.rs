//! Tests of `sightline export`: the sets of a result for engines and tables.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::{Value, json};
use sightline_tests::{Sandbox, assert_same, house};

#[test]
fn export_formats_have_objects_of_dump() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --grid 3x2 --triangles 1500 -o rooms.glb");
    sandbox
        .ok("bake rooms.glb -o rooms.pvs --cells 4x1x3 --granularity objects --contributions --backend cpu \
         --view-box 1,0.5,1,9,2,9");
    let dump = sandbox.ok("dump rooms.pvs --items objects");
    let mut cells: Vec<Value> = dump
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    cells.remove(0);
    for form in ["sidecar", "manifest"] {
        sandbox.ok(&format!("export rooms.pvs --format {form} -o {form}.json"));
        let found: Value = serde_json::from_slice(&sandbox.read(&format!("{form}.json"))).unwrap();
        assert_eq!(found["format"], format!("sightline.{form}"));
        let exported_cells = found["cells"].as_array().unwrap();
        assert_eq!(exported_cells.len(), cells.len());
        for (found, cell) in exported_cells.iter().zip(&cells) {
            assert_eq!(found["objects"], cell["visible"]);
            assert_eq!((&found["min"], &found["max"]), (&cell["min"], &cell["max"]));
        }
        let first = &found["objects"][0];
        assert!(
            first["name"].is_string() && first["node"].is_u64(),
            "{first}"
        );
    }
    let manifest: Value = serde_json::from_slice(&sandbox.read("manifest.json")).unwrap();
    // A corner of a grid of 4×1×3 has two neighbours, and each of them has the corner as a neighbour.
    let cells_of = manifest["cells"].as_array().unwrap();
    assert_eq!(cells_of[0]["neighbours"].as_array().unwrap().len(), 2);
    assert!(cells_of[0]["triangles"].as_u64().unwrap() > 0);
    assert_eq!(
        cells_of[0]["shares"].as_array().unwrap().len(),
        cells_of[0]["objects"].as_array().unwrap().len()
    );
    sandbox.ok("export rooms.pvs --format csv -o rooms.csv");
    let csv = String::from_utf8(sandbox.read("rooms.csv")).unwrap();
    let pairs: usize = cells
        .iter()
        .map(|cell| cell["visible"].as_array().unwrap().len())
        .sum();
    assert_eq!(csv.lines().count(), pairs + 1);
    let some = sandbox.ok("dump rooms.pvs --items objects --cell 7 --cell 2");
    let some: Vec<&str> = some.lines().skip(1).collect();
    assert_eq!(
        some,
        [dump.lines().nth(3).unwrap(), dump.lines().nth(8).unwrap()]
    );
    sandbox
        .run("dump rooms.pvs --cell 12")
        .code(2)
        .says("has 12 cells");
    sandbox
        .run("export rooms.pvs --format csv -o rooms.glb")
        .code(2)
        .says("cannot be written");
    sandbox
        .run("export rooms.glb --format csv -o x.csv")
        .code(3)
        .says("not a .pvs file");
}

/// Returns the JSON and the binary chunk of a GLB.
fn parts(glb: &[u8]) -> (Value, &[u8]) {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&glb[..4], word(8)), (&b"glTF"[..], glb.len()));
    let json = word(12);
    assert_eq!(&glb[24 + json..28 + json], b"BIN\0");
    (
        serde_json::from_slice(&glb[20..20 + json]).unwrap(),
        &glb[28 + json..][..word(20 + json)],
    )
}

/// Removes the extension from a document and returns it.
fn take(json: &mut Value) -> Value {
    let root = json.as_object_mut().unwrap();
    assert_eq!(
        root.remove("extensionsUsed").unwrap(),
        json!(["SIGHTLINE_visibility"])
    );
    root.remove("extensions").unwrap()["SIGHTLINE_visibility"].take()
}

/// Returns the lines of `dump --items objects` about cells.
fn dumped(sandbox: &Sandbox, result: &str) -> Vec<Value> {
    let lines = sandbox.ok(&format!("dump {result} --items objects"));
    lines
        .lines()
        .skip(1)
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn glb_with_lists_is_same_scene() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 5x3 -o maze.glb");
    let boxes = "--view-box 0.4,0.5,0.4,9.6,1.5,5.6 --cells 3x1x2";
    sandbox.ok(&format!("bake maze.glb -o maze.pvs {boxes} --backend cpu"));
    sandbox.ok("export maze.pvs --format gltf --scene maze.glb -o seen.glb");
    let (before, after) = (sandbox.read("maze.glb"), sandbox.read("seen.glb"));
    let ((before, bytes), (mut after, same)) = (parts(&before), parts(&after));
    let extension = take(&mut after);
    assert_eq!((&before, bytes), (&after, same));
    assert_eq!(
        (&extension["version"], &extension["method"]),
        (&json!(1), &json!("aggressive"))
    );
    let cells = extension["cells"].as_array().unwrap();
    let dump = dumped(&sandbox, "maze.pvs");
    assert_eq!(cells.len(), 6);
    for (cell, expected) in cells.iter().zip(&dump) {
        assert_eq!(cell["objects"], expected["visible"]);
        assert_eq!(
            (&cell["min"], &cell["max"]),
            (&expected["min"], &expected["max"])
        );
        // At least one object is hidden, so the lists are not trivial.
        assert!(
            cell["objects"].as_array().unwrap().len()
                < extension["objects"].as_array().unwrap().len()
        );
    }
    assert_eq!(extension["viewBox"]["min"], dump[0]["min"]);
    // Objects are named "node/mesh#primitive"; the generator names nodes.
    sandbox.ok("export maze.pvs --format sidecar -o maze.json");
    let sidecar: Value = serde_json::from_slice(&sandbox.read("maze.json")).unwrap();
    for (object, entry) in sidecar["objects"]
        .as_array()
        .unwrap()
        .iter()
        .zip(extension["objects"].as_array().unwrap())
    {
        let node = &after["nodes"][entry["node"].as_u64().unwrap() as usize];
        assert_eq!(node["mesh"], entry["mesh"]);
        assert!(
            object["name"]
                .as_str()
                .unwrap()
                .starts_with(node["name"].as_str().unwrap())
        );
        assert_eq!(entry["primitive"], 0);
    }
    // Every other command reads the same scene from the file.
    sandbox.ok("mesh maze.glb -o maze.ply");
    sandbox.ok("mesh seen.glb -o seen.ply");
    assert_same(
        &sandbox.read("maze.ply"),
        &sandbox.read("seen.ply"),
        "triangles",
    );
    sandbox.ok("view maze.pvs seen.glb -o seen.html");

    let export = |rest: &str| sandbox.run(&format!("export maze.pvs --format gltf {rest}"));
    export("-o x.glb").code(2).says("--scene LEVEL.glb");
    export("--scene seen.glb -o x.glb")
        .code(3)
        .says("already has the extension");
    export("--scene maze.glb -o x.gltf")
        .code(2)
        .says("a name that ends in .glb");
    export("--scene maze.glb -o maze.glb")
        .code(2)
        .says("the input itself");
    sandbox
        .run("export maze.pvs --format csv --scene maze.glb -o x.csv")
        .code(2)
        .says("omit --scene");
    sandbox.ok("generate maze --grid 5x3 --seed 7 -o other.glb");
    export("--scene other.glb -o x.glb")
        .code(3)
        .says("another scene");
    sandbox.write("house.obj", house(&[]));
    sandbox.ok("bake house.obj -o house.pvs --cells 1x1x1 --backend cpu");
    let of_obj = sandbox.run("export house.pvs --format gltf --scene house.obj -o x.glb");
    of_obj
        .code(3)
        .says("not a glTF or GLB file; use --format sidecar");
    assert!(!sandbox.path("x.glb").exists());
}

/// Returns the cells of an extension: their corners and their objects.
fn cells(extension: &Value, json: &Value, data: &[u8]) -> Vec<(Vec<f32>, Vec<u32>)> {
    let packed = &extension["packedCells"];
    let numbers = |list: &Value| {
        list.as_array()
            .unwrap()
            .iter()
            .map(|x| x.as_f64().unwrap())
            .collect::<Vec<_>>()
    };
    if packed.is_null() {
        let cell = |cell: &Value| {
            let corners = [numbers(&cell["min"]), numbers(&cell["max"])].concat();
            let ids = numbers(&cell["objects"])
                .iter()
                .map(|id| *id as u32)
                .collect();
            (corners.iter().map(|x| *x as f32).collect(), ids)
        };
        return extension["cells"]
            .as_array()
            .unwrap()
            .iter()
            .map(cell)
            .collect();
    }
    let view = |key: &str| {
        let view = &json["bufferViews"][packed[key].as_u64().unwrap() as usize];
        let field = |key: &str| view[key].as_u64().unwrap() as usize;
        &data[field("byteOffset")..][..field("byteLength")]
    };
    let word = |b: &[u8]| u32::from_le_bytes(b.try_into().unwrap());
    let boxes: Vec<f32> = view("boxes")
        .chunks(4)
        .map(|b| f32::from_bits(word(b)))
        .collect();
    assert_eq!(packed["componentType"], 5123);
    let ids: Vec<u32> = view("objects")
        .chunks(2)
        .map(|b| u32::from(b[0]) + 256 * u32::from(b[1]))
        .collect();
    let mut start = 0;
    let cell = |(corners, end): (&[f32], &[u8])| {
        let from = std::mem::replace(&mut start, word(end) as usize);
        (corners.to_vec(), ids[from..start].to_vec())
    };
    boxes
        .chunks(6)
        .zip(view("ends").chunks(4))
        .map(cell)
        .collect()
}

#[test]
fn long_lists_of_glb_are_packed_without_moving_objects() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate maze --grid 5x3 -o maze.glb");
    let glb = sandbox.read("maze.glb");
    let (mut json, bytes) = parts(&glb);
    json["nodes"][1]["name"] = "turning".into();
    sandbox.write("moving.glb", with_json(&json, bytes));
    // The file as JSON with a separate buffer.
    let mut beside = json.clone();
    beside["buffers"][0]["uri"] = "moving.bin".into();
    sandbox.write("moving.bin", bytes);
    sandbox.write("moving.gltf", beside.to_string());
    let boxes =
        "--cells 8x2x8 --view-box 0.4,0.5,0.4,9.6,1.5,5.6 --granularity objects --backend cpu";
    for (scene, seen, before) in [
        ("moving.gltf", "seen.gltf", beside),
        ("moving.glb", "seen.glb", json),
    ] {
        sandbox.ok(&format!(
            "bake {scene} -o maze.pvs {boxes} --moving turning"
        ));
        sandbox.ok(&format!(
            "export maze.pvs --format gltf --scene {scene} -o {seen}"
        ));
        let file = sandbox.read(seen);
        let is_glb = seen == "seen.glb";
        let (mut after, data) = if is_glb {
            parts(&file)
        } else {
            (serde_json::from_slice(&file).unwrap(), bytes)
        };
        let extension = take(&mut after);
        assert_eq!(extension["cells"].is_null(), is_glb);
        // Object 1 moves, so the lists do not contain it, and the numbers of later objects are one lower.
        let objects = extension["objects"].as_array().unwrap();
        assert!(objects.iter().all(|o| o["node"] != 1) && objects[1]["node"] == 2);
        let cells = cells(&extension, &after, data);
        let dump = dumped(&sandbox, "maze.pvs");
        assert_eq!((dump.len(), cells.len()), (128, 128));
        for ((corners, ids), cell) in cells.iter().zip(&dump) {
            let expected = cell["visible"]
                .as_array()
                .unwrap()
                .iter()
                .map(|id| id.as_u64().unwrap() as u32);
            assert_eq!(
                *ids,
                expected
                    .map(|id| id - u32::from(id > 1))
                    .collect::<Vec<_>>()
            );
            let expected = ["min", "max"]
                .into_iter()
                .flat_map(|key| cell[key].as_array().unwrap());
            assert_eq!(
                *corners,
                expected
                    .map(|x| x.as_f64().unwrap() as f32)
                    .collect::<Vec<_>>()
            );
        }
        // Without the extension, the file is unchanged.
        assert_same(&data[..bytes.len()], bytes, "binary chunk");
        let views = before["bufferViews"].as_array().unwrap().len();
        after["bufferViews"].as_array_mut().unwrap().truncate(views);
        after["buffers"][0]["byteLength"] = before["buffers"][0]["byteLength"].clone();
        assert_eq!(after, before);
        sandbox.ok(&format!("view maze.pvs {seen} -o seen.html"));
        if !is_glb {
            std::fs::create_dir(sandbox.path("elsewhere")).unwrap();
            let export = "export maze.pvs --format gltf --scene moving.gltf -o elsewhere/seen.gltf";
            sandbox
                .run(export)
                .code(2)
                .says("refers to the file moving.bin in its folder");
        }
    }
}

/// Creates a GLB of JSON and a binary chunk.
fn with_json(json: &Value, bytes: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + text.len() as u32 + bytes.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text[..]), (b"BIN\0", bytes)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

#[test]
fn shells_and_readers_receive_result_of_arguments() {
    let sandbox = Sandbox::new();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(
            sandbox
                .ok(&format!("completions {shell}"))
                .contains("reachable-from"),
            "{shell}"
        );
    }
    sandbox.ok("man pages/man1");
    let page = String::from_utf8(sandbox.read("pages/man1/sightline-bake.1")).unwrap();
    assert!(page.contains(".TH") && page.contains("reachable"), "{page}");
}
