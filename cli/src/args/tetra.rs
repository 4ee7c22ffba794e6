//! The arguments of `sightline tetra` and `sightline look`. The doc comments are the text of `--help`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::args::kinds::KindArgs;

/// Divide the space between the surfaces of a scene into convex cells, for `look`
///
/// The triangles may intersect, overlap, leave gaps, or have no area. Every triangle with an area
/// becomes a union of faces. The command neither moves nor rounds a point.
///
///   sightline tetra town.glb -o town.tets          build the file
///   sightline tetra --check town.glb town.tets     check it with separate code, with integers
///   echo '{"id":1,"point":[1,2,3]}' | sightline look town.tets --points -
#[derive(Args, Debug)]
#[command(
    verbatim_doc_comment,
    override_usage = "sightline tetra [OPTIONS] <SCENE> -o <OUT.tets> [--export <MESH.vtu>]\n       \
                      sightline tetra [OPTIONS] --check <SCENE> <OUT.tets>"
)]
pub struct TetraArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// The file to check. Needs --check.
    #[arg(value_name = "OUT.tets", requires = "check")]
    pub tets: Option<PathBuf>,
    /// The file to write. Required without --check.
    #[arg(
        short,
        long,
        value_name = "OUT.tets",
        required_unless_present = "check"
    )]
    pub output: Option<PathBuf>,
    /// The VTK file to write with the cells as tetrahedra, for ParaView and similar programs. Each
    /// tetrahedron has the number of its cell and the number of solids that contain it. The file also
    /// contains each triangle of the scene with its id. Default: none.
    #[arg(long, value_name = "MESH.vtu", conflicts_with = "check")]
    pub export: Option<PathBuf>,
    /// Check a file instead of writing one: its cells must fill the box without overlap, neighbours must
    /// agree, and each triangle must be covered once. If a check fails, the exit code is 3.
    #[arg(long, conflicts_with = "output", requires = "tets")]
    pub check: bool,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// Threads, 1 to 256. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

/// The accuracy of a set.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LookMode {
    /// Exactly the visible triangles.
    #[default]
    Exact,
    /// Only visible triangles. A triangle that is visible only in beams narrower than --angle may be missing;
    /// "dropped" is the solid angle of these beams.
    Aggressive,
    /// All visible triangles and, in beams narrower than --angle, also some hidden triangles.
    Conservative,
}

/// The query algorithm.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LookEngine {
    /// Select the algorithm that needs less work for the first point (docs/look.md).
    #[default]
    Auto,
    /// Traverse the cells front to back.
    Tetra,
    /// Traverse a hierarchy of boxes, nearest first.
    Bvh,
}

/// Compute the triangles that are visible from points, and the visible shares of boxes
///
/// With a .tets file of `sightline tetra`, the command computes the triangles that are visible from
/// a point, exactly or up to an angle, in a cone or in all directions, and the visible share of the
/// picture of a box. All fields except "point" are optional. "fov" is the full angle of a round cone
/// in degrees; its default is 90. "distance" is the end of the view:
///
///   {"id":1,"point":[x,y,z],"direction":[x,y,z],"fov":DEG,"distance":D,
///    "targets":[{"id":1,"min":[x,y,z],"max":[x,y,z]}]}
///   {"id":1,"visible":[ids],"areas":[steradians],"witnesses":[[x,y,z]],"sky":…,"dropped":…,
///    "inside":false,"targets":[{"id":1,"fraction":0.37}],"cells":n,"beams":n,"micros":n}
///
/// "areas" and "witnesses" need the flags of these names. "sky" is the solid angle without triangles and
/// "dropped" the undecided solid angle, both in steradians. "inside" is true if the point is inside of a
/// closed solid. "unseen" is the solid angle of triangles that block and are in no set, in steradians; the
/// field is absent if the scene has no such triangles. "cells" is the number of visited cells or boxes,
/// "beams" the number of ended beams, and "micros" the time of the answer in microseconds.
///
/// With a result of --method portals (.pvs), the command prints the triangles of the cell's set that
/// are in the view and not behind walls. "fov" contains the full angles in degrees. "shut", the names
/// of the closed doors, is optional:
///
///   {"id":1,"eye":[x,y,z],"dir":[x,y,z],"up":[x,y,z],"fov":[h,v],"shut":["door"]}
///   {"id":1,"cell":7,"visible":[ids],"micros":…}
///
/// The answers have the order of the input lines.
#[derive(Args, Debug)]
#[command(verbatim_doc_comment)]
pub struct LookArgs {
    /// A .tets file of `tetra`, or a result (.pvs) baked with --method portals.
    #[arg(value_name = "OUT.tets|OUT.pvs")]
    pub file: PathBuf,
    /// The points or views as JSON Lines; - for stdin.
    #[arg(long, visible_alias = "eyes", value_name = "P.jsonl")]
    pub points: PathBuf,
    /// The accuracy of the sets. Default: exact.
    #[arg(long, value_enum, help_heading = TETS)]
    pub mode: Option<LookMode>,
    /// The angle of --mode aggressive or conservative, in degrees. Default: 0.2.
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, help_heading = TETS)]
    pub angle: Option<f64>,
    /// Query algorithm. All algorithms return the same exact sets. Default: auto.
    #[arg(long, value_enum, help_heading = TETS)]
    pub engine: Option<LookEngine>,
    /// Add the solid angle of each visible triangle, in steradians.
    #[arg(long, help_heading = TETS)]
    pub areas: bool,
    /// Add to each visible triangle a direction in which no other triangle is nearer. The direction is null
    /// if the triangle contains the point, if no direction in doubles is certain, or if the middle of the
    /// visible part is outside of the view.
    #[arg(long, help_heading = TETS)]
    pub witnesses: bool,
    /// Threads, 1 to 256. With more than one, lines that have already arrived are answered in parallel.
    /// Default: 1.
    #[arg(long, value_name = "N", help_heading = TETS)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

/// The heading of the options that need a .tets file.
const TETS: &str = "With a .tets file";

impl LookArgs {
    /// Returns the first given option that needs a .tets file.
    pub fn of_tets(&self) -> Option<&'static str> {
        let given = [
            (self.mode.is_some(), "--mode"),
            (self.angle.is_some(), "--angle"),
            (self.engine.is_some(), "--engine"),
            (self.areas, "--areas"),
            (self.witnesses, "--witnesses"),
            (self.threads.is_some(), "--threads"),
        ];
        given
            .into_iter()
            .find(|(given, _)| *given)
            .map(|(_, name)| name)
    }
}
