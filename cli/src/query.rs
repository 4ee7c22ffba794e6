//! `sightline query`: the set of the cell that contains a point, or whether the cell sees a place.

use std::io::Write as _;

use serde::Serialize;
use serde_json::{Value, json};
use sightline_pvs::{Granularity, Pvs, PvsError};
use sightline_scene::Scene;

use crate::args::{Items, QueryArgs};
use crate::dump::{Ids, corners, sets};
use crate::enclosure::of_result;
use crate::error::CliError;
use crate::opening::{open, plural, scene_of};
use crate::printable;
use crate::progress::say;
use crate::serve::{print, print_json, print_with};
use crate::why::{self, Question};

/// Answers a query.
pub fn query(args: &QueryArgs, json: bool) -> Result<(), CliError> {
    let pvs = open(&args.result.result)?;
    let (cell, target) = match (args.point.is_empty(), args.cell) {
        (true, Some(cell)) if args.sees.is_empty() && args.to_box.is_none() => (cell, None),
        (true, _) => {
            return Err(CliError::Usage(
                "give the viewpoint as three numbers X Y Z, or --cell alone".to_owned(),
            ));
        }
        (false, to) => {
            let cell = cell_of(&pvs, args, &args.point)?;
            (cell, target(&pvs, args, to)?)
        }
    };
    if cell >= pvs.cells() {
        return Err(PvsError::NoCell {
            cell,
            cells: pvs.cells(),
        }
        .into());
    }
    if !pvs.is_reached(cell)? {
        return Err(CliError::Input(format!(
            "no viewpoint can be in cell {cell}: the bake left it out (--view-box, --view-mesh, \
             --viewpoints, --reachable-from); choose another point, or bake with more viewpoints"
        )));
    }
    let scene = match &args.scene {
        None => None,
        Some(_) if args.why.is_none() && pvs.region().is_none() => {
            return Err(CliError::Usage(
                "--scene is for --why, and to check a point in a result whose viewpoints walls enclose; \
                 leave it out"
                    .to_owned(),
            ));
        }
        Some(path) => Some(scene_of(path, &args.kinds, &pvs, &args.result.result)?),
    };
    check_region(&pvs, args, scene.as_ref())?;
    if let Some(target) = target {
        return sees(&pvs, cell, &target, json);
    }
    if let Some(what) = &args.why {
        let [min, max] = pvs.cell_bounds(cell).unwrap_or_default();
        let middle = std::array::from_fn(|axis| f32::midpoint(min[axis], max[axis]));
        let question = Question {
            pvs: &pvs,
            result: &args.result.result,
            cell,
            what,
            scene,
            eye: args.point.as_slice().try_into().unwrap_or(middle),
            picture: args.picture.as_deref(),
        };
        return why::why(&question, json);
    }
    set(&pvs, cell, args, json)
}

/// Refuses a point outside the region that holds all viewpoints, or says that it was not checked.
fn check_region(pvs: &Pvs, args: &QueryArgs, scene: Option<&Scene>) -> Result<(), CliError> {
    let (Some(_), Ok(point)) = (pvs.region(), <[f32; 3]>::try_from(args.point.as_slice())) else {
        return Ok(());
    };
    let result = &args.result.result;
    let Some(scene) = scene else {
        say(
            "note: the sets hold for viewpoints that walls enclose (--reachable-from); with --scene SCENE it \
             is checked whether this is one",
        );
        return Ok(());
    };
    match of_result(pvs, scene, result)?.is_none_or(|region| region.holds(point.into())) {
        true => Ok(()),
        false => Err(CliError::Input(format!(
            "no viewpoint can be at {point:?}: it is outside the walls around the points of \
             --reachable-from; choose another point, or bake without --reachable-from"
        ))),
    }
}

/// The cell of a point.
fn cell_of(pvs: &Pvs, args: &QueryArgs, point: &[f32]) -> Result<u32, CliError> {
    let point: [f32; 3] = point
        .try_into()
        .map_err(|_| CliError::Usage("give a point as three numbers X Y Z".to_owned()))?;
    pvs.find_cell(point).ok_or_else(|| {
        let [min, max] = pvs.tree().view_box();
        CliError::Input(format!(
            "{point:?} is outside the view box of {} ({min:?} to {max:?}); choose a point inside, or bake \
             with a larger --view-box",
            args.result.result.display()
        ))
    })
}

/// What a cell may see.
enum Target {
    Cell(u32),
    Box([f32; 3], [f32; 3]),
}

fn target(pvs: &Pvs, args: &QueryArgs, to: Option<u32>) -> Result<Option<Target>, CliError> {
    Ok(match (args.sees.is_empty(), args.to_box, to) {
        (false, ..) => Some(Target::Cell(cell_of(pvs, args, &args.sees)?)),
        (true, Some(b), _) => Some(Target::Box(b.min.to_array(), b.max.to_array())),
        (true, None, Some(cell)) if cell < pvs.cells() => Some(Target::Cell(cell)),
        (true, None, Some(cell)) => {
            return Err(PvsError::NoCell {
                cell,
                cells: pvs.cells(),
            }
            .into());
        }
        (true, None, None) => None,
    })
}

/// Prints whether a cell sees a cell or a box.
fn sees(pvs: &Pvs, cell: u32, target: &Target, json: bool) -> Result<(), CliError> {
    let (seen, mut answer, words): (bool, Value, String) = match target {
        Target::Cell(to) => {
            let pairs = pvs.cell_pairs()?.ok_or(PvsError::NoPairs)?;
            let open = pairs.undecided.as_ref().is_some_and(|u| u.has(cell, *to));
            let seen = pvs.sees(cell, *to)?;
            let state = match (seen, open, pvs.method()) {
                (_, true, _) => "undecided",
                (true, false, _) => "visible",
                (false, false, "aggressive") => "not seen",
                (false, false, _) => "hidden",
            };
            (
                seen,
                json!({"to_cell": to, "state": state}),
                format!("cell {to} ({state})"),
            )
        }
        Target::Box(min, max) => {
            let seen = pvs.sees_box(cell, *min, *max)?;
            (
                seen,
                json!({"box": {"min": min, "max": max}}),
                format!("the box {min:?} to {max:?}"),
            )
        }
    };
    answer["cell"] = cell.into();
    answer["sees"] = seen.into();
    if json {
        return print(&answer.to_string());
    }
    print(&format!(
        "cell {cell} {} {words}",
        if seen { "sees" } else { "does not see" }
    ))
}

/// Prints the set of a cell.
fn set(pvs: &Pvs, cell: u32, args: &QueryArgs, json: bool) -> Result<(), CliError> {
    if args.items == Items::Clusters && pvs.granularity() != Granularity::Clusters {
        return Err(CliError::Input(
            "the sets name no clusters; bake with --granularity clusters".to_owned(),
        ));
    }
    let [visible, undecided] = sets(pvs, cell, args.items)?;
    let set_aside = pvs.is_set_aside(cell)?;
    if json {
        let [min, max] = corners(pvs, cell);
        let items = args.items.name();
        return print_json(&Answer {
            cell,
            min,
            max,
            items,
            visible,
            undecided,
            set_aside,
        });
    }
    let [min, max] = pvs.cell_bounds(cell).unwrap_or_default();
    let aside = if set_aside {
        "; SET ASIDE: this cell failed, everything is shown"
    } else {
        ""
    };
    let what = args.items.name().trim_end_matches('s');
    print_with(|out| {
        writeln!(
            out,
            "cell {cell}, {min:?} to {max:?}: {} {}{}{aside}",
            plural(visible.count(), what),
            if args.items == Items::Cells {
                "that it sees"
            } else {
                "to draw"
            },
            match undecided.count() {
                0 => String::new(),
                n => format!(": {} visible, {n} undecided", visible.count() - n),
            },
        )?;
        for (k, id) in visible.iter().enumerate() {
            match args.items {
                Items::Objects if k > 0 => writeln!(out)?,
                _ if k > 0 => write!(out, " ")?,
                _ => {}
            }
            match args.items {
                Items::Objects => write!(
                    out,
                    "{id} {}",
                    printable::name(&pvs.objects()[id as usize].name)
                )?,
                _ => write!(out, "{id}")?,
            }
        }
        writeln!(out)
    })
}

/// The set of a cell as JSON.
#[derive(Serialize)]
struct Answer {
    cell: u32,
    min: [f64; 3],
    max: [f64; 3],
    items: &'static str,
    visible: Ids,
    undecided: Ids,
    set_aside: bool,
}
