//! Answers about stored results that need rays or exact queries: for the coordinator, which does neither.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;
use sightline_coordinator::SceneQueries;
use sightline_model::TracerChoice;
use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_scene::Scene;

use crate::args::MeasureArgs;
use crate::kind_args::KindArgs;
use crate::measuring;
use crate::reasons;

/// What errors call the result.
const RESULT: &str = "the stored result";

/// Answers with the program's own commands.
pub struct Commands;

impl SceneQueries for Commands {
    fn why(
        &self,
        pvs: &Pvs,
        scene: Scene,
        cell_and_triangle: (u32, u32),
        is_gone: &dyn Fn() -> bool,
    ) -> Result<v1::WhyResponse, String> {
        let answer =
            reasons::ask_as_message(pvs, Path::new(RESULT), &scene, cell_and_triangle, is_gone);
        answer.map_err(|e| e.to_string())
    }

    fn measure(
        &self,
        pvs: &Pvs,
        scene: Scene,
        asked: &v1::MeasureRequest,
        is_gone: &dyn Fn() -> bool,
    ) -> Result<v1::MeasureResponse, String> {
        let args = MeasureArgs {
            scene: PathBuf::from("the stored scene"),
            result: PathBuf::from(RESULT),
            kinds: KindArgs::default(),
            viewpoints: asked.viewpoints,
            viewpoints_file: None,
            seed: asked.seed,
            path: None,
            pairs: 0,
            exact: false,
            images: None,
            turntable: false,
            resolution: asked.resolution,
            backend: TracerChoice::Auto,
        };
        let report =
            measuring::measured_in(&args, pvs, Arc::new(scene), (None, None), &mut |_, _| {
                !is_gone()
            });
        let report = report.map_err(|e| e.to_string())?;
        let of = |value: &Value, key: &str| value[key].as_f64().unwrap_or_default();
        let frame = |value: &Value| {
            let at = |axis: usize| value["viewpoint"][axis].as_f64().unwrap_or_default() as f32;
            v1::WrongFrame {
                viewpoint: Some(v1::Point {
                    x: at(0),
                    y: at(1),
                    z: at(2),
                }),
                cell: value["cell"].as_u64().unwrap_or_default() as u32,
                error: of(value, "error"),
            }
        };
        Ok(v1::MeasureResponse {
            frames: report["frames"].as_u64().unwrap_or_default(),
            mean_error: of(&report, "mean_error"),
            p99_error: of(&report, "p99_error"),
            max_error: of(&report, "max_error"),
            worst: report["worst"]
                .as_array()
                .map_or_else(Vec::new, |all| all.iter().map(frame).collect()),
        })
    }
}
