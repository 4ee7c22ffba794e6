//! `sightline generate`: writes a generated test scene.

use std::path::Path;

use sightline::output::{Format, Output};
use sightline::{Error, Scene};
use sightline_scene::generate::{GenerateError, SceneKind, SceneParams, generate};
use sightline_scene::glb_out::{GlbError, write_glb};

use crate::args::cli::{GenerateArgs, GeneratedKind};
use crate::terminal::stdout::print;

/// Generates a test scene and writes it.
pub fn run(args: &GenerateArgs, json: bool) -> Result<(), Error> {
    let kind = match args.kind {
        GeneratedKind::Forest => SceneKind::Forest,
        GeneratedKind::Town => SceneKind::Town,
        GeneratedKind::Rooms => SceneKind::Rooms,
        GeneratedKind::Maze => SceneKind::Maze,
        GeneratedKind::Slits => SceneKind::Slits,
    };
    let params = SceneParams {
        seed: args.seed,
        triangles: args.triangles,
        trees: args.trees,
        triangles_per_tree: args.triangles_per_tree,
        grid: args.grid,
        slit_width: args.slit_width,
    };
    let output = Output::check(&args.output, Format::Glb, None)?;
    let scene = generate(kind, &params).map_err(|e| match e {
        GenerateError::Scene(e) => Error::internal(e),
        e => Error::usage(e.to_string()),
    })?;
    output.write(|out| {
        write_glb(&scene, out).map_err(|e| match e {
            GlbError::Io(e) => Error::writing(&args.output, &e),
            e => Error::usage(e.to_string()),
        })
    })?;
    print_written(&args.output, &scene, json)
}

/// Prints the description of a written scene.
pub fn print_written(path: &Path, scene: &Scene, json: bool) -> Result<(), Error> {
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
