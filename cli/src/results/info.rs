//! `sightline info`: the summary of a result.

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

/// The version of what `info` and `dump` print.
const DUMP_VERSION: u32 = 1;
/// Objects listed by `info` without --json.
const OBJECTS_SHOWN: usize = 20;

/// The summary of a result that `info` and the end of a bake print.
#[derive(Serialize)]
pub struct Summary {
    pub format: &'static str,
    pub version: u32,
    pub method: String,
    pub triangles: u32,
    pub objects: usize,
    /// What the sets name: triangles, clusters or objects.
    granularity: &'static str,
    /// How many there are.
    pub items: u32,
    pub cells: u32,
    /// Cells in which viewpoints can be. Only these count in means.
    cells_reached: u32,
    pub view_box: serde_json::Value,
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
    /// Which cells see which; `None` when the result does not say.
    cell_to_cell: Option<CellToCell>,
    /// What exact queries decided; `None` for the method aggressive.
    decided: Option<info_cells::Decided>,
    /// Cells of an adaptive tree that see more triangles than its budget; `None` for a grid.
    cells_over_budget: Option<usize>,
    pub info: serde_json::Value,
    /// Whether walls enclose all viewpoints.
    in_region: bool,
}

/// How many cells see which.
#[derive(Serialize)]
struct CellToCell {
    /// Pairs of different cells that see each other, the undecided ones included.
    pairs: u64,
    /// Their part of all pairs of different cells of which one at least is reached.
    density: f64,
    undecided: u64,
    bytes: u64,
    /// The greatest and the mean bound, at 95 %, on the fraction of sight lines from a cell that cross a cell
    /// which is no pair with it.
    greatest_bound: Option<f64>,
    mean_bound: Option<f64>,
}

impl CellToCell {
    fn of(pvs: &Pvs) -> Result<Option<Self>, Error> {
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

/// A set with more than this fraction of the triangles hides little.
const MUCH: f64 = 0.5;

impl Summary {
    /// Whether exact queries took part.
    pub fn is_decided(&self) -> bool {
        self.decided.is_some()
    }

    /// Whether the sets are what portals do not hide.
    fn by_portals(&self) -> bool {
        self.method == "portals"
    }

    /// Whether no triangle is seen from any cell.
    pub fn sees_nothing(&self) -> bool {
        self.max_visible == 0
    }

    /// Reads the result at `path`.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let pvs = open(path)?;
        // Another program may have written the result, so its parameters may be anything.
        let info: serde_json::Value =
            serde_json::from_str(pvs.info_json()).unwrap_or_else(|_| pvs.info_json().into());
        let budget =
            find_field(&info["spec"], "triangle_budget").and_then(serde_json::Value::as_u64);
        // Collected before the error is taken, so that the first damaged cell is reported on every run.
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
        // Cells without viewpoints count in nothing.
        let sets: Vec<(u64, u64, bool)> = sets
            .into_iter()
            .filter(|s| s.3)
            .map(|(visible, open, aside, _)| (visible, open, aside))
            .collect();
        let sizes: Vec<u64> = sets.iter().map(|s| s.0).collect();
        let undecided: u64 = sets.iter().map(|s| s.1).sum();
        let aside = sets.iter().filter(|s| s.2).count() as u32;
        // A cell that was set aside shows all triangles; this does not count as over the budget.
        let over = sets
            .iter()
            .filter(|s| !s.2 && budget.is_some_and(|b| s.0 > b))
            .count();
        let bounds = info_cells::bounds(&pvs)?;
        let [cells_unfinished, cells_spared] = info_cells::unfinished_and_spared(&pvs)?;
        let [file_bytes, visible, undecided_bytes] = pvs.file_bytes();
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
            cell_to_cell: CellToCell::of(&pvs)?,
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

    /// The summary as lines for people.
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
                false => format!("the sets name {} {}", self.items, self.granularity),
            },
            match self.cells_reached == self.cells {
                true => String::new(),
                false => format!(
                    "viewpoints are in {} of {}; the others were not sampled",
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
                // Sampling alone decides nothing, so it has no number of undecided triangles.
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
                undecided => format!(
                    "visible from a cell: between {:.0} and {:.0} triangles on average; \
                     drawn: the latter ({:.2} %), {} to {}; undecided: {undecided} in all cells",
                    self.mean_visible - undecided as f64 / f64::from(self.cells_reached.max(1)),
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
                _ if find_field(&self.info["spec"], "max_error").is_some() => {
                    "missed sight lines: the bound asked for was not reached in any cell".to_owned()
                }
                _ if find_field(&self.info["spec"], "adaptive").is_some() => {
                    "missed sight lines: not bounded (only those of a grid can be)".to_owned()
                }
                _ => "missed sight lines: not bounded (--max-error F bounds them)".to_owned(),
            },
        ];
        if let Some(open) = self.info["tiles_open"].as_u64() {
            lines.push(format!(
                "NOT FINISHED: {open} tiles of the job were not done; their cells show everything"
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
                "{} pairs of cell and triangle are hidden by walls ({} by closed surfaces); {} have no \
                 witness, count as undecided and are drawn",
                d.hidden, d.by_surfaces, self.undecided
            ));
            if self.mean_visible_fraction > MUCH && !self.in_region {
                lines.push(
                    "walls hide little here: portals help where they enclose rooms; `sightline portals` \
                     shows the way out of a scene, and --reachable-from leaves out where nobody is"
                        .to_owned(),
                );
            }
            if d.out_of_time > 0 {
                lines.push(format!(
                    "NOT FINISHED: the time ended first in {} cells",
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
        // Exact queries decide afterwards whatever sampling leaves, so unfinished cells do not matter then.
        if self.cells_unfinished > 0 && self.decided.is_none() {
            let why = match find_field(&self.info["spec"], "time_budget_ms") {
                Some(_) => "the time budget ended first",
                _ => "sampling gave up after many rounds; info --cells lists the hardest cells",
            };
            lines.push(format!(
                "NOT FINISHED: {} of {} cells: {why}",
                self.cells_unfinished, self.cells
            ));
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
    let summary = Summary::of(&args.result.result)?;
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

/// A point in text. Its coordinates come from single precision, so they are printed in single precision.
fn corner(of: &serde_json::Value) -> String {
    let coordinates = of.as_array().map_or(&[][..], |c| c);
    let short: Vec<String> = coordinates
        .iter()
        .map(|c| {
            c.as_f64()
                .map_or("?".to_owned(), |c| (c as f32).to_string())
        })
        .collect();
    format!("({})", short.join(", "))
}
