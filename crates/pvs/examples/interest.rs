//! Who may know of whom: what a game server tells each player, by the cells that see each other.
//!
//! `cargo run --release -p sightline-pvs --example interest -- RESULT.pvs [MARGIN] < PLAYERS` reads a line
//! `name x y z` or `name x y z margin` for each player and prints `name: others…` for each, in the order of
//! the input. Blank lines and lines that begin with # are left out.
//!
//! The margin is how far a player, body and all, may get on each axis before the next message: half the
//! body, and the greatest speed times the time until then (the tick and the slowest connection). Both
//! players have moved by then, so both are boxes: one is told of the other when any cell of the one's box
//! sees a cell of the other's. Then nobody pops up late at a corner, and the answer is the same both ways.

#![allow(clippy::print_stdout)] // A program for people at a terminal.

use std::io::BufRead as _;

use sightline_pvs::{Pvs, PvsError};

const USAGE: &str =
    "usage: interest RESULT.pvs [MARGIN] < PLAYERS, with lines `name x y z [margin]`";

/// A player: the box that holds it until the next message, and the cells of that.
struct Player {
    name: String,
    min: [f32; 3],
    max: [f32; 3],
    cells: Vec<u32>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (path, margin) = match args.as_slice() {
        [path] => (path, 0.0),
        [path, text] => (
            path,
            number(text).filter(|margin| *margin >= 0.0).ok_or(USAGE)?,
        ),
        _ => return Err(USAGE.into()),
    };
    let pvs = Pvs::open(path)?;
    if pvs.cell_pairs()?.is_none() {
        return Err(format!(
            "{path} does not say which cells see which; bake with --cell-to-cell on"
        )
        .into());
    }
    let mut players = Vec::new();
    for (count, line) in std::io::stdin().lock().lines().enumerate() {
        let line = line?;
        if !line.trim().is_empty() && !line.starts_with('#') {
            let wrong = || format!("line {}: {line:?}; give `name x y z [margin]`", count + 1);
            players.push(player(&pvs, &line, margin).ok_or_else(wrong)?);
        }
    }
    for (k, to) in players.iter().enumerate() {
        let mut told = Vec::new();
        for (_, of) in players.iter().enumerate().filter(|(other, _)| *other != k) {
            if may_know(&pvs, to, of)? {
                told.push(of.name.as_str());
            }
        }
        println!("{}: {}", to.name, told.join(" "));
    }
    Ok(())
}

/// Whether a player is told of another.
fn may_know(pvs: &Pvs, to: &Player, of: &Player) -> Result<bool, PvsError> {
    // Nothing is known of places outside the view box.
    let [lo, hi] = pvs.tree().view_box();
    if !(0..3).all(|a| lo[a] <= to.min[a] && to.max[a] <= hi[a]) {
        return Ok(true);
    }
    for cell in &to.cells {
        if pvs.sees_box(*cell, of.min, of.max)? {
            return Ok(true);
        }
    }
    Ok(false)
}

fn player(pvs: &Pvs, line: &str, margin: f32) -> Option<Player> {
    let mut words = line.split_whitespace();
    let name = words.next()?.to_owned();
    let numbers: Vec<f32> = words.map(number).collect::<Option<_>>()?;
    let (at, margin) = match numbers[..] {
        [x, y, z] => ([x, y, z], margin),
        [x, y, z, own] if own >= 0.0 => ([x, y, z], own),
        _ => return None,
    };
    let (min, max) = (at.map(|c| c - margin), at.map(|c| c + margin));
    let meets = |cell: &u32| {
        let [lo, hi] = pvs.cell_bounds(*cell).unwrap_or_default();
        (0..3).all(|a| lo[a] <= max[a] && min[a] <= hi[a])
    };
    Some(Player {
        name,
        min,
        max,
        cells: (0..pvs.cells()).filter(meets).collect(),
    })
}

fn number(text: &str) -> Option<f32> {
    text.parse().ok().filter(|n: &f32| n.is_finite())
}
