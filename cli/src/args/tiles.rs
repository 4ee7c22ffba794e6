//! The arguments of `plan`, `tile` and `assemble`.

use std::path::PathBuf;

use clap::Args;
use sightline::JobOptions;

use crate::args::kinds::KindArgs;

/// Plan a bake in a folder, so that any number of processes can compute its tiles without a coordinator.
#[derive(Args, Debug)]
pub struct PlanArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// The folder to write, or a location in a bucket: s3://BUCKET/PREFIX, in the form of `sightline
    /// coordinator --blobs`. The command writes the job, the scene, and plan.json with the tiles and their
    /// dependencies.
    #[arg(short, long, value_name = "DIR")]
    pub output: String,
    #[command(flatten)]
    pub kinds: KindArgs,
    #[command(flatten)]
    pub job: JobOptions,
}

/// Compute one tile of a planned bake. The machine needs access to the folder and the backend of the plan. A
/// tile that is already complete is not computed again.
#[derive(Args, Debug)]
pub struct TileArgs {
    /// The folder of the plan, or its location in a bucket.
    #[arg(value_name = "DIR")]
    pub dir: String,
    /// The number of the tile, starting at 0. plan.json lists the tiles, and for each tile the numbers of the
    /// tiles that it needs.
    #[arg(value_name = "N")]
    pub number: u32,
}

/// Join the tiles of a planned bake into a result. The result has the same bytes as with `sightline bake`.
#[derive(Args, Debug)]
pub struct AssembleArgs {
    /// The folder of the plan, or its location in a bucket.
    #[arg(value_name = "DIR")]
    pub dir: String,
    /// The result file to write.
    #[arg(short, long, value_name = "OUT.pvs")]
    pub output: PathBuf,
}
