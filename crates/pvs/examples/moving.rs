//! Decides if a camera may see a moving object, and if two players may see each other: `cargo run --example
//! moving -- RESULT.pvs X Y Z x0 y0 z0 x1 y1 z1`. The arguments are the position of a camera and two opposite
//! corners of the box of the moving object.

#![allow(clippy::print_stdout)] // Users read the output at a terminal.

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

    // A renderer draws the moving object only if the camera's cell sees a cell that the object's box meets.
    let Some(camera) = pvs.find_cell([x, y, z]) else {
        println!("the camera is outside the view box: draw everything");
        return Ok(());
    };
    let drawn = pvs.sees_box(camera, [x0, y0, z0], [x1, y1, z1])?;
    println!(
        "the moving object is {}",
        if drawn { "drawn" } else { "culled" }
    );

    // A server sends a player the position of another player only if the cells of the two see each other. If
    // the other player is outside the view box, send the position: the result has no relations for such
    // positions.
    let middle = [x0.midpoint(x1), y0.midpoint(y1), z0.midpoint(z1)];
    let told = match pvs.find_cell(middle) {
        Some(other) => pvs.sees(camera, other)?,
        None => true,
    };
    println!(
        "the server {} the position of the player",
        if told { "sends" } else { "does not send" }
    );
    Ok(())
}
