//! `sightline info`, `dump` and `query`: print the content of a result.

use std::io::{BufWriter, Write as _};
use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use sightline_pvs::{Pvs, PvsError};

use crate::args::{DumpArgs, InfoArgs, Items, QueryArgs};
use crate::cells;
use crate::error::CliError;
use crate::opening::{self, open, plural};
use crate::serve::print;
use crate::why;

/// Objects listed by `info` without --json.
const OBJECTS_SHOWN: usize = 20;

/// The summary of a result that `info` and the end of a bake print.
#[derive(Serialize)]
pub struct Summary {
    format: &'static str,
    version: u32,
    method: String,
    triangles: u32,
    objects: usize,
    cells: u32,
    view_box: serde_json::Value,
    file_bytes: u64,
    set_bytes: u64,
    bytes_per_cell: f64,
    mean_visible: f64,
    min_visible: u64,
    max_visible: u64,
    mean_visible_fraction: f64,
    undecided: u64,
    cells_set_aside: u32,
    /// Cells with a bound on their missed sight lines, at 95 % confidence; then the greatest and the mean
    /// bound.
    cells_bounded: usize,
    greatest_bound: Option<f64>,
    mean_bound: Option<f64>,
    /// Cells whose sampling ended, by time or rounds, before they reached their target.
    cells_unfinished: usize,
    /// Cells with a per-cell tolerance above the target error, because they took far more work than others.
    cells_spared: usize,
    /// What exact queries decided; `None` for the method aggressive.
    decided: Option<cells::Decided>,
    /// Cells of an adaptive tree that see more triangles than its budget; `None` for a grid.
    cells_over_budget: Option<usize>,
    info: serde_json::Value,
}

impl Summary {
    /// Whether exact queries took part.
    pub fn is_decided(&self) -> bool {
        self.decided.is_some()
    }

    /// Whether no triangle is seen from any cell.
    pub fn sees_nothing(&self) -> bool {
        self.max_visible == 0
    }

    /// Reads the result at `path`.
    pub fn of(path: &Path) -> Result<Self, CliError> {
        let pvs = open(path)?;
        // Another program may have written the result, so its parameters may be anything.
        let info: serde_json::Value =
            serde_json::from_str(pvs.info_json()).unwrap_or_else(|_| pvs.info_json().into());
        let budget = info["division"]["adaptive"]["budget"].as_u64();
        // Collected before the error is taken, so that the first damaged cell is reported on every run.
        let sets: Vec<Result<(u64, u64, bool), PvsError>> = (0..pvs.cells())
            .into_par_iter()
            .map_init(Vec::new, |ids, cell| {
                pvs.undecided(cell, ids)?;
                let undecided = ids.len() as u64;
                pvs.visible(cell, ids)?;
                Ok((ids.len() as u64, undecided, pvs.is_set_aside(cell)?))
            })
            .collect();
        let sets: Vec<(u64, u64, bool)> = sets.into_iter().collect::<Result<_, _>>()?;
        let sizes: Vec<u64> = sets.iter().map(|s| s.0).collect();
        let undecided: u64 = sets.iter().map(|s| s.1).sum();
        let aside = sets.iter().filter(|s| s.2).count() as u32;
        // A cell that was set aside shows all triangles; this does not count as over the budget.
        let over = sets.iter().filter(|s| !s.2 && budget.is_some_and(|b| s.0 > b)).count();
        let bounds = cells::bounds(&pvs)?;
        let [cells_unfinished, cells_spared] = cells::unfinished_and_spared(&pvs)?;
        let [file_bytes, visible, undecided_bytes] = pvs.file_bytes();
        let cells = f64::from(pvs.cells());
        let sum: u64 = sizes.iter().sum();
        let [min, max] = pvs.tree().view_box();
        Ok(Self {
            format: "sightline.pvs",
            version: sightline_pvs::VERSION,
            method: pvs.method().to_owned(),
            triangles: pvs.triangle_count(),
            objects: pvs.objects().len(),
            cells: pvs.cells(),
            view_box: serde_json::json!({"min": min, "max": max}),
            file_bytes,
            set_bytes: visible + undecided_bytes,
            bytes_per_cell: (visible + undecided_bytes) as f64 / cells,
            mean_visible: sum as f64 / cells,
            min_visible: sizes.iter().copied().min().unwrap_or(0),
            max_visible: sizes.iter().copied().max().unwrap_or(0),
            mean_visible_fraction: sum as f64 / cells / f64::from(pvs.triangle_count()),
            undecided,
            cells_set_aside: aside,
            cells_bounded: bounds.as_ref().map_or(0, |b| b.cells),
            greatest_bound: bounds.as_ref().map(|b| b.greatest),
            mean_bound: bounds.as_ref().map(|b| b.mean),
            cells_unfinished,
            cells_spared,
            decided: if pvs.method() == "aggressive" { None } else { Some(cells::decided(&pvs)?) },
            cells_over_budget: budget.map(|_| over),
            info,
        })
    }

    /// The summary as lines for people.
    pub fn lines(&self) -> Vec<String> {
        let text = |key: &str| self.info.get(key).and_then(|v| v.as_str()).unwrap_or("?").to_owned();
        let mut lines = vec![
            format!(
                "{} over {} in {}, method {}",
                plural(self.cells as usize, "cell"),
                plural(self.triangles as usize, "triangle"),
                plural(self.objects, "object"),
                self.method
            ),
            format!("view box {} to {}", corner(&self.view_box["min"]), corner(&self.view_box["max"])),
            opening::kinds_in_words(&opening::counts_of(&self.info)).join("; "),
            match self.undecided {
                // Sampling alone decides nothing, so it has no number of undecided triangles.
                0 => format!(
                    "visible from a cell: {:.0} triangles on average ({:.2} %), {} to {}{}",
                    self.mean_visible,
                    self.mean_visible_fraction * 100.0,
                    self.min_visible,
                    self.max_visible,
                    if self.decided.is_some() { "; undecided: 0" } else { "" },
                ),
                undecided => format!(
                    "visible from a cell: between {:.0} and {:.0} triangles on average; \
                     drawn: the latter ({:.2} %), {} to {}; undecided: {undecided} in all cells",
                    self.mean_visible - undecided as f64 / f64::from(self.cells),
                    self.mean_visible,
                    self.mean_visible_fraction * 100.0,
                    self.min_visible,
                    self.max_visible,
                ),
            },
            format!(
                "{} bytes, {:.0} a cell for the sets; cells set aside: {}",
                self.file_bytes, self.bytes_per_cell, self.cells_set_aside
            ),
            match (self.greatest_bound, self.mean_bound) {
                // The bounds are those of sampling, before exact queries found the rest.
                _ if self.decided.is_some() && self.undecided > 0 => {
                    "missed sight lines: none, because undecided triangles are drawn".to_owned()
                }
                _ if self.decided.is_some() => "missed sight lines: none".to_owned(),
                (Some(greatest), Some(mean)) => format!(
                    "missed sight lines, bounds of {} cells at 95 % each: the greatest {:.4} %, {:.4} % on \
                     average",
                    self.cells_bounded,
                    greatest * 100.0,
                    mean * 100.0
                ),
                _ if self.info["sampling"]["max_error"].is_number() => {
                    "missed sight lines: the bound asked for was not reached in any cell".to_owned()
                }
                _ if self.info["division"]["adaptive"].is_object() => {
                    "missed sight lines: not bounded (only those of a grid can be)".to_owned()
                }
                _ => "missed sight lines: not bounded (--max-error F bounds them)".to_owned(),
            },
        ];
        if let Some(d) = &self.decided {
            lines.push(format!(
                "decided exactly, in pairs of cell and triangle: {} hidden ({} by closed surfaces), {} \
                 visible that sampling had missed, {} hidden that sampling had shown",
                d.hidden, d.by_surfaces, d.missed, d.refuted
            ));
            if d.evidence_bytes > 0 {
                lines.push(format!(
                    "{} bytes of witnesses and certificates; sightline verify checks them",
                    d.evidence_bytes
                ));
            }
            if d.cells_open > 0 {
                lines.push(format!(
                    "UNDECIDED in {} of {} cells, and drawn: {} because the time ended, {} beyond the limits \
                     of a query",
                    d.cells_open, self.cells, d.out_of_time, d.beyond_limits
                ));
            }
        }
        // Exact queries decide afterwards whatever sampling leaves, so unfinished cells do not matter then.
        if self.cells_unfinished > 0 && self.decided.is_none() {
            let why = match self.info["time_budget_ms"].as_u64() {
                Some(1..) => "the time budget ended first",
                _ => "sampling gave up after many rounds; info --cells lists the hardest cells",
            };
            lines.push(format!("NOT FINISHED: {} of {} cells: {why}", self.cells_unfinished, self.cells));
        }
        if self.cells_spared > 0 && self.decided.is_none() {
            lines.push(format!(
                "hard cells: {} of {} took far more work than the others and were finished with a tolerance \
                 above the target error; --max-error allows no such tolerance",
                self.cells_spared, self.cells
            ));
        }
        if let Some(over @ 1..) = self.cells_over_budget {
            let why = if self.decided.is_some() {
                "the tree was built from what sampling had shown"
            } else if self.cells_unfinished > 0 {
                "they are at the deepest level (--max-depth), too thin to be halved, or not finished"
            } else {
                "they are at the deepest level (--max-depth) or too thin to be halved"
            };
            lines.push(format!("over the triangle budget: {over} of {} cells; {why}", self.cells));
        }
        lines.push(format!("numerics profile {}", text("profile")));
        lines
    }
}

/// Prints a summary of a result.
pub fn info(args: &InfoArgs, json: bool) -> Result<(), CliError> {
    let summary = Summary::of(&args.result.result)?;
    let pvs = open(&args.result.result)?;
    if json {
        let mut value = serde_json::to_value(&summary).map_err(CliError::internal)?;
        let object = |o: &sightline_pvs::Object| {
            let (name, first, count) = (&o.name, o.first, o.count);
            serde_json::json!({"name": name, "first": first, "count": count})
        };
        value["objects"] = pvs.objects().iter().map(object).collect();
        if args.cells {
            value["per_cell"] = cells::json(&pvs)?;
        }
        return print(&value.to_string());
    }
    let mut lines = summary.lines();
    lines.push(format!("parameters {}", summary.info));
    if args.cells {
        lines.extend(cells::table(&pvs)?);
        return print(&lines.join("\n"));
    }
    for (i, o) in pvs.objects().iter().enumerate().take(OBJECTS_SHOWN) {
        let last = u64::from(o.first) + u64::from(o.count);
        lines.push(format!("object {i}: {} (triangles {}..{last})", o.name, o.first));
    }
    if pvs.objects().len() > OBJECTS_SHOWN {
        lines.push(format!("… and {} more objects; --json lists all", pvs.objects().len() - OBJECTS_SHOWN));
    }
    print(&lines.join("\n"))
}

/// Prints a result as JSON Lines: a header, then one line per cell.
pub fn dump(args: &DumpArgs) -> Result<(), CliError> {
    let summary = Summary::of(&args.result.result)?;
    let pvs = open(&args.result.result)?;
    let mut out = BufWriter::new(std::io::stdout().lock());
    let mut write = || -> Result<(), Dumping> {
        let mut header = serde_json::json!({
            "format": summary.format, "version": summary.version, "triangles": summary.triangles,
            "method": summary.method, "cells": summary.cells, "view_box": summary.view_box,
            "objects": summary.objects, "info": summary.info,
        });
        if args.items == Items::Objects {
            header["items"] = "objects".into();
        }
        writeln!(out, "{header}")?;
        let (mut visible, mut undecided) = (Vec::new(), Vec::new());
        for cell in 0..pvs.cells() {
            sets(&pvs, cell, args.items, &mut visible, &mut undecided)?;
            let [min, max] = pvs.cell_bounds(cell).unwrap_or_default();
            let mut line = serde_json::json!({
                "cell": cell, "min": min, "max": max, "visible": visible, "undecided": undecided,
            });
            if pvs.is_set_aside(cell)? {
                line["set_aside"] = true.into();
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

#[derive(Debug, thiserror::Error)]
enum Dumping {
    #[error(transparent)]
    Out(#[from] std::io::Error),
    #[error(transparent)]
    Pvs(#[from] sightline_pvs::PvsError),
}

fn sets(
    pvs: &Pvs,
    cell: u32,
    items: Items,
    visible: &mut Vec<u32>,
    undecided: &mut Vec<u32>,
) -> Result<(), sightline_pvs::PvsError> {
    match items {
        Items::Triangles => {
            pvs.visible(cell, visible)?;
            pvs.undecided(cell, undecided)
        }
        Items::Objects => {
            pvs.visible_objects(cell, visible)?;
            pvs.undecided_objects(cell, undecided)
        }
    }
}

/// Prints the set of the cell that contains a point.
pub fn query(args: &QueryArgs, json: bool) -> Result<(), CliError> {
    let pvs = open(&args.result.result)?;
    let point: [f32; 3] =
        args.point.as_slice().try_into().map_err(|_| CliError::Usage("give x y z".to_owned()))?;
    let Some(cell) = pvs.find_cell(point) else {
        let [min, max] = pvs.tree().view_box();
        return Err(CliError::Input(format!(
            "{point:?} is outside the view box of {} ({min:?} to {max:?}); choose a point inside, or bake \
             with a larger --view-box",
            args.result.result.display()
        )));
    };
    if let Some(triangle) = args.why {
        return why::why(
            &pvs,
            &args.result.result,
            (cell, triangle),
            (args.scene.as_deref(), &args.kinds.rules),
            json,
        );
    }
    let (mut visible, mut undecided) = (Vec::new(), Vec::new());
    sets(&pvs, cell, args.items, &mut visible, &mut undecided)?;
    let [min, max] = pvs.cell_bounds(cell).unwrap_or_default();
    let what = if args.items == Items::Objects { "object" } else { "triangle" };
    if json {
        let value = serde_json::json!({
            "cell": cell, "min": min, "max": max, "items": format!("{what}s"),
            "visible": visible, "undecided": undecided,
            "set_aside": pvs.is_set_aside(cell)?,
        });
        return print(&value.to_string());
    }
    let list: Vec<String> = visible
        .iter()
        .map(|id| match args.items {
            Items::Triangles => id.to_string(),
            Items::Objects => format!("{id} {}", pvs.objects()[*id as usize].name),
        })
        .collect();
    let aside =
        if pvs.is_set_aside(cell)? { "; SET ASIDE: this cell failed, everything is shown" } else { "" };
    print(&format!(
        "cell {cell}, {min:?} to {max:?}: {} to draw{}{aside}\n{}",
        plural(visible.len(), what),
        match undecided.len() {
            0 => String::new(),
            n => format!(": {} visible, {n} undecided", visible.len() - n),
        },
        list.join(if args.items == Items::Objects { "\n" } else { " " })
    ))
}

/// A point in text. Its coordinates come from single precision, so they are printed in single precision.
fn corner(of: &serde_json::Value) -> String {
    let coordinates = of.as_array().map_or(&[][..], |c| c);
    let short: Vec<String> =
        coordinates.iter().map(|c| c.as_f64().map_or("?".to_owned(), |c| (c as f32).to_string())).collect();
    format!("({})", short.join(", "))
}
