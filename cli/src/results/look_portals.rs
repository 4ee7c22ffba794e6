//! `sightline look OUT.pvs`: prints the triangles that are visible through portals from viewpoints, with one
//! JSON line per viewpoint in input and output.

use std::time::Instant;

use serde::Deserialize;
use serde_json::{Value, json};
use sightline::Error;
use sightline::open;
use sightline_pvs::{LookError, Looker, Pvs, View};

use crate::args::tetra::LookArgs;
use crate::results::look_lines::{self, LookReport};
use crate::terminal::json_lines::JsonLines;
use crate::terminal::printable;
use crate::terminal::stderr::say;

/// The resolution of the median share: the number of steps from 0 to 1.
const SHARES: f64 = 1e5;

/// One line of the input.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PortalInput {
    #[serde(default)]
    id: Value,
    eye: [f64; 3],
    dir: [f64; 3],
    up: [f64; 3],
    fov: [f64; 2],
    #[serde(default)]
    shut: Vec<String>,
}

/// Answers every view of a file, in order.
pub fn run(args: &LookArgs) -> Result<(), Error> {
    if let Some(option) = args.of_tets() {
        return Err(Error::usage(format!(
            "{option} needs a .tets file, but {} is a result; create a .tets file with `sightline \
             tetra`",
            args.file.display()
        )));
    }
    let pvs = open(&args.file)?;
    let mut looker = Looker::new(&pvs)?.ok_or_else(|| {
        Error::input(format!(
            "{} has no portals (method {}); {}",
            args.file.display(),
            pvs.method(),
            match (pvs.method(), pvs.region()) {
                ("portals", _) | ("exact" | "verified", Some(_)) =>
                    "the tile with the portals was set aside; run the same bake again",
                _ => "bake the scene with --method portals, or with --method exact and --reachable-from \
                 at points that walls enclose",
            }
        ))
    })?;
    let doors = looker.doors();
    let example =
        r#"{"id":1,"eye":[x,y,z],"dir":[x,y,z],"up":[x,y,z],"fov":[90,60],"shut":["door"]}"#;
    let mut input = JsonLines::open(&args.points, "--points", example)?;
    let check = |line: PortalInput| {
        let number = |name: &String| {
            doors.binary_search(name).map_err(|_| match doors {
                [] => format!("there is no door {name:?}: the result has no doors; omit \"shut\""),
                _ => {
                    format!(
                        "there is no door {name:?}; the doors are {}",
                        printable::name(&doors.join(", "))
                    )
                }
            })
        };
        let shut: Vec<usize> = line.shut.iter().map(number).collect::<Result<_, _>>()?;
        Ok((line, shut))
    };
    let mut answer = |(line, shut): (PortalInput, Vec<usize>)| {
        (0..doors.len()).for_each(|door| looker.shut(door, shut.contains(&door)));
        let view = View {
            eye: line.eye,
            direction: line.dir,
            up: line.up,
            fov: line.fov,
        };
        let start = Instant::now();
        let cell = looker.look(&view);
        let nanos = start.elapsed().as_nanos() as u64;
        let cell = seen_from(&pvs, &view, cell)?;
        let share = looker.visible().len() as f64 / looker.of_cell().max(1) as f64;
        let micros = nanos as f64 / 1e3;
        let line =
            json!({"id": line.id, "cell": cell, "visible": looker.visible(), "micros": micros});
        Ok(LookReport {
            line,
            nanos,
            count: (share * SHARES).round() as u64,
        })
    };
    let answers = |queries: Vec<(PortalInput, Vec<usize>)>| {
        let mut all = Vec::with_capacity(queries.len());
        for query in queries {
            let answer = answer(query);
            let failed = answer.is_err();
            all.push(answer);
            if failed {
                break;
            }
        }
        all
    };
    let (ended, medians) = look_lines::answer(&mut input, check, answers, "views");
    if let (Some(nanos), Some(share)) = (medians.nanos.get(), medians.count.get()) {
        say(&format!(
            "{} views; medians per view: {:.1} µs, and {:.1} % of the cell's set",
            medians.answers,
            nanos as f64 / 1e3,
            share as f64 / SHARES * 100.0
        ));
    }
    ended
}

/// Returns the number of the cell that contains the eye, or the reason why no cell with viewpoints contains
/// the eye.
fn seen_from(pvs: &Pvs, view: &View, cell: Result<Option<u32>, LookError>) -> Result<u32, String> {
    let [lo, hi] = pvs.tree().view_box();
    let Some(cell) = cell.map_err(|e| e.to_string())? else {
        let region = match pvs.find_cell_precisely(view.eye) {
            Some(_) => "the walls that enclose the points of --reachable-from".to_owned(),
            None => format!("the view box, {lo:?} to {hi:?}"),
        };
        return Err(format!(
            "the eye {:?} is outside of {region}; give an eye inside",
            view.eye
        ));
    };
    match pvs.is_reached(cell).map_err(|e| e.to_string())? {
        true => Ok(cell),
        false => Err(format!(
            "no viewpoint can be in cell {cell} of the eye, so the bake skipped the cell; choose another \
             eye"
        )),
    }
}
