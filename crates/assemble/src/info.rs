//! The description of a bake in its result: all facts that the result depends on. Facts that differ between
//! two runs are not included.

use sightline_model::{ALGORITHM_VERSION, Visibility};
use sightline_scene::Kinds;
use sightline_scene::kinds::KindCount;
use sightline_viewcells::TileIndex;

use crate::{Assembly, OutputState, Outputs};

/// Describes a bake as a JSON object.
pub fn info<O: Outputs>(input: &Assembly<'_, O>, task: &Visibility) -> String {
    let of_state = |state| {
        let leaves = input.job.plan().leaves();
        leaves
            .filter(|tile| input.outputs.state(TileIndex(*tile)) == state)
            .count()
    };
    let mut info = serde_json::json!({
        "program": concat!("sightline ", env!("CARGO_PKG_VERSION")),
        "algorithm": ALGORITHM_VERSION,
        "profile": input.profile,
        "spec": input.job.spec().to_json(),
        "samples": input.samples,
        "tiles_set_aside": of_state(OutputState::SetAside),
    });
    let open = of_state(OutputState::Open);
    if open > 0 {
        info["tiles_open"] = open.into();
    }
    if let Some(marks) = task.viewpoints().mask() {
        info["viewpoints"] = serde_json::json!({
            "cells_reached": marks.reached(), "cells": marks.count(), "parts": marks.marked(),
        });
    }
    if input.scene.is_culled {
        info["cull_back_faces"] = true.into();
    }
    // Opaque scenes have no `kinds` field.
    let kinds = &input.scene.kinds;
    if *kinds != Kinds::opaque() {
        let count = |c: KindCount| {
            let kind = c.kind.name();
            serde_json::json!({"kind": kind, "reason": c.reason, "triangles": c.triangles})
        };
        let counts: Vec<_> = kinds.counts().into_iter().map(count).collect();
        let rules = kinds.rules().iter();
        let rules: Vec<_> = rules
            .map(|r| serde_json::json!({"kind": r.kind.name(), "glob": r.glob}))
            .collect();
        info["kinds"] = serde_json::json!({"counts": counts, "rules": rules});
        if kinds.alpha_textures() {
            info["kinds"]["alpha_textures"] = true.into();
        }
    }
    info.to_string()
}
