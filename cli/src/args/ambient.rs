//! The arguments of `ambient`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sightline_ambient::Falloff;

use crate::args::kinds::KindArgs;
use crate::args::remote::KeyArgs;

/// How things darken with their distance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum FalloffChoice {
    /// What is nearer than the distance D hides.
    #[default]
    None,
    /// What is first met at the distance d < D leaves √(d/D).
    Sqrt,
}

impl FalloffChoice {
    /// The falloff.
    pub fn falloff(self) -> Falloff {
        match self {
            Self::None => Falloff::None,
            Self::Sqrt => Falloff::Sqrt,
        }
    }
}

/// Where the occlusion goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum To {
    /// A texture: `occlusionTexture` of the materials, a PNG within the file.
    #[default]
    Texture,
    /// The vertices: `_OCCLUSION` and `COLOR_0`.
    Vertices,
}

/// Which texture coordinates are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Uv {
    /// TEXCOORD_1 of the file, or an error.
    Keep,
    /// New ones.
    Unwrap,
}

#[derive(Args, Debug)]
#[command(group(clap::ArgGroup::new("answer").required(true).args(["points", "output"])))]
pub struct AmbientArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// The file to write: the scene's own file with its occlusion, as GLB.
    #[arg(short, long, value_name = "OUT.glb")]
    pub output: Option<PathBuf>,
    /// Where the occlusion goes.
    #[arg(long, value_enum, default_value_t = To::Texture, conflicts_with = "points")]
    pub to: To,
    /// Side of a texel, in units of the scene.
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true)]
    #[arg(conflicts_with_all = ["points", "resolution"])]
    pub texel: Option<f64>,
    /// Side of the texture in texels, 16 to 16384. Default without --texel: 1024.
    #[arg(long, value_name = "PX", conflicts_with = "points")]
    pub resolution: Option<u32>,
    /// Bits of a value, 8 or 16.
    #[arg(
        long,
        value_name = "8|16",
        default_value_t = 8,
        conflicts_with = "points"
    )]
    #[arg(value_parser = clap::value_parser!(u8).range(8..=16))]
    pub bits: u8,
    /// Use TEXCOORD_1 of the file, or make new texture coordinates. Default: TEXCOORD_1 where it can be used,
    /// else new ones.
    #[arg(long, value_enum, conflicts_with = "points")]
    pub uv: Option<Uv>,
    /// Points as JSON Lines; - for stdin: {"id":1,"point":[x,y,z],"normal":[x,y,z],"triangle":t}. "triangle"
    /// is the one that the point lies on, which hides nothing from it; it may be left out.
    #[arg(long, value_name = "P.jsonl")]
    pub points: Option<PathBuf>,
    /// Lights as JSON Lines: {"id":"lamp","polygon":[[x,y,z],…]}, flat and convex, with corners in order.
    /// Each answer tells what share of its hemisphere each light takes, weighted by the cosine.
    #[arg(long, value_name = "L.jsonl")]
    pub lights: Option<PathBuf>,
    /// Tell for each point which triangles it sees first, in which directions, and what each takes of the
    /// hemisphere.
    #[arg(long)]
    pub fragments: bool,
    /// Distance beyond which nothing hides, in units of the scene, or inf. Default: a twentieth of the
    /// scene's diagonal.
    #[arg(long, value_name = "D", allow_hyphen_values = true)]
    pub distance: Option<String>,
    /// How things darken with their distance.
    #[arg(long, value_enum, default_value_t = FalloffChoice::None)]
    pub falloff: FalloffChoice,
    /// Threads, for points. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Workers in this process, 1 to 256. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    #[arg(conflicts_with_all = ["points", "coordinator"])]
    pub workers: Option<u16>,
    /// Where finished work is kept, so that an interrupted run goes on. Default: as for `bake`.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["points", "coordinator"])]
    pub data_dir: Option<PathBuf>,
    /// Compute on the cluster of this coordinator instead of in this process: https:// where it has a
    /// certificate.
    #[arg(long, value_name = "URL", conflicts_with = "points")]
    pub coordinator: Option<String>,
    #[command(flatten)]
    pub keys: KeyArgs,
}
