//! The kinds of triangles that loaders find in materials, animations, skins and extras.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use serde_json::{Value, json};
use sightline_scene::TriangleId;
use sightline_scene::kinds::{KindRule, SurfaceKind};
use sightline_scene::load::{LoadOptions, LoadedScene, load_bytes_with, load_with};
use support::Gltf;

/// Loads a file with `nodes` nodes, each with a mesh of one triangle. `change` edits the document.
fn load(nodes: usize, change: impl FnOnce(&mut Value)) -> LoadedScene {
    let mut g = Gltf::default();
    let p = g.positions(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    for _ in 0..nodes {
        g.mesh(json!([{"attributes": {"POSITION": p}}]));
    }
    g.json["nodes"] = (0..nodes).map(|n| json!({"mesh": n})).collect();
    g.json["scenes"][0]["nodes"] = (0..nodes).collect();
    change(&mut g.json);
    load_bytes_with("test.glb", &g.glb(), None, &LoadOptions::default()).unwrap()
}

fn kinds(loaded: &LoadedScene) -> Vec<SurfaceKind> {
    (0..loaded.scene.len())
        .map(|t| loaded.scene.kinds().kind(TriangleId(t)))
        .collect()
}

#[test]
fn materials_with_holes_or_transmission_are_see_through() {
    use SurfaceKind::{Opaque, SeeThrough};
    let loaded = load(7, |j| {
        j["materials"] = json!([
            {"alphaMode": "OPAQUE"}, {"alphaMode": "MASK"}, {"alphaMode": "BLEND"},
            {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5}}},
            {"extensions": {"KHR_materials_transmission": {}}},
            {"extensions": {"KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 1}}},
            // A fault in a material does not make a scene unreadable.
            {"alphaMode": 7, "extensions": []},
        ]);
        for m in 0..7 {
            j["meshes"][m]["primitives"][0]["material"] = json!(m);
        }
    });
    assert_eq!(
        kinds(&loaded),
        [
            Opaque, SeeThrough, SeeThrough, SeeThrough, Opaque, SeeThrough, Opaque
        ]
    );
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let reasons: Vec<String> = loaded
        .scene
        .kinds()
        .counts()
        .into_iter()
        .map(|c| c.reason)
        .collect();
    assert!(
        reasons.contains(&"alphaMode MASK".to_owned()),
        "{reasons:?}"
    );
    // The kinds are part of the canonical bytes.
    let again = sightline_scene::Scene::from_blob("blob", &loaded.scene.to_blob()).unwrap();
    assert_eq!(again.kinds(), loaded.scene.kinds());
    assert_ne!(again.digest(), load(7, |_| {}).scene.digest());
}

#[test]
fn moving_triangles_neither_block_nor_show() {
    use SurfaceKind::{Moving, Opaque};
    // Node 0 is animated, 1 is a child of 0, 2 is skinned, 3 is animated through a pointer, 4 does not move.
    let loaded = load(5, |j| {
        j["scenes"][0]["nodes"] = json!([0, 2, 3, 4]);
        j["nodes"][0]["children"] = json!([1]);
        j["nodes"][2]["skin"] = json!(0);
        let pointer = json!({"KHR_animation_pointer": {"pointer": "/nodes/3/translation"}});
        j["animations"] = json!([{"channels": [
            {"sampler": 0, "target": {"node": 0, "path": "rotation"}},
            {"sampler": 0, "target": {"path": "pointer", "extensions": pointer}},
            {"sampler": 0, "target": {"node": 99, "path": "rotation"}}, {}, 7,
        ]}, {}]);
    });
    assert_eq!(kinds(&loaded), [Moving, Moving, Moving, Moving, Opaque]);
}

/// Returns the extension of a node that is visible or hidden.
fn visible(visible: Value) -> Value {
    json!({"KHR_node_visibility": {"visible": visible}})
}

#[test]
fn hidden_node_hides_everything_below_it() {
    use SurfaceKind::{Hidden, Opaque};
    let plain = load(7, |_| {});
    // Node 0 is hidden with child 1, whose own field is true, and 2 below 1. 3 and 4 are visible; 5 has no
    // field.
    let hide = |j: &mut Value| {
        j["scenes"][0]["nodes"] = json!([0, 3, 4, 5, 6]);
        j["nodes"][0]["extensions"] = visible(json!(false));
        j["nodes"][0]["children"] = json!([1]);
        j["nodes"][1]["extensions"] = visible(json!(true));
        j["nodes"][1]["children"] = json!([2]);
        j["nodes"][3]["extensions"] = visible(json!(true));
        j["nodes"][5]["extensions"] = json!({"KHR_node_visibility": {}});
    };
    for list in ["extensionsUsed", "extensionsRequired"] {
        let loaded = load(7, |j| {
            hide(j);
            j[list] = json!(["KHR_node_visibility"]);
        });
        assert_eq!(
            kinds(&loaded),
            [Hidden, Hidden, Hidden, Opaque, Opaque, Opaque, Opaque],
            "{list}"
        );
        assert!(
            (0..3)
                .all(|t| !loaded.scene.blocks(TriangleId(t)) && !loaded.scene.shows(TriangleId(t)))
        );
        assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
        // Ids, objects and bounds are unchanged. The kinds are part of the canonical bytes.
        assert_eq!(loaded.scene.triangles(), plain.scene.triangles());
        assert_eq!(loaded.scene.objects(), plain.scene.objects());
        assert_eq!(loaded.scene.bounds(), plain.scene.bounds());
        assert_ne!(loaded.scene.digest(), plain.scene.digest());
        let again = sightline_scene::Scene::from_blob("blob", &loaded.scene.to_blob()).unwrap();
        assert_eq!(again.kinds(), loaded.scene.kinds());
        let counts = loaded.scene.kinds().counts();
        let hidden = counts.iter().find(|c| c.kind == Hidden).unwrap();
        assert_eq!(
            (hidden.triangles, hidden.reason.as_str()),
            (3, "KHR_node_visibility")
        );
    }
}

#[test]
fn hidden_node_stays_hidden_against_extras_and_rules() {
    use SurfaceKind::{Hidden, Opaque};
    let hide = |j: &mut Value| {
        j["nodes"][0]["extensions"] = visible(json!(false));
        j["nodes"][0]["name"] = json!("ghost");
        j["nodes"][0]["extras"] = json!({"sightline": {"blocks": true, "shows": true}});
        j["nodes"][0]["skin"] = json!(0);
        j["materials"] = json!([{"alphaMode": "BLEND", "name": "glass"}]);
        j["meshes"][0]["primitives"][0]["material"] = json!(0);
        j["animations"] =
            json!([{"channels": [{"sampler": 0, "target": {"node": 0, "path": "scale"}}]}]);
    };
    assert_eq!(kinds(&load(2, hide)), [Hidden, Opaque]);
    // A rule that matches only hidden nodes results in a warning. A rule that also matches other nodes does
    // not.
    let mut g = Gltf::default();
    let p = g.positions(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    for _ in 0..2 {
        g.mesh(json!([{"attributes": {"POSITION": p}}]));
    }
    g.json["nodes"] = json!([{"mesh": 0}, {"mesh": 1}]);
    g.json["scenes"][0]["nodes"] = json!([0, 1]);
    hide(&mut g.json);
    let rules = [(SurfaceKind::OccluderOnly, "gh?st"), (Opaque, "*")];
    let rules = rules
        .map(|(kind, glob)| KindRule::new(kind, glob).unwrap())
        .to_vec();
    let options = LoadOptions {
        rules,
        ..LoadOptions::default()
    };
    let loaded = load_bytes_with("test.glb", &g.glb(), None, &options).unwrap();
    assert_eq!(kinds(&loaded), [Hidden, Opaque]);
    assert_eq!(loaded.warnings.len(), 1, "{:?}", loaded.warnings);
    assert!(loaded.warnings[0].starts_with("--occluder-only \"gh?st\" matches hidden nodes only"));
}

#[test]
fn rule_cannot_hide() {
    let loaded = load(1, |_| {});
    let rules = vec![KindRule {
        kind: SurfaceKind::Hidden,
        glob: "*".to_owned(),
    }];
    let hidden = sightline_scene::Kinds::from_runs([(1, SurfaceKind::Opaque, "by default")], rules);
    let error = loaded
        .scene
        .with_kinds("test", hidden)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("a rule sets the kind hidden, which only a scene file can set"),
        "{error}"
    );
}

#[test]
fn animated_visibility_makes_triangles_moving() {
    use SurfaceKind::{Hidden, Moving, Opaque};
    // Node 0 is hidden at first and animated, and 1 is its child. 2 is visible and animated. 3 is animated
    // below 4, which no animation shows. 5 has no animation.
    let loaded = load(6, |j| {
        j["extensionsRequired"] = json!(["KHR_node_visibility", "KHR_animation_pointer"]);
        j["scenes"][0]["nodes"] = json!([0, 2, 4, 5]);
        j["nodes"][0]["children"] = json!([1]);
        j["nodes"][0]["extensions"] = visible(json!(false));
        j["nodes"][4]["children"] = json!([3]);
        j["nodes"][4]["extensions"] = visible(json!(false));
        let channel = |n: u32| {
            let pointer = format!("/nodes/{n}/extensions/KHR_node_visibility/visible");
            let target = json!({"KHR_animation_pointer": {"pointer": pointer}});
            json!({"sampler": 0, "target": {"path": "pointer", "extensions": target}})
        };
        j["animations"] = json!([{"channels": [channel(0), channel(2), channel(3)]}]);
    });
    // The kinds are in depth-first order of the nodes: 0, 1, 2, 4, 3, 5.
    assert_eq!(
        kinds(&loaded),
        [Moving, Moving, Moving, Hidden, Hidden, Opaque]
    );
}

#[test]
fn nearest_extras_count_for_each_field() {
    use SurfaceKind::{Moving, OccluderOnly, Opaque, SeeThrough};
    let extras =
        |blocks: Value, shows: Value| json!({"sightline": {"blocks": blocks, "shows": shows}});
    let loaded = load(6, |j| {
        j["scenes"][0]["nodes"] = json!([0, 2, 3, 4, 5]);
        j["materials"] = json!([
            {"alphaMode": "BLEND", "extras": {"sightline": {"blocks": true}}},
            {"extras": {"sightline": {"shows": false}}},
        ]);
        // An ancestor's extras apply to its children. The mesh is nearer than the node, and the material is
        // nearest.
        j["nodes"][0]["extras"] = extras(json!(false), json!(true));
        j["nodes"][0]["children"] = json!([1]);
        j["meshes"][1]["extras"] = json!({"sightline": {"shows": false}});
        j["nodes"][2]["extras"] = json!({"sightline": {"blocks": false}});
        j["meshes"][2]["primitives"][0]["material"] = json!(0);
        j["meshes"][3]["primitives"][0]["material"] = json!(1);
        // Faults result in warnings and have no other effect.
        j["nodes"][4]["extras"] = json!({"sightline": {"blocks": "no", "hides": true}});
        j["nodes"][5]["extras"] = json!({"sightline": 7});
    });
    assert_eq!(
        kinds(&loaded),
        [SeeThrough, Moving, Opaque, OccluderOnly, Opaque, Opaque]
    );
    let warnings = loaded.warnings.join("\n");
    for part in [
        "node 4: extras.sightline.blocks is neither",
        "unknown field \"hides\"",
        "node 5",
    ] {
        assert!(warnings.contains(part), "{part} in {warnings}");
    }
}

#[test]
fn rules_match_names_of_objects_nodes_meshes_and_materials() {
    let names = |j: &mut Value| {
        j["materials"] = json!([{"name": "brick"}]);
        for (n, name) in ["hall", "door", "tree"].iter().enumerate() {
            j["nodes"][n]["name"] = json!(name);
        }
        j["meshes"][2]["name"] = json!("leaves");
        j["meshes"][0]["primitives"][0]["material"] = json!(0);
    };
    let mut g = Gltf::default();
    let p = g.positions(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    (0..3).for_each(|_| {
        g.mesh(json!([{"attributes": {"POSITION": p}}]));
    });
    g.json["nodes"] = (0..3).map(|n| json!({"mesh": n})).collect();
    g.json["scenes"][0]["nodes"] = json!([0, 1, 2]);
    names(&mut g.json);
    let with = |rules: &[(SurfaceKind, &str)]| {
        let rules = rules
            .iter()
            .map(|(kind, glob)| KindRule::new(*kind, glob).unwrap())
            .collect();
        let options = LoadOptions {
            rules,
            ..LoadOptions::default()
        };
        load_bytes_with("test.glb", &g.glb(), None, &options).unwrap()
    };
    use SurfaceKind::{Moving, OccluderOnly, Opaque, SeeThrough};
    let loaded = with(&[
        (Moving, "door"),
        (SeeThrough, "leaves"),
        (OccluderOnly, "br?ck"),
    ]);
    assert_eq!(kinds(&loaded), [OccluderOnly, Moving, SeeThrough]);
    let loaded = with(&[(SeeThrough, "*"), (Opaque, "hall/*")]);
    assert_eq!(kinds(&loaded), [Opaque, SeeThrough, SeeThrough]);
    let loaded = with(&[(SeeThrough, "leafs")]);
    assert!(
        loaded.warnings[0].ends_with("similar names: leaves"),
        "{:?}",
        loaded.warnings
    );
}

#[test]
fn obj_materials_apply_by_face_and_missing_library_warns() {
    let dir = tempfile::tempdir().unwrap();
    let obj = "mtllib my glass.mtl gone.mtl\nmtllib ../out.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\no a\nusemtl pane\n\
               f 1 2 3\nusemtl wall\nf 1 2 3\nf 1 2 3\no b\nf 1 2 3\nusemtl nowhere\nf 1 2 3\n";
    let path = dir.path().join("a.obj");
    std::fs::write(
        &path,
        obj.replace("my glass.mtl gone.mtl", "my.mtl gone.mtl"),
    )
    .unwrap();
    std::fs::write(
        dir.path().join("my.mtl"),
        "newmtl pane\nd 0.3\nnewmtl wall\nKd 1 0 0\n",
    )
    .unwrap();
    let loaded = load_with(&path, &LoadOptions::default()).unwrap();
    use SurfaceKind::{Opaque, SeeThrough};
    assert_eq!(kinds(&loaded), [SeeThrough, Opaque, Opaque, Opaque, Opaque]);
    let warnings = loaded.warnings.join("\n");
    for part in [
        "\"gone.mtl\" is missing",
        "\"../out.mtl\" is not read",
        "\"nowhere\" is in no library",
    ] {
        assert!(warnings.contains(part), "{part} in {warnings}");
    }
    // A library with spaces in its name, and rules for materials of OBJ files.
    std::fs::write(&path, obj.replace("my glass.mtl gone.mtl", "my glass.mtl")).unwrap();
    std::fs::write(
        dir.path().join("my glass.mtl"),
        "newmtl pane\nillum 4\nnewmtl wall\n",
    )
    .unwrap();
    let rules = vec![
        KindRule::new(SurfaceKind::Moving, "wall").unwrap(),
        KindRule::new(SeeThrough, "b").unwrap(),
    ];
    let loaded = load_with(
        &path,
        &LoadOptions {
            rules,
            ..LoadOptions::default()
        },
    )
    .unwrap();
    assert_eq!(
        kinds(&loaded),
        [
            SeeThrough,
            SurfaceKind::Moving,
            SurfaceKind::Moving,
            SeeThrough,
            SeeThrough
        ]
    );
}
