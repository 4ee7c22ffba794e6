//! `sightline export`: the sets of a result for engines and tables.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use serde_json::Value;
use sightline_tests::Sandbox;

#[test]
fn every_form_has_the_same_objects_as_dump() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --grid 3x2 --triangles 1500 -o rooms.glb");
    sandbox
        .ok("bake rooms.glb -o rooms.pvs --cells 4x1x3 --granularity objects --contributions --backend cpu \
         --view-box 1,0.5,1,9,2,9");
    let dump = sandbox.ok("dump rooms.pvs --items objects");
    let mut cells: Vec<Value> = dump.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    cells.remove(0);
    for form in ["sidecar", "manifest"] {
        sandbox.ok(&format!("export rooms.pvs --format {form} -o {form}.json"));
        let found: Value = serde_json::from_slice(&sandbox.read(&format!("{form}.json"))).unwrap();
        assert_eq!(found["format"], format!("sightline.{form}"));
        let of = found["cells"].as_array().unwrap();
        assert_eq!(of.len(), cells.len());
        for (found, cell) in of.iter().zip(&cells) {
            assert_eq!(found["objects"], cell["visible"]);
            assert_eq!((&found["min"], &found["max"]), (&cell["min"], &cell["max"]));
        }
        let first = &found["objects"][0];
        assert!(first["name"].is_string() && first["node"].is_u64(), "{first}");
    }
    let manifest: Value = serde_json::from_slice(&sandbox.read("manifest.json")).unwrap();
    // A corner of a grid of 4×1×3 has two neighbours; each is one of the other's.
    let cells_of = manifest["cells"].as_array().unwrap();
    assert_eq!(cells_of[0]["neighbours"].as_array().unwrap().len(), 2);
    assert!(cells_of[0]["triangles"].as_u64().unwrap() > 0);
    assert_eq!(
        cells_of[0]["shares"].as_array().unwrap().len(),
        cells_of[0]["objects"].as_array().unwrap().len()
    );
    sandbox.ok("export rooms.pvs --format csv -o rooms.csv");
    let csv = String::from_utf8(sandbox.read("rooms.csv")).unwrap();
    let pairs: usize = cells.iter().map(|cell| cell["visible"].as_array().unwrap().len()).sum();
    assert_eq!(csv.lines().count(), pairs + 1);
    let some = sandbox.ok("dump rooms.pvs --items objects --cell 7 --cell 2");
    let some: Vec<&str> = some.lines().skip(1).collect();
    assert_eq!(some, [dump.lines().nth(3).unwrap(), dump.lines().nth(8).unwrap()]);
    sandbox.run("dump rooms.pvs --cell 12").code(2).says("has 12 cells");
    sandbox.run("export rooms.pvs --format csv -o rooms.glb").code(2).says("cannot be written");
    sandbox.run("export rooms.glb --format csv -o x.csv").code(3).says("not a .pvs file");
}

#[test]
fn shells_and_readers_get_what_the_arguments_say() {
    let sandbox = Sandbox::new();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(sandbox.ok(&format!("completions {shell}")).contains("reachable-from"), "{shell}");
    }
    sandbox.ok("man pages/man1");
    let page = String::from_utf8(sandbox.read("pages/man1/sightline-bake.1")).unwrap();
    assert!(page.contains(".TH") && page.contains("reachable"), "{page}");
}
