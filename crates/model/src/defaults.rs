//! The defaults of a job for clients that give a scene and little else: fields of a message that are absent,
//! or zero where zero means nothing, get what `sightline submit` gives.

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_proto::v1;
use sightline_viewcells::Division;

use crate::ambient_spec;
use crate::{JobSpec, default_block_cells};

/// Cells along each axis.
pub const USUAL_GRID: [u32; 3] = [8; 3];

/// Depth of an adaptive tree.
const USUAL_DEPTH: u32 = 12;

/// A specification with defaults for what is absent, for a scene of so many triangles. One that was complete
/// stays as it is.
pub fn with_defaults(spec: &v1::JobSpec, triangles: u32) -> v1::JobSpec {
    let mut spec = spec.clone();
    if spec.ambient.is_some() {
        ambient_spec::fill(&mut spec);
        return spec;
    }
    let [x, y, z] = USUAL_GRID;
    let division = spec.division.get_or_insert(v1::job_spec::Division::Grid(v1::Grid { x, y, z }));
    if let v1::job_spec::Division::Adaptive(adaptive) = division
        && adaptive.max_depth == 0
    {
        adaptive.max_depth = USUAL_DEPTH;
    }
    let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
    let usual = JobSpec::new([0; 32], Division::Grid(USUAL_GRID), bounds).to_proto();
    let usual = usual.sampling.unwrap_or_default();
    let own = spec.sampling.get_or_insert(usual);
    // No cube has a side of 0 pixels: what is about cubes was left out.
    if own.resolution == 0 {
        own.resolution = usual.resolution;
        own.solids = usual.solids;
    }
    let fill = |own: &mut f64, usual: f64| {
        if *own == 0.0 {
            *own = usual;
        }
    };
    fill(&mut own.error_threshold, usual.error_threshold);
    fill(&mut own.interior_threshold, usual.interior_threshold);
    fill(&mut own.min_distance, usual.min_distance);
    // As on the command line, a bound is the target, too.
    fill(&mut own.target_error, own.max_error.unwrap_or(usual.target_error));
    if own.rays == 0 {
        own.rays = usual.rays;
    }
    if spec.method() == v1::Method::Portals && spec.backend() == v1::Backend::Auto {
        spec.set_backend(v1::Backend::None);
    }
    let is_grid = matches!(spec.division, Some(v1::job_spec::Division::Grid(_)));
    if spec.block_cells == 0 && is_grid {
        // What is wrong with the specification is said where it is read.
        if let Ok(read) = JobSpec::from_proto(&spec, Some(bounds)) {
            spec.block_cells = default_block_cells(triangles, &read.sampling, read.method);
        }
    }
    spec
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_enough_and_a_whole_specification_stays() {
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let scene = v1::JobSpec { scene: vec![7; 32], ..Default::default() };
        let filled = JobSpec::from_proto(&with_defaults(&scene, 100), Some(bounds)).unwrap();
        assert_eq!(filled, JobSpec::new([7; 32], Division::Grid(USUAL_GRID), bounds));
        let whole = filled.to_proto();
        assert_eq!(with_defaults(&whole, 100), whole);
    }

    #[test]
    fn part_of_the_sampling_is_enough() {
        let sampling = v1::Sampling { max_error: Some(0.01), contributions: true, ..Default::default() };
        let spec = v1::JobSpec { scene: vec![7; 32], sampling: Some(sampling), ..Default::default() };
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let filled = JobSpec::from_proto(&with_defaults(&spec, 100), Some(bounds)).unwrap();
        assert_eq!((filled.sampling.max_error, filled.sampling.contributions), (Some(0.01), true));
        assert_eq!(filled.sampling.target_error, 0.01);
        let exact = v1::JobSpec { method: v1::Method::Exact.into(), ..scene() };
        assert_eq!(with_defaults(&exact, 100).block_cells, 8);
        let portals = v1::JobSpec { method: v1::Method::Portals.into(), ..scene() };
        assert!(JobSpec::from_proto(&with_defaults(&portals, 100), Some(bounds)).is_ok());
    }

    fn scene() -> v1::JobSpec {
        v1::JobSpec { scene: vec![7; 32], ..Default::default() }
    }
}
