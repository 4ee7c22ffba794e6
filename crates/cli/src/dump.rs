//! `sightline dump`: the sets of a result as JSON Lines.

use std::io::{BufWriter, Write as _};

use serde_json::json;
use sightline_pvs::{Granularity, Pvs, PvsError, Relation};

use crate::args::{DumpArgs, Items};
use crate::error::CliError;
use crate::inspect::Summary;
use crate::opening::open;

/// Prints a result as JSON Lines: a header, then one line per cell.
pub fn dump(args: &DumpArgs) -> Result<(), CliError> {
    let summary = Summary::of(&args.result.result)?;
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
        if args.items == Items::Clusters {
            let mut ids = Vec::new();
            let mut clusters = Vec::new();
            for item in 0..pvs.item_count() {
                pvs.item_triangles(item, &mut ids);
                clusters.push(ids.clone());
            }
            header["clusters"] = clusters.into();
        }
        writeln!(out, "{header}")?;
        let (mut visible, mut undecided) = (Vec::new(), Vec::new());
        let all = (0..pvs.cells()).filter(|cell| args.cell.is_empty() || args.cell.contains(cell));
        for cell in all {
            sets(&pvs, cell, args.items, &mut visible, &mut undecided)?;
            let [min, max] = pvs.cell_bounds(cell).unwrap_or_default();
            let mut line = json!({
                "cell": cell, "min": min, "max": max, "visible": visible, "undecided": undecided,
            });
            if pvs.is_set_aside(cell)? {
                line["set_aside"] = true.into();
            }
            if !pvs.is_reached(cell)? {
                line["reached"] = false.into();
            }
            if args.contributions {
                let all = pvs.contributions(cell)?.unwrap_or_default();
                let of =
                    |c: &sightline_pvs::Contribution| json!({"mean": c.mean(), "greatest": c.greatest()});
                line["contributions"] = all.iter().map(of).collect();
            }
            writeln!(out, "{line}")?;
        }
        out.flush()?;
        Ok(())
    };
    match write() {
        Ok(()) => Ok(()),
        Err(Dumping::Out(e)) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        Err(Dumping::Out(e)) => Err(CliError::stdout(&e)),
        Err(Dumping::Pvs(e)) => Err(e.into()),
    }
}

/// Refuses what the result does not hold.
fn check(pvs: &Pvs, args: &DumpArgs) -> Result<(), CliError> {
    let file = args.result.result.display();
    if let Some(cell) = args.cell.iter().find(|cell| **cell >= pvs.cells()) {
        return Err(CliError::Usage(format!("--cell {cell}: {file} has {} cells, from 0", pvs.cells())));
    }
    if args.items == Items::Cells && pvs.cell_pairs()?.is_none() {
        return Err(CliError::Input(format!("{file}: {}", PvsError::NoPairs)));
    }
    if args.items == Items::Clusters && pvs.granularity() != Granularity::Clusters {
        return Err(CliError::Input(format!(
            "{file}: its sets name {}, not clusters; bake with --granularity clusters",
            pvs.granularity().name()
        )));
    }
    if args.contributions && !pvs.has_contributions() {
        return Err(CliError::Input(format!("{file} has no contributions; bake with --contributions")));
    }
    if args.contributions && args.items.name() != pvs.granularity().name() {
        let name = pvs.granularity().name();
        return Err(CliError::Input(format!(
            "{file}: its contributions are those of {name}; dump them with --items {name}, or bake with \
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

/// A cell's sets of items of a kind.
pub fn sets(
    pvs: &Pvs,
    cell: u32,
    items: Items,
    visible: &mut Vec<u32>,
    undecided: &mut Vec<u32>,
) -> Result<(), PvsError> {
    match items {
        Items::Triangles => {
            pvs.visible(cell, visible)?;
            pvs.undecided(cell, undecided)
        }
        Items::Objects => {
            pvs.visible_objects(cell, visible)?;
            pvs.undecided_objects(cell, undecided)
        }
        Items::Clusters => {
            pvs.visible_items(cell, visible)?;
            pvs.undecided_items(cell, undecided)
        }
        Items::Cells => {
            let pairs = pvs.cell_pairs()?.ok_or(PvsError::NoPairs)?;
            *visible = pairs.visible.partners(cell).collect();
            let open = |u: &Relation| u.partners(cell).collect();
            *undecided = pairs.undecided.as_ref().map_or_else(Vec::new, open);
            Ok(())
        }
    }
}
