//! Consistent decisions about five points on one sphere.
//!
//! Delaunay tetrahedra are the lower hull of the points lifted to heights h = |p|². Let point i have the
//! height |p|² + εᵢ instead, where every εᵢ > 0 is infinitely small and ε₀ ≫ ε₁ ≫ ε₂ …: the smaller the
//! number of a point, the larger its εᵢ. The method is from Edelsbrunner and Mücke, "Simulation of
//! Simplicity", 1990. Devillers and Teillaud, "Perturbations and Vertex Removal in a 3D Delaunay
//! Triangulation", 2003, also lift points.
//!
//! Let a, b, c, d be the corners of a tetrahedron with orient(a, b, c, d) = D > 0. Let H be the affine
//! function that equals the heights at these corners. Point e is in conflict with the tetrahedron if its
//! height is below H(e). Let Dᵢ be the orientation after e replaced corner i. The barycentric coordinates of
//! e are Dᵢ / D, hence
//!
//! D · (H(e) − hₑ) = Σ Dᵢ hᵢ − D hₑ,
//!
//! which is the usual determinant for heights |p|², plus Σ Dᵢ εᵢ − D εₑ. If the determinant is 0, the sign is
//! the sign of the largest ε whose coefficient is not 0. The coefficient of εₑ is −D < 0, so such an ε always
//! exists: no tetrahedron with volume has an undecided tie.
//!
//! The result is the lower hull of one fixed set of heights (take real ε small enough; there are finitely
//! many determinants). It has the following properties:
//! - The result depends on the points and their numbers, not on the order of insertion.
//! - No tetrahedron is flat: four coplanar points lift into a vertical hyperplane, which contains no facet of
//!   the lower hull. No facet has a fifth point: of five such points four are not coplanar, and the tie would
//!   remain.
//! - Every point is a corner: |p|² is strictly convex, and small ε keep each point below the hull of the
//!   other points.
//! - From every viewpoint x the tetrahedra have a front-to-back order: along a ray from x, the powers |x|² −
//!   H(x) of the tetrahedra that the ray meets grow (Edelsbrunner, "An acyclicity theorem for cell complexes
//!   in d dimensions", 1990). So walks from tetrahedron to tetrahedron towards a point end.

use std::cmp::Ordering;

/// Returns true if point `e` conflicts with the tetrahedron `corners`, for five points on one sphere.
///
/// `signs[i]` is the orientation of the tetrahedron after `e` replaced corner i.
pub(super) fn conflicts(corners: [u32; 4], e: u32, signs: [Ordering; 4]) -> bool {
    let mut by_number = [0, 1, 2, 3];
    by_number.sort_unstable_by_key(|&k| corners[k]);
    for k in by_number {
        if corners[k] > e {
            break;
        }
        match signs[k] {
            Ordering::Greater => return true,
            Ordering::Less => return false,
            Ordering::Equal => {}
        }
    }
    // The coefficient of the perturbation of `e` itself is negative.
    false
}
