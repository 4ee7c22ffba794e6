//! Adaptive sampling of one rectangle (Nirenstein and Blake 2004, section 3.2; Nirenstein 2003, section
//! 4.1.3).
//!
//! The quadtree grows level by level instead of depth first. The set of split rectangles does not depend on
//! the order, and the samples of a level can be rendered at once.

use std::collections::BTreeSet;
use std::sync::Arc;

use sightline_model::CubeParams;
use sightline_model::VisibilitySample;
use sightline_viewcells::{Lattice, LatticePoint, Rect};

use super::measure::error;

/// A test that distinguishes samples inside closed solids from samples outside.
pub trait Exterior: Sync {
    /// Returns true if a viewpoint can be at `p`, where `sample` was taken.
    fn is_exterior(&self, p: LatticePoint, sample: &VisibilitySample) -> bool;
}

/// The source of the refinement's samples.
pub trait SampleSource {
    /// The error of a request for samples.
    type Error;

    /// Returns the samples at `points`, in their order, cached or rendered.
    ///
    /// # Errors
    /// [`Self::Error`] if a sample cannot be rendered.
    fn samples(
        &mut self,
        points: &[LatticePoint],
    ) -> Result<Vec<Arc<VisibilitySample>>, Self::Error>;
}

/// Samples `rect` and splits it, until the leaves of its quadtree are below the error threshold, small
/// enough, or cannot be halved.
///
/// # Errors
/// The error of the source, unchanged.
pub fn refine<S: SampleSource>(
    rect: Rect,
    lattice: &Lattice,
    min_distance: f64,
    params: &CubeParams,
    exterior: &dyn Exterior,
    source: &mut S,
) -> Result<(), S::Error> {
    let mut level = vec![rect];
    while !level.is_empty() {
        let points: Vec<LatticePoint> = level
            .iter()
            .flat_map(Rect::corners)
            .collect::<BTreeSet<_>>()
            .into_iter()
            .collect();
        let samples = source.samples(&points)?;
        // Every corner is among the sorted points.
        let at = |p: &LatticePoint| points.binary_search(p).ok().map(|i| &*samples[i]);
        let mut next = Vec::new();
        for r in level {
            let corners = r.corners();
            let split = r.spans_cells() || {
                let [a, b] = r.sides(lattice);
                a.max(b) > min_distance && {
                    let corner_samples: Vec<_> = corners
                        .iter()
                        .filter_map(|p| at(p).map(|s| (*p, s)))
                        .collect();
                    wants_split(&corner_samples, params, exterior)
                }
            };
            if split {
                next.extend(r.split(lattice));
            }
        }
        level = next;
    }
    Ok(())
}

/// Returns true if a rectangle must be split (Nirenstein and Blake 2004, section 3.6).
///
/// The three conditions are a single exterior sample, exterior samples that differ, and interior samples that
/// differ.
fn wants_split(
    corners: &[(LatticePoint, &VisibilitySample)],
    params: &CubeParams,
    exterior: &dyn Exterior,
) -> bool {
    let (outside, inside): (Vec<_>, Vec<_>) = corners
        .iter()
        .partition(|(p, s)| !params.solids || exterior.is_exterior(*p, s));
    let samples = |part: &[(LatticePoint, &VisibilitySample)]| -> f64 {
        let s: Vec<&VisibilitySample> = part.iter().map(|(_, s)| *s).collect();
        error(params.measure, &s)
    };
    outside.len() == 1
        || samples(&outside) > params.error_threshold.get()
        || samples(&inside) > params.interior_threshold.get()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use sightline_model::numbers::{ErrorThreshold, InteriorThreshold};
    use sightline_viewcells::Division;

    /// A source that sees triangle 0 left of a plane and triangle 1 right of it.
    struct Edge(u32, Vec<LatticePoint>);
    impl SampleSource for Edge {
        type Error = std::convert::Infallible;
        fn samples(
            &mut self,
            points: &[LatticePoint],
        ) -> Result<Vec<Arc<VisibilitySample>>, Self::Error> {
            self.1.extend(points);
            let one = |p: &LatticePoint| VisibilitySample {
                ids: vec![u32::from(p[0] >= self.0)],
                strata: vec![1],
                ..Default::default()
            };
            Ok(points.iter().map(|p| Arc::new(one(p))).collect())
        }
    }
    struct Open;
    impl Exterior for Open {
        fn is_exterior(&self, _: LatticePoint, _: &VisibilitySample) -> bool {
            true
        }
    }

    /// A space that is entirely inside a closed solid.
    struct Solid;
    impl Exterior for Solid {
        fn is_exterior(&self, _: LatticePoint, _: &VisibilitySample) -> bool {
            false
        }
    }

    #[test]
    fn samples_gather_where_visibility_changes() {
        let division = Division::Grid([1, 1, 1]);
        let lattice = division.lattice(Vec3::ZERO, Vec3::ONE).unwrap();
        let root = division.root(&lattice);
        let mut source = Edge(20_000, Vec::new());
        let params = CubeParams::default();
        refine(
            root.face(4),
            &lattice,
            1.0 / 64.0,
            &params,
            &Open,
            &mut source,
        )
        .unwrap();
        let mut points = source.1;
        points.sort_unstable();
        points.dedup();
        let near = points
            .iter()
            .filter(|p| p[0].abs_diff(20_000) < 2_000)
            .count();
        assert!(
            near > 60 && near * 3 > points.len(),
            "{near} of {}",
            points.len()
        );
        assert!(points.len() < 400, "{}", points.len());
    }

    #[test]
    fn equal_corners_end_refinement() {
        let division = Division::Grid([1, 1, 1]);
        let lattice = division.lattice(Vec3::ZERO, Vec3::ONE).unwrap();
        let mut source = Edge(0, Vec::new());
        let rect = division.root(&lattice).face(0);
        refine(
            rect,
            &lattice,
            1e-3,
            &CubeParams::default(),
            &Open,
            &mut source,
        )
        .unwrap();
        assert_eq!(source.1.len(), 4);
    }

    #[test]
    fn uniform_measure_splits_every_rectangle() {
        let division = Division::Grid([1, 1, 1]);
        let lattice = division.lattice(Vec3::ZERO, Vec3::ONE).unwrap();
        let rect = division.root(&lattice).face(0);
        // All corners are equal, and thresholds of 1 are never exceeded.
        let params = CubeParams {
            measure: sightline_model::ErrorMeasure::Uniform,
            error_threshold: ErrorThreshold::new(1.0).unwrap(),
            interior_threshold: InteriorThreshold::new(1.0).unwrap(),
            ..CubeParams::default()
        };
        for exterior in [&Open as &dyn Exterior, &Solid] {
            let mut source = Edge(0, Vec::new());
            refine(rect, &lattice, 1.0 / 8.0, &params, exterior, &mut source).unwrap();
            let points: BTreeSet<LatticePoint> = source.1.into_iter().collect();
            assert_eq!(points.len(), 9 * 9);
        }
    }

    #[test]
    fn single_exterior_sample_splits_and_interior_uses_own_threshold() {
        struct Walls;
        impl Exterior for Walls {
            fn is_exterior(&self, p: LatticePoint, _: &VisibilitySample) -> bool {
                p == [0, 0, 0]
            }
        }
        let s = VisibilitySample {
            ids: vec![1],
            strata: vec![1],
            ..Default::default()
        };
        let t = VisibilitySample {
            ids: vec![2],
            strata: vec![1],
            ..Default::default()
        };
        let p = CubeParams {
            interior_threshold: InteriorThreshold::new(1.0).unwrap(),
            ..Default::default()
        };
        assert!(wants_split(&[([0; 3], &s), ([1, 0, 0], &s)], &p, &Walls));
        assert!(!wants_split(
            &[([2, 0, 0], &s), ([1, 0, 0], &t)],
            &p,
            &Walls
        ));
        let strict = CubeParams {
            interior_threshold: InteriorThreshold::new(0.5).unwrap(),
            ..p
        };
        assert!(wants_split(
            &[([2, 0, 0], &s), ([1, 0, 0], &t)],
            &strict,
            &Walls
        ));
    }
}
