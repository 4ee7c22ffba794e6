//! A tile of a job whose cells are the boxes of a tree: each box is baked as a grid of one cell of its own.
//!
//! The boxes are open: a wall in a face blocks ([`sightline_portals::OpenFaces`]). Rays keep off these walls
//! ([`sightline_portals::open_box()`]).

use std::sync::Arc;

use sightline_model::JobSpec;
use sightline_numbers::Aabb;
use sightline_portals::open_box;
use sightline_scene::Scene;
use sightline_viewcells::division::{GAP, ROUNDING};
use sightline_viewcells::{Division, DivisionError, Lattice, Tile, Viewpoints};

/// The job of one box of a tree; `None` for a job with other cells.
///
/// # Errors
/// [`DivisionError`] for a box that is no cell.
pub fn of_box(
    spec: &JobSpec,
    lattice: &Lattice,
    tile: &Tile,
) -> Result<Option<JobSpec>, DivisionError> {
    let Division::Tree(_) = &spec.division else {
        return Ok(None);
    };
    let (min, max) = tile.cell.world(lattice);
    let number = spec.division.number(lattice, &tile.cell).unwrap_or(0);
    let viewpoints = spec.viewpoints.as_ref().map(|marks| {
        let own = Viewpoints::of_one(marks.of(number)).within(marks.region().cloned());
        Arc::new(own)
    });
    let own = JobSpec {
        division: Division::Grid([1; 3]),
        view_box: Aabb::new(min, max),
        viewpoints,
        // Boxes would have the same random numbers.
        seed: spec
            .seed
            .wrapping_add((number as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)),
        ..spec.clone()
    };
    own.lattice()?;
    Ok(Some(own))
}

/// The lattice of a box's rays.
///
/// # Errors
/// [`DivisionError`] for a box that is too thin.
pub fn off_walls(own: &JobSpec, scene: &Scene) -> Result<Lattice, DivisionError> {
    let Aabb { min, max } = own.view_box;
    let gap = min.abs().max(max.abs()).max_element() * f32::EPSILON * ROUNDING * GAP;
    let Aabb { min, max } = open_box(scene, own.view_box, gap);
    own.division.lattice(min, max)
}
