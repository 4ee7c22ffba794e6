//! Answers about stored results that need tracers or exact queries: for the coordinator, which has neither.

use std::path::Path;
use std::sync::Arc;

use sightline_coordinator::SceneQueries;
use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_scene::Scene;

use crate::explain::explain_as_message;
use crate::measure::{MeasureOptions, MeasureReport, measure_in};
use crate::observer::Observer;
use crate::result::NamedResult;

/// The name of the result in errors.
const RESULT: &str = "the stored result";

/// The answers of this library, for a coordinator of this process.
///
/// ```
/// let queries = std::sync::Arc::new(sightline::LibraryQueries);
/// # let _: std::sync::Arc<dyn sightline_coordinator::SceneQueries> = queries;
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct LibraryQueries;

/// An observer that cancels when the client of a call is gone.
struct Caller<'a>(&'a (dyn Fn() -> bool + Sync));

impl Observer for Caller<'_> {
    fn is_cancelled(&self) -> bool {
        (self.0)()
    }
}

impl SceneQueries for LibraryQueries {
    fn why(
        &self,
        pvs: &Pvs,
        scene: Scene,
        cell_and_triangle: (u32, u32),
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::WhyResponse, String> {
        let result = NamedResult::new(pvs, Path::new(RESULT));
        explain_as_message(result, &scene, cell_and_triangle, &|| is_gone())
            .map_err(|e| e.to_string())
    }

    fn measure(
        &self,
        pvs: &Pvs,
        scene: Scene,
        asked: &v1::MeasureRequest,
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::MeasureResponse, String> {
        let options = MeasureOptions {
            viewpoints: asked.viewpoints,
            seed: asked.seed,
            resolution: asked.resolution,
            ..MeasureOptions::default()
        };
        let result = NamedResult::new(pvs, Path::new(RESULT));
        let measured = measure_in(result, Arc::new(scene), &options, &Caller(is_gone));
        let report = match measured.map_err(|e| e.to_string())? {
            MeasureReport::Frames(measured) => measured.report,
            MeasureReport::Exact(_) => return Err("frames were measured exactly".to_owned()),
        };
        let frame = |frame: &sightline_measure::Frame| {
            let [x, y, z] = frame.viewpoint;
            v1::WrongFrame {
                viewpoint: Some(v1::Point { x, y, z }),
                cell: frame.cell,
                error: frame.error,
            }
        };
        Ok(v1::MeasureResponse {
            frames: report.frames,
            mean_error: report.mean_error,
            p99_error: report.p99_error,
            max_error: report.max_error,
            worst: report.worst.iter().map(frame).collect(),
        })
    }
}
