//! `sightline query`: prints the set of the cell that contains a point, or decides if the cell sees a target.

use std::io::Write as _;

use serde::Serialize;
use serde_json::{Value, json};
use sightline::NamedResult;
use sightline::open;
use sightline::viewpoints::region_of_result;
use sightline::words::plural;
use sightline::{CellIndex, Error};
use sightline_pvs::{Granularity, Pvs, PvsError};
use sightline_scene::Scene;

use crate::args::cli::{Items, QueryArgs};
use crate::results::dump::{Ids, corners, sets};
use crate::results::query_why::{self, Question};
use crate::scenes::read::scene_of;
use crate::terminal::printable;
use crate::terminal::stderr::say;
use crate::terminal::stdout::{print, print_json, print_with};

/// Prints the answer to the query in the arguments.
pub fn run(args: &QueryArgs, json: bool) -> Result<(), Error> {
    let pvs = open(&args.result.result)?;
    let (cell, target) = match (args.point.is_empty(), args.cell) {
        (true, Some(cell)) if args.sees.is_empty() && args.to_box.is_none() => {
            (CellIndex(cell), None)
        }
        (true, _) => {
            return Err(Error::usage(
                "give the viewpoint as three numbers X Y Z, or give only --cell without a \
                 viewpoint"
                    .to_owned(),
            ));
        }
        (false, to) => {
            let cell = cell_of(&pvs, args, &args.point)?;
            (cell, target(&pvs, args, to)?)
        }
    };
    if cell.0 >= pvs.cells() {
        return Err(PvsError::NoCell {
            cell: cell.0,
            cells: pvs.cells(),
        }
        .into());
    }
    if !pvs.is_reached(cell.0)? {
        return Err(Error::input(format!(
            "no viewpoint can be in cell {cell}: the bake skipped it (--view-box, --view-mesh, \
             --viewpoints, --reachable-from); choose another point, or bake with more viewpoints"
        )));
    }
    let scene = match &args.scene {
        None => None,
        Some(_) if args.why.is_none() && pvs.region().is_none() => {
            return Err(Error::usage(
                "--scene applies only to --why, and to results of --reachable-from whose viewpoints \
                 are enclosed by walls; omit --scene"
                    .to_owned(),
            ));
        }
        Some(path) => Some(scene_of(
            path,
            &args.kinds,
            NamedResult::new(&pvs, &args.result.result),
        )?),
    };
    check_region(&pvs, args, scene.as_deref())?;
    if let Some(target) = target {
        return sees(&pvs, cell, &target, json);
    }
    if let Some(what) = &args.why {
        let [min, max] = pvs.cell_bounds(cell.0).unwrap_or_default();
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
        return query_why::why(&question, json);
    }
    set(&pvs, cell, args, json)
}

/// Checks that a point is in the region of all viewpoints. Without a scene, prints a note that the point was
/// not checked.
fn check_region(pvs: &Pvs, args: &QueryArgs, scene: Option<&Scene>) -> Result<(), Error> {
    let (Some(_), Ok(point)) = (pvs.region(), <[f32; 3]>::try_from(args.point.as_slice())) else {
        return Ok(());
    };
    let result = &args.result.result;
    let Some(scene) = scene else {
        say(
            "note: the sets are valid for viewpoints that walls enclose (--reachable-from); give \
             --scene SCENE to check this viewpoint",
        );
        return Ok(());
    };
    let region = region_of_result(NamedResult::new(pvs, result), scene)?;
    match region.is_none_or(|region| region.holds(point.into())) {
        true => Ok(()),
        false => Err(Error::input(format!(
            "no viewpoint can be at {point:?}: it is outside the walls around the points of \
             --reachable-from; choose another point, or bake without --reachable-from"
        ))),
    }
}

/// Returns the cell of a point.
fn cell_of(pvs: &Pvs, args: &QueryArgs, point: &[f32]) -> Result<CellIndex, Error> {
    let point: [f32; 3] = point
        .try_into()
        .map_err(|_| Error::usage("give a point as three numbers X Y Z".to_owned()))?;
    if !point.iter().all(|c| c.is_finite()) {
        return Err(Error::input(format!(
            "{point:?} is not a point; give three finite numbers"
        )));
    }
    pvs.find_cell(point).map(CellIndex).ok_or_else(|| {
        let [min, max] = pvs.tree().view_box();
        Error::input(format!(
            "{point:?} is outside the view box of {} ({min:?} to {max:?}); choose a point inside, or bake \
             with a larger --view-box",
            args.result.result.display()
        ))
    })
}

/// The target of a visibility query from a cell: another cell, or a box.
enum Target {
    Cell(CellIndex),
    Box([f32; 3], [f32; 3]),
}

fn target(pvs: &Pvs, args: &QueryArgs, to: Option<u32>) -> Result<Option<Target>, Error> {
    Ok(match (args.sees.is_empty(), args.to_box, to) {
        (false, ..) => Some(Target::Cell(cell_of(pvs, args, &args.sees)?)),
        (true, Some(b), _) => Some(Target::Box(b.min.to_array(), b.max.to_array())),
        (true, None, Some(cell)) if cell < pvs.cells() => Some(Target::Cell(CellIndex(cell))),
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

/// Prints the visibility of a cell or a box from a cell.
fn sees(pvs: &Pvs, cell: CellIndex, target: &Target, json: bool) -> Result<(), Error> {
    let (seen, mut answer, words): (bool, Value, String) = match target {
        Target::Cell(to) => {
            let pairs = pvs.cell_pairs()?.ok_or(PvsError::NoPairs)?;
            let open = pairs
                .undecided
                .as_ref()
                .is_some_and(|u| u.has(cell.0, to.0));
            let seen = pvs.sees(cell.0, to.0)?;
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
            let seen = pvs.sees_box(cell.0, *min, *max)?;
            (
                seen,
                json!({"box": {"min": min, "max": max}}),
                format!("the box {min:?} to {max:?}"),
            )
        }
    };
    answer["cell"] = cell.0.into();
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
fn set(pvs: &Pvs, cell: CellIndex, args: &QueryArgs, json: bool) -> Result<(), Error> {
    if args.items == Items::Clusters && pvs.granularity() != Granularity::Clusters {
        return Err(Error::input(
            "the sets of the result contain no clusters; bake with --granularity clusters"
                .to_owned(),
        ));
    }
    let [visible, undecided] = sets(pvs, cell, args.items)?;
    let set_aside = pvs.is_set_aside(cell.0)?;
    if json {
        let [min, max] = corners(pvs, cell);
        let items = args.items.name();
        return print_json(&CellAnswer {
            cell,
            min,
            max,
            items,
            visible,
            undecided,
            set_aside,
        });
    }
    let [min, max] = pvs.cell_bounds(cell.0).unwrap_or_default();
    let aside = if set_aside {
        "; SET ASIDE: the tile of this cell failed, so the set contains every triangle"
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

/// The set of a cell, for JSON.
#[derive(Serialize)]
struct CellAnswer {
    cell: CellIndex,
    min: [f64; 3],
    max: [f64; 3],
    items: &'static str,
    visible: Ids,
    undecided: Ids,
    set_aside: bool,
}
