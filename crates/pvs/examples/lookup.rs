//! Prints the objects to draw from a camera position: `cargo run --example lookup -- RESULT.pvs X Y Z`.

#![allow(clippy::print_stdout)] // A program for people at a terminal.

use sightline_pvs::Pvs;

const USAGE: &str = "usage: lookup RESULT.pvs X Y Z";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [path, x, y, z] = args.as_slice() else {
        return Err(USAGE.into());
    };
    let camera = [x.parse()?, y.parse()?, z.parse()?];

    // Once, at the start: this maps the file and checks all of it. Share the result between threads as it is.
    let pvs = Pvs::open(path)?;

    // In every frame: find the cell of the camera. The set changes only when the cell does, so an engine
    // keeps both.
    let Some(cell) = pvs.find_cell(camera) else {
        println!(
            "the camera is outside the view box {:?}",
            pvs.tree().view_box()
        );
        return Ok(());
    };

    // As ranges of triangle ids for draw calls. Reuse the vectors, so that later cells allocate nothing.
    let (mut runs, mut objects) = (Vec::new(), Vec::new());
    pvs.visible_runs(cell, &mut runs)?;
    let triangles: usize = runs.iter().map(ExactSizeIterator::len).sum();
    println!(
        "cell {cell}: {triangles} of {} triangles in {} runs",
        pvs.triangle_count(),
        runs.len()
    );

    // Or as whole objects of the scene, in the order of the scene file.
    pvs.visible_objects(cell, &mut objects)?;
    for object in objects {
        println!("  {}", pvs.objects()[object as usize].name);
    }
    Ok(())
}
