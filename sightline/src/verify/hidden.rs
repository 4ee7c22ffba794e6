//! `sightline verify --sample` of a result of the method portals, which has no certificates: exact queries
//! about pairs of a cell and a triangle that are called hidden.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rayon::prelude::*;
use sightline_exact::{
    Cell, Cost, ExactScene, ExactViewRegion, Found, Limits, Polygon, Sources, from_cell,
};
use sightline_numbers::Aabb;
use sightline_numbers::random::SplitMix64;
use sightline_portals::OpenFaces;
use sightline_pvs::Pvs;
use sightline_scene::Scene;

use super::verdict::{HiddenReport, Verdict};
use crate::error::Error;
use crate::observer::{Observer, note};
use crate::result::NamedResult;
use crate::viewpoints::{region_of_result, walls_of};

/// Draws of a pair that are not hidden before the sample ends with fewer pairs.
const TRIES: u32 = 1000;

/// Checks random pairs that a result calls hidden, with exact queries.
pub(super) fn verify(
    result: NamedResult<'_>,
    scene: &Scene,
    (wanted, seed): (u64, u64),
    observer: &dyn Observer,
) -> Result<Verdict, Error> {
    let pvs = result.pvs;
    if result.info()["spec"]["visibility"]["far"].is_number() {
        return Err(Error::input(format!(
            "{} leaves out what is beyond --far, which is not hidden; verify a result without --far",
            result.name.display()
        )));
    }
    let places = region_of_result(result, scene)?;
    let exact = ExactScene::prepare(scene).map_err(|e| Error::input(e.to_string()))?;
    let pairs = draw(pvs, &exact, wanted, seed)?;
    if pairs.is_empty() {
        return Err(
            result.error("no pair that is called hidden was found, so there is nothing to ask")
        );
    }
    let places = places.as_ref().map(|places| places as &dyn ExactViewRegion);
    let faces = open_faces(result, scene, &pairs, places);
    let cancelled = || observer.is_cancelled();
    let ask = |(cell, triangle): &(u32, u32)| {
        let places = faces
            .get(cell)
            .map(|faces| faces as &dyn ExactViewRegion)
            .or(places);
        ask(pvs, &exact, (places, &cancelled), *cell, *triangle)
    };
    let answers: Vec<Result<Answer, Error>> = pairs.par_iter().map(ask).collect();
    if observer.is_cancelled() {
        return Err(Error::cancelled("interrupted; nothing is known yet"));
    }
    let (mut hidden, mut undecided) = (0u64, 0u64);
    for ((cell, triangle), answer) in pairs.iter().zip(answers) {
        match answer? {
            Answer::Hidden => hidden += 1,
            Answer::Undecided => undecided += 1,
            Answer::Seen(why) => {
                let reason = format!("triangle {triangle} is called hidden and {why}");
                return Ok(Verdict::rejected(Some(*cell), &reason, result.name));
            }
        }
    }
    if (pairs.len() as u64) < wanted {
        note(
            observer,
            format!(
                "note: of {wanted} pairs {} were found: nearly all triangles are in the sets",
                pairs.len()
            ),
        );
    }
    Ok(Verdict::AcceptedHidden(HiddenReport {
        accepted: true,
        method: pvs.method().to_owned(),
        cells: pvs.cells(),
        pairs: pairs.len() as u64,
        hidden,
        undecided,
        sampled: true,
    }))
}

/// Pairs of a cell with viewpoints and a triangle that can be in a set and is not in the cell's.
fn draw(pvs: &Pvs, scene: &ExactScene, wanted: u64, seed: u64) -> Result<Vec<(u32, u32)>, Error> {
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
    result: NamedResult<'_>,
    scene: &Scene,
    pairs: &[(u32, u32)],
    places: Option<&'a dyn ExactViewRegion>,
) -> BTreeMap<u32, OpenFaces<'a>> {
    let Some(scene) = walls_of(result, scene) else {
        return BTreeMap::new();
    };
    let cells: BTreeSet<u32> = pairs.iter().map(|(cell, _)| *cell).collect();
    let faces = |cell: u32| {
        let [min, max] = result.pvs.cell_bounds(cell)?.map(Vec3::from);
        Some((cell, OpenFaces::new(scene, Aabb::new(min, max), places)))
    };
    cells.into_iter().filter_map(faces).collect()
}

fn ask(
    pvs: &Pvs,
    scene: &ExactScene,
    (places, cancelled): (Option<&dyn ExactViewRegion>, &(dyn Fn() -> bool + Sync)),
    cell: u32,
    triangle: u32,
) -> Result<Answer, Error> {
    let bounds = pvs.cell_bounds(cell).map(|b| b.map(Vec3::from));
    let cell = bounds.and_then(|[min, max]| Cell::new(min, max));
    let cell = cell.ok_or_else(|| Error::input("a cell of the result has no volume"))?;
    let sources = Sources::new(cell, places);
    let corners = *scene.occluders().triangle(triangle);
    let shape = sightline_scene::Triangle { v: corners };
    // A triangle that meets the cell where viewpoints are is seen.
    if sightline_scene::overlap::triangle_touches_box(&shape, &cell.bounds())
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
