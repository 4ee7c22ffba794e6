//! Exact from-region visibility: queries in line space, their witnesses and proofs, and whole view cells.
//!
//! A query decides whether one convex polygon sees another among the triangles of a scene. The [`Verdict`] is
//! a witness (an unobstructed segment), a proof that nothing is visible, or "undecided" with the limit that
//! ended the search. [`sightline_certificate::checker`] verifies witnesses and proofs with only exact
//! arithmetic. All coordinates are in the units and the frame of the scene.
//! `docs/decisions/0006-exact-queries.md` explains queries, and `0007-exact-cells.md` whole cells.
//!
//! # Modules
//!
//! Each module depends only on modules above it in this list:
//!
//! - `arithmetic`: double-doubles, big integers, signs, random numbers.
//! - `geometry`: points, exact polygons, view cells, the frame of a query, the bounding volume hierarchy.
//! - `occluders`: convex coplanar sets of triangles, their boundary edges, and segments among them.
//! - `surfaces`: closed surfaces and the triangles that they hide without a query.
//! - `line_space`: Plücker vectors, cones, the Klein quadric, the stabbing polyhedron, polar splits.
//! - `search`: the query between two polygons, with occluder fusion and side bitsets.
//! - `cells`: queries from a view cell, all triangles of a cell, and groups of cells.
//!
//! The entry points are [`sightlines`] for two polygons, [`decide`] for a cell, and [`decide_group`] for a
//! group of cells.
//!
//! # Invariants
//!
//! - No verdict depends on a tolerance: the search computes each sign in doubles with an error bound, and in
//!   integers if the error bound does not determine the sign.
//! - visible ⊆ V(C) ⊆ visible ∪ undecided for every cell C. V(C) is the true set of the cell, and "visible"
//!   and "undecided" are the triangles that the search returns as such. The rule also holds if a limit or a
//!   caller stops the search early.
//! - A triangle that sampling has seen is in the set "visible" only if it meets the cell or the search has
//!   found a witness for it.
//! - The initial region of line space in the checker lies inside the initial region of the search. A proof of
//!   the search therefore covers the region of the checker.
//!
//! # Limits
//!
//! - Exact queries do not support masked triangles, and decide single triangles only. The sets of clusters
//!   and objects of an exact result are derived from its sets of triangles.
//! - Exact methods decide a reached cell as a whole, or its part of the region that walls enclose. They do
//!   not decide the marked parts of a cell.
//!
//! # Example
//!
//! ```
//! use glam::{DVec3, Vec3};
//! use sightline_exact::{QueryLimits, Occluders, Polygon, Verdict, sightlines};
//! use sightline_scene::{Object, Scene, Triangle};
//!
//! // A triangle perpendicular to the x axis, as wide as `size`.
//! let corners = |x: f32, size: f32| {
//!     [[x, -size, -size], [x, size, -size], [x, 0.0, size]].map(Vec3::from)
//! };
//! let polygon = |x: f32| Polygon::triangle(corners(x, 1.0).map(|v| v.as_dvec3())).unwrap();
//! let scene = |wall: Triangle| {
//!     let object = Object { name: "wall".to_owned(), first: 0, count: 1 };
//!     Occluders::new(&Scene::new("example", vec![wall], vec![object]).unwrap()).unwrap()
//! };
//! let between = scene(Triangle { v: corners(1.0, 10.0) });
//! let behind = scene(Triangle { v: corners(3.0, 10.0) });
//! let (a, b) = ([polygon(0.0)], [polygon(2.0)]);
//!
//! // The wall is between the two polygons: the proof names triangle 0 of the scene.
//! let (verdict, _) = sightlines(&between, &a, &b, &QueryLimits::default());
//! let Verdict::Hidden(proof) = verdict else { panic!("the wall covers all lines") };
//! assert_eq!(proof.blockers(), [0]);
//!
//! // The wall is behind both polygons: the witness is a segment from one polygon to the other.
//! let (verdict, _) = sightlines(&behind, &a, &b, &QueryLimits::default());
//! assert!(matches!(verdict, Verdict::Visible(_)));
//! ```

mod arithmetic;
mod cells;
#[doc(hidden)]
pub mod fuzzing;
mod geometry;
mod line_space;
mod occluders;
mod search;
mod surfaces;

pub use cells::{
    CellDecisions, CellGroup, CellTask, ExactScene, ExactViewRegion, FromCellAnswer,
    GroupDecisions, QueryStatistics, Sources, box_from_cell, decide, decide_group, decide_listed,
    from_cell,
};
pub use geometry::{Cell, PointOrigin, Polygon, PolygonError, polygon, predicates};
pub use line_space::Decisions;
pub use occluders::{Occluder, OccluderId, Occluders};
pub use search::{Antipenumbra, NoAntipenumbra, Surface, Swath, antipenumbra};
pub use search::{
    QueryCost, QueryLimits, Stabbed, UndecidedReason, Verdict, sightlines, sightlines_until, stab,
};

pub use surfaces::HiddenFrom;
