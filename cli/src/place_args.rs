//! The arguments that say where viewpoints can be.

use std::path::PathBuf;

use clap::Args;
use glam::Vec3;
use sightline_model::Up;
use sightline_scene::Aabb;

use crate::choices::choice;

/// Where viewpoints can be.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Where viewpoints can be")]
pub struct PlaceArgs {
    /// A box of viewpoints, in world space: x0,y0,z0,x1,y1,z1. May be given several times: viewpoints are in
    /// any of the boxes, and the cells divide the box around all of them. Default: the scene's bounds.
    #[arg(long, value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    pub view_box: Vec<Aabb>,
    /// A scene file with closed volumes that hold all viewpoints or, with --eye-heights, a navigation mesh.
    #[arg(long, value_name = "FILE")]
    pub view_mesh: Option<PathBuf>,
    /// Viewpoints are at these heights above the triangles of --view-mesh, from the first to the second, in
    /// the scene's units.
    #[arg(long, value_name = "LO,HI", value_parser = parse_heights, allow_hyphen_values = true)]
    #[arg(requires = "view_mesh")]
    pub eye_heights: Option<[f32; 2]>,
    /// A file of viewpoints, such as telemetry or a camera path: a line `x y z` or `x y z weight` for each.
    /// Viewpoints of weight 0 are left out; `measure --viewpoints-file` uses the other weights.
    #[arg(long, value_name = "FILE")]
    pub viewpoints: Option<PathBuf>,
    /// Viewpoints are also where an unobstructed segment of at most this length from a point of --viewpoints
    /// ends.
    #[arg(long, value_name = "R", requires = "viewpoints", value_parser = parse_length)]
    #[arg(allow_negative_numbers = true)]
    pub reach: Option<f32>,
    /// Viewpoints are where one gets from this point along unobstructed segments, any number of them. May be
    /// given several times. Where walls enclose the points, viewpoints are exactly between these walls, in
    /// parts of cells as well. Where there is a way out of the scene, its narrowest opening is named, whole
    /// parts (quarters) of cells are taken, and those behind gaps that no ray finds are left out.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub reachable_from: Vec<[f32; 3]>,
    /// The axis of the scene that points up. It turns nothing: it is used by --eye-heights and is kept in the
    /// result. Default: y.
    #[arg(long, value_parser = choice::<Up>())]
    pub up: Option<Up>,
}

fn numbers<const N: usize>(text: &str) -> Option<[f32; N]> {
    let parts = text
        .split(',')
        .map(|p| p.trim().parse::<f32>())
        .collect::<Result<Vec<_>, _>>()
        .ok()?;
    <[f32; N]>::try_from(parts)
        .ok()
        .filter(|all| all.iter().all(|x| x.is_finite()))
}

/// A point, as in 1.5,0,-2.
pub fn parse_point(text: &str) -> Result<[f32; 3], String> {
    numbers(text).ok_or_else(|| "give three numbers as in 1.5,0,-2".to_owned())
}

fn parse_heights(text: &str) -> Result<[f32; 2], String> {
    let wrong = || "give the least and the greatest height as in 1.2,1.8".to_owned();
    numbers(text).filter(|[lo, hi]| lo <= hi).ok_or_else(wrong)
}

/// A length above 0, as in 2.5.
pub fn parse_length(text: &str) -> Result<f32, String> {
    let length = text
        .parse::<f32>()
        .ok()
        .filter(|r| r.is_finite() && *r > 0.0);
    length.ok_or_else(|| "give a length above 0, as in 2.5".to_owned())
}

/// A box, as in -1,0,-1,1,2,1.
pub fn parse_box(text: &str) -> Result<Aabb, String> {
    let parts = text
        .split(',')
        .map(|p| p.trim().parse())
        .collect::<Result<Vec<f32>, _>>();
    match parts.as_deref() {
        Ok([x0, y0, z0, x1, y1, z1]) => Ok(Aabb::new(
            Vec3::new(*x0, *y0, *z0),
            Vec3::new(*x1, *y1, *z1),
        )),
        _ => Err("give six numbers as in -1,0,-1,1,2,1".to_owned()),
    }
}
