//! `sightline info`: prints the summary of a result.

use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use sightline::Error;
use sightline::words::{kinds_in_words, plural, sides_in_words};
use sightline::{kind_counts, open};
use sightline_model::job::json::find_field;
use sightline_pvs::{Granularity, Pvs, PvsError};

use crate::args::cli::InfoArgs;
use crate::results::info_cells;
use crate::terminal::printable;
use crate::terminal::stdout::print;

/// The version of the output of `info` and `dump`.
const DUMP_VERSION: u32 = 1;
/// The number of objects that `info` lists without --json.
const OBJECTS_SHOWN: usize = 20;

/// The summary of a result that `info` and the end of a bake print.
#[derive(Serialize)]
pub struct Summary {
    pub format: &'static str,
    pub version: u32,
    pub method: String,
    pub triangles: u32,
    pub objects: usize,
    /// The kind of the items in the sets: triangles, clusters or objects.
    granularity: &'static str,
    /// The number of items.
    pub items: u32,
    pub cells: u32,
    /// The number of cells in which viewpoints can be. Only these cells count in means.
    cells_reached: u32,
    pub view_box: serde_json::Value,
    file_bytes: u64,
    set_bytes: u64,
    bytes_per_cell: f64,
    mean_visible: f64,
    /// The expected set: the mean number of triangles to draw over all viewpoints, weighted by the volume
    /// that viewpoints reach or by the weights of a file of viewpoints.
    expected: f64,
    /// The share of the view box's volume that viewpoints reach.
    reached: f64,
    /// The digest of the result from which this result was computed. `None` after a full bake.
    from: Option<String>,
    min_visible: u64,
    max_visible: u64,
    mean_visible_fraction: f64,
    undecided: u64,
    cells_set_aside: u32,
    /// The number of cells with a bound on the fraction of their missed sight lines, at 95 % confidence. The
    /// next two fields are the largest and the mean of these bounds.
    cells_bounded: usize,
    greatest_bound: Option<f64>,
    mean_bound: Option<f64>,
    /// The number of cells whose sampling ended, by the time budget or the maximum number of rounds, before
    /// they reached their target error.
    cells_unfinished: usize,
    /// The number of cells with a per-cell tolerance above the target error, because they took far more work
    /// than others.
    cells_spared: usize,
    /// The cell-to-cell visibility. `None` if the result does not contain it.
    cell_to_cell: Option<CellToCell>,
    /// The decisions of exact queries. `None` for the method aggressive.
    decided: Option<info_cells::Decided>,
    /// The number of cells of an adaptive tree that see more triangles than its budget. `None` for a grid.
    cells_over_budget: Option<usize>,
    pub info: serde_json::Value,
    /// True if walls enclose all viewpoints.
    in_region: bool,
}

/// The amount of cell-to-cell visibility.
#[derive(Serialize)]
struct CellToCell {
    /// The number of pairs of different cells that see each other, including the undecided ones.
    pairs: u64,
    /// The number of these pairs, divided by the number of all pairs of different cells of which at least one
    /// is reached.
    density: f64,
    undecided: u64,
    bytes: u64,
    /// The largest and the mean bound on a cell's missed pairs, at 95 % confidence. A bound is the fraction
    /// of the cell's sight lines that cross a cell which forms no pair with it.
    greatest_bound: Option<f64>,
    mean_bound: Option<f64>,
}

impl CellToCell {
    fn from_result(pvs: &Pvs) -> Result<Option<Self>, Error> {
        let Some(found) = pvs.cell_pairs()? else {
            return Ok(None);
        };
        let cells = u64::from(pvs.cells());
        let reached = (0..pvs.cells())
            .map(|c| pvs.is_reached(c))
            .collect::<Result<Vec<_>, _>>()?;
        let reached = reached.iter().filter(|r| **r).count() as u64;
        let own = (0..pvs.cells())
            .filter(|c| found.visible.has(*c, *c))
            .count() as u64;
        let pairs = found.visible.pairs() - own;
        let all = reached * (cells - reached) + reached * reached.saturating_sub(1) / 2;
        let bounds = info_cells::pair_bounds(pvs)?;
        Ok(Some(Self {
            pairs,
            density: pairs as f64 / all.max(1) as f64,
            undecided: found
                .undecided
                .as_ref()
                .map_or(0, sightline_pvs::Relation::pairs),
            bytes: pvs.pair_bytes(),
            greatest_bound: bounds.as_ref().map(|b| b.greatest),
            mean_bound: bounds.as_ref().map(|b| b.mean),
        }))
    }
}

/// Returns the share of the view box's volume that viewpoints reach.
fn reached_volume(pvs: &Pvs, info: &serde_json::Value) -> Result<f64, PvsError> {
    let marks = &info["viewpoints"];
    let is_grid = find_field(&info["spec"], "boxes").is_none();
    if let (Some(parts), Some(cells), true) =
        (marks["parts"].as_f64(), marks["cells"].as_f64(), is_grid)
        && cells > 0.0
    {
        return Ok((parts / (PARTS * cells)).min(1.0));
    }
    let (mut reached, mut all) = (0.0, 0.0);
    for cell in 0..pvs.cells() {
        let volume = info_cells::volume(pvs, cell);
        all += volume;
        reached += if pvs.is_reached(cell)? { volume } else { 0.0 };
    }
    Ok(if all > 0.0 { reached / all } else { 0.0 })
}

/// The number of parts of a grid cell that can be marked.
const PARTS: f64 = 64.0;
/// The mean fraction of the scene's triangles in a set above which the summary states that walls hide little.
const MUCH: f64 = 0.5;

impl Summary {
    /// Returns true if exact queries contributed to the sets.
    pub fn is_decided(&self) -> bool {
        self.decided.is_some()
    }

    /// Returns true if portals computed the sets.
    fn by_portals(&self) -> bool {
        self.method == "portals"
    }

    /// Returns true if no triangle is visible from any cell.
    pub fn sees_nothing(&self) -> bool {
        self.max_visible == 0
    }

    /// Reads the result at `path`.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let pvs = open(path)?;
        // Another program may have written the result, so its parameters can have any form.
        let info: serde_json::Value =
            serde_json::from_str(pvs.info_json()).unwrap_or_else(|_| pvs.info_json().into());
        let budget =
            find_field(&info["spec"], "triangle_budget").and_then(serde_json::Value::as_u64);
        // The sets are collected before an error is returned, so that every run reports the first damaged
        // cell.
        let sets: Vec<Result<(u64, u64, bool, bool), PvsError>> = (0..pvs.cells())
            .into_par_iter()
            .map(|cell| {
                let (visible, undecided) = (pvs.visible_count(cell)?, pvs.undecided_count(cell)?);
                let sizes = (u64::from(visible), u64::from(undecided));
                Ok((
                    sizes.0,
                    sizes.1,
                    pvs.is_set_aside(cell)?,
                    pvs.is_reached(cell)?,
                ))
            })
            .collect();
        let sets: Vec<(u64, u64, bool, bool)> = sets.into_iter().collect::<Result<_, _>>()?;
        // Cells without viewpoints do not count.
        let sets: Vec<(u64, u64, bool)> = sets
            .into_iter()
            .filter(|s| s.3)
            .map(|(visible, open, aside, _)| (visible, open, aside))
            .collect();
        let sizes: Vec<u64> = sets.iter().map(|s| s.0).collect();
        let undecided: u64 = sets.iter().map(|s| s.1).sum();
        let aside = sets.iter().filter(|s| s.2).count() as u32;
        // A cell that was set aside shows all triangles, so it does not count as over the budget.
        let over = sets
            .iter()
            .filter(|s| !s.2 && budget.is_some_and(|b| s.0 > b))
            .count();
        let bounds = info_cells::bounds(&pvs)?;
        let [cells_unfinished, cells_spared] = info_cells::unfinished_and_spared(&pvs)?;
        let [file_bytes, visible, undecided_bytes] = pvs.file_bytes();
        let expected = info_cells::expected_set(&pvs)?;
        let reached = reached_volume(&pvs, &info)?;
        let cells = sets.len().max(1) as f64;
        let sum: u64 = sizes.iter().sum();
        let [min, max] = pvs.tree().view_box();
        Ok(Self {
            format: "sightline.pvs",
            version: DUMP_VERSION,
            method: pvs.method().to_owned(),
            triangles: pvs.triangle_count(),
            objects: pvs.objects().len(),
            granularity: pvs.granularity().name(),
            items: pvs.item_count(),
            cells: pvs.cells(),
            cells_reached: sets.len() as u32,
            view_box: serde_json::json!({"min": min, "max": max}),
            file_bytes,
            set_bytes: visible + undecided_bytes,
            bytes_per_cell: (visible + undecided_bytes) as f64 / cells,
            mean_visible: sum as f64 / cells,
            expected,
            reached,
            from: info["from"].as_str().map(str::to_owned),
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
            cell_to_cell: CellToCell::from_result(&pvs)?,
            decided: if pvs.method() == "aggressive" {
                None
            } else {
                Some(info_cells::decided(&pvs)?)
            },
            cells_over_budget: budget.map(|_| over),
            in_region: pvs.region().is_some(),
            info,
        })
    }

    /// Returns the choice of cells by cost as a sentence; `None` for other cells.
    fn by_cost_in_words(&self) -> Option<String> {
        let choice = self.info.get("cells_by_cost")?;
        let number = |part: &str, name: &str| choice[part][name].as_f64();
        let unit = choice["cost"].as_str()?;
        let within = match choice["is_within_budget"].as_bool()? {
            true => "",
            false => {
                "; NOT WITHIN THE BUDGET: these are the smallest cells that the fine grid allows"
            }
        };
        Some(format!(
            "cells by cost: {} with a set, expected set {:.1} {unit}; {} fine cells have {:.1} {unit} and \
             {:.2} times the bytes{within}",
            number("chosen", "cells")?,
            number("chosen", "expected")?,
            number("grid", "cells")?,
            number("grid", "expected")?,
            number("grid", "bytes")? / number("chosen", "bytes")?.max(1.0),
        ))
    }

    /// Returns the summary as human-readable lines.
    pub fn lines(&self) -> Vec<String> {
        let text = |key: &str| {
            self.info
                .get(key)
                .and_then(|v| v.as_str())
                .unwrap_or("?")
                .to_owned()
        };
        let mut lines = vec![
            format!(
                "{} over {} in {}, method {}",
                plural(self.cells as usize, "cell"),
                plural(self.triangles as usize, "triangle"),
                plural(self.objects, "object"),
                self.method
            ),
            match self.granularity == Granularity::Triangles.name() {
                true => String::new(),
                false => format!("the sets contain ids of {} {}", self.items, self.granularity),
            },
            match self.cells_reached == self.cells {
                true => String::new(),
                false => format!(
                    "viewpoints are in {} of {}; the other cells were not sampled",
                    self.cells_reached,
                    plural(self.cells as usize, "cell")
                ),
            },
            format!(
                "view box {} to {}",
                corner(&self.view_box["min"]),
                corner(&self.view_box["max"])
            ),
            kinds_in_words(&kind_counts(&self.info)).join("; "),
            match self.info["cull_back_faces"] == true {
                true => sides_in_words(None),
                false => String::new(),
            },
            match self.undecided {
                // Only a method that decides triangles, or completion, has a number of undecided triangles.
                0 => format!(
                    "visible from a cell: {:.0} triangles on average ({:.2} %), {} to {}{}",
                    self.mean_visible,
                    self.mean_visible_fraction * 100.0,
                    self.min_visible,
                    self.max_visible,
                    if self.decided.is_some() {
                        "; undecided: 0"
                    } else {
                        ""
                    },
                ),
                undecided if self.decided.is_none() => format!(
                    "seen from a cell: {:.0} triangles on average; drawn with likely ones, which are \
                     undecided: {:.0} ({:.2} %), {} to {}",
                    self.mean_visible - undecided as f64 / f64::from(self.cells_reached.max(1)),
                    self.mean_visible,
                    self.mean_visible_fraction * 100.0,
                    self.min_visible,
                    self.max_visible,
                ),
                undecided => format!(
                    "visible from a cell: between {:.0} and {:.0} triangles on average; \
                     drawn: the larger number ({:.2} %), {} to {}; undecided: {undecided} in all cells",
                    self.mean_visible - undecided as f64 / f64::from(self.cells_reached.max(1)),
                    self.mean_visible,
                    self.mean_visible_fraction * 100.0,
                    self.min_visible,
                    self.max_visible,
                ),
            },
            format!(
                "{} bytes, {:.0} bytes of sets per cell; cells set aside: {}",
                self.file_bytes, self.bytes_per_cell, self.cells_set_aside
            ),
            match (self.greatest_bound, self.mean_bound) {
                // The bounds apply to the sampling, before exact queries found the missed triangles.
                _ if self.decided.is_some() && self.undecided > 0 => {
                    "missed sight lines: none, because undecided triangles are drawn".to_owned()
                }
                _ if self.decided.is_some() => "missed sight lines: none".to_owned(),
                (Some(greatest), Some(mean)) => format!(
                    "missed sight lines, bounds of {} cells at 95 % each: at most {:.4} %, {:.4} % \
                     on average",
                    self.cells_bounded,
                    greatest * 100.0,
                    mean * 100.0
                ),
                _ if find_field(&self.info["spec"], "max_error").is_some() => {
                    "missed sight lines: no cell reached the requested bound".to_owned()
                }
                _ if find_field(&self.info["spec"], "adaptive").is_some() => {
                    "missed sight lines: not bounded (only cells of a grid or boxes along walls have \
                     bounds)".to_owned()
                }
                _ => "missed sight lines: not bounded (--max-error F bounds them)".to_owned(),
            },
        ];
        if let Some(line) = self.by_cost_in_words() {
            lines.push(line);
        }
        if let Some(open) = self.info["tiles_open"].as_u64() {
            lines.push(format!(
                "NOT FINISHED: {open} tiles of the job were not done; the sets of their cells contain \
                 every triangle"
            ));
        }
        lines.retain(|line| !line.is_empty());
        lines.extend(self.cell_to_cell.as_ref().map(|c| {
            let bound = match (c.greatest_bound, self.decided.is_some()) {
                (Some(bound), false) => {
                    format!(
                        "; missed at most {:.4} % in any cell, at 95 %",
                        bound * 100.0
                    )
                }
                _ => String::new(),
            };
            let open = match c.undecided {
                0 => String::new(),
                n => format!(", {n} of them undecided"),
            };
            format!(
                "cell to cell: {} pairs see each other ({:.1} %){open}, {} bytes{bound}",
                c.pairs,
                c.density * 100.0,
                c.bytes
            )
        }));
        if let Some(d) = self.decided.as_ref().filter(|_| self.by_portals()) {
            lines.push(format!(
                "walls hide {} pairs of a cell and a triangle (closed surfaces hide {} of them); {} pairs \
                 have no witness, count as undecided and are drawn",
                d.hidden, d.by_surfaces, self.undecided
            ));
            if self.mean_visible_fraction > MUCH && !self.in_region {
                lines.push(
                    "walls hide little here: portals help where walls enclose rooms; `sightline portals` \
                     prints the way out of a scene, and --reachable-from excludes space that no viewer \
                      can reach"
                        .to_owned(),
                );
            }
            if d.out_of_time > 0 {
                lines.push(format!(
                    "NOT FINISHED: the time budget ended before {} cells were complete",
                    d.cells_out_of_time
                ));
            }
        } else if let Some(d) = &self.decided {
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
        // Exact queries decide the triangles that sampling leaves open, so unfinished cells do not matter
        // then.
        if self.cells_unfinished > 0 && self.decided.is_none() {
            let why = match find_field(&self.info["spec"], "time_budget_ms") {
                Some(_) => "the time budget ended first",
                _ => {
                    "sampling ended at its maximum number of rounds; info --cells lists the cells with \
                 the most rays"
                }
            };
            lines.push(format!(
                "NOT FINISHED: {} of {} cells: {why}",
                self.cells_unfinished, self.cells
            ));
        }
        if self.cells_spared > 0 && self.decided.is_none() {
            lines.push(format!(
                "hard cells: {} of {} needed far more work than the other cells, and finished with a \
                 tolerance above the target error; --max-error allows no such tolerance",
                self.cells_spared, self.cells
            ));
        }
        if let Some(over @ 1..) = self.cells_over_budget {
            let why = if self.decided.is_some() {
                "sampling divided the cells before exact queries found more triangles"
            } else if self.cells_unfinished > 0 {
                "these cells are at the deepest level (--max-depth), too thin to be halved, or not finished"
            } else {
                "these cells are at the deepest level (--max-depth), or too thin to be halved"
            };
            lines.push(format!(
                "over the triangle budget: {over} of {} cells; {why}",
                self.cells
            ));
        }
        lines.push(format!("numerics profile {}", text("profile")));
        lines
    }
}

/// Prints a summary of a result.
pub fn run(args: &InfoArgs, json: bool) -> Result<(), Error> {
    let summary = Summary::open(&args.result.result)?;
    let pvs = open(&args.result.result)?;
    if json {
        let mut value = serde_json::to_value(&summary).map_err(Error::internal)?;
        let object = |o: &sightline_pvs::Object| {
            let (name, first, count) = (&o.name, o.first, o.count);
            let mut object = serde_json::json!({"name": name, "first": first, "count": count});
            if let Some(source) = o.source {
                object["node"] = source.node.into();
                object["mesh"] = source.mesh.into();
                object["primitive"] = source.primitive.into();
                object["instance"] = source.instance.into();
            }
            object
        };
        value["objects"] = pvs.objects().iter().map(object).collect();
        if args.cells {
            value["per_cell"] = info_cells::json(&pvs)?;
        }
        return print(&value.to_string());
    }
    let mut lines = summary.lines();
    lines.push(format!("parameters {}", summary.info));
    if args.cells {
        lines.extend(info_cells::table(&pvs)?);
        return print(&lines.join("\n"));
    }
    for (i, o) in pvs.objects().iter().enumerate().take(OBJECTS_SHOWN) {
        let last = u64::from(o.first) + u64::from(o.count);
        let name = printable::name(&o.name);
        lines.push(format!(
            "object {i}: {name} (triangles {}..{last})",
            o.first
        ));
    }
    if pvs.objects().len() > OBJECTS_SHOWN {
        lines.push(format!(
            "… and {} more objects; --json lists all",
            pvs.objects().len() - OBJECTS_SHOWN
        ));
    }
    print(&lines.join("\n"))
}

/// Formats a point. The coordinates were single-precision numbers, so the function prints them in single
/// precision.
fn corner(point: &serde_json::Value) -> String {
    let coordinates = point.as_array().map_or(&[][..], |c| c);
    let short: Vec<String> = coordinates
        .iter()
        .map(|c| {
            c.as_f64()
                .map_or("?".to_owned(), |c| (c as f32).to_string())
        })
        .collect();
    format!("({})", short.join(", "))
}
