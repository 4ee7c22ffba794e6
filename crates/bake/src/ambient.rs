//! A tile of ambient occlusion: the openness of its receivers, block by block.
//!
//! The mathematics is that of `sightline_ambient`; here is what a tile is and how its answers become bytes.
//! No backend takes part, so all machines give the same bytes.

use glam::DVec3;
use rayon::prelude::*;
use sightline_ambient::{Answer, Falloff, Light, Memory, Receiver, Settings, Solver};
use sightline_model::Ambient;
use sightline_model::openness::Openness;
use sightline_model::receivers::{self, Receivers};
use sightline_sample::Watcher;

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
pub fn run(
    ambient: &Ambient,
    number: u32,
    scene: &BakeScene,
    receivers: &Receivers,
    watcher: &dyn Watcher,
) -> Result<TileDone, BakeError> {
    let wrong = |reason: &str| BakeError::Tile(reason.to_owned());
    if ambient.points as usize != receivers.receivers.len() {
        return Err(wrong("the job names other receivers than were sent"));
    }
    let blocks = receivers
        .of_tile(number)
        .ok_or_else(|| wrong("the plan has no such tile"))?;
    let prepared = scene.ambient().map_err(BakeError::Tile)?;
    let settings = settings(&receivers.settings).map_err(|reason| wrong(&reason))?;
    let solver = Solver::new(prepared, settings);
    let answers: Vec<Option<Vec<Answer>>> = blocks
        .par_iter()
        // Some take much longer than others.
        .with_max_len(1)
        .map_init(Memory::default, |memory, block| {
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
    // The order of blocks, whichever thread had them.
    let answers: Option<Vec<Vec<Answer>>> = answers.into_iter().collect();
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
fn settings(wanted: &receivers::ReceiverSettings) -> Result<Settings, String> {
    let light = |(k, corners): (usize, &Vec<[f64; 3]>)| {
        Light::new(corners).map_err(|e| format!("light {k}: {e}"))
    };
    Ok(Settings {
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
        ..Settings::new(wanted.distance)
    })
}

/// Answers in single precision, so many numbers each.
fn openness(answers: &[Answer], numbers: u32) -> Result<Openness, BakeError> {
    let (mut values, mut bound) = (Vec::with_capacity(answers.len() * numbers as usize), 0.0f64);
    for (at, answer) in answers.iter().enumerate() {
        let fractions = std::iter::once(answer.openness.open).chain(answer.lights.iter().copied());
        let all = fractions.clone().all(f64::is_finite) && answer.openness.bound.is_finite();
        if !all || fractions.clone().count() != numbers as usize {
            return Err(BakeError::Tile(format!(
                "receiver {at} of the tile has no answer in numbers"
            )));
        }
        // Rounding can leave the range by less than the bound.
        values.extend(fractions.map(|x| (x as f32).clamp(0.0, 1.0)));
        bound = bound.max(answer.openness.bound);
    }
    Ok(Openness {
        numbers,
        values,
        bound,
    })
}
