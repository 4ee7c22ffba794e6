//! The arguments of `ambient`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sightline_ambient::Falloff;

use crate::kind_args::KindArgs;

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

#[derive(Args, Debug)]
pub struct AmbientArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// Points as JSON Lines; - for stdin: {"id":1,"point":[x,y,z],"normal":[x,y,z],"triangle":t}. "triangle"
    /// is the one that the point lies on, which hides nothing from it; it may be left out.
    #[arg(long, value_name = "P.jsonl")]
    pub points: PathBuf,
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
    /// Threads. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}
