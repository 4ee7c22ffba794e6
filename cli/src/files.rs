//! `sightline mesh` and `sightline generate`: the commands that write scenes.

use std::path::Path;

use sightline_scene::Scene;
use sightline_scene::generate::{GenerateError, Kind, Params, generate as make};
use sightline_scene::glb_out::{GlbError, write_glb};

use crate::args::{GenerateArgs, MeshArgs, SceneKind};
use crate::error::CliError;
use crate::output::{Format, Output};
use crate::serve::print;

/// Writes the triangles of a scene as the program reads and numbers them.
pub fn mesh(args: &MeshArgs, json: bool) -> Result<(), CliError> {
    let output = Output::check(&args.output, Format::Ply, Some(&args.scene))?;
    let scene = sightline_scene::load(&args.scene)?;
    output.write(|out| {
        sightline_scene::write_mesh_ply(&scene, out)
            .map_err(|e| CliError::writing(&args.output, &e))
    })?;
    say_written(&args.output, &scene, json)
}

/// Makes a test scene.
pub fn generate(args: &GenerateArgs, json: bool) -> Result<(), CliError> {
    let kind = match args.kind {
        SceneKind::Forest => Kind::Forest,
        SceneKind::Town => Kind::Town,
        SceneKind::Rooms => Kind::Rooms,
        SceneKind::Maze => Kind::Maze,
        SceneKind::Slits => Kind::Slits,
    };
    let params = Params {
        seed: args.seed,
        triangles: args.triangles,
        trees: args.trees,
        triangles_per_tree: args.triangles_per_tree,
        grid: args.grid,
        slit_width: args.slit_width,
    };
    let output = Output::check(&args.output, Format::Glb, None)?;
    let scene = make(kind, &params).map_err(|e| match e {
        GenerateError::Scene(e) => CliError::internal(e),
        e => CliError::Usage(e.to_string()),
    })?;
    output.write(|out| {
        write_glb(&scene, out).map_err(|e| match e {
            GlbError::Io(e) => CliError::writing(&args.output, &e),
            e => CliError::Usage(e.to_string()),
        })
    })?;
    say_written(&args.output, &scene, json)
}

fn say_written(path: &Path, scene: &Scene, json: bool) -> Result<(), CliError> {
    let b = scene.bounds();
    if json {
        let value = serde_json::json!({
            "output": path.display().to_string(),
            "triangles": scene.len(),
            "objects": scene.objects().len(),
            "bounds": {"min": b.min.to_array(), "max": b.max.to_array()},
        });
        return print(&value.to_string());
    }
    print(&format!(
        "wrote {}: {} triangles, {} objects, bounds {} to {}",
        path.display(),
        scene.len(),
        scene.objects().len(),
        b.min,
        b.max
    ))
}
