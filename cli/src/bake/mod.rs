//! Commands that bake.

pub mod ambient;
pub mod ambient_distance;
pub mod ambient_file;
pub mod ambient_points;
pub mod assemble;
#[allow(
    clippy::module_inception,
    reason = "each command is a file of its folder, and bake is one"
)]
pub mod bake;
pub mod plan;
pub mod resources;
pub mod tile;
pub mod unite;
