//! `sightline diff`: what came into the sets of a result and what went, against another result of the same
//! cells.
//!
//! Sampled sets differ from run to run. A change is told from that by the bounds of `--max-error`: items that
//! came and take more of the view than the older result may miss are a change, and so for those that went.
//! Undecided items are none.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};
use sightline::Error;
use sightline::output::{Format, Output};
use sightline::words::plural;
use sightline::{NamedResult, open};
use sightline_pvs::{Granularity, Pvs, PvsError, runs};

use crate::args::results::DiffArgs;
use crate::results::diff_page::{self, CellChange};
use crate::results::info_cells;
use crate::scenes::read::scene_of;
use crate::terminal::printable;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Cells and objects that are listed.
const LISTED: usize = 10;

/// The change of one cell.
struct Change {
    cell: u32,
    /// Items of only the newer set and of only the older one.
    came: Runs,
    went: Runs,
    /// Those of them that the result which has them calls undecided.
    undecided: usize,
    /// The part of both sets' union that came or went.
    fraction: f64,
    /// The share of the view that came and that went, where both results have contributions.
    shares: Option<[f64; 2]>,
    /// Whether sampling alone cannot explain it; `None` where nothing bounds what sampling misses.
    is_beyond_noise: Option<bool>,
}

/// Ascending items as the boundaries of their runs: a few bytes of a result can stand for millions of items.
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

    /// Returns the items of both.
    fn common(&self, other: &Self) -> Self {
        let [both] = runs::sweep([&self.0, &other.0], |m| u32::from(m == 3));
        Self(both)
    }

    fn has(&self, item: u32) -> bool {
        self.0.partition_point(|bound| *bound <= item) % 2 == 1
    }
}

/// How the items of two results are compared.
enum ComparedItems {
    /// Triangles by number: both results are of one scene, or of scenes with the same objects.
    Triangles,
    /// Objects by name: for each object of the older result the number of its name, and of the newer one.
    Objects {
        names: Vec<String>,
        of: [Vec<u32>; 2],
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
            "{} of {} changed: {came} {what} came and {went} went",
            changed.len(),
            plural(reached, "cell")
        );
        let pvs_and_scene = (newer, scene.transpose()?);
        diff_page::write(
            output,
            [&args.older, &args.newer],
            (pvs_and_scene.0, pvs_and_scene.1.as_deref()),
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
            "{bold}{} of {} changed{bold}: {came} {what} came and {went} went, {:.3} % of the sets on \
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
            true => format!("beyond what sampling may miss: {}", plural(beyond, "cell")),
            false if misses_nothing(older) && misses_nothing(newer) => {
                "both results miss nothing: what came or went, and is not undecided, is a change".to_owned()
            }
            false if is_other => format!(
                "the sets of the older result have {}, those of the newer one {}: triangles of an item that \
                 is seen in part may come or go without a change; bake both with one --granularity",
                older.granularity().name(),
                newer.granularity().name()
            ),
            false => {
                "sampling alone may explain it: bake both with --max-error and --contributions to tell noise \
                      from change, or exactly"
                    .to_owned()
            }
        });
        table(
            &mut out,
            args.markdown,
            ["cell", "came", "went", "undecided", "of the sets"],
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
            ["object", "came in cells", "went in cells"],
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
            "{:.6} of the sets changed on average, more than --fail-above {most}",
            fraction
        ))),
        _ => Ok(()),
    }
}

/// Refuses results whose cells differ.
fn same_cells(args: &DiffArgs, older: &Pvs, newer: &Pvs) -> Result<(), Error> {
    let is_same = older.cells() == newer.cells()
        && (0..older.cells()).all(|cell| older.cell_bounds(cell) == newer.cell_bounds(cell));
    if is_same {
        return Ok(());
    }
    Err(Error::input(format!(
        "{} and {} have other cells; bake both with the same --cells and the same --view-box",
        args.older.display(),
        args.newer.display()
    )))
}

/// How the items of both results are compared.
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
    Ok(ComparedItems::Objects { names, of: numbers })
}

/// The changes of all cells with viewpoints in either result, in their order.
fn changes(results: &[Pvs; 2], items: &ComparedItems) -> Result<Vec<Change>, Error> {
    let bounds = [
        info_cells::bounds_of_cells(&results[0])?,
        info_cells::bounds_of_cells(&results[1])?,
    ];
    let mut all = Vec::new();
    for cell in 0..results[0].cells() {
        if !results[0].is_reached(cell)? && !results[1].is_reached(cell)? {
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
        // What is undecided may be there or not in any case.
        let certain = both(&came.without(&newer_open), &went.without(&older_open))?;
        // The older result may miss what came, and the newer one what went.
        let may_miss = [0, 1].map(|k| {
            if misses_nothing(&results[k]) {
                Some(0.0)
            } else {
                bounds[k][cell as usize]
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

/// Whether the sets miss nothing: what the method has not decided is in them.
fn misses_nothing(pvs: &Pvs) -> bool {
    pvs.method() != "aggressive"
}

/// The set of a cell and its undecided part, as items that both results number alike.
fn set(pvs: &Pvs, items: &ComparedItems, result: usize, cell: u32) -> Result<[Runs; 2], PvsError> {
    match items {
        ComparedItems::Triangles => Ok([
            Runs(pvs.visible_bounds(cell)?),
            Runs(pvs.undecided_bounds(cell)?),
        ]),
        ComparedItems::Objects { of, .. } => {
            let (mut visible, mut undecided) = (Vec::new(), Vec::new());
            pvs.visible_objects(cell, &mut visible)?;
            pvs.undecided_objects(cell, &mut undecided)?;
            Ok([visible, undecided].map(|mut ids| {
                ids.iter_mut().for_each(|id| *id = of[result][*id as usize]);
                ids.sort_unstable();
                Runs(runs::from_ids(&ids))
            }))
        }
    }
}

/// The least share of the view that some items of a cell take together, on average over its viewpoints;
/// `None` without contributions of such items.
fn share(pvs: &Pvs, items: &ComparedItems, cell: u32, of: &Runs) -> Result<Option<f64>, Error> {
    let is_one = matches!(
        (items, pvs.granularity()),
        (ComparedItems::Triangles, Granularity::Triangles)
    );
    let Some(all) = pvs.contributions(cell)?.filter(|_| is_one) else {
        return Ok(None);
    };
    let mut ids = Vec::new();
    pvs.visible_items(cell, &mut ids)?;
    // Contributions have a byte for each visible item, which is more than enough for these ids.
    let shares = ids
        .iter()
        .zip(&all)
        .filter(|(id, _)| of.has(**id))
        .map(|(_, c)| c.mean()[0]);
    Ok(Some(shares.sum()))
}

/// For each object, in how many cells something of it came or went; those in most cells first.
fn objects(
    results: &[Pvs; 2],
    items: &ComparedItems,
    changed: &[&Change],
) -> Vec<(String, [usize; 2])> {
    let named = |result: usize, of: &Runs| -> BTreeSet<String> {
        let each = of.0.chunks_exact(2);
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
        for (k, (result, of)) in [(1, &change.came), (0, &change.went)]
            .into_iter()
            .enumerate()
        {
            named(result, of)
                .into_iter()
                .for_each(|name| counts.entry(name).or_default()[k] += 1);
        }
    }
    let mut all: Vec<(String, [usize; 2])> = counts.into_iter().collect();
    all.sort_by_key(|(name, [came, went])| (std::cmp::Reverse(came + went), name.clone()));
    all
}

/// Appends a table of the first rows.
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
        // A bar in a name would end its column.
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
