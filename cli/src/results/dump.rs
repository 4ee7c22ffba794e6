//! `sightline dump`: prints the sets of a result as JSON Lines.
//!
//! A few bytes of a file can represent millions of ids, so the ids of a set are printed directly from its
//! runs.

use std::io::{BufWriter, Write as _};

use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};
use sightline::open;
use sightline::{CellIndex, Error};
use sightline_pvs::{Granularity, Pvs, PvsError, Relation, runs};

use crate::args::cli::{DumpArgs, Items};
use crate::results::info::Summary;
use crate::terminal::printable;

/// Prints a result as JSON Lines: a header, then one line per cell.
pub fn run(args: &DumpArgs) -> Result<(), Error> {
    let summary = Summary::open(&args.result.result)?;
    let pvs = open(&args.result.result)?;
    check(&pvs, args)?;
    let mut out = BufWriter::new(std::io::stdout().lock());
    let mut write = || -> Result<(), Dumping> {
        let mut header = json!({
            "format": summary.format, "version": summary.version, "triangles": summary.triangles,
            "method": summary.method, "cells": summary.cells, "view_box": summary.view_box,
            "objects": summary.objects, "info": summary.info,
        });
        if args.items != Items::Triangles {
            header["items"] = args.items.name().into();
        }
        let clusters = (args.items == Items::Clusters).then_some(Clusters(&pvs));
        let fields = header
            .as_object_mut()
            .map(std::mem::take)
            .unwrap_or_default();
        printable::json(&mut out, &Head { fields, clusters })?;
        writeln!(out)?;
        let all = (0..pvs.cells()).filter(|cell| args.cell.is_empty() || args.cell.contains(cell));
        for cell in all.map(CellIndex) {
            let [visible, undecided] = sets(&pvs, cell, args.items)?;
            let [min, max] = corners(&pvs, cell);
            let to_json = |c: &sightline_pvs::Contribution| {
                json!({
                    "mean": c.mean(), "greatest": c.greatest(),
                })
            };
            let contributions = match args.contributions {
                true => Some(
                    pvs.contributions(cell.0)?
                        .unwrap_or_default()
                        .iter()
                        .map(to_json)
                        .collect(),
                ),
                false => None,
            };
            let line = CellLine {
                cell,
                min,
                max,
                visible,
                undecided,
                set_aside: pvs.is_set_aside(cell.0)?.then_some(true),
                reached: (!pvs.is_reached(cell.0)?).then_some(false),
                contributions,
            };
            printable::json(&mut out, &line)?;
            writeln!(out)?;
        }
        out.flush()?;
        Ok(())
    };
    match write() {
        Ok(()) => Ok(()),
        Err(Dumping::Out(e)) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        Err(Dumping::Out(e)) => Err(crate::terminal::stdout::unwritable(&e)),
        Err(Dumping::Pvs(e)) => Err(e.into()),
    }
}

/// Checks that the result contains the requested cells, kind of items, and contributions.
fn check(pvs: &Pvs, args: &DumpArgs) -> Result<(), Error> {
    let file = args.result.result.display();
    if let Some(cell) = args.cell.iter().find(|cell| **cell >= pvs.cells()) {
        return Err(Error::usage(format!(
            "--cell {cell} does not exist: {file} has {} cells, numbered from 0",
            pvs.cells()
        )));
    }
    if args.items == Items::Cells && pvs.cell_pairs()?.is_none() {
        return Err(Error::input(format!("{file}: {}", PvsError::NoPairs)));
    }
    if args.items == Items::Clusters && pvs.granularity() != Granularity::Clusters {
        return Err(Error::input(format!(
            "the sets of {file} contain {}, not clusters; bake with --granularity clusters",
            pvs.granularity().name()
        )));
    }
    if args.contributions && !pvs.has_contributions() {
        return Err(Error::input(format!(
            "{file} has no contributions; bake with --contributions"
        )));
    }
    if args.contributions && args.items.name() != pvs.granularity().name() {
        let name = pvs.granularity().name();
        return Err(Error::input(format!(
            "{file} has contributions only for {name}; dump them with --items {name}, or bake with \
             --granularity {}",
            args.items.name()
        )));
    }
    Ok(())
}

#[derive(Debug, thiserror::Error)]
enum Dumping {
    #[error(transparent)]
    Out(#[from] std::io::Error),
    #[error(transparent)]
    Pvs(#[from] PvsError),
}

/// The first line of the output: the description of the result, and the triangles of its clusters.
#[derive(Serialize)]
struct Head<'a> {
    #[serde(flatten)]
    fields: Map<String, Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    clusters: Option<Clusters<'a>>,
}

/// The triangles of each cluster of a result.
struct Clusters<'a>(&'a Pvs);

impl Serialize for Clusters<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq((0..self.0.item_count()).map(|item| Ids(self.0.item_bounds(item))))
    }
}

/// The line of a cell in the output.
#[derive(Serialize)]
struct CellLine {
    cell: CellIndex,
    min: [f64; 3],
    max: [f64; 3],
    visible: Ids,
    undecided: Ids,
    #[serde(skip_serializing_if = "Option::is_none")]
    set_aside: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reached: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    contributions: Option<Vec<Value>>,
}

/// Returns the corners of a cell as doubles, so that JSON keeps all digits of the single-precision values.
pub fn corners(pvs: &Pvs, cell: CellIndex) -> [[f64; 3]; 2] {
    pvs.cell_bounds(cell.0)
        .unwrap_or_default()
        .map(|corner| corner.map(f64::from))
}

/// Ascending ids, stored as the boundaries of their runs.
pub struct Ids(Vec<u32>);

impl Ids {
    /// Returns the ids in ascending order.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.0.chunks_exact(2).flat_map(|run| run[0]..run[1])
    }

    /// Returns the number of ids.
    pub fn count(&self) -> usize {
        self.0
            .chunks_exact(2)
            .map(|run| (run[1] - run[0]) as usize)
            .sum()
    }
}

impl Serialize for Ids {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

/// Reads the visible and the undecided set of a cell. `items` is the kind of the returned ids.
pub fn sets(pvs: &Pvs, cell: CellIndex, items: Items) -> Result<[Ids; 2], PvsError> {
    let (mut visible, mut undecided) = (Vec::new(), Vec::new());
    match items {
        Items::Triangles => {
            return Ok([
                Ids(pvs.visible_bounds(cell.0)?),
                Ids(pvs.undecided_bounds(cell.0)?),
            ]);
        }
        Items::Objects => {
            pvs.visible_objects(cell.0, &mut visible)?;
            pvs.undecided_objects(cell.0, &mut undecided)?;
        }
        Items::Clusters => {
            pvs.visible_items(cell.0, &mut visible)?;
            pvs.undecided_items(cell.0, &mut undecided)?;
        }
        Items::Cells => {
            let pairs = pvs.cell_pairs()?.ok_or(PvsError::NoPairs)?;
            visible = pairs.visible.partners(cell.0).collect();
            let open = |u: &Relation| u.partners(cell.0).collect();
            undecided = pairs.undecided.as_ref().map_or_else(Vec::new, open);
        }
    }
    Ok([visible, undecided].map(|ids| Ids(runs::from_ids(&ids))))
}
