//! Example program that draws a plan of a scene divided along its walls, as SVG, and prints the time of each
//! stage.
//!
//! ```sh
//! cargo run --release -p sightline-portals --example plan -- SCENE X,Y,Z UP OUT.svg [CELLS]
//! ```
//!
//! The plan is the section across the axis UP (x, y or z) through the point. Thin lines divide the leaves
//! that the point reaches; walls are black and portals green. With CELLS, as in 8x8x8, the program also
//! searches the portals of each cell of that grid.

#![allow(clippy::print_stdout, reason = "this program's output is its purpose")]

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use glam::{DVec3, UVec3, Vec3};
use sightline_numbers::Aabb;
use sightline_portals::{Enclosure, EnclosureLimits, LeafId, OUTSIDE, Partition, PortalId, Tree};
use sightline_portals::{enclose, reached, region_of, sights, solids};

/// Width of the picture, in SVG units.
const WIDTH: f64 = 1000.0;

/// The plane of the plan: the axis, and the coordinate on this axis.
#[derive(Clone, Copy)]
struct Cut(usize, f64);

impl Cut {
    /// Returns the section of a convex polygon, or `None` if the plane does not cross it.
    fn section(self, corners: &[DVec3]) -> Option<[DVec3; 2]> {
        let Self(axis, level) = self;
        let next = corners.iter().cycle().skip(1);
        let mut crossings = corners.iter().zip(next).filter_map(|(a, b)| {
            let (from, to) = (a[axis] - level, b[axis] - level);
            ((from < 0.0) != (to < 0.0)).then(|| a.lerp(*b, from / (from - to)))
        });
        Some([crossings.next()?, crossings.next()?])
    }
}

/// Writes segments of one style as an SVG path.
fn lines(
    out: &mut String,
    style: &str,
    project: &dyn Fn(DVec3) -> [f64; 2],
    segments: &[[DVec3; 2]],
) -> std::fmt::Result {
    write!(out, "<path {style} d=\"")?;
    for segment in segments {
        let [[x0, y0], [x1, y1]] = segment.map(project);
        write!(out, "M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}")?;
    }
    writeln!(out, "\"/>")
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1000.0
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let ([_, path, point, up, out] | [_, path, point, up, out, _]) = args.as_slice() else {
        return Err("usage: plan SCENE X,Y,Z x|y|z OUT.svg [NXxNYxNZ]".into());
    };
    let point: Vec<f32> = point.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let point: [f32; 3] = point
        .try_into()
        .map_err(|_| "X,Y,Z must be three numbers, as in 1,2,3")?;
    let axis = ["x", "y", "z"]
        .iter()
        .position(|a| a == up)
        .ok_or("UP must be x, y or z")?;
    let start = Instant::now();
    let scene = sightline_scene::load(Path::new(path))?;
    println!(
        "read {} triangles: {:.0} ms",
        scene.len(),
        milliseconds(start)
    );

    let start = Instant::now();
    let mut tree = Tree::new(&scene, &[point]);
    let found = enclose(&mut tree, &[point], EnclosureLimits::default(), &mut |_| {
        true
    });
    let inside: Vec<LeafId> = reached(&tree, &[point])
        .into_iter()
        .filter(|l| *l != OUTSIDE)
        .collect();
    let leaf_counts = (inside.len(), tree.len() - 1);
    let answer = match found {
        Enclosure::Closed => "walls enclose the point",
        Enclosure::Leak(..) => "a way leads out",
        Enclosure::Unknown | Enclosure::Stopped => "the limits end the search",
    };
    println!(
        "divide until {answer}: {} of {} leaves reached: {:.0} ms",
        leaf_counts.0,
        leaf_counts.1,
        milliseconds(start)
    );

    if let Some(grid) = args.get(5) {
        let start = Instant::now();
        let region = region_of(&tree, &inside)?;
        let partition = Partition::new(
            &scene,
            Some(&region),
            scene.bounds(),
            EnclosureLimits::default(),
            &|| false,
        )?;
        println!(
            "partition with outlines and parts: {:.0} ms",
            milliseconds(start)
        );
        let grid: Vec<u32> = grid.split('x').map(str::parse).collect::<Result<_, _>>()?;
        let grid: [u32; 3] = grid
            .try_into()
            .map_err(|_| "CELLS must be three numbers, as in 8x8x8")?;
        let start = Instant::now();
        let (cells, listed) = search(&partition, scene.bounds(), UVec3::from(grid));
        let each = milliseconds(start) / f64::from(cells.max(1));
        let mean = listed / cells.max(1) as usize;
        println!("search, {cells} cells with viewpoints: {each:.1} ms each, {mean} triangles each");
    }

    // Displace the cut slightly, because many corners have round coordinates and would lie in it.
    let cut = Cut(
        axis,
        f64::from(point[axis])
            + 1e-5 * f64::from((scene.bounds().max - scene.bounds().min).max_element()),
    );
    let leaves = solids(&tree, &inside);
    let portals: BTreeSet<PortalId> = inside
        .iter()
        .flat_map(|l| tree.leaf(*l).portals.iter().copied())
        .collect();
    let walls = scene.triangles().iter().map(|t| t.v.map(|v| v.as_dvec3()));
    let walls: Vec<_> = walls.filter_map(|v| cut.section(&v)).collect();
    let edges: Vec<_> = leaves
        .iter()
        .flat_map(|s| &s.faces)
        .filter_map(|f| cut.section(f.corners()))
        .collect();
    let doors: Vec<_> = portals
        .iter()
        .filter_map(|p| cut.section(tree.portal(*p).face.corners()))
        .collect();
    let ends = edges.iter().flatten();
    let bounds = ends.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[a, b], p| {
        [a.min(*p), b.max(*p)]
    });
    let [across, along] = [[2, 1], [0, 2], [0, 1]][axis];
    let scale = (WIDTH - 20.0) / (bounds[1][across] - bounds[0][across]);
    let height = (bounds[1][along] - bounds[0][along]) * scale + 20.0;
    let project = |p: DVec3| {
        let x = (p[across] - bounds[0][across]) * scale + 10.0;
        [x, height - 10.0 - (p[along] - bounds[0][along]) * scale]
    };
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" fill=\"none\">\n\
         <rect width=\"{WIDTH}\" height=\"{height:.0}\" fill=\"#fff\"/>\n"
    );
    lines(
        &mut svg,
        "stroke=\"#999\" stroke-width=\"0.5\"",
        &project,
        &edges,
    )?;
    lines(
        &mut svg,
        "stroke=\"#1a9850\" stroke-width=\"1.4\"",
        &project,
        &doors,
    )?;
    lines(
        &mut svg,
        "stroke=\"#000\" stroke-width=\"1.2\"",
        &project,
        &walls,
    )?;
    let [x, y] = project(Vec3::from(point).as_dvec3());
    writeln!(
        svg,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"#d73027\"/>\n</svg>"
    )?;
    std::fs::write(out, svg)?;
    println!(
        "wrote {out}: {} portals and {} walls in the section",
        doors.len(),
        walls.len()
    );
    Ok(())
}

/// Searches from all cells of a grid. Returns the number of cells with viewpoints, and the sum of their set
/// sizes.
fn search(partition: &Partition, bounds: Aabb, grid: UVec3) -> (u32, usize) {
    let size = (bounds.max - bounds.min) / grid.as_vec3();
    let (mut cells, mut listed) = (0, 0);
    for k in 0..grid.element_product() {
        let place = UVec3::new(k % grid.x, k / grid.x % grid.y, k / (grid.x * grid.y));
        let min = bounds.min + size * place.as_vec3();
        let cell = Aabb::new(min, bounds.max.min(min + size));
        // Only cells that the region meets have viewpoints.
        if partition.solids(cell).is_empty() {
            continue;
        }
        if let Some(seen) = sights(partition, cell, false, &|| false) {
            cells += 1;
            listed += seen.len();
        }
    }
    (cells, listed)
}
