//! Faults that the loaders reject, one test for each kind of fault. The message must name the file, the
//! element and the reason.
#![allow(clippy::unwrap_used)]

mod support;

use serde_json::{Value, json};
use sightline_scene::{load, load_bytes};
use support::*;

/// Asserts that loading fails, and that the message begins with the file and contains each part.
#[track_caller]
fn refused(name: &str, bytes: &[u8], parts: &[&str]) {
    let message = load_bytes(name, bytes, None).unwrap_err().to_string();
    assert!(message.starts_with(&format!("{name}: ")), "{message}");
    for part in parts {
        assert!(message.contains(part), "\"{message}\" lacks \"{part}\"");
    }
    assert!(message.contains("; "), "\"{message}\" has no remedy");
}

/// Asserts that [`square`] with one change to its JSON is rejected.
#[track_caller]
fn gltf_refused(change: impl FnOnce(&mut Value), parts: &[&str]) {
    let mut g = square();
    change(&mut g.json);
    refused("bad.glb", &g.glb(), parts);
}

#[test]
fn rejects_files_with_wrong_extension() {
    let ply = binary_ply(false, &SQUARE, 3);
    refused(
        "a.obj",
        &ply,
        &[
            "file",
            "indicates .obj",
            "a PLY file",
            "rename the file to .ply",
        ],
    );
    refused("a.ply", &square().glb(), &["indicates .ply", "GLB"]);
    refused("a.gltf", &square().glb(), &["indicates .gltf", "GLB"]);
    refused("a.glb", b"{}", &["indicates .glb", "JSON"]);
    refused("a.glb", b"PK\x03\x04....", &["ZIP"]);
    refused(
        "a.ply",
        b"version https://git-lfs.github.com/spec/v1",
        &["Git LFS"],
    );
    refused("a.gltf", OBJ.as_bytes(), &["OBJ"]);
    refused("a", b"hello there", &["text, not like a scene"]);
    refused("a.glb", b"", &["file", "empty"]);
    refused("a.ply", &[0, 1, 2, 3], &["unknown binary"]);
}

#[test]
fn rejects_unreadable_files() {
    let dir = tempfile::tempdir().unwrap();
    let message = load(&dir.path().join("none.obj")).unwrap_err().to_string();
    assert!(
        message.contains("none.obj") && message.contains("cannot be read"),
        "{message}"
    );
    let message = load(dir.path()).unwrap_err().to_string();
    assert!(message.contains("not a regular file"), "{message}");
}

#[test]
fn obj_faults_name_the_line() {
    let bad = |text: &str, parts: &[&str]| refused("a.obj", text.as_bytes(), parts);
    bad("v 0 0\n", &["line 1", "no z"]);
    bad(
        "v 0 0 nan\nf 1 1 1",
        &["line 1", "vertex 0", "z coordinate nan is not finite"],
    );
    bad(
        "v 0 0 0\nv 1e99 0 0\n",
        &["line 2", "vertex 1", "not finite"],
    );
    let stray = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 -1e19 0\nf 1 2 3\nf 1 2 4\n";
    bad(
        stray,
        &["triangle 1, vertex 2", "is beyond ±1e9", "misplaced"],
    );
    bad("v 0 x 0\n", &["line 1", "\"x\" is not a number"]);
    bad("v 0 0 0\n\nf 1 1 2\n", &["line 3", "vertex 2", "has 1"]);
    bad("v 0 0 0\nf 1 1 -2\n", &["line 2", "vertex -2"]);
    bad("v 0 0 0\nf 1 1 0\n", &["line 2", "vertex 0"]);
    bad(
        "v 0 0 0\nf 1 1 99999999999999999999\n",
        &["line 2", "not a valid corner"],
    );
    bad(
        "v 0 0 0\nf 1 1 1/a\n",
        &["line 2", "\"1/a\" is not a valid corner"],
    );
    bad("v 0 0 0\nf 1 1\n", &["line 2", "2 corners"]);
    bad("v 0 0 0\n", &["scene", "no triangles"]);
    bad("v 0 0 0\nsurf 0 1 0 1 1 2\n", &["line 2", "free-form"]);
}

#[test]
fn ply_faults_name_the_element() {
    let bad = |from: &str, to: &str, parts: &[&str]| {
        assert!(PLY.contains(from));
        refused("a.ply", PLY.replace(from, to).as_bytes(), parts);
    };
    bad(
        "vertex 4",
        "vertex 4294967295",
        &["element vertex", "4294967295", "more than the remaining"],
    );
    bad(
        "face 2",
        "face 18446744073709551615",
        &["element face", "more than the remaining"],
    );
    bad(
        "vertex 4",
        "vertex 4e9",
        &["header line 4", "not a whole number"],
    );
    bad(
        "4 0 1 2 3",
        "4 0 1 2 4",
        &["face 0", "vertex 4, but the file has 4"],
    );
    bad(
        "4 0 1 2 3",
        "4 0 1 2 -1",
        &["face 0", "vertex -1, but the file has 4"],
    );
    bad(
        "4 0 1 2 3",
        "400000000 0 1 2 3",
        &["face 0", "400000000 values"],
    );
    bad("4 0 1 2 3", "-4 0 1 2 3", &["face 0", "-4 values"]);
    bad("1 9 1 0", "1 9 inf 0", &["vertex 2", "not finite"]);
    bad("1 9 1 0", "1 9 1 1e300", &["vertex 2", "not finite"]);
    bad(
        "1 9 1 0",
        "1 9 one 0",
        &["vertex 2, property y", "\"one\" (line 17)"],
    );
    bad(
        "3 2 1 0 1\n",
        "3 2 1",
        &["face 1", "3 values", "bytes follow"],
    );
    bad(
        "3 2 1 0 1\n",
        "3 2 1 0 1\n3 0 1 2 1\n",
        &["end", "follow the last element"],
    );
    bad(
        "3 2 1 0 1\n",
        "3 2 1 0",
        &["face 1, property w", "file ends"],
    );
    bad("3 2 1 0 1\n", "2 2 1 0 1\n", &["face 1", "2 corners"]);
    bad("float y", "float q", &["element vertex", "property y"]);
    bad(
        "vertex_indices",
        "corners",
        &["element face", "vertex_indices"],
    );
    bad("element face", "element facet", &["no face element"]);
    bad("ascii 1.0", "ascii 2.0", &["header line 2"]);
    bad("end_header", "comment", &["not a valid PLY header line"]);
    bad(
        "list uchar int vertex_indices",
        "list float int vertex_indices",
        &["integer type"],
    );
    refused(
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 4\n",
        &["before the line end_header"],
    );
    refused(
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n\
          element face 0\nproperty list uchar int vertex_indices\nend_header\n",
        &["no triangles"],
    );
}

#[test]
fn binary_ply_faults() {
    let whole = binary_ply(false, &SQUARE, 3);
    refused("a.ply", &whole[..whole.len() - 1], &["face 1", "file ends"]);
    refused(
        "a.ply",
        &binary_ply(true, &SQUARE, 4),
        &["face 1", "vertex 4, but the file has 4"],
    );
    let mut nan = SQUARE;
    nan[2][1] = f32::NAN;
    refused(
        "a.ply",
        &binary_ply(true, &nan, 3),
        &["vertex 2", "not finite"],
    );
}

#[test]
fn rejects_truncated_or_invalid_glb_containers() {
    let whole = square().glb();
    refused(
        "a.glb",
        &whole[..whole.len() - 1],
        &["GLB header", "announces"],
    );
    refused("a.glb", &whole[..8], &["GLB header", "ends"]);
    let with = |at: usize, v: u32| {
        let mut b = whole.clone();
        b[at..at + 4].copy_from_slice(&v.to_le_bytes());
        b
    };
    refused("a.glb", &with(4, 1), &["GLB header", "version is 1"]);
    refused("a.glb", &with(12, u32::MAX), &["GLB chunk 0", "4294967295"]);
    refused("a.glb", &with(16, 0), &["GLB chunk 0", "not the JSON"]);
    refused(
        "a.glb",
        &glb(b"{\"asset\": 1", b""),
        &["glTF JSON", "line 1"],
    );
}

#[test]
fn gltf_references_out_of_range() {
    gltf_refused(
        |j| j["scene"] = json!(4),
        &["scene", "scene 4, but the file has 1"],
    );
    gltf_refused(|j| j["scenes"][0]["nodes"] = json!([7]), &["node 7"]);
    gltf_refused(
        |j| j["nodes"][0]["mesh"] = json!(1),
        &["node 0", "mesh 1, but the file has 1"],
    );
    let position = |n: i32| {
        move |j: &mut Value| j["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(n)
    };
    gltf_refused(
        position(9),
        &["mesh 0, primitive 0", "accessor 9 does not exist"],
    );
    gltf_refused(position(-1), &["glTF JSON"]);
    gltf_refused(
        |j| j["accessors"][0]["bufferView"] = json!(5),
        &["accessor 0", "buffer view 5"],
    );
    gltf_refused(
        |j| j["bufferViews"][0]["buffer"] = json!(5),
        &["buffer view 0", "buffer 5"],
    );
    gltf_refused(
        |j| j["bufferViews"][0]["byteLength"] = json!(1u64 << 40),
        &["buffer view 0", "reach beyond"],
    );
    gltf_refused(
        |j| j["bufferViews"][0]["byteOffset"] = json!(u64::MAX),
        &["buffer view 0", "reach beyond"],
    );
    gltf_refused(
        |j| j["accessors"][0]["count"] = json!(5),
        &["mesh 0, primitive 0, accessor 0", "buffer view 0"],
    );
    gltf_refused(
        |j| j["accessors"][0]["count"] = json!(u64::MAX),
        &["accessor 0", "reach beyond"],
    );
    gltf_refused(
        |j| j["accessors"][0]["count"] = json!(3),
        &[
            "mesh 0, primitive 0",
            "accessor 1",
            "vertex 3, but the primitive has 3",
        ],
    );
    gltf_refused(
        |j| j["bufferViews"][0]["byteStride"] = json!(4),
        &["accessor 0", "stride"],
    );
    gltf_refused(
        |j| j["accessors"][1]["count"] = json!(5),
        &["multiple of three"],
    );
    gltf_refused(
        |j| j["accessors"][0]["type"] = json!("VEC2"),
        &["accessor 0", "VEC2"],
    );
    gltf_refused(
        |j| j["accessors"][0]["componentType"] = json!(5123),
        &["accessor 0", "KHR_mesh_quantization"],
    );
    gltf_refused(
        |j| j["accessors"][1]["componentType"] = json!(5122),
        &["accessor 1", "unsigned"],
    );
    gltf_refused(
        |j| j["accessors"][1]["componentType"] = json!(1),
        &["accessor 1", "component type 1"],
    );
    gltf_refused(
        |j| j["meshes"][0]["primitives"][0]["mode"] = json!(7),
        &["mesh 0, primitive 0", "mode is 7"],
    );
}

#[test]
fn rejects_large_accessor_without_data() {
    gltf_refused(
        |j| {
            j["accessors"][0] =
                json!({"componentType": 5126, "type": "VEC3", "count": 4_294_967_295u32});
            j["meshes"][0]["primitives"][0]
                .as_object_mut()
                .unwrap()
                .remove("indices");
        },
        &["accessor 0", "no buffer view"],
    );
    gltf_refused(
        |j| j["buffers"] = json!([{"byteLength": 4_294_967_295u32}]),
        &["buffer 0", "4294967295"],
    );
}

#[test]
fn instances_beyond_the_limit() {
    use sightline_scene::load::{LoadLimits, LoadOptions, load_bytes_with};
    let mut g = square();
    g.json["nodes"] = json!(vec![json!({"mesh": 0}); 10]);
    g.json["scenes"][0]["nodes"] = json!((0..10).collect::<Vec<_>>());
    let load = |triangles, objects| {
        let options = LoadOptions {
            limits: LoadLimits { triangles, objects },
            ..LoadOptions::default()
        };
        load_bytes_with("a.glb", &g.glb(), None, &options).map(|l| l.scene.len())
    };
    assert_eq!(load(20, 10).unwrap(), 20);
    assert!(
        load(19, 10)
            .unwrap_err()
            .to_string()
            .contains("(at node 9): with this element, the scene has more than 19 triangles")
    );
    assert!(
        load(20, 9)
            .unwrap_err()
            .to_string()
            .contains("more than 9 objects")
    );
}

#[test]
fn rejects_node_cycles_and_infinite_transforms() {
    gltf_refused(
        |j| j["nodes"] = json!([{"children": [1]}, {"children": [0]}]),
        &["node 0", "cycle"],
    );
    gltf_refused(
        |j| j["nodes"] = json!([{"children": [0]}]),
        &["node 0", "cycle"],
    );
    gltf_refused(
        |j| {
            j["nodes"] = json!([{"children": [1]}, {"children": [0]}]);
            j.as_object_mut().unwrap().remove("scene");
            j.as_object_mut().unwrap().remove("scenes");
        },
        &["nodes", "cycle"],
    );
    gltf_refused(
        |j| {
            let scale = json!([1e200, 1, 1]);
            j["nodes"] = json!([{"scale": scale, "children": [1]}, {"scale": scale, "mesh": 0}])
        },
        &["node 1", "not finite"],
    );
    gltf_refused(
        |j| j["nodes"][0]["scale"] = json!([1e39, 1, 1]),
        &[
            "mesh 0, primitive 0",
            "accessor 0, vertex 1",
            "out of range",
        ],
    );
    gltf_refused(
        |j| j["nodes"][0]["rotation"] = json!([0, 0, 0, 0]),
        &["node 0", "quaternion"],
    );
    gltf_refused(
        |j| j["nodes"][0]["matrix"] = json!(vec![0; 16]),
        &["node 0", "last row"],
    );
    gltf_refused(
        |j| j["nodes"][0]["translation"] = json!([1, 2]),
        &["glTF JSON"],
    );
}

#[test]
fn rejects_gltf_vertices_that_are_not_finite() {
    let mut g = square();
    g.bin[16..20].copy_from_slice(&f32::INFINITY.to_le_bytes());
    refused(
        "a.glb",
        &g.glb(),
        &["mesh 0, primitive 0", "accessor 0, vertex 1", "not finite"],
    );
}

/// Several threads read a scene, and the reported fault does not depend on the order of threads. One thread
/// reaches the first fault late, and another thread reaches the second fault immediately.
#[test]
fn first_of_several_faults_is_reported() {
    const VERTICES: usize = 3 * 200_000;
    let bad = |at: &[usize]| {
        let mut p = vec![[1.0f32; 3]; VERTICES];
        at.iter().for_each(|i| p[*i][1] = f32::NAN);
        p
    };
    let mut primitives = Gltf::default();
    let [whole, last, start] =
        [vec![], vec![VERTICES - 1], vec![0]].map(|at| primitives.positions(&bad(&at)));
    let primitive = |a: usize| json!({"attributes": {"POSITION": a}});
    let order = [whole, whole, whole, last, start, whole, whole, whole];
    primitives.mesh(json!(order.map(primitive)));
    // The eleventh and the thirteenth of 25 parts of 8192 triangles.
    let (first, second) = (3 * 8192 * 11 - 1, 3 * 8192 * 12);
    let mut parts = Gltf::default();
    let both = parts.positions(&bad(&[first, second]));
    parts.mesh(json!([primitive(both)]));
    let (primitives, parts) = (primitives.glb(), parts.glb());
    let last = format!("vertex {}", VERTICES - 1);
    for _ in 0..20 {
        refused(
            "a.glb",
            &primitives,
            &["mesh 0, primitive 3", &last, "not finite"],
        );
        refused(
            "a.glb",
            &parts,
            &[
                "mesh 0, primitive 0",
                &format!("vertex {first}"),
                "not finite",
            ],
        );
    }
}

#[test]
fn rejects_primitive_restart() {
    let mut g = Gltf::default();
    let p = g.positions(&vec![[0.; 3]; 300]);
    let i = g.indices(5121, &[0, 1, 255, 2, 3, 4]);
    g.mesh(json!([{"attributes": {"POSITION": p}, "indices": i}]));
    refused(
        "a.glb",
        &g.glb(),
        &["accessor 1, index 2", "vertex 255", "restart"],
    );
}

#[test]
fn sparse_faults() {
    let sparse = |change: fn(&mut Value)| {
        let mut g = rich();
        change(&mut g.json["accessors"][0]["sparse"]);
        g.glb()
    };
    refused(
        "a.glb",
        &sparse(|s| s["count"] = json!(3)),
        &["accessor 0, sparse", "reach beyond"],
    );
    refused(
        "a.glb",
        &sparse(|s| s["indices"]["componentType"] = json!(5126)),
        &["sparse", "unsigned"],
    );
    refused(
        "a.glb",
        &sparse(|s| s["indices"]["bufferView"] = json!(99)),
        &["accessor 0", "buffer view 99"],
    );
    refused(
        "a.glb",
        &sparse(|s| s["indices"]["componentType"] = json!(5121)),
        &["sparse", "must increase"],
    );
}

#[test]
fn rejects_extensions_by_name() {
    gltf_refused(
        |j| j["extensionsRequired"] = json!(["NGA_gpm_local"]),
        &["extensionsRequired", "NGA_gpm_local", "without"],
    );
    gltf_refused(
        |j| j["asset"]["version"] = json!("1.0"),
        &["asset", "glTF 1.0"],
    );
    gltf_refused(
        |j| j["asset"]["minVersion"] = json!("2.1"),
        &["asset", "glTF 2.1"],
    );
}

#[test]
fn meshopt_faults() {
    let packed = |change: fn(&mut Value)| {
        let mut g = packed_square();
        change(&mut g.json["bufferViews"][2]["extensions"]["EXT_meshopt_compression"]);
        g.glb()
    };
    let view = "buffer view 2, EXT_meshopt_compression";
    refused(
        "a.glb",
        &packed(|m| m["count"] = json!(1u64 << 50)),
        &[view, "unpack to"],
    );
    refused(
        "a.glb",
        &packed(|m| m["count"] = json!(1u64 << 20)),
        &[view, "too short"],
    );
    refused(
        "a.glb",
        &packed(|m| m["count"] = json!(100)),
        &[view, "malformed"],
    );
    refused(
        "a.glb",
        &packed(|m| m["byteStride"] = json!(6)),
        &[view, "stride"],
    );
    refused(
        "a.glb",
        &packed(|m| m["filter"] = json!("OCTAHEDRAL")),
        &[view, "OCTAHEDRAL"],
    );
    refused(
        "a.glb",
        &packed(|m| m["mode"] = json!("X")),
        &[view, "mode X"],
    );
    refused(
        "a.glb",
        &packed(|m| m["byteLength"] = json!(9999)),
        &["buffer view 2", "reach beyond"],
    );
}

#[test]
fn rejects_views_that_unpack_to_far_more_than_file() {
    // A control byte represents 256 equal elements of 4 bytes.
    let blocks = 1 << 16;
    let mut data = vec![0xa1];
    data.resize(1 + blocks, 0xaa);
    data.resize(1 + blocks + 24, 0);
    let mut g = square();
    let at = g.view(&data);
    let packed = json!({"EXT_meshopt_compression": {
        "buffer": 0, "byteOffset": g.json["bufferViews"][at]["byteOffset"], "byteLength": data.len(),
        "byteStride": 4, "count": 256 * blocks, "mode": "ATTRIBUTES",
    }});
    let mut views = Vec::new();
    for _ in 0..2 {
        let length = 1024 * blocks;
        let view =
            json!({"buffer": 0, "byteLength": length, "byteStride": 4, "extensions": packed});
        let view = g.add("bufferViews", view);
        let indices =
            json!({"bufferView": view, "componentType": 5125, "type": "SCALAR", "count": 6});
        views.push(view);
        let indices = g.add("accessors", indices);
        g.mesh(json!([{"attributes": {"POSITION": 0}, "indices": indices}]));
    }
    let second = format!("buffer view {}, EXT_meshopt_compression", views[1]);
    g.json["nodes"] = json!([{"mesh": 1}, {"mesh": 2}]);
    g.json["scenes"] = json!([{"nodes": [0, 1]}]);
    refused("a.glb", &g.glb(), &[&second, "unpack to 134217728 bytes"]);
}

#[test]
fn buffers_stay_below_scene_folder() {
    for uri in [
        "/etc/passwd",
        "../secret.bin",
        "http://example.com/a.bin",
        "%2e%2e/x",
    ] {
        gltf_refused(
            |j| j["buffers"] = json!([{"byteLength": 4, "uri": uri}]),
            &["buffer 0", uri, "plain path"],
        );
    }
    let with = |uri: &str| json!([{"byteLength": 72, "uri": uri}]);
    gltf_refused(
        |j| j["buffers"] = with("a.bin"),
        &["buffer 0", "was not loaded from a directory"],
    );
    gltf_refused(
        |j| j["buffers"] = with("data:text/plain,abc"),
        &["buffer 0", "base64"],
    );
    gltf_refused(
        |j| j["buffers"] = with("data:;base64,!!"),
        &["buffer 0", "base64"],
    );
    gltf_refused(
        |j| j["buffers"] = with("data:;base64,AAAA"),
        &["buffer 0", "truncated"],
    );
    gltf_refused(
        |j| j["buffers"] = json!([{"byteLength": 1}, {"byteLength": 4}]),
        &["buffer view 0"],
    );
    let dir = tempfile::tempdir().unwrap();
    let mut g = square();
    g.json["buffers"] = with("missing.bin");
    let file = dir.path().join("a.gltf");
    std::fs::write(&file, g.json.to_string()).unwrap();
    let message = load(&file).unwrap_err().to_string();
    assert!(
        message.contains("a.gltf: buffer 0: ") && message.contains("missing.bin"),
        "{message}"
    );
}

#[test]
fn rejects_scenes_without_triangles() {
    gltf_refused(|j| j["nodes"] = json!([{}]), &["scene", "no triangles"]);
    gltf_refused(
        |j| j["meshes"][0]["primitives"][0]["mode"] = json!(1),
        &["no triangles"],
    );
}
