//! Counts the work that a sampler of a scene could skip, from a baked result. The program prints the numbers
//! of cells inside closed solids, cells that see no triangle, triangles that no cell sees, and rounds that
//! cells skipped.
//!
//! `cargo run --release -p sightline-measure --example skips -- SCENE OUT.pvs`

#![allow(clippy::print_stdout, reason = "the example prints its counts")]

use glam::Vec3;
use rayon::prelude::*;
use sightline_pvs::Pvs;
use sightline_scene::topology::Solids;
use sightline_scene::{Aabb, Scene, TriangleId};

/// A direction that is parallel to no axis. The triangle that a ray from a free cell meets shows if a solid
/// surrounds the cell.
const OUTWARDS: Vec3 = Vec3::new(0.31, 0.83, 0.463);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, scene, result] = args.as_slice() else {
        return Err("usage: skips SCENE OUT.pvs".into());
    };
    let scene = sightline_scene::load(std::path::Path::new(scene))?;
    let pvs = Pvs::open(result)?;
    if pvs.triangle_count() != scene.len() {
        return Err("the result belongs to another scene; give the scene that was baked".into());
    }
    let solids = Solids::find(&scene)?;
    let of_solids = (0..scene.len())
        .filter(|id| solids.outward(TriangleId(*id)).is_some())
        .count();

    let mut seen = vec![false; scene.triangles().len()];
    let mut blind = 0;
    let mut ids = Vec::new();
    let mut boxes = Vec::new();
    for cell in 0..pvs.cells() {
        ids.clear();
        pvs.visible(cell, &mut ids)?;
        blind += u32::from(ids.is_empty());
        ids.iter().for_each(|id| seen[*id as usize] = true);
        boxes.push(
            pvs.cell_bounds(cell)
                .ok_or("a cell has no bounds")?
                .map(Vec3::from),
        );
    }
    let free: Vec<Vec3> = boxes
        .par_iter()
        .filter_map(|b| free_centre(&scene, *b))
        .collect();
    let enclosed = free
        .par_iter()
        .filter(|p| inside(&scene, &solids, **p))
        .count();

    println!(
        "{} triangles: {of_solids} bound closed solids, {} are seen from no cell",
        scene.len(),
        seen.iter().filter(|s| !**s).count()
    );
    println!(
        "{} cells: {blind} see no triangle, {} meet no triangle's box, {enclosed} of these are inside \
            a closed solid",
        pvs.cells(),
        free.len()
    );
    for column in pvs
        .columns()?
        .iter()
        .filter(|c| ["rounds", "rays_uniform"].contains(&c.name.as_str()))
    {
        let most = column.values.iter().max().copied().unwrap_or(0);
        let mean = column.values.iter().sum::<u64>() as f64 / f64::from(pvs.cells());
        println!(
            "{} of a cell: {mean:.1} on average, {most} at most",
            column.name
        );
    }
    Ok(())
}

/// Returns the centre of a cell, or `None` if the box of a triangle meets the cell.
fn free_centre(scene: &Scene, [min, max]: [Vec3; 2]) -> Option<Vec3> {
    let cell = Aabb { min, max };
    let meets = scene.triangles().iter().any(|t| t.bounds().touches(&cell));
    (!meets).then_some((min + max) * 0.5)
}

/// Returns true if the triangle that is seen from `p` along [`OUTWARDS`] shows the inner side of a closed
/// solid. Single precision suffices, because the points are away from all triangles.
fn inside(scene: &Scene, solids: &Solids, p: Vec3) -> bool {
    let hits = (0u32..)
        .zip(scene.triangles())
        .filter_map(|(id, t)| Some((distance(t.v, p)?, id)));
    let nearest = hits.min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.is_some_and(|(_, id)| solids.exterior(scene, TriangleId(id), p) == Some(false))
}

/// Returns the distance to a triangle along [`OUTWARDS`] (Möller and Trumbore 1997).
fn distance([a, b, c]: [Vec3; 3], p: Vec3) -> Option<f32> {
    let (e, f) = (b - a, c - a);
    let h = OUTWARDS.cross(f);
    let scale = 1.0 / e.dot(h);
    let u = (p - a).dot(h) * scale;
    let q = (p - a).cross(e);
    let v = OUTWARDS.dot(q) * scale;
    let t = f.dot(q) * scale;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
}
