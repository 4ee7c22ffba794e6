//! `sightline verify --sample` of a result of the method portals, which has no certificates: exact queries
//! about pairs of a cell and a triangle that are called hidden.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rayon::prelude::*;
use serde_json::json;
use sightline_exact::{Cell, Cost, ExactScene, Found, Limits, Places, Polygon, Sources, from_cell};
use sightline_numbers::Aabb;
use sightline_numbers::random::SplitMix64;
use sightline_portals::OpenFaces;
use sightline_pvs::Pvs;
use sightline_scene::Scene;

use crate::args::VerifyArgs;
use crate::enclosure::{of_result, walls_of};
use crate::error::CliError;
use crate::opening::plural;
use crate::progress::say;
use crate::verdict::{Hooks, Verdict};

/// Draws of a pair that are not hidden before the sample ends with fewer pairs.
const TRIES: u32 = 1000;

/// Asks about pairs that are drawn at random.
pub fn check(
    args: &VerifyArgs,
    (pvs, scene): (&Pvs, &Scene),
    wanted: u64,
    hooks: &Hooks<'_>,
) -> Result<Verdict, CliError> {
    let info: serde_json::Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    if info["spec"]["visibility"]["far"].is_number() {
        return Err(CliError::Input(format!(
            "{} leaves out what is beyond --far, which is not hidden; verify a result without --far",
            args.result.display()
        )));
    }
    let places = of_result(pvs, scene, &args.result)?;
    let exact = ExactScene::prepare(scene).map_err(|e| CliError::Input(e.to_string()))?;
    let pairs = draw(pvs, &exact, wanted, args.seed)?;
    if pairs.is_empty() {
        return Err(CliError::Input(format!(
            "{}: no pair that is called hidden was found, so there is nothing to ask",
            args.result.display()
        )));
    }
    let places = places.as_ref().map(|places| places as &dyn Places);
    let faces = open_faces(pvs, scene, &pairs, places);
    let ask = |(cell, triangle): &(u32, u32)| {
        let places = faces.get(cell).map(|faces| faces as &dyn Places).or(places);
        ask(pvs, &exact, (places, hooks.cancelled), *cell, *triangle)
    };
    let answers: Vec<Result<Answer, CliError>> = pairs.par_iter().map(ask).collect();
    if (hooks.cancelled)() {
        return Err(CliError::Interrupted(
            "interrupted; nothing is known yet".to_owned(),
        ));
    }
    let (mut hidden, mut undecided) = (0u64, 0u64);
    for ((cell, triangle), answer) in pairs.iter().zip(answers) {
        match answer? {
            Answer::Hidden => hidden += 1,
            Answer::Undecided => undecided += 1,
            Answer::Seen(why) => {
                let reason = format!("triangle {triangle} is called hidden and {why}");
                return Ok(Verdict::refused(Some(*cell), &reason, &args.result));
            }
        }
    }
    let value = json!({
        "accepted": true, "method": pvs.method(), "cells": pvs.cells(), "pairs": pairs.len(),
        "hidden": hidden, "undecided": undecided, "sampled": true,
    });
    if (pairs.len() as u64) < wanted {
        say(&format!(
            "note: of {wanted} pairs {} were found: nearly all triangles are in the sets",
            pairs.len()
        ));
    }
    let text = format!(
        "accepted: of {} called hidden, exact queries say the same of {hidden}; {undecided} are undecided",
        plural(pairs.len(), "pair")
    );
    Ok(Verdict::Accepted(value, text))
}

/// Pairs of a cell with viewpoints and a triangle that can be in a set and is not in the cell's.
fn draw(
    pvs: &Pvs,
    scene: &ExactScene,
    wanted: u64,
    seed: u64,
) -> Result<Vec<(u32, u32)>, CliError> {
    let mut random = SplitMix64::new(seed);
    let mut below = |n: u32| (((random.bits() >> 32) * u64::from(n)) >> 32) as u32;
    let mut of_cell: Vec<Option<Vec<u32>>> = vec![None; pvs.cells() as usize];
    let (mut pairs, mut tries) = (Vec::new(), 0);
    while (pairs.len() as u64) < wanted && tries < TRIES {
        tries += 1;
        let (cell, triangle) = (below(pvs.cells()), below(pvs.triangle_count()));
        if !pvs.is_reached(cell)? || !scene.occluders().is_target(triangle) {
            continue;
        }
        let set = &mut of_cell[cell as usize];
        let set = match set {
            Some(set) => set,
            None => {
                let mut ids = Vec::new();
                pvs.visible(cell, &mut ids)?;
                set.insert(ids)
            }
        };
        if set.binary_search(&triangle).is_err() {
            pairs.push((cell, triangle));
            tries = 0;
        }
    }
    Ok(pairs)
}

enum Answer {
    Hidden,
    Undecided,
    Seen(String),
}

/// The faces of the cells of some pairs, where these are open boxes.
fn open_faces<'a>(
    pvs: &Pvs,
    scene: &Scene,
    pairs: &[(u32, u32)],
    places: Option<&'a dyn Places>,
) -> BTreeMap<u32, OpenFaces<'a>> {
    let Some(scene) = walls_of(pvs, scene) else {
        return BTreeMap::new();
    };
    let cells: BTreeSet<u32> = pairs.iter().map(|(cell, _)| *cell).collect();
    let faces = |cell: u32| {
        let [min, max] = pvs.cell_bounds(cell)?.map(Vec3::from);
        Some((cell, OpenFaces::new(scene, Aabb::new(min, max), places)))
    };
    cells.into_iter().filter_map(faces).collect()
}

fn ask(
    pvs: &Pvs,
    scene: &ExactScene,
    (places, cancelled): (Option<&dyn Places>, &(dyn Fn() -> bool + Sync)),
    cell: u32,
    triangle: u32,
) -> Result<Answer, CliError> {
    let bounds = pvs.cell_bounds(cell).map(|b| b.map(Vec3::from));
    let cell = bounds.and_then(|[min, max]| Cell::new(min, max));
    let cell =
        cell.ok_or_else(|| CliError::Input("a cell of the result has no volume".to_owned()))?;
    let sources = Sources::new(cell, places);
    let corners = *scene.occluders().triangle(triangle);
    let of = sightline_scene::Triangle { v: corners };
    // A triangle that meets the cell where viewpoints are is seen.
    if sightline_scene::overlap::triangle_touches_box(&of, &cell.bounds())
        && sources.is_met_by(corners)
    {
        return Ok(Answer::Seen("meets the cell".to_owned()));
    }
    let Some(target) = Polygon::triangle(corners.map(|v| v.as_dvec3())) else {
        return Ok(Answer::Hidden);
    };
    let mut cost = Cost::default();
    let limits = Limits::default();
    let found = from_cell(
        scene.occluders(),
        &sources,
        (&[target], None),
        (&limits, cancelled),
        &mut cost,
    );
    Ok(match found {
        Found::Hidden(_) => Answer::Hidden,
        Found::Undecided(_) => Answer::Undecided,
        Found::Visible(ends) => {
            let [p, q] = ends.each_ref().map(sightline_exact::polygon::rounded);
            Answer::Seen(format!("is seen along the segment from {p} to {q}"))
        }
    })
}
