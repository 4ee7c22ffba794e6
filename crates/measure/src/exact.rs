//! The error of a result without pixels: the solid angle that its sets miss, by exact sets from points.
//!
//! For each viewpoint, the measurement compares the exact set, with the solid angle of each triangle, with
//! the set of the viewpoint's cell (`sightline_tetra::point_query`). Item buffers overlook triangles that
//! fall between their pixels. This measurement finds every triangle that a set misses, even if it is seen
//! through an extremely narrow gap.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;
use sightline_numbers::ids::CellIndex;
use sightline_pvs::Pvs;
use sightline_tetra::point_query::Looker;
use sightline_tetra::{Mode, Scratch, View};

use crate::error::MeasureError;
use crate::report::nearest_rank;
use crate::viewpoints::Viewpoints;

/// The number of viewpoints between two reports of progress.
const BATCH: usize = 32;

/// The measures over all viewpoints. Errors are fractions of all directions.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ExactReport {
    /// True, to mark a report of solid angles, for which no pixels were drawn.
    pub exact: bool,
    /// The number of viewpoints.
    pub frames: u64,
    /// The mean over the viewpoints of the fraction of all directions in which a triangle outside the cell's
    /// set is seen.
    pub mean_error: f64,
    /// The 99th percentile by nearest rank: the ⌈0.99·frames⌉-th smallest error.
    pub p99_error: f64,
    /// The error of the worst viewpoint.
    pub max_error: f64,
    /// The number of viewpoints from which a triangle outside the set is seen. See-through triangles count,
    /// but have no solid angle.
    pub frames_with_error: u64,
    /// The mean over the viewpoints of the number of visible triangles.
    pub mean_seen: f64,
    /// The mean over the viewpoints of the number of visible triangles that are not in the set.
    pub mean_missed: f64,
    /// The number of view cells that contain a viewpoint.
    pub cells_visited: u64,
    /// The number of different triangles that are visible from a viewpoint.
    pub triangles_seen: u64,
    /// The number of different triangles that a set missed.
    pub triangles_missed: u64,
    /// The viewpoints with the largest errors, worst first. Of equal errors, the earlier viewpoint comes
    /// first.
    pub worst: Vec<ExactFrame>,
}

/// The measurement from one viewpoint.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ExactFrame {
    /// The index of the viewpoint, from 0.
    pub frame: u64,
    /// The position of the viewpoint, in world space.
    pub viewpoint: [f32; 3],
    /// The view cell that contains the viewpoint.
    pub cell: CellIndex,
    /// The fraction of all directions in which a missed triangle is seen.
    pub error: f64,
    /// The visible triangles that are not in the set, ascending.
    pub missed: Vec<u32>,
}

struct ExactJudgement {
    frame: ExactFrame,
    seen: Vec<u32>,
}

/// Measures a result from `views`. `looker` contains the triangles of the scene that was baked. Geometry at a
/// distance of `far` or more is not visible. `progress` receives the number of finished viewpoints and of all
/// viewpoints, and returns true to continue. The report does not depend on threads or time.
///
/// # Errors
/// [`MeasureError::Stopped`] if `progress` returns false. [`MeasureError::Outside`] if a viewpoint has no
/// cell. [`MeasureError::NoViewpoints`] if `views` is empty. Also the errors of the result's decoder.
pub fn measure_exact(
    looker: &Looker<'_>,
    pvs: &Pvs,
    views: &Viewpoints,
    far: Option<f64>,
    worst: usize,
    progress: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<ExactReport, MeasureError> {
    if views.points.is_empty() {
        return Err(MeasureError::NoViewpoints);
    }
    let total = views.points.len() as u64;
    let pool: Mutex<Vec<Scratch>> = Mutex::default();
    let view = View {
        distance: far,
        ..View::default()
    };
    let judge = |(frame, point): (usize, &glam::Vec3)| -> Result<ExactJudgement, MeasureError> {
        let viewpoint = point.to_array();
        let cell = pvs.find_cell(viewpoint).map(CellIndex);
        let cell = cell.ok_or(MeasureError::Outside {
            frame,
            point: viewpoint,
        })?;
        let mut set = Vec::new();
        pvs.visible(cell.0, &mut set)?;
        let mut scratch = pool
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop()
            .unwrap_or_default();
        let seen = looker.look(viewpoint.map(f64::from), &view, Mode::Exact, &mut scratch)?;
        let (mut missed, mut angle) = (Vec::new(), 0.0);
        for (id, area) in seen.visible.iter().zip(&seen.areas) {
            if set.binary_search(id).is_err() {
                missed.push(*id);
                angle += area;
            }
        }
        let seen = seen.visible.clone();
        pool.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(scratch);
        let error = angle / (4.0 * std::f64::consts::PI);
        Ok(ExactJudgement {
            frame: ExactFrame {
                frame: frame as u64,
                viewpoint,
                cell,
                error,
                missed,
            },
            seen,
        })
    };
    let (mut seen, mut missed) = (vec![false; pvs.triangle_count() as usize], BTreeSet::new());
    let (mut cells, mut frames) = (BTreeSet::new(), Vec::new());
    let (mut all_seen, mut all_missed) = (0u64, 0u64);
    for (batch, points) in views.points.chunks(BATCH).enumerate() {
        let judged: Vec<Result<ExactJudgement, MeasureError>> = points
            .par_iter()
            .enumerate()
            .map(|(i, point)| judge((batch * BATCH + i, point)))
            .collect();
        for judged in judged {
            let ExactJudgement { frame, seen: ids } = judged?;
            all_seen += ids.len() as u64;
            all_missed += frame.missed.len() as u64;
            // A result of another scene may have fewer triangles. The caller has compared the digests before.
            ids.iter()
                .filter_map(|id| seen.get_mut(*id as usize).map(|s| *s = true))
                .for_each(drop);
            missed.extend(frame.missed.iter().copied());
            cells.insert(frame.cell);
            frames.push(frame);
        }
        let done = frames.len() as u64;
        if !progress(done, total) {
            return Err(MeasureError::Stopped { done, total });
        }
    }
    // Add the errors in the order of the viewpoints, so that the sum does not depend on threads.
    let mean_error = match views.weights.is_empty() {
        true => frames.iter().map(|f| f.error).sum::<f64>() / total as f64,
        false => {
            let sum: f64 = views.weights.iter().sum();
            frames
                .iter()
                .zip(&views.weights)
                .map(|(f, weight)| f.error * weight)
                .sum::<f64>()
                / sum
        }
    };
    let frames_with_error = frames.iter().filter(|f| !f.missed.is_empty()).count() as u64;
    frames.sort_by(|a, b| b.error.total_cmp(&a.error).then(a.frame.cmp(&b.frame)));
    let errors: Vec<f64> = frames.iter().rev().map(|f| f.error).collect();
    frames.truncate(worst);
    Ok(ExactReport {
        exact: true,
        frames: total,
        mean_error,
        p99_error: nearest_rank(&errors, 99).unwrap_or(0.0),
        max_error: errors.last().copied().unwrap_or(0.0),
        frames_with_error,
        mean_seen: all_seen as f64 / total as f64,
        mean_missed: all_missed as f64 / total as f64,
        cells_visited: cells.len() as u64,
        triangles_seen: seen.iter().filter(|s| **s).count() as u64,
        triangles_missed: missed.len() as u64,
        worst: frames,
    })
}
