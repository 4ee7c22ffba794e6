//! `sightline mesh`: writes the triangles of a scene as a PLY file.

use sightline::Error;
use sightline::output::{Format, Output};

use crate::args::cli::MeshArgs;
use crate::scenes::generate::print_written;

/// Writes the triangles of a scene in the order of their ids.
pub fn run(args: &MeshArgs, json: bool) -> Result<(), Error> {
    let output = Output::check(&args.output, Format::Ply, Some(&args.scene))?;
    let scene = sightline_scene::load(&args.scene)?;
    output.write(|out| {
        sightline_scene::write_mesh_ply(&scene, out).map_err(|e| Error::writing(&args.output, &e))
    })?;
    print_written(&args.output, &scene, json)
}
