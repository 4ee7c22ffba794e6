//! A tile of ambient occlusion: the openness of its receivers, block by block.
//!
//! The mathematics is that of `sightline_ambient`; here is what a tile is and how its answers become bytes.
//! No backend takes part, so all machines give the same bytes.

use glam::DVec3;
use rayon::prelude::*;
use sightline_ambient::query::{Openness as Answer, Scratch};
use sightline_ambient::receivers::Receiver;
use sightline_ambient::solve::{Options, solve_block};
use sightline_model::JobSpec;
use sightline_model::openness::Openness;
use sightline_model::receivers::{self, Receivers};
use sightline_sampling::Watcher;

use crate::outcome::{BakeError, TileDone, tile_error};
use crate::scene::BakeScene;

/// Computes tile `number` of a job of ambient occlusion. `receivers` are those that the job names.
///
/// The bytes are a function of the scene and the receivers.
///
/// # Errors
/// [`BakeError`]; a cancelled tile is one.
///
/// # Panics
/// On a thread of rayon's pool, which could wait for itself.
pub fn run_ambient_tile(
    spec: &JobSpec,
    number: u32,
    scene: &BakeScene,
    receivers: &Receivers,
    watcher: &dyn Watcher,
) -> Result<TileDone, BakeError> {
    let wrong = |reason: &str| BakeError::Tile(reason.to_owned());
    let ambient = spec.ambient.ok_or_else(|| wrong("the job names no receivers"))?;
    if ambient.points as usize != receivers.receivers.len() {
        return Err(wrong("the job names other receivers than were sent"));
    }
    let blocks = receivers.of_tile(number).ok_or_else(|| wrong("the plan has no such tile"))?;
    let blockers = scene.blockers().map_err(BakeError::Tile)?;
    let options = Options::new(receivers.asked.distance);
    let answers: Vec<Option<Vec<Answer>>> = blocks
        .par_iter()
        .map_init(Scratch::default, |scratch, block| {
            if watcher.cancelled() {
                return None;
            }
            let block: Vec<Receiver> = block.iter().map(receiver).collect();
            let answers = solve_block(blockers, &block, &options, scratch);
            watcher.rendered(answers.len() as u64);
            answers.iter().for_each(|_| watcher.cell_done());
            Some(answers)
        })
        .collect();
    // The order of blocks, whichever thread had them.
    let answers: Option<Vec<Vec<Answer>>> = answers.into_iter().collect();
    let answers = answers.ok_or(BakeError::Cancelled)?.concat();
    let bytes = openness(&answers)?.encode().map_err(tile_error)?;
    Ok(TileDone { bytes, samples: answers.len() as u64, recomputed: Vec::new() })
}

fn receiver(r: &receivers::Receiver) -> Receiver {
    let receivers::Receiver { point, normal, triangle } = *r;
    Receiver { point: DVec3::from_array(point), normal: DVec3::from_array(normal), triangle }
}

/// Answers in single precision.
fn openness(answers: &[Answer]) -> Result<Openness, BakeError> {
    if let Some(at) = answers.iter().position(|a| !(a.open.is_finite() && a.bound.is_finite())) {
        return Err(BakeError::Tile(format!("the openness of receiver {at} of the tile is not a number")));
    }
    // Rounding can leave the range by less than the bound.
    let values = answers.iter().map(|a| (a.open as f32).clamp(0.0, 1.0)).collect();
    let bound = answers.iter().fold(0.0, |most: f64, a| most.max(a.bound));
    Ok(Openness { numbers: 1, values, bound })
}
