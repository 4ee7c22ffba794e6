//! Interest management of a game server, from cell-to-cell visibility.
//!
//! `cargo run --release -p sightline-pvs --example interest -- RESULT.pvs [MARGIN] < PLAYERS` reads one line
//! per player: `name x y z` or `name x y z margin`. The program prints a line `name: others…` per player, in
//! the order of the input. `others` are the players whose positions the server must send to this player. The
//! program skips blank lines and lines that begin with #.
//!
//! The margin is the largest distance, on each axis, from the position of a player that any part of the
//! player may reach before the next message, in units of the scene. Compute the margin as half the size of
//! the body, plus the maximum speed times the time until the next message (the tick and the slowest
//! connection). Both players may move by then, so a box represents each of them. The server sends a player
//! the position of another player if any cell of one box sees a cell of the other box. Then no player appears
//! late at a corner, and the relation is symmetric.

#![allow(clippy::print_stdout)] // Users read the output at a terminal.

use std::io::BufRead as _;

use sightline_pvs::{Pvs, PvsError};

const USAGE: &str =
    "usage: interest RESULT.pvs [MARGIN] < PLAYERS, with lines `name x y z [margin]`";

/// A player: the box that contains the player until the next message, and the cells that the box meets.
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
            "{path} contains no cell-to-cell visibility; bake the scene again with --cell-to-cell on"
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
        for (_, subject) in players.iter().enumerate().filter(|(other, _)| *other != k) {
            if may_know(&pvs, to, subject)? {
                told.push(subject.name.as_str());
            }
        }
        println!("{}: {}", to.name, told.join(" "));
    }
    Ok(())
}

/// Returns true if the server must send the position of the player `subject` to the player `to`.
fn may_know(pvs: &Pvs, to: &Player, subject: &Player) -> Result<bool, PvsError> {
    // The result contains no relations for positions outside the view box, so assume that every player is
    // visible from there.
    let [lo, hi] = pvs.tree().view_box();
    if !(0..3).all(|a| lo[a] <= to.min[a] && to.max[a] <= hi[a]) {
        return Ok(true);
    }
    for cell in &to.cells {
        if pvs.sees_box(*cell, subject.min, subject.max)? {
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
