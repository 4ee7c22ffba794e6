//! The computation of a tile of ambient occlusion: the openness of the tile's receivers, block by block.
//!
//! `sightline_ambient` computes the openness. This module selects the receivers of a tile and encodes their
//! openness. No tracer is used, so all machines compute the same bytes.

use glam::DVec3;
use rayon::prelude::*;
use sightline_ambient::{
    BlockMemory, Falloff, Light, Receiver, ReceiverResult, Solver, SolverSettings,
};
use sightline_model::Ambient;
use sightline_model::openness::Openness;
use sightline_model::receivers::{self, Receivers};
use sightline_sample::Watcher;
use sightline_viewcells::TileIndex;

use crate::outcome::{BakeError, TileDone, tile_error};
use crate::scene::BakeScene;

/// Computes tile `number` of a job of ambient occlusion. `receivers` are the receivers that the job
/// references.
///
/// The bytes are a function of the scene and the receivers.
///
/// # Errors
/// [`BakeError::Cancelled`] if the watcher cancels the tile; [`BakeError::Tile`] if the tile cannot be
/// computed.
///
/// # Panics
/// Panics on a thread of rayon's pool, because the thread could wait for itself.
pub fn run(
    ambient: &Ambient,
    number: TileIndex,
    scene: &BakeScene,
    receivers: &Receivers,
    watcher: &dyn Watcher,
) -> Result<TileDone, BakeError> {
    let wrong = |reason: &str| BakeError::Tile(reason.to_owned());
    if ambient.points as usize != receivers.receivers.len() {
        return Err(wrong(
            "the number of receivers differs from the job's; send the receivers of this job",
        ));
    }
    let blocks = receivers
        .of_tile(number)
        .ok_or_else(|| wrong("the plan has no tile with this number"))?;
    let prepared = scene.ambient().map_err(BakeError::Tile)?;
    let settings = settings(&receivers.settings).map_err(|reason| wrong(&reason))?;
    let solver = Solver::new(prepared, settings);
    let answers: Vec<Option<Vec<ReceiverResult>>> = blocks
        .par_iter()
        // The times of blocks differ much.
        .with_max_len(1)
        .map_init(BlockMemory::default, |memory, block| {
            if watcher.cancelled() {
                return None;
            }
            let block: Vec<Receiver> = block.iter().map(receiver).collect();
            let answers = solver.block(&block, memory);
            watcher.rendered(answers.len() as u64);
            answers.iter().for_each(|_| watcher.cell_done());
            Some(answers)
        })
        .collect();
    // The answers are in the order of the blocks, independent of the threads that computed them.
    let answers: Option<Vec<Vec<ReceiverResult>>> = answers.into_iter().collect();
    let answers = answers.ok_or(BakeError::Cancelled)?.concat();
    let bytes = openness(&answers, ambient.numbers())?
        .encode()
        .map_err(tile_error)?;
    Ok(TileDone {
        bytes,
        samples: answers.len() as u64,
        recomputed: Vec::new(),
    })
}

fn receiver(r: &receivers::Receiver) -> Receiver {
    let receivers::Receiver {
        point,
        normal,
        triangle,
    } = *r;
    Receiver {
        point: DVec3::from_array(point),
        normal: DVec3::from_array(normal),
        triangle,
    }
}

/// Converts the settings of receivers to the settings of the solver.
fn settings(wanted: &receivers::ReceiverSettings) -> Result<SolverSettings, String> {
    let light = |(k, corners): (usize, &Vec<[f64; 3]>)| {
        Light::new(corners).map_err(|e| format!("light {k}: {e}"))
    };
    Ok(SolverSettings {
        falloff: match wanted.falloff {
            receivers::Falloff::None => Falloff::None,
            receivers::Falloff::Sqrt => Falloff::Sqrt,
        },
        lights: wanted
            .lights
            .iter()
            .enumerate()
            .map(light)
            .collect::<Result<_, _>>()?,
        ..SolverSettings::new(wanted.distance)
    })
}

/// Converts the results of receivers to single precision. Each receiver must have `numbers` values.
fn openness(answers: &[ReceiverResult], numbers: u32) -> Result<Openness, BakeError> {
    let (mut values, mut bound) = (Vec::with_capacity(answers.len() * numbers as usize), 0.0f64);
    for (at, answer) in answers.iter().enumerate() {
        let fractions = std::iter::once(answer.openness.open).chain(answer.lights.iter().copied());
        let all = fractions.clone().all(f64::is_finite) && answer.openness.bound.is_finite();
        if !all || fractions.clone().count() != numbers as usize {
            return Err(BakeError::Tile(format!(
                "receiver {at} of the tile has a value that is not finite, or a wrong number of values"
            )));
        }
        // Rounding errors can move a value out of the range 0 to 1 by less than the bound.
        values.extend(fractions.map(|x| (x as f32).clamp(0.0, 1.0)));
        bound = bound.max(answer.openness.bound);
    }
    Ok(Openness {
        numbers,
        values,
        bound,
    })
}
