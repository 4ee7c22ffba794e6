//! Exact from-region visibility: queries in line space, their witnesses and proofs, and whole view cells.
//!
//! A query decides whether one convex polygon sees another among the triangles of a scene. The verdict is a
//! witness (an unobstructed segment), a proof that [`sightline_certificate::checker`] verifies with exact
//! arithmetic only, or "undecided" with the limit that ended the search. No tolerance decides a verdict: a
//! sign is computed in doubles with an error bound, and in integers where the bound leaves it open. All
//! coordinates are in the units and the frame of the scene.
//!
//! The crate has one module for each subject. A module depends only on those above it in this list:
//!
//! - `arithmetic`: double-doubles, big integers, signs, random numbers.
//! - `geometry`: points, exact polygons, view cells, the frame of a query, the bounding volume hierarchy.
//! - `occluders`: convex coplanar sets of triangles, their boundary edges, and segments among them.
//! - `surfaces`: closed surfaces and the triangles that they hide without a query.
//! - `line_space`: Plücker vectors, cones, the Klein quadric, the stabbing polyhedron, polar splits.
//! - `search`: the query between two polygons, with occluder fusion and side bitsets.
//! - `cells`: queries from a view cell, all triangles of a cell, and groups of cells.
//!
//! ```
//! use glam::{DVec3, Vec3};
//! use sightline_exact::{Limits, Occluders, Polygon, Verdict, sightlines};
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
//! // The wall stands between the two polygons: the proof names triangle 0 of the scene.
//! let (verdict, _) = sightlines(&between, &a, &b, &Limits::default());
//! let Verdict::Hidden(proof) = verdict else { panic!("the wall covers all lines") };
//! assert_eq!(proof.blockers(), [0]);
//!
//! // The wall stands behind both polygons: the witness is a segment from one to the other.
//! let (verdict, _) = sightlines(&behind, &a, &b, &Limits::default());
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
    CellGroup, Decided, ExactScene, ExactViewRegion, Found, GroupDecided, QueryStatistics, Sources,
    Task, box_from_cell, decide, decide_group, decide_listed, from_cell,
};
pub use geometry::{Cell, Polygon, PolygonError, Source, polygon, predicates};
pub use line_space::Decisions;
pub use occluders::{Occluder, OccluderId, Occluders};
pub use search::{Antipenumbra, NoAntipenumbra, Surface, Swath, antipenumbra};
pub use search::{Cost, Limits, Reason, Stabbed, Verdict, sightlines, sightlines_until, stab};

pub use surfaces::Hides;
