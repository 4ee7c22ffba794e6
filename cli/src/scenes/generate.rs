//! `sightline generate`: test scenes.

use std::path::Path;

use sightline::output::{Format, Output};
use sightline::{Error, Scene};
use sightline_scene::generate::{GenerateError, Kind, Params, generate};
use sightline_scene::glb_out::{GlbError, write_glb};

use crate::args::cli::{GenerateArgs, SceneKind};
use crate::terminal::stdout::print;

/// Makes a test scene.
pub fn run(args: &GenerateArgs, json: bool) -> Result<(), Error> {
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
