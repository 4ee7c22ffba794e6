//! The arguments of `sightline tetra` and `sightline look`. The doc comments are the text of `--help`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::args::kinds::KindArgs;

/// Divide the space between the surfaces of a scene into convex cells, for `look`
///
/// Any triangles will do: they may cross, overlap, leave gaps, or have no area. Every triangle with
/// an area becomes a union of faces, and nothing is moved or rounded.
///
///   sightline tetra town.glb -o town.tets          build
///   sightline tetra --check town.glb town.tets     check a file, by other code with integers
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
    /// With --check: the file to check.
    #[arg(value_name = "OUT.tets", requires = "check")]
    pub tets: Option<PathBuf>,
    /// The file to write.
    #[arg(
        short,
        long,
        value_name = "OUT.tets",
        required_unless_present = "check"
    )]
    pub output: Option<PathBuf>,
    /// Also write the cells as tetrahedra, a file that ParaView and other programs with VTK read. Each has
    /// the number of its cell and the number of solids that hold it, and each triangle of the scene is there
    /// with its id.
    #[arg(long, value_name = "MESH.vtu", conflicts_with = "check")]
    pub export: Option<PathBuf>,
    /// Check a file: that its cells fill the box without overlap, that neighbours agree, and that each
    /// triangle is covered once. If not, the exit code is 3.
    #[arg(long, conflicts_with = "output", requires = "tets")]
    pub check: bool,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// Threads, 1 to 256. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

/// How exactly a set is decided.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LookMode {
    /// All that is visible, and nothing else.
    #[default]
    Exact,
    /// Nothing that is hidden, and not less than the angle allows: what is seen in beams narrower than
    /// --angle may be missing, and "dropped" is their solid angle.
    Aggressive,
    /// All that is visible, and in beams narrower than --angle also what is hidden in part.
    Conservative,
}

/// Who answers.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LookEngine {
    /// The one that has less to do for the first point (docs/look.md).
    #[default]
    Auto,
    /// The cells, front to back.
    Tetra,
    /// A hierarchy of boxes, nearest first.
    Bvh,
}

/// Look from points at run time: what is seen, and what share of a box
///
/// A .tets file of `sightline tetra` answers what is seen from a point, exactly or up to an angle,
/// in a cone or in all directions, and what share of a box's picture is visible. All but the point
/// may be left out. The fov is the full angle of a round cone in degrees, 90 if none is given;
/// "distance" ends the view:
///
///   {"id":1,"point":[x,y,z],"direction":[x,y,z],"fov":DEG,"distance":D,
///    "targets":[{"id":1,"min":[x,y,z],"max":[x,y,z]}]}
///   {"id":1,"visible":[ids],"areas":[steradians],"witnesses":[[x,y,z]],"sky":…,"dropped":…,
///    "inside":false,"targets":[{"id":1,"fraction":0.37}],"cells":n,"beams":n,"micros":n}
///
/// A result with portals (.pvs) answers with the triangles of a cell's set that are in the view and
/// not behind walls. The angles are full ones in degrees, and "shut" may be left out:
///
///   {"id":1,"eye":[x,y,z],"dir":[x,y,z],"up":[x,y,z],"fov":[h,v],"shut":["door"]}
///   {"id":1,"cell":7,"visible":[ids],"micros":…}
///
/// Answers come in the order of the lines.
#[derive(Args, Debug)]
#[command(verbatim_doc_comment)]
pub struct LookArgs {
    /// A .tets file of `tetra`, or a result (.pvs) baked with --method portals.
    #[arg(value_name = "OUT.tets|OUT.pvs")]
    pub file: PathBuf,
    /// The points or views as JSON Lines; - for stdin.
    #[arg(long, visible_alias = "eyes", value_name = "P.jsonl")]
    pub points: PathBuf,
    /// How exactly to answer.
    #[arg(long, value_enum, help_heading = TETS)]
    pub mode: Option<LookMode>,
    /// The angle of --mode aggressive or conservative, in degrees. Default: 0.2.
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, help_heading = TETS)]
    pub angle: Option<f64>,
    /// Who answers. Exact sets do not depend on it.
    #[arg(long, value_enum, help_heading = TETS)]
    pub engine: Option<LookEngine>,
    /// Add the solid angle of each visible triangle, in steradians.
    #[arg(long, help_heading = TETS)]
    pub areas: bool,
    /// Add a direction to each visible triangle along which nothing is met before it; null where a triangle
    /// holds the point, or where no direction in doubles is certain.
    #[arg(long, help_heading = TETS)]
    pub witnesses: bool,
    /// Threads, 1 to 256. Default: one, as a program that asks point after point has; with more, lines that
    /// are there already are answered together.
    #[arg(long, value_name = "N", help_heading = TETS)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

/// The heading of the options that need a .tets file.
const TETS: &str = "With a .tets file";

impl LookArgs {
    /// The first option that needs a .tets file.
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
