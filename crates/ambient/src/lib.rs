//! Ambient occlusion without noise: what a point's hemisphere is free of, as a sum over exact parts of it.
//!
//! The openness of a point x with normal n, for a distance D, is 1/π ∫ free(ω) (n·ω) dω over the hemisphere
//! above n (Apostu et al., "Analytic Ambient Occlusion using Exact from-Polygon Visibility", equation 1). A
//! direction ω is free if no triangle, from either side, is met along it closer than D. A triangle whose
//! plane holds x hides nothing. All lengths are in units of the scene, and all vectors in its frame.
//!
//! Receivers are sorted into blocks. The points of a block share a partition of rays: a tree of the Plücker
//! hyperplanes of the occluders' edges, which grows where queries arrive. A query takes the quarters of a
//! point's hemisphere down the tree, divides them where hyperplanes pass through them, and adds up Lambert's
//! closed form over the parts that end free. No ray is sampled and nothing is random. Positions are doubles;
//! a sign that doubles cannot tell moves an area from one part to another, and the sum of these areas is the
//! answer's bound.
//!
//! The crate has one module for each subject. A module depends only on those above it in this list:
//!
//! - `receivers`: points, their blocks, and the convex set that holds a block.
//! - `masked`, `blockers`: the scene's triangles, joined to convex polygons, and the hierarchy over them.
//! - `polygon`, `lambert`, `arcs`, `falloff`: parts of the sphere of directions, and integrals over them.
//! - `items`: what a block may see, and up to where.
//! - `partition`, `descend`: the tree, and the way of a part down to its ends.
//! - `openness`, `fragments`, `lights`, `inside`: the questions.
//! - `lines`: points and lights as users give them.
//! - `solve`: many receivers.
//!
//! ```
//! use glam::{DVec3, Vec3};
//! use sightline_ambient::{Prepared, Receiver, Settings, Solver};
//! use sightline_scene::{Object, Scene, Triangle};
//!
//! // A ceiling of 20 by 20 at the height 0.5.
//! let corner = |x: f32, y: f32| Vec3::new(x, y, 0.5);
//! let [a, b, c, d] = [corner(-10.0, -10.0), corner(10.0, -10.0), corner(10.0, 10.0), corner(-10.0, 10.0)];
//! let object = Object { name: "ceiling".to_owned(), first: 0, count: 2 };
//! let triangles = vec![Triangle { v: [a, b, c] }, Triangle { v: [a, c, d] }];
//! let scene = Scene::new("example", triangles, vec![object])?;
//!
//! // Within the distance 1 it hides a cap of the hemisphere: all but (0.5 / 1)² of it.
//! let prepared = Prepared::new(&scene, false)?;
//! let solver = Solver::new(&prepared, Settings::new(1.0));
//! let below = Receiver { point: DVec3::ZERO, normal: DVec3::Z, triangle: None };
//! let answer = &solver.solve(&[below], |_| {})[0];
//! assert!((answer.openness.open - 0.25).abs() < 1e-12 && answer.openness.bound < 1e-12);
//! # Ok::<(), sightline_scene::SceneError>(())
//! ```

mod arcs;
mod blockers;
mod descend;
mod falloff;
mod fragments;
pub mod fuzzing;
mod hull;
mod hyperplane;
mod inside;
mod items;
mod lambert;
mod lights;
mod lines;
mod masked;
mod openness;
mod partition;
mod polygon;
mod receivers;
mod solve;

pub use fragments::{Falloff, Fragment};
pub use lights::Light;
pub use lines::{LightLine, LineError, PointLine};
pub use openness::Openness;
pub use receivers::{Receiver, blocks};
pub use solve::{Answer, Memory, Prepared, Settings, Solver};
