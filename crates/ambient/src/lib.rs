//! Ambient occlusion without noise.

pub mod blockers;
pub mod items;
pub mod lambert;
pub mod partition;
pub mod polygon;
pub mod query;
pub mod receivers;
pub mod solve;
