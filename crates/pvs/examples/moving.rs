//! Decides what a camera may see of moving things, and which players may know of each other:
//! `cargo run --example moving -- RESULT.pvs X Y Z x0 y0 z0 x1 y1 z1`, a camera and the box of a moving
//! thing.

#![allow(clippy::print_stdout)] // A program for people at a terminal.

use sightline_pvs::Pvs;

const USAGE: &str = "usage: moving RESULT.pvs X Y Z x0 y0 z0 x1 y1 z1";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [path, numbers @ ..] = args.as_slice() else {
        return Err(USAGE.into());
    };
    let numbers: Vec<f32> = numbers
        .iter()
        .map(|n| n.parse())
        .collect::<Result<_, _>>()?;
    let [x, y, z, x0, y0, z0, x1, y1, z1] = numbers[..] else {
        return Err(USAGE.into());
    };
    let pvs = Pvs::open(path)?;

    // A renderer: draw the moving thing only when the camera's cell sees a cell that its box meets.
    let Some(camera) = pvs.find_cell([x, y, z]) else {
        println!("the camera is outside the view box: draw everything");
        return Ok(());
    };
    let drawn = pvs.sees_box(camera, [x0, y0, z0], [x1, y1, z1])?;
    println!(
        "the moving thing is {}",
        if drawn { "drawn" } else { "culled" }
    );

    // A server: tell a player about another only when the cells of the two see each other. A player outside
    // the view box is told, because nothing is known of places there.
    let middle = [x0.midpoint(x1), y0.midpoint(y1), z0.midpoint(z1)];
    let told = match pvs.find_cell(middle) {
        Some(other) => pvs.sees(camera, other)?,
        None => true,
    };
    println!("the player is {}", if told { "told" } else { "not told" });
    Ok(())
}
