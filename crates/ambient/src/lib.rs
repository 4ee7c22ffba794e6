//! Ambient occlusion without noise: the unobstructed fraction of a point's hemisphere, as a sum over exact
//! parts of the hemisphere.
//!
//! The openness of a point x with normal n, for a distance D, is 1/π ∫ free(ω) (n·ω) dω over the hemisphere
//! above n (Apostu et al., "Analytic Ambient Occlusion using Exact from-Polygon Visibility", equation 1). A
//! direction ω is free if the ray from x along ω meets no triangle, from either side, closer than D. A
//! triangle whose plane contains x is ignored. All lengths are in units of the scene, and all vectors in its
//! frame.
//!
//! Receivers are sorted into blocks. The points of a block share a partition of rays: a tree of the Plücker
//! hyperplanes of the occluders' edges, which grows at the nodes that queries reach. A query moves the
//! quarters of a point's hemisphere down the tree, and divides a quarter where a hyperplane passes through
//! the quarter. The openness is the sum of Lambert's closed form over the parts that meet no occluder.
//!
//! The entry points are [`AmbientScene`], the prepared scene, and [`Solver`], which computes the [`Openness`]
//! of [`Receiver`]s. `docs/decisions/0016-ambient-occlusion-by-partitions.md` has the reasons for the method.
//!
//! # Modules
//!
//! A module depends only on the modules above it in this list:
//!
//! - `receivers`: points, their blocks, and the convex set that contains a block.
//! - `masked`, `blockers`: the scene's triangles, joined to convex polygons, and the hierarchy over them.
//! - `polygon`, `lambert`, `arcs`, `falloff`: parts of the sphere of directions, and integrals over the
//!   parts.
//! - `items`: the potential occluders of a block, and the range within which they hide.
//! - `partition`, `descent`: the tree, and the descent of a part of the hemisphere to the leaves.
//! - `openness`, `fragments`, `lights`, `inside`: the queries of a receiver.
//! - `lines`: points and lights in JSON.
//! - `solve`: the queries of many receivers, in blocks.
//!
//! # Invariants
//!
//! - The computation uses neither sampled rays nor random numbers.
//! - Positions are doubles. If doubles cannot decide a sign, an area may count in the wrong part of the
//!   hemisphere. The bound of the answer includes the sum of these areas.
//! - Blocks share no state, so answers do not depend on the order or the machine.
//!
//! # Example
//!
//! ```
//! use glam::{DVec3, Vec3};
//! use sightline_ambient::{AmbientScene, Receiver, Solver, SolverSettings};
//! use sightline_scene::{Object, Scene, Triangle};
//!
//! // A ceiling of 20 by 20 at the height 0.5.
//! let corner = |x: f32, y: f32| Vec3::new(x, y, 0.5);
//! let [a, b, c, d] = [corner(-10.0, -10.0), corner(10.0, -10.0), corner(10.0, 10.0), corner(-10.0, 10.0)];
//! let object = Object { name: "ceiling".to_owned(), first: 0, count: 2 };
//! let triangles = vec![Triangle { v: [a, b, c] }, Triangle { v: [a, c, d] }];
//! let scene = Scene::new("example", triangles, vec![object])?;
//!
//! // Within the distance 1, the ceiling hides a cap of the hemisphere. The fraction (0.5 / 1)² stays open.
//! let prepared = AmbientScene::new(&scene, false)?;
//! let solver = Solver::new(&prepared, SolverSettings::new(1.0));
//! let below = Receiver { point: DVec3::ZERO, normal: DVec3::Z, triangle: None };
//! let answer = &solver.solve(&[below], |_| {})[0];
//! assert!((answer.openness.open - 0.25).abs() < 1e-12 && answer.openness.bound < 1e-12);
//! # Ok::<(), sightline_scene::SceneError>(())
//! ```

mod arcs;
mod blockers;
mod descent;
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
pub use solve::{AmbientScene, BlockMemory, ReceiverResult, Solver, SolverSettings};
