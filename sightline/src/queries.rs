//! Answers to queries that need tracers or exact queries, for the coordinator, which has neither.

use std::path::Path;
use std::sync::Arc;

use sightline_coordinator::SceneQueries;
use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_scene::{Scene, TriangleId};
use sightline_viewcells::CellIndex;

use crate::explain::explain_as_message;
use crate::measure::{MeasureOptions, MeasureReport, measure_in};
use crate::observer::Observer;
use crate::result::NamedResult;

/// The name of the result in error messages, which have no path.
const RESULT: &str = "the stored result";

/// The query program of this library, for a coordinator in this process.
///
/// ```
/// let queries = std::sync::Arc::new(sightline::LibraryQueries);
/// # let _: std::sync::Arc<dyn sightline_coordinator::SceneQueries> = queries;
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct LibraryQueries;

/// An observer that cancels if the client of a call has disconnected.
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
        cell: CellIndex,
        triangle: TriangleId,
        is_gone: &(dyn Fn() -> bool + Sync),
    ) -> Result<v1::WhyResponse, String> {
        let result = NamedResult::new(pvs, Path::new(RESULT));
        explain_as_message(result, &scene, cell, triangle, &|| is_gone()).map_err(|e| e.to_string())
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
            MeasureReport::Exact(_) => {
                return Err("the measurement returned exact sets in place of \
            frames; report this fault"
                    .to_owned());
            }
        };
        let frame = |frame: &sightline_measure::Frame| {
            let [x, y, z] = frame.viewpoint;
            v1::WrongFrame {
                viewpoint: Some(v1::Point { x, y, z }),
                cell: frame.cell.0,
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
