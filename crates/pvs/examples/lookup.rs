//! Prints the objects to draw from a camera position: `cargo run --example lookup -- RESULT.pvs X Y Z`.

#![allow(clippy::print_stdout)] // Users read the output at a terminal.

use sightline_pvs::Pvs;

const USAGE: &str = "usage: lookup RESULT.pvs X Y Z";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [path, x, y, z] = args.as_slice() else {
        return Err(USAGE.into());
    };
    let camera = [x.parse()?, y.parse()?, z.parse()?];

    // Do this once, at the start: `open` maps the file and checks all of it. Threads can share the result.
    let pvs = Pvs::open(path)?;

    // Do this in every frame: find the cell of the camera. The set changes only when the cell changes, so an
    // engine should store both.
    let Some(cell) = pvs.find_cell(camera) else {
        println!(
            "the camera is outside the view box {:?}",
            pvs.tree().view_box()
        );
        return Ok(());
    };

    // Get the set as ranges of triangle ids for draw calls. Reuse the vectors, so that later cells allocate
    // nothing.
    let (mut runs, mut objects) = (Vec::new(), Vec::new());
    pvs.visible_runs(cell, &mut runs)?;
    let triangles: usize = runs.iter().map(ExactSizeIterator::len).sum();
    println!(
        "cell {cell}: {triangles} of {} triangles in {} runs",
        pvs.triangle_count(),
        runs.len()
    );

    // Or get the set as whole objects of the scene, in the order of the scene file.
    pvs.visible_objects(cell, &mut objects)?;
    for object in objects {
        println!("  {}", pvs.objects()[object as usize].name);
    }
    Ok(())
}
