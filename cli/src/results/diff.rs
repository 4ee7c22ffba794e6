//! `sightline diff`: compares the sets of two results of the same cells.
//!
//! Sampled sets differ from run to run. The bounds of `--max-error` separate this noise from changes: items
//! of only the newer set are a change if they have a larger share of the view than the older result may miss,
//! and vice versa. Undecided items are not a change.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};
use sightline::output::{Format, Output};
use sightline::words::plural;
use sightline::{CellIndex, Error};
use sightline::{NamedResult, open};
use sightline_pvs::{Granularity, Pvs, PvsError, runs};

use crate::args::results::DiffArgs;
use crate::results::diff_page::{self, CellChange};
use crate::results::info_cells;
use crate::scenes::read::scene_of;
use crate::terminal::printable;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Maximum number of listed cells and objects.
const LISTED: usize = 10;

/// The change of one cell.
struct Change {
    cell: CellIndex,
    /// The items that only the newer set contains (`came`), and the items that only the older set contains
    /// (`went`).
    came: Runs,
    went: Runs,
    /// The number of these items that are undecided in the result whose set contains them.
    undecided: usize,
    /// The fraction of the union of both sets that only one set contains.
    fraction: f64,
    /// The shares of the view of items of only the newer and of only the older set, if both results have
    /// contributions.
    shares: Option<[f64; 2]>,
    /// True if the change is larger than sampling noise can explain. `None` if a result lacks contributions,
    /// or a sampled result lacks a bound on missed items.
    is_beyond_noise: Option<bool>,
}

/// Ascending items, stored as the boundaries of their runs, because a few bytes of a result can represent
/// millions of items.
#[derive(Default)]
struct Runs(Vec<u32>);

impl Runs {
    /// Returns the number of items.
    fn count(&self) -> usize {
        self.0
            .chunks_exact(2)
            .map(|run| (run[1] - run[0]) as usize)
            .sum()
    }

    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the items of `self` that `other` does not have.
    fn without(&self, other: &Self) -> Self {
        let [left] = runs::sweep([&self.0, &other.0], |m| u32::from(m == 1));
        Self(left)
    }

    /// Returns the items that both `self` and `other` contain.
    fn common(&self, other: &Self) -> Self {
        let [both] = runs::sweep([&self.0, &other.0], |m| u32::from(m == 3));
        Self(both)
    }

    fn has(&self, item: u32) -> bool {
        self.0.partition_point(|bound| *bound <= item) % 2 == 1
    }
}

/// The comparison of the items of two results.
enum ComparedItems {
    /// Triangles are compared by number: both results are of one scene, or of scenes with the same objects.
    Triangles,
    /// Objects are compared by name. For each object of the older and of the newer result, `of` contains the
    /// number of its name.
    Objects {
        names: Vec<String>,
        numbers: [Vec<u32>; 2],
    },
}

/// Compares two results.
pub fn run(args: &DiffArgs, json: bool) -> Result<(), Error> {
    let output = args
        .output
        .as_ref()
        .map(|path| Output::check(path, Format::Html, Some(&args.newer)));
    let output = output.transpose()?;
    let results = [open(&args.older)?, open(&args.newer)?];
    let [older, newer] = &results;
    same_cells(args, older, newer)?;
    let items = items(args, older, newer)?;
    let changes = changes(&results, &items)?;
    let reached = changes.len();
    let mean = |quantity: &dyn Fn(&Change) -> f64| {
        changes.iter().map(quantity).sum::<f64>() / reached.max(1) as f64
    };
    let fraction = mean(&|c| c.fraction);
    let has_shares = changes.iter().all(|c| c.shares.is_some()) && reached > 0;
    let share = has_shares.then(|| mean(&|c| c.shares.map_or(0.0, |[came, went]| came + went)));
    let changed: Vec<&Change> = changes
        .iter()
        .filter(|c| !c.came.is_empty() || !c.went.is_empty())
        .collect();
    let mut worst = changed.clone();
    let weight = |c: &Change| c.shares.map_or(c.fraction, |[came, went]| came + went);
    worst.sort_by(|a, b| weight(b).total_cmp(&weight(a)).then(a.cell.cmp(&b.cell)));
    let beyond = changes
        .iter()
        .filter(|c| c.is_beyond_noise == Some(true))
        .count();
    let is_bounded = changes.iter().any(|c| c.is_beyond_noise.is_some());
    let objects = objects(&results, &items, &changed);
    let total = |count: &dyn Fn(&Change) -> usize| changed.iter().map(|c| count(c)).sum::<usize>();
    let (came, went) = (total(&|c| c.came.count()), total(&|c| c.went.count()));
    let what = match &items {
        ComparedItems::Triangles => "triangles",
        ComparedItems::Objects { .. } => "objects",
    };
    if let Some(output) = &output {
        let scene = args
            .scene
            .as_ref()
            .map(|path| scene_of(path, &args.kinds, NamedResult::new(newer, &args.newer)));
        let to_cell_change = |c: &&Change| CellChange {
            cell: c.cell,
            came: c.came.count(),
            went: c.went.count(),
        };
        let cells: Vec<CellChange> = changed.iter().map(to_cell_change).collect();
        let about = format!(
            "{} of {} changed: {came} {what} gained and {went} lost",
            changed.len(),
            plural(reached, "cell")
        );
        let scene = scene.transpose()?;
        diff_page::write(
            output,
            [&args.older, &args.newer],
            newer,
            scene.as_deref(),
            &cells,
            &about,
        )?;
        say(&format!("wrote {}", output.path().display()));
    }
    if json {
        let of_cell = |c: &&Change| {
            json!({
                "cell": c.cell, "came": c.came.count(), "went": c.went.count(), "undecided": c.undecided,
                "fraction": c.fraction, "came_share": c.shares.map(|s| s[0]),
                "went_share": c.shares.map(|s| s[1]), "beyond_noise": c.is_beyond_noise,
            })
        };
        let of_object = |(name, [came, went]): &(String, [usize; 2])| {
            let mut value = json!({"object": name});
            (value["came_in_cells"], value["went_in_cells"]) = ((*came).into(), (*went).into());
            value
        };
        print(
            &json!({
                "items": what, "cells": reached, "changed_cells": changed.len(), "came": came, "went": went,
                "changed_fraction": fraction, "changed_share": share,
                "cells_beyond_noise": is_bounded.then_some(beyond),
                "worst": worst.iter().take(LISTED).map(of_cell).collect::<Vec<Value>>(),
                "objects": objects.iter().take(LISTED).map(of_object).collect::<Vec<Value>>(),
            })
            .to_string(),
        )?;
    } else {
        let mut out = String::new();
        let mut line = |text: String| {
            out.push_str(&text);
            out.push('\n');
        };
        let bold = if args.markdown { "**" } else { "" };
        line(format!(
            "{bold}{} of {} changed{bold}: {came} {what} gained and {went} lost, {:.3} % of the sets on \
             average{}",
            changed.len(),
            plural(reached, "cell"),
            100.0 * fraction,
            share.map_or(String::new(), |s| format!(
                ", {:.3} % of the view",
                100.0 * s
            )),
        ));
        let is_other =
            matches!(items, ComparedItems::Triangles) && older.granularity() != newer.granularity();
        line(match is_bounded {
            true => format!("changed by more than sampling may miss: {}", plural(beyond, "cell")),
            false if misses_nothing(older) && misses_nothing(newer) => {
                "both results miss nothing: each gained or lost item that is not undecided is a \
                 change".to_owned()
            }
            false if is_other => format!(
                "the sets of the older result contain {}, and the sets of the newer result {}: triangles \
                 of a partly visible item may differ without a change; bake both results with the same \
                 --granularity",
                older.granularity().name(),
                newer.granularity().name()
            ),
            false => {
                "sampling alone may explain the differences: to separate noise from changes, bake both \
                 results with --max-error and --contributions, or with --method exact"
                    .to_owned()
            }
        });
        table(
            &mut out,
            args.markdown,
            ["cell", "gained", "lost", "undecided", "of the sets"],
            &mut worst.iter().map(|c| {
                [
                    c.cell.to_string(),
                    c.came.count().to_string(),
                    c.went.count().to_string(),
                    c.undecided.to_string(),
                    format!("{:.2} %", 100.0 * c.fraction),
                ]
            }),
        );
        table(
            &mut out,
            args.markdown,
            ["object", "gained in cells", "lost in cells"],
            &mut objects.iter().map(|(name, [came, went])| {
                [
                    printable::name(name).into_owned(),
                    came.to_string(),
                    went.to_string(),
                ]
            }),
        );
        print(out.trim_end())?;
    }
    match args.fail_above {
        Some(most) if fraction > most => Err(Error::different(format!(
            "the changed fraction of the sets is {:.6} on average over the cells, more than --fail-above \
             {most}",
            fraction
        ))),
        _ => Ok(()),
    }
}

/// Returns an error if the cells of the two results differ.
fn same_cells(args: &DiffArgs, older: &Pvs, newer: &Pvs) -> Result<(), Error> {
    let is_same = older.cells() == newer.cells()
        && (0..older.cells()).all(|cell| older.cell_bounds(cell) == newer.cell_bounds(cell));
    if is_same {
        return Ok(());
    }
    Err(Error::input(format!(
        "{} and {} have different cells; bake both with the same --cells and the same --view-box",
        args.older.display(),
        args.newer.display()
    )))
}

/// Returns the comparison for the items of both results.
fn items(args: &DiffArgs, older: &Pvs, newer: &Pvs) -> Result<ComparedItems, Error> {
    let ranges = |pvs: &Pvs| -> Vec<(String, u32, u32)> {
        pvs.objects()
            .iter()
            .map(|o| (o.name.clone(), o.first, o.count))
            .collect()
    };
    if !args.objects && ranges(older) == ranges(newer) {
        return Ok(ComparedItems::Triangles);
    }
    let numbered = |pvs: &Pvs| -> Result<BTreeSet<String>, Error> {
        let names: BTreeSet<String> = pvs.objects().iter().map(|o| o.name.clone()).collect();
        if names.len() == pvs.objects().len() {
            return Ok(names);
        }
        Err(Error::input(
            "the scenes of both results differ, and several objects have one name; name each object, so that \
             objects can be compared by name"
                .to_owned(),
        ))
    };
    let names: Vec<String> = numbered(older)?.union(&numbered(newer)?).cloned().collect();
    let numbers = [older, newer].map(|pvs| {
        let number =
            |o: &sightline_pvs::Object| names.binary_search(&o.name).map_or(0, |n| n as u32);
        pvs.objects().iter().map(number).collect()
    });
    Ok(ComparedItems::Objects { names, numbers })
}

/// Returns the changes of all cells with viewpoints in either result, in the order of the cells.
fn changes(results: &[Pvs; 2], items: &ComparedItems) -> Result<Vec<Change>, Error> {
    let bounds = [
        info_cells::bounds_of_cells(&results[0])?,
        info_cells::bounds_of_cells(&results[1])?,
    ];
    let mut all = Vec::new();
    for cell in (0..results[0].cells()).map(CellIndex) {
        if !results[0].is_reached(cell.0)? && !results[1].is_reached(cell.0)? {
            continue;
        }
        let [a, older_open] = set(&results[0], items, 0, cell)?;
        let [b, newer_open] = set(&results[1], items, 1, cell)?;
        let (went, came) = (a.without(&b), b.without(&a));
        let undecided = went.common(&older_open).count() + came.common(&newer_open).count();
        let union = a.count() + came.count();
        let both = |came: &Runs, went: &Runs| -> Result<Option<[f64; 2]>, Error> {
            let came = share(&results[1], items, cell, came)?;
            Ok(came
                .zip(share(&results[0], items, cell, went)?)
                .map(|(came, went)| [came, went]))
        };
        let shares = both(&came, &went)?;
        // Undecided items may be visible or not, so they are not a certain change.
        let certain = both(&came.without(&newer_open), &went.without(&older_open))?;
        // The older result may have missed items of the newer set, and vice versa.
        let may_miss = [0, 1].map(|k| {
            if misses_nothing(&results[k]) {
                Some(0.0)
            } else {
                bounds[k][cell.at()]
            }
        });
        let is_beyond_noise = match (certain, may_miss) {
            (Some([came, went]), [Some(older), Some(newer)]) => Some(came > older || went > newer),
            _ => None,
        };
        let fraction = (came.count() + went.count()) as f64 / union.max(1) as f64;
        all.push(Change {
            cell,
            came,
            went,
            undecided,
            fraction,
            shares,
            is_beyond_noise,
        });
    }
    Ok(all)
}

/// Returns true if the sets contain every visible item, because the method is not aggressive and the sets
/// contain undecided items.
fn misses_nothing(pvs: &Pvs) -> bool {
    pvs.method() != "aggressive"
}

/// Returns the set of a cell and its undecided part, as items with the same numbers in both results.
fn set(
    pvs: &Pvs,
    items: &ComparedItems,
    result: usize,
    cell: CellIndex,
) -> Result<[Runs; 2], PvsError> {
    match items {
        ComparedItems::Triangles => Ok([
            Runs(pvs.visible_bounds(cell.0)?),
            Runs(pvs.undecided_bounds(cell.0)?),
        ]),
        ComparedItems::Objects { numbers: of, .. } => {
            let (mut visible, mut undecided) = (Vec::new(), Vec::new());
            pvs.visible_objects(cell.0, &mut visible)?;
            pvs.undecided_objects(cell.0, &mut undecided)?;
            Ok([visible, undecided].map(|mut ids| {
                ids.iter_mut().for_each(|id| *id = of[result][*id as usize]);
                ids.sort_unstable();
                Runs(runs::from_ids(&ids))
            }))
        }
    }
}

/// Returns a lower bound on the share of the view, 0 to 1, that the items in `runs` cover together, as the
/// mean over the cell's viewpoints. Returns `None` if the result has no contributions of such items.
fn share(
    pvs: &Pvs,
    items: &ComparedItems,
    cell: CellIndex,
    runs: &Runs,
) -> Result<Option<f64>, Error> {
    let is_one = matches!(
        (items, pvs.granularity()),
        (ComparedItems::Triangles, Granularity::Triangles)
    );
    let Some(all) = pvs.contributions(cell.0)?.filter(|_| is_one) else {
        return Ok(None);
    };
    let mut ids = Vec::new();
    pvs.visible_items(cell.0, &mut ids)?;
    // Contributions have a byte for each visible item, so these ids need no more memory.
    let shares = ids
        .iter()
        .zip(&all)
        .filter(|(id, _)| runs.has(**id))
        .map(|(_, c)| c.mean()[0]);
    Ok(Some(shares.sum()))
}

/// Returns for each changed object two numbers of cells: the cells with a part of the object only in the
/// newer set, and the cells with a part of the object only in the older set. Objects with the most cells come
/// first.
fn objects(
    results: &[Pvs; 2],
    items: &ComparedItems,
    changed: &[&Change],
) -> Vec<(String, [usize; 2])> {
    let named = |result: usize, runs: &Runs| -> BTreeSet<String> {
        let each = runs.0.chunks_exact(2);
        match items {
            ComparedItems::Objects { names, .. } => each
                .flat_map(|run| run[0]..run[1])
                .map(|id| names[id as usize].clone())
                .collect(),
            ComparedItems::Triangles => {
                let objects = results[result].objects();
                let touched = |run: &[u32]| {
                    let first = objects.partition_point(|o| o.first + o.count <= run[0]);
                    let end = objects.partition_point(|o| o.first < run[1]);
                    objects[first..end.max(first)].iter()
                };
                each.flat_map(touched)
                    .filter(|o| o.count > 0)
                    .map(|o| o.name.clone())
                    .collect()
            }
        }
    };
    let mut counts: BTreeMap<String, [usize; 2]> = BTreeMap::new();
    for change in changed {
        for (k, (result, runs)) in [(1, &change.came), (0, &change.went)]
            .into_iter()
            .enumerate()
        {
            named(result, runs)
                .into_iter()
                .for_each(|name| counts.entry(name).or_default()[k] += 1);
        }
    }
    let mut all: Vec<(String, [usize; 2])> = counts.into_iter().collect();
    all.sort_by_key(|(name, [came, went])| (std::cmp::Reverse(came + went), name.clone()));
    all
}

/// Appends a table of the first [`LISTED`] rows to `out`, as Markdown or as aligned text.
fn table<const N: usize>(
    out: &mut String,
    markdown: bool,
    head: [&str; N],
    rows: &mut dyn Iterator<Item = [String; N]>,
) {
    let rows: Vec<[String; N]> = rows.take(LISTED).collect();
    if rows.is_empty() {
        return;
    }
    out.push('\n');
    if markdown {
        let row = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        out.push_str(&row(&head.map(str::to_owned)));
        out.push_str(&row(&head.map(|_| "--".to_owned())));
        // A bar in a name would end the column.
        rows.iter()
            .for_each(|cells| out.push_str(&row(&cells.clone().map(|c| c.replace('|', "\\|")))));
        return;
    }
    let width = |k: usize| {
        rows.iter()
            .map(|r| r[k].chars().count())
            .chain([head[k].len()])
            .max()
            .unwrap_or(0)
    };
    let widths: [usize; N] = std::array::from_fn(width);
    let mut line = |cells: [&str; N]| {
        let padded: Vec<String> = cells
            .iter()
            .zip(widths)
            .map(|(c, w)| format!("{c:<w$}"))
            .collect();
        out.push_str(padded.join("  ").trim_end());
        out.push('\n');
    };
    line(head);
    rows.iter()
        .for_each(|row| line(std::array::from_fn(|k| row[k].as_str())));
}
