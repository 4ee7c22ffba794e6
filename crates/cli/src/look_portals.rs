//! `sightline look OUT.pvs`: what is seen through portals from viewpoints, one JSON line in, one JSON line
//! out.

use std::time::Instant;

use serde::Deserialize;
use serde_json::{Value, json};
use sightline_pvs::{LookError, Looker, Pvs, View};

use crate::error::CliError;
use crate::json_lines::JsonLines;
use crate::opening::open;
use crate::progress::say;
use crate::serve::print;
use crate::tetra_args::LookArgs;

/// One line of the input.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    #[serde(default)]
    id: Value,
    eye: [f64; 3],
    dir: [f64; 3],
    up: [f64; 3],
    fov: [f64; 2],
    #[serde(default)]
    shut: Vec<String>,
}

/// Looks from every eye of a file, in order.
pub fn run(args: &LookArgs) -> Result<(), CliError> {
    if let Some(option) = args.of_tets() {
        return Err(CliError::Usage(format!(
            "{option} needs a .tets file, and {} is a result; make one with `sightline tetra`",
            args.file.display()
        )));
    }
    let pvs = open(&args.file)?;
    let mut looker = Looker::new(&pvs)?.ok_or_else(|| {
        CliError::Input(format!(
            "{} has no portals (method {}); {}",
            args.file.display(),
            pvs.method(),
            match (pvs.method(), pvs.region()) {
                ("portals", _) | ("exact" | "verified", Some(_)) =>
                    "the tile that has them was set aside: run the same bake again",
                _ => "bake it with --method portals, or exactly with --reachable-from where walls enclose it",
            }
        ))
    })?;
    let doors = looker.doors();
    let example = r#"{"id":1,"eye":[x,y,z],"dir":[x,y,z],"up":[x,y,z],"fov":[90,60],"shut":["door"]}"#;
    let mut input = JsonLines::open(&args.points, "--points", example)?;
    let (mut times, mut shares): (Vec<u64>, Vec<f64>) = (Vec::new(), Vec::new());
    let check = |line: Line| {
        let number = |name: &String| {
            doors.binary_search(name).map_err(|_| match doors {
                [] => format!("there is no door {name:?}: the result has no doors"),
                _ => format!("there is no door {name:?}; the doors are {}", doors.join(", ")),
            })
        };
        let shut: Vec<usize> = line.shut.iter().map(number).collect::<Result<_, _>>()?;
        Ok((line, shut))
    };
    let ended = 'all: loop {
        let (lines, failure) = input.read(check);
        let last = lines.is_empty();
        for (number, (line, shut)) in input.numbers.iter().zip(lines) {
            (0..doors.len()).for_each(|door| looker.shut(door, shut.contains(&door)));
            let view = View { eye: line.eye, direction: line.dir, up: line.up, fov: line.fov };
            let start = Instant::now();
            let cell = looker.look(&view);
            let nanos = start.elapsed().as_nanos() as u64;
            let cell = match seen_from(&pvs, &view, cell) {
                Ok(cell) => cell,
                Err(why) => {
                    break 'all Err(CliError::Input(format!("{}, line {number}: {why}", input.name)));
                }
            };
            times.push(nanos);
            shares.push(looker.visible().len() as f64 / looker.of_cell().max(1) as f64);
            let micros = nanos as f64 / 1e3;
            let answer = json!({"id": line.id, "cell": cell, "visible": looker.visible(), "micros": micros});
            print(&answer.to_string())?;
        }
        match failure {
            Some(e) => break Err(e),
            None if last => break Ok(()),
            None => {}
        }
    };
    if ended.is_err() {
        say("only the views before the bad line were answered");
    }
    times.sort_unstable();
    shares.sort_by(f64::total_cmp);
    if let (Some(time), Some(share)) = (times.get(times.len() / 2), shares.get(shares.len() / 2)) {
        say(&format!(
            "{} views; in the median {:.1} µs each, and {:.1} % of the cell's set",
            times.len(),
            *time as f64 / 1e3,
            share * 100.0
        ));
    }
    ended
}

/// The cell of a look, or why it has none.
fn seen_from(pvs: &Pvs, view: &View, cell: Result<Option<u32>, LookError>) -> Result<u32, String> {
    let [lo, hi] = pvs.tree().view_box();
    let Some(cell) = cell.map_err(|e| e.to_string())? else {
        let of = match pvs.find_cell_precisely(view.eye) {
            Some(_) => "the walls that enclose the points of --reachable-from".to_owned(),
            None => format!("the view box, {lo:?} to {hi:?}"),
        };
        return Err(format!("the eye {:?} is outside of {of}; give one inside", view.eye));
    };
    match pvs.is_reached(cell).map_err(|e| e.to_string())? {
        true => Ok(cell),
        false => Err(format!("no viewpoint can be in cell {cell}; the bake left it out")),
    }
}
