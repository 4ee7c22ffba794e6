//! Bakes a scene and prints the triangles visible from the middle of its view box:
//! `cargo run --release -p sightline --example bake -- SCENE OUT.pvs`.
#![allow(clippy::print_stdout, reason = "an example")]

use std::path::Path;

use sightline::{
    Cells, Error, JobOptions, LoadOptions, Local, Note, Observer, Progress, Pvs, SceneSource,
    read_scene,
};

/// An observer that prints progress and notes.
struct Print;

impl Observer for Print {
    fn progress(&self, progress: &Progress<'_>) {
        println!("{} of {} {}", progress.done, progress.total, progress.what);
    }

    fn note(&self, note: &Note) {
        println!("{}", note.text);
    }
}

/// Bakes a scene file in this process.
pub fn bake_file(scene: &Path, local: &Local) -> Result<Pvs, Error> {
    let source = SceneSource::File(scene.to_owned());
    let scene = read_scene(&source, &LoadOptions::default(), &Print)?;
    let options = JobOptions {
        cells: Some(Cells::Grid([4, 2, 4])),
        ..JobOptions::default()
    };
    let job = options.resolve(&scene, &Print)?;
    Ok(sightline::bake(&scene, &job, local, &Print)?.pvs)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, scene, output] = arguments.as_slice() else {
        return Err("usage: bake SCENE OUT.pvs".into());
    };
    let local = Local {
        output: Some(output.into()),
        ..Local::default()
    };
    let pvs = bake_file(Path::new(scene), &local)?;
    let [min, max] = pvs.tree().view_box();
    let middle = std::array::from_fn(|axis| f32::midpoint(min[axis], max[axis]));
    let mut triangles = Vec::new();
    if let Some(cell) = pvs.find_cell(middle) {
        pvs.visible(cell, &mut triangles)?;
        println!("{} triangles are visible from cell {cell}", triangles.len());
    }
    Ok(())
}
