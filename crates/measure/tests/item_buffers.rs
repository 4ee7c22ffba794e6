//! Test that item buffers show only triangles of the exact set from their viewpoint.

#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::sync::Arc;

use glam::Vec3;
use sightline_numbers::random::SplitMix64;
use sightline_scene::generate::{SceneKind, SceneParams, generate};
use sightline_tetra::point_query::{Hierarchy, Looker};
use sightline_tetra::surfaces::Surfaces;
use sightline_tetra::{Mode, Scratch, View};
use sightline_trace::cpu::CpuBackend;
use sightline_trace::{CubeSpec, SKY, Strata, Tracer as _};

#[test]
fn item_buffers_show_only_triangles_of_exact_set() {
    let town = SceneParams {
        triangles: Some(3000),
        ..SceneParams::default()
    };
    let rooms = SceneParams {
        grid: Some([2, 2]),
        ..SceneParams::default()
    };
    for (kind, params) in [(SceneKind::Town, town), (SceneKind::Rooms, rooms)] {
        let scene = Arc::new(generate(kind, &params).unwrap());
        let surfaces = Surfaces::new(&scene).unwrap();
        let hierarchy = Hierarchy::new(surfaces.view());
        let looker = Looker::new(surfaces.view(), hierarchy.view());
        let spec = CubeSpec {
            resolution: 128,
            strata: Strata::One,
            keep_pixels: false,
        };
        let backend = CpuBackend::new(scene.clone(), spec).unwrap();
        let renderer = backend.prepare(None).unwrap();
        let (mut stream, mut scratch) = (SplitMix64::new(5), Scratch::default());
        let bounds = scene.bounds();
        let mut shown = 0;
        for _ in 0..8 {
            let part = Vec3::new(stream.unit_f32(), stream.unit_f32(), stream.unit_f32());
            let x = bounds.min + (bounds.max - bounds.min) * part;
            let mut ids = renderer.image(x).unwrap().ids;
            ids.sort_unstable();
            ids.dedup();
            ids.pop_if(|last| *last == SKY);
            shown += ids.len();
            let seen = looker
                .look(
                    x.as_dvec3().to_array(),
                    &View::default(),
                    Mode::Exact,
                    &mut scratch,
                )
                .unwrap();
            for id in ids {
                assert!(
                    seen.visible.binary_search(&id).is_ok(),
                    "{kind:?}: triangle {id} from {x}"
                );
            }
        }
        assert!(shown > 500, "{kind:?}: {shown}");
    }
}
