//! The error of a result without pixels: the solid angle that its sets miss, by exact sets from points.
//!
//! From each viewpoint the exact set with the solid angle of each triangle is compared with the set of the
//! viewpoint's cell (`sightline_tetra::look`). Item buffers overlook what falls between their pixels; this
//! does not, so a triangle that is missed by a set is found however narrow the gap is through which it is
//! seen.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;
use sightline_pvs::Pvs;
use sightline_tetra::look::Looker;
use sightline_tetra::{Mode, Scratch, View};

use crate::error::MeasureError;
use crate::report::nearest_rank;
use crate::viewpoints::Viewpoints;

/// Viewpoints between two reports of progress.
const BATCH: usize = 32;

/// The measures over all viewpoints. Errors are fractions of all directions.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ExactReport {
    /// That nothing was drawn: solid angles are meant, not pixels.
    pub exact: bool,
    /// Number of viewpoints.
    pub frames: u64,
    /// Mean over the viewpoints of the part of all directions in which a triangle is seen that is not in the
    /// cell's set.
    pub mean_error: f64,
    /// 99th percentile by nearest rank: the ⌈0.99·frames⌉-th smallest error.
    pub p99_error: f64,
    /// The error of the worst viewpoint.
    pub max_error: f64,
    /// Number of viewpoints from which a triangle is seen that is not in the set. See-through triangles
    /// count, but have no solid angle.
    pub frames_with_error: u64,
    /// Mean over the viewpoints of the number of triangles that are seen.
    pub mean_seen: f64,
    /// Mean over the viewpoints of the number of those that are not in the set.
    pub mean_missed: f64,
    /// Number of view cells with a viewpoint in them.
    pub cells_visited: u64,
    /// Number of different triangles seen from any viewpoint.
    pub triangles_seen: u64,
    /// Number of different triangles that were missed from any.
    pub triangles_missed: u64,
    /// The viewpoints with the greatest errors, worst first; of equal ones the earlier first.
    pub worst: Vec<ExactFrame>,
}

/// One viewpoint.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ExactFrame {
    /// Its index, from 0.
    pub frame: u64,
    /// Where it is, world space.
    pub viewpoint: [f32; 3],
    /// The view cell that it lies in.
    pub cell: u32,
    /// The part of all directions that is missed.
    pub error: f64,
    /// The triangles that are seen and not in the set, ascending.
    pub missed: Vec<u32>,
}

struct ExactJudgement {
    frame: ExactFrame,
    seen: Vec<u32>,
}

/// Measures a result from `views`. `looker` has the triangles of the scene that was baked; what is at least
/// `far` away is not seen. `progress` is told how many viewpoints are done and how many there are, and says
/// whether to go on. The report depends on neither threads nor time.
///
/// # Errors
/// [`MeasureError::Stopped`] when `progress` says so, [`MeasureError::Outside`] when a viewpoint has no cell,
/// and what the result's decoder reports.
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
        let cell = pvs.find_cell(viewpoint).ok_or(MeasureError::Outside {
            frame,
            point: viewpoint,
        })?;
        let mut set = Vec::new();
        pvs.visible(cell, &mut set)?;
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
            // A result of another scene may have fewer triangles; its digest was compared before.
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
    // Added in the order of the viewpoints, whatever threads did.
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
