//! The arguments of `ambient`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sightline_ambient::Falloff;

use crate::args::kinds::KindArgs;
use crate::args::remote::KeyArgs;

/// The decrease of occlusion with the distance of a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum FalloffChoice {
    /// Every surface nearer than the distance D occludes fully.
    #[default]
    None,
    /// A direction whose nearest surface is at the distance d < D counts as the fraction √(d/D) unoccluded.
    Sqrt,
}

impl FalloffChoice {
    /// Returns the falloff of the library.
    pub fn falloff(self) -> Falloff {
        match self {
            Self::None => Falloff::None,
            Self::Sqrt => Falloff::Sqrt,
        }
    }
}

/// The part of the file that stores the occlusion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum OcclusionTarget {
    /// A texture: `occlusionTexture` of the materials, a PNG within the file.
    #[default]
    Texture,
    /// The vertices: `_OCCLUSION` and `COLOR_0`.
    Vertices,
}

/// The texture coordinates of the occlusion texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Uv {
    /// TEXCOORD_1 of the file. Materials without usable TEXCOORD_1 are an error.
    Keep,
    /// New texture coordinates.
    Unwrap,
}

#[derive(Args, Debug)]
#[command(group(clap::ArgGroup::new("answer").required(true).args(["points", "output"])))]
pub struct AmbientArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// The GLB file to write: the scene with its occlusion.
    #[arg(short, long, value_name = "OUT.glb")]
    pub output: Option<PathBuf>,
    /// The part of the file that stores the occlusion.
    #[arg(long, value_enum, default_value_t = OcclusionTarget::Texture, conflicts_with = "points")]
    pub to: OcclusionTarget,
    /// Side of a texel, in units of the scene. Not together with --resolution.
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true)]
    #[arg(conflicts_with_all = ["points", "resolution"])]
    pub texel: Option<f64>,
    /// Side of the texture in texels, 16 to 16384. Default without --texel: 1024.
    #[arg(long, value_name = "PX", conflicts_with = "points")]
    pub resolution: Option<u32>,
    /// Bits per occlusion value, 8 or 16.
    #[arg(
        long,
        value_name = "8|16",
        default_value_t = 8,
        conflicts_with = "points"
    )]
    #[arg(value_parser = clap::value_parser!(u8).range(8..=16))]
    pub bits: u8,
    /// Texture coordinates of the occlusion texture: TEXCOORD_1 of the file, or new ones. Default: TEXCOORD_1
    /// if it is usable, otherwise new ones.
    #[arg(long, value_enum, conflicts_with = "points")]
    pub uv: Option<Uv>,
    /// Points as JSON Lines; - for stdin: {"id":1,"point":[x,y,z],"normal":[x,y,z],"triangle":t}. "triangle"
    /// is optional: the triangle that contains the point, which does not occlude the point.
    #[arg(long, value_name = "P.jsonl")]
    pub points: Option<PathBuf>,
    /// Lights as JSON Lines: {"id":"lamp","polygon":[[x,y,z],…]}, flat and convex, with corners in order.
    /// Each answer contains the share of the hemisphere that each light covers, weighted by the cosine.
    #[arg(long, value_name = "L.jsonl")]
    pub lights: Option<PathBuf>,
    /// Print for each point the triangles that are nearest in some directions, these directions, and the
    /// share of the hemisphere that each triangle covers.
    #[arg(long)]
    pub fragments: bool,
    /// Distance beyond which surfaces do not occlude, in units of the scene, or inf. Default: a twentieth of
    /// the diagonal of the scene.
    #[arg(long, value_name = "D", allow_hyphen_values = true)]
    pub distance: Option<String>,
    /// The decrease of occlusion with the distance of a surface.
    #[arg(long, value_enum, default_value_t = FalloffChoice::None)]
    pub falloff: FalloffChoice,
    /// Threads for --points, 1 to 1024. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Workers in this process, 1 to 256. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    #[arg(conflicts_with_all = ["points", "coordinator"])]
    pub workers: Option<u16>,
    /// Directory for finished work, from which an interrupted run continues. Default: as for `bake`.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["points", "coordinator"])]
    pub data_dir: Option<PathBuf>,
    /// Address of a coordinator whose workers compute instead of this process: https:// if the coordinator
    /// has a certificate. Default: compute in this process.
    #[arg(long, value_name = "URL", conflicts_with = "points")]
    pub coordinator: Option<String>,
    #[command(flatten)]
    pub keys: KeyArgs,
}
