//! Tests that exact methods reject scenes with alpha masks.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test")]

use std::sync::Arc;

use sightline_bake::{BakeError, BakeScene, Control, Inputs, SoleMember, Watcher};
use sightline_model::{
    Effort, GridCells, JobSpec, KnownCells, Method, PlannedJob, Sampler, Sampling,
};
use sightline_scene::load::{LoadOptions, load_bytes_with};
use sightline_trace::{CubeSpec, cpu::CpuBackend};
use sightline_viewcells::TileIndex;

struct Silent;

impl Watcher for Silent {
    fn rendered(&self, _: u64) {}
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        false
    }
}

/// A triangle whose mask is open everywhere.
const FILE: &str = r#"{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.2]}}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36,
            "uri": "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;

#[test]
fn masked_tile_is_sampled_but_not_decided() {
    let options = LoadOptions {
        alpha_textures: true,
        ..LoadOptions::default()
    };
    let scene = load_bytes_with("mask.gltf", FILE.as_bytes(), None, &options)
        .unwrap()
        .scene;
    assert!(scene.kinds().any_masked());
    let scene = Arc::new(scene);
    let view = sightline_scene::Aabb::new([2.0; 3].into(), [3.0; 3].into());
    let cells = KnownCells::Grid(GridCells::new(view, [1, 1, 1]).unwrap());
    let sampling = Sampling::new(Sampler::lines(cells));
    let digest = scene.digest().0;
    let backend = CpuBackend::new(
        Arc::clone(&scene),
        CubeSpec::from_sampler(&sampling.sampler),
    )
    .unwrap();
    let scene = BakeScene::new(scene).unwrap();
    let control = Control {
        watcher: &Silent,
        deadline: None,
        crew: &SoleMember,
    };
    let run = |method: Method| {
        let job = PlannedJob::new(JobSpec::new(digest, method)).unwrap();
        sightline_bake::run(
            &job,
            TileIndex(0),
            Inputs::new(&scene).with_tracer(&backend),
            control,
        )
    };
    assert!(run(Method::aggressive(sampling.clone())).is_ok());
    for effort in [Effort::Full, Effort::Bounded] {
        match run(Method::exact(sampling.clone(), effort)) {
            Err(BakeError::Tile(why)) => {
                assert!(why.contains("use the method aggressive"), "{why}")
            }
            other => panic!("{other:?}"),
        }
    }
}
