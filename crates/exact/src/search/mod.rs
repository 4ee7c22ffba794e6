//! The query between two polygons: feedback-guided subtraction of occluders in line space.

mod antipenumbra;
mod corners;
mod edges;
mod fusion;
mod halves;
mod local;
mod maps;
mod query;
mod side_bitsets;
mod sight_line;
mod stab;
mod subtract;
mod swath;
mod trace;
mod verdict;

pub use antipenumbra::{Antipenumbra, NoAntipenumbra, Swath, antipenumbra};
pub use query::{sightlines, sightlines_until};
pub use stab::{Stabbed, stab};
pub use swath::Surface;
pub use verdict::{QueryCost, QueryLimits, UndecidedReason, Verdict};
