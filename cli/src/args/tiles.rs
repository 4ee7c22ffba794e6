//! The arguments of `plan`, `tile` and `assemble`.

use std::path::PathBuf;

use clap::Args;
use sightline::JobOptions;

use crate::args::kinds::KindArgs;

/// Plan a bake in a folder, for tiles that any number of processes compute without a coordinator.
#[derive(Args, Debug)]
pub struct PlanArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// The folder to write, or a place in a bucket as the coordinator's --blobs names it: s3://BUCKET/PREFIX.
    /// It holds the job, the scene, and plan.json with the tiles that each tile needs.
    #[arg(short, long, value_name = "DIR")]
    pub output: String,
    #[command(flatten)]
    pub kinds: KindArgs,
    #[command(flatten)]
    pub job: JobOptions,
}

/// Compute one tile of a planned bake, on any machine that sees the folder and has the plan's backend. A tile
/// that is there and whole is not computed again.
#[derive(Args, Debug)]
pub struct TileArgs {
    /// The folder of the plan, or its place in a bucket.
    #[arg(value_name = "DIR")]
    pub dir: String,
    /// The number of the tile, from 0. plan.json lists the tiles, and which of them each one needs.
    #[arg(value_name = "N")]
    pub number: u32,
}

/// Join the tiles of a planned bake to a result, which has the bytes of `sightline bake`.
#[derive(Args, Debug)]
pub struct AssembleArgs {
    /// The folder of the plan, or its place in a bucket.
    #[arg(value_name = "DIR")]
    pub dir: String,
    /// The result file to write.
    #[arg(short, long, value_name = "OUT.pvs")]
    pub output: PathBuf,
}
