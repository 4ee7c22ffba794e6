//! The defaults of a job for clients that give a scene and little else: fields of a message that are absent,
//! or zero where zero means nothing, get what `sightline submit` gives.

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_proto::v1;
use sightline_viewcells::Division;

use crate::JobSpec;

/// Cells along each axis.
pub const USUAL_GRID: [u32; 3] = [8; 3];

/// A specification with defaults for what is absent. One that was complete stays as it is.
pub fn with_defaults(spec: &v1::JobSpec) -> v1::JobSpec {
    let mut spec = spec.clone();
    let [x, y, z] = USUAL_GRID;
    spec.division.get_or_insert(v1::job_spec::Division::Grid(v1::Grid { x, y, z }));
    let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
    let usual = JobSpec::new([0; 32], Division::Grid(USUAL_GRID), bounds).to_proto();
    let usual = usual.sampling.unwrap_or_default();
    match &mut spec.sampling {
        None => spec.sampling = Some(usual),
        Some(own) => {
            // No cube has a side of 0 pixels: what is about cubes was left out.
            if own.resolution == 0 {
                own.resolution = usual.resolution;
                own.solids = usual.solids;
                let fill = |own: &mut f64, usual: f64| {
                    if *own == 0.0 {
                        *own = usual;
                    }
                };
                fill(&mut own.error_threshold, usual.error_threshold);
                fill(&mut own.interior_threshold, usual.interior_threshold);
                fill(&mut own.min_distance, usual.min_distance);
            }
            if own.rays == 0 {
                own.rays = usual.rays;
            }
            if own.target_error == 0.0 {
                // As on the command line, a bound or a least share replaces the target.
                own.target_error = match own.max_error.is_some() || own.min_share.is_some() {
                    true => 1.0,
                    false => usual.target_error,
                };
            }
        }
    }
    if spec.method() == v1::Method::Portals && spec.backend() == v1::Backend::Auto {
        spec.set_backend(v1::Backend::None);
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
        let filled = JobSpec::from_proto(&with_defaults(&scene), Some(bounds)).unwrap();
        assert_eq!(filled, JobSpec::new([7; 32], Division::Grid(USUAL_GRID), bounds));
        let whole = filled.to_proto();
        assert_eq!(with_defaults(&whole), whole);
    }

    #[test]
    fn part_of_the_sampling_is_enough() {
        let sampling = v1::Sampling { max_error: Some(0.01), contributions: true, ..Default::default() };
        let spec = v1::JobSpec { scene: vec![7; 32], sampling: Some(sampling), ..Default::default() };
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let filled = JobSpec::from_proto(&with_defaults(&spec), Some(bounds)).unwrap();
        assert_eq!((filled.sampling.max_error, filled.sampling.contributions), (Some(0.01), true));
        let portals = v1::JobSpec { method: v1::Method::Portals.into(), ..scene() };
        assert!(JobSpec::from_proto(&with_defaults(&portals), Some(bounds)).is_ok());
    }

    fn scene() -> v1::JobSpec {
        v1::JobSpec { scene: vec![7; 32], ..Default::default() }
    }
}
