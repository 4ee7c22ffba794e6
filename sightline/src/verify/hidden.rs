//! `sightline verify --sample` for a result of the method portals, which has no certificates.
//!
//! Exact queries check pairs of a cell and a triangle that the result calls hidden.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rayon::prelude::*;
use sightline_exact::{
    Cell, ExactScene, ExactViewRegion, FromCellAnswer, Polygon, QueryCost, QueryLimits, Sources,
    from_cell,
};
use sightline_numbers::Aabb;
use sightline_numbers::random::SplitMix64;
use sightline_portals::OpenFaces;
use sightline_pvs::Pvs;
use sightline_scene::{Scene, TriangleId};
use sightline_viewcells::CellIndex;

use super::verdict::{HiddenReport, Verdict};
use crate::error::Error;
use crate::observer::{Observer, note};
use crate::result::NamedResult;
use crate::viewpoints::{region_of_result, walls_of};

/// Maximum number of consecutive draws without a hidden pair. The sample then ends with fewer pairs than
/// requested.
const TRIES: u32 = 1000;

/// Checks random pairs that a result calls hidden, with exact queries.
pub(super) fn verify(
    result: NamedResult<'_>,
    scene: &Scene,
    wanted: u64,
    seed: u64,
    observer: &dyn Observer,
) -> Result<Verdict, Error> {
    let pvs = result.pvs;
    if result.info()["spec"]["visibility"]["far"].is_number() {
        return Err(Error::input(format!(
            "{} omits triangles beyond --far, which are not hidden; verify a result without --far",
            result.name.display()
        )));
    }
    let planes = region_of_result(result, scene)?;
    let exact = ExactScene::prepare(scene).map_err(|e| Error::input(e.to_string()))?;
    let pairs = draw(pvs, &exact, wanted, seed)?;
    if pairs.is_empty() {
        return Err(result.error(
            "the sample contains no hidden pair of a cell and a triangle, so there is \
            nothing to verify",
        ));
    }
    let region = planes.as_ref().map(|planes| planes as &dyn ExactViewRegion);
    let faces = open_faces(result, scene, &pairs, region);
    let cancelled = || observer.is_cancelled();
    let ask = |(cell, triangle): &(CellIndex, TriangleId)| {
        let region = faces
            .get(cell)
            .map(|faces| faces as &dyn ExactViewRegion)
            .or(region);
        ask(pvs, &exact, region, *cell, *triangle, &cancelled)
    };
    let answers: Vec<Result<QueryAnswer, Error>> = pairs.par_iter().map(ask).collect();
    if observer.is_cancelled() {
        return Err(Error::cancelled(
            "interrupted before the queries had answers",
        ));
    }
    let (mut hidden, mut undecided) = (0u64, 0u64);
    for ((cell, triangle), answer) in pairs.iter().zip(answers) {
        match answer? {
            QueryAnswer::Hidden => hidden += 1,
            QueryAnswer::Undecided => undecided += 1,
            QueryAnswer::Seen(why) => {
                let reason =
                    format!("the result calls triangle {triangle} hidden, but the triangle {why}");
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

/// Draws at most `wanted` pairs: a cell with viewpoints, and a triangle that the cell's set could contain but
/// does not.
fn draw(
    pvs: &Pvs,
    scene: &ExactScene,
    wanted: u64,
    seed: u64,
) -> Result<Vec<(CellIndex, TriangleId)>, Error> {
    let mut random = SplitMix64::new(seed);
    let mut below = |n: u32| (((random.bits() >> 32) * u64::from(n)) >> 32) as u32;
    let mut of_cell: Vec<Option<Vec<u32>>> = vec![None; pvs.cells() as usize];
    let (mut pairs, mut tries) = (Vec::new(), 0);
    while (pairs.len() as u64) < wanted && tries < TRIES {
        tries += 1;
        let (cell, triangle) = (
            CellIndex(below(pvs.cells())),
            TriangleId(below(pvs.triangle_count())),
        );
        if !pvs.is_reached(cell.0)? || !scene.occluders().is_target(triangle) {
            continue;
        }
        let set = &mut of_cell[cell.at()];
        let set = match set {
            Some(set) => set,
            None => {
                let mut ids = Vec::new();
                pvs.visible(cell.0, &mut ids)?;
                set.insert(ids)
            }
        };
        if set.binary_search(&triangle.0).is_err() {
            pairs.push((cell, triangle));
            tries = 0;
        }
    }
    Ok(pairs)
}

enum QueryAnswer {
    Hidden,
    Undecided,
    Seen(String),
}

/// Returns the open faces of each cell in `pairs` if the cells are boxes along walls, and otherwise an empty
/// map.
fn open_faces<'a>(
    result: NamedResult<'_>,
    scene: &Scene,
    pairs: &[(CellIndex, TriangleId)],
    region: Option<&'a dyn ExactViewRegion>,
) -> BTreeMap<CellIndex, OpenFaces<'a>> {
    let Some(scene) = walls_of(result, scene) else {
        return BTreeMap::new();
    };
    let cells: BTreeSet<CellIndex> = pairs.iter().map(|(cell, _)| *cell).collect();
    let faces = |cell: CellIndex| {
        let [min, max] = result.pvs.cell_bounds(cell.0)?.map(Vec3::from);
        Some((cell, OpenFaces::new(scene, Aabb::new(min, max), region)))
    };
    cells.into_iter().filter_map(faces).collect()
}

fn ask(
    pvs: &Pvs,
    scene: &ExactScene,
    region: Option<&dyn ExactViewRegion>,
    cell: CellIndex,
    triangle: TriangleId,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<QueryAnswer, Error> {
    let bounds = pvs.cell_bounds(cell.0).map(|b| b.map(Vec3::from));
    let cell = bounds.and_then(|[min, max]| Cell::new(min, max));
    let cell = cell.ok_or_else(|| Error::input("a cell of the result has no volume"))?;
    let sources = Sources::new(cell, region);
    let corners = *scene.occluders().triangle(triangle.0);
    let shape = sightline_scene::Triangle { v: corners };
    // A triangle that meets the cell where viewpoints are is visible.
    if sightline_scene::overlap::triangle_touches_box(&shape, &cell.bounds())
        && sources.is_met_by(corners)
    {
        return Ok(QueryAnswer::Seen("meets the cell".to_owned()));
    }
    let Some(target) = Polygon::triangle(corners.map(|v| v.as_dvec3())) else {
        return Ok(QueryAnswer::Hidden);
    };
    let mut cost = QueryCost::default();
    let limits = QueryLimits::default();
    let found = from_cell(
        scene.occluders(),
        &sources,
        &[target],
        None,
        &limits,
        cancelled,
        &mut cost,
    );
    Ok(match found {
        FromCellAnswer::Hidden(_) => QueryAnswer::Hidden,
        FromCellAnswer::Undecided(_) => QueryAnswer::Undecided,
        FromCellAnswer::Visible(ends) => {
            let [p, q] = ends.each_ref().map(sightline_exact::polygon::rounded);
            QueryAnswer::Seen(format!("is seen along the segment from {p} to {q}"))
        }
    })
}
