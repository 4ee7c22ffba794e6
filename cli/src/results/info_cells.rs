//! `sightline info --cells`: prints the sampling of each cell, the hardest cells first, and their bounds.
//!
//! The numbers are columns of the result file and the same on every run of a job. So they include no times;
//! the number of rays represents the time.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use sightline::{CellIndex, Error};
use sightline_model::bound::{ALPHA, alpha_of, upper_bound};
use sightline_model::statistics::VIEWPOINT_WEIGHT;
use sightline_pvs::Pvs;
use sightline_view::{Map, each};

/// The number of cells that `info --cells` lists without --json.
const SHOWN: usize = 20;

/// The bounds of a result on the fraction of missed sight lines, 0 to 1, at 95 % confidence.
pub struct Bounds {
    /// The number of cells that have a bound.
    pub cells: usize,
    /// The largest bound.
    pub greatest: f64,
    /// The mean bound.
    pub mean: f64,
}

/// Returns the columns of a result by name.
fn columns(pvs: &Pvs) -> Result<BTreeMap<String, Vec<u64>>, Error> {
    Ok(pvs
        .columns()?
        .into_iter()
        .map(|c| (c.name, c.values))
        .collect())
}

/// Returns a cell's bound on the fraction of sight lines that it misses, with confidence 95 %.
fn bound(columns: &BTreeMap<String, Vec<u64>>, names: [&str; 3], cell: usize) -> Option<f64> {
    let at = |name: &str| {
        columns
            .get(name)
            .and_then(|c| c.get(cell))
            .copied()
            .unwrap_or(0)
    };
    let [lines, misses, look] = names.map(at);
    let look = u32::try_from(look).unwrap_or(u32::MAX);
    (lines > 0).then(|| upper_bound(misses, lines, alpha_of(look)))
}

/// Returns the volume of a cell, in cubic units of the scene.
pub fn volume(pvs: &Pvs, cell: u32) -> f64 {
    let bounds = pvs.cell_bounds(cell);
    bounds.map_or(0.0, |[min, max]| {
        (0..3)
            .map(|axis: usize| f64::from(max[axis]) - f64::from(min[axis]))
            .product()
    })
}

/// Returns the expected set: the mean number of triangles to draw over all viewpoints. The weights of the
/// cells are a column of the result. Without this column, the weight of a cell with viewpoints is its volume.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn expected_set(pvs: &Pvs) -> Result<f64, Error> {
    let columns = columns(pvs)?;
    let weights = columns.get(VIEWPOINT_WEIGHT);
    let (mut sum, mut all) = (0.0, 0.0);
    for cell in 0..pvs.cells() {
        if !pvs.is_reached(cell)? {
            continue;
        }
        let weight = match weights.and_then(|weights| weights.get(cell as usize)) {
            Some(weight) => *weight as f64,
            None => volume(pvs, cell),
        };
        all += weight;
        sum += weight * f64::from(pvs.visible_count(cell)?);
    }
    Ok(if all > 0.0 { sum / all } else { 0.0 })
}

/// The columns of the bound on missed triangles: held-out lines, lines that missed, and the number of the
/// look.
const OF_TRIANGLES: [&str; 3] = ["bound_lines", "bound_misses", "bound_look"];
/// The columns of the bound on missed cells: held-out lines, lines that missed, and the number of the look.
const OF_CELLS: [&str; 3] = ["bound_cell_lines", "bound_cell_misses", "bound_cell_look"];

/// The decisions of exact queries over all cells, as numbers of pairs of a cell and a triangle. All numbers
/// are 0 for a sampled result.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Decided {
    /// The number of pairs that are proved hidden.
    pub hidden: u64,
    /// The number of hidden pairs whose triangle is hidden by its own closed surface.
    pub by_surfaces: u64,
    /// The number of visible pairs that sampling had missed.
    pub missed: u64,
    /// The number of hidden pairs that sampling had shown.
    pub refuted: u64,
    /// The number of pairs that are undecided because the time ended.
    pub out_of_time: u64,
    /// The number of cells with such pairs.
    pub cells_out_of_time: usize,
    /// The number of pairs that are undecided because a query exceeded a limit.
    pub beyond_limits: u64,
    /// The number of cells with undecided triangles.
    pub cells_open: usize,
    /// The size of witnesses and certificates, in bytes.
    pub evidence_bytes: u64,
}

/// Sums the decisions of exact queries over all cells.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn decided(pvs: &Pvs) -> Result<Decided, Error> {
    let columns = columns(pvs)?;
    let sum = |name: &str| {
        columns
            .get(name)
            .map_or(0, |c| c.iter().fold(0u64, |a, b| a.saturating_add(*b)))
    };
    let reasons = [
        "undecided_regions",
        "undecided_memory",
        "undecided_halvings",
    ];
    let (mut open, mut evidence_bytes) = (0, 0);
    for cell in 0..pvs.cells() {
        open += usize::from(pvs.undecided_count(cell)? > 0);
        evidence_bytes += pvs.certificate(cell)?.map_or(0, |e| e.len() as u64);
    }
    Ok(Decided {
        hidden: sum("exact_hidden"),
        by_surfaces: sum("exact_enclosed"),
        missed: sum("exact_missed"),
        refuted: sum("exact_refuted"),
        out_of_time: sum("undecided_stopped"),
        cells_out_of_time: columns
            .get("undecided_stopped")
            .map_or(0, |c| c.iter().filter(|n| **n > 0).count()),
        beyond_limits: reasons.iter().fold(0, |a, r| sum(r).saturating_add(a)),
        cells_open: open,
        evidence_bytes,
    })
}

/// Counts the unfinished and the spared cells. The sampling of an unfinished cell ended before its target. A
/// spared cell has a per-cell tolerance above the target error.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn unfinished_and_spared(pvs: &Pvs) -> Result<[usize; 2], Error> {
    let columns = columns(pvs)?;
    let count = |name| {
        columns
            .get(name)
            .map_or(0, |c| c.iter().filter(|n| **n != 0).count())
    };
    Ok(["unfinished", "spared"].map(count))
}

/// Returns the bounds on missed sight lines of a result, or `None` if no cell has a bound.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn bounds(pvs: &Pvs) -> Result<Option<Bounds>, Error> {
    bounds_of(pvs, OF_TRIANGLES)
}

/// Returns the bounds on missed pairs of cells, if the result has any. A bound is the fraction of a cell's
/// sight lines that cross a cell which forms no pair with it.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn pair_bounds(pvs: &Pvs) -> Result<Option<Bounds>, Error> {
    bounds_of(pvs, OF_CELLS)
}

fn bounds_of(pvs: &Pvs, names: [&str; 3]) -> Result<Option<Bounds>, Error> {
    let columns = columns(pvs)?;
    let all: Vec<f64> = (0..pvs.cells() as usize)
        .filter_map(|c| bound(&columns, names, c))
        .collect();
    let sum: f64 = all.iter().sum();
    Ok((!all.is_empty()).then(|| Bounds {
        cells: all.len(),
        greatest: all.iter().copied().fold(0.0, f64::max),
        mean: sum / all.len() as f64,
    }))
}

/// Returns heat maps of the bake's statistics.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn maps(pvs: &Pvs) -> Result<Vec<Map>, Error> {
    let columns = columns(pvs)?;
    let rays = [
        "rays_uniform",
        "rays_flood",
        "rays_candidate",
        "rays_check",
        "exact_rays",
    ];
    let at = |name: &str, cell: CellIndex| columns.get(name).map_or(0, |c| c[cell.at()]);
    Ok(vec![
        each(pvs, "rays", |_, cell| {
            Ok(rays
                .iter()
                .map(|name| at(name, CellIndex(cell)) as f32)
                .sum())
        })?,
        each(pvs, "bound on missed sight lines", |_, cell| {
            Ok(bound(&columns, OF_TRIANGLES, cell as usize).map_or(f32::NAN, |bound| bound as f32))
        })?,
    ])
}

/// Returns for each cell the bound on the fraction of sight lines that it misses, if it has one.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn bounds_of_cells(pvs: &Pvs) -> Result<Vec<Option<f64>>, Error> {
    let columns = columns(pvs)?;
    Ok((0..pvs.cells() as usize)
        .map(|cell| bound(&columns, OF_TRIANGLES, cell))
        .collect())
}

/// Returns a JSON array with one object per cell.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn json(pvs: &Pvs) -> Result<Value, Error> {
    let columns = columns(pvs)?;
    let mut cells = Vec::new();
    for cell in 0..pvs.cells() {
        let [min, max] = pvs.cell_bounds(cell).unwrap_or_default();
        let mut line =
            json!({"cell": cell, "min": min, "max": max, "visible": pvs.visible_count(cell)?});
        for (name, values) in &columns {
            line[name] = values[cell as usize].into();
        }
        if let Some(bound) = bound(&columns, OF_TRIANGLES, cell as usize) {
            line["bound"] = bound.into();
            line["confidence"] = (1.0 - ALPHA).into();
        }
        cells.push(line);
    }
    Ok(cells.into())
}

/// Returns the cells with the most rays, as a table.
///
/// # Errors
/// An error of the kind [`sightline::ErrorKind::Input`] if the result cannot be read.
pub fn table(pvs: &Pvs) -> Result<Vec<String>, Error> {
    let columns = columns(pvs)?;
    let none = Vec::new();
    let column = |name: &str| columns.get(name).unwrap_or(&none);
    let at = |name: &str, cell: usize| column(name).get(cell).copied().unwrap_or(0);
    if columns.is_empty() {
        return Ok(vec![
            "this result contains no statistics of its cells".to_owned(),
        ]);
    }
    let kinds = [
        "rays_uniform",
        "rays_flood",
        "rays_candidate",
        "rays_check",
        "samples",
    ];
    let finds = [
        "finds_uniform",
        "finds_flood",
        "finds_candidate",
        "finds_check",
    ];
    let cost = |cell: usize| {
        kinds
            .iter()
            .fold(0u64, |sum, k| sum.saturating_add(at(k, cell)))
    };
    let mut order: Vec<usize> = (0..pvs.cells() as usize).collect();
    order.sort_by_key(|c| (std::cmp::Reverse(cost(*c)), *c));
    let exact = pvs.method() != "aggressive";
    let mut lines = vec![format!(
        "the cells with the most rays{}. rays: numbers of uniform/flood/candidate/held-out rays; finds: \
         triangles that rays of each kind were the first to show (held-out: lines that met a triangle \
         outside the set); missed: fraction of the last round's uniform rays that met a triangle outside \
         the set before that round; bound: upper limit of the fraction of sight lines still missed, at \
         95 % confidence; *: not finished; ~: finished with a tolerance above \
         the target error",
        if exact {
            " in sampling, which came first"
        } else {
            ""
        }
    )];
    let mut rows = vec![
        [
            "cell", "visible", "rounds", "cubes", "rays", "finds", "missed", "bound",
        ]
        .map(str::to_owned),
    ];
    for cell in order.iter().copied().take(SHOWN) {
        let visible = pvs.visible_count(cell as u32)?;
        let list = |names: &[&str]| {
            names
                .iter()
                .map(|n| at(n, cell).to_string())
                .collect::<Vec<_>>()
                .join("/")
        };
        let rays = at("last_rays", cell);
        let missed = if rays > 0 {
            format!(
                "{:.4} %",
                at("last_misses", cell) as f64 / rays as f64 * 100.0
            )
        } else {
            "-".to_owned()
        };
        let bound = bound(&columns, OF_TRIANGLES, cell)
            .map_or("-".to_owned(), |b| format!("{:.4} %", b * 100.0));
        let mark = match (at("unfinished", cell), at("spared", cell)) {
            (1.., _) => " *",
            (_, 1..) => " ~",
            _ => "",
        };
        rows.push([
            cell.to_string(),
            visible.to_string(),
            at("rounds", cell).to_string(),
            at("samples", cell).to_string(),
            list(&kinds[..4]),
            list(&finds),
            missed,
            format!("{bound}{mark}"),
        ]);
    }
    lines.extend(aligned(&rows));
    lines.push("boxes of these cells, in world space".to_owned());
    for cell in order.iter().copied().take(SHOWN) {
        let [min, max] = pvs.cell_bounds(cell as u32).unwrap_or_default();
        lines.push(format!("  {cell}: {min:?} to {max:?}"));
    }
    if order.len() > SHOWN {
        lines.push(format!(
            "… and {} cells with fewer rays; --json lists all cells",
            order.len() - SHOWN
        ));
    }
    if exact {
        lines.extend(exact_table(pvs, &at)?);
    }
    Ok(lines)
}

/// Returns the cells whose exact queries visited the most regions of line space, as a table.
fn exact_table(pvs: &Pvs, at: &dyn Fn(&str, usize) -> u64) -> Result<Vec<String>, Error> {
    let mut order: Vec<usize> = (0..pvs.cells() as usize).collect();
    order.sort_by_key(|c| (std::cmp::Reverse(at("exact_regions", *c)), *c));
    let mut lines = vec![
        "the cells whose exact queries needed the most work; queries about the box around a cell group \
         count for the first cell of the group. group: triangles hidden from the box around the cell's \
         group; surfaces: of the other hidden triangles, the triangles hidden by their own closed \
         surface; missed: visible triangles that sampling had not shown; regions: \
         visited regions of line space, on which queries spend their time"
            .to_owned(),
    ];
    let mut rows = vec![
        [
            "cell",
            "undecided",
            "hidden",
            "group",
            "surfaces",
            "missed",
            "queries",
            "regions",
        ]
        .map(str::to_owned),
    ];
    for cell in order.iter().copied().take(SHOWN) {
        let undecided = pvs.undecided_count(cell as u32)?;
        let [hidden, above, surfaces, missed, queries, regions] = [
            "exact_hidden",
            "exact_above",
            "exact_enclosed",
            "exact_missed",
            "exact_queries",
            "exact_regions",
        ]
        .map(|name| at(name, cell).to_string());
        rows.push([
            cell.to_string(),
            undecided.to_string(),
            hidden,
            above,
            surfaces,
            missed,
            queries,
            regions,
        ]);
    }
    lines.extend(aligned(&rows));
    Ok(lines)
}

/// Formats rows as right-aligned lines. Each column is as wide as its widest entry.
fn aligned<const N: usize>(rows: &[[String; N]]) -> Vec<String> {
    let width = |k: usize| rows.iter().map(|r| r[k].chars().count()).max().unwrap_or(0);
    let widths: [usize; N] = std::array::from_fn(width);
    let line = |row: &[String; N]| {
        let cells: Vec<String> = row
            .iter()
            .zip(widths)
            .map(|(c, w)| format!("{c:>w$}"))
            .collect();
        format!("  {}", cells.join("  "))
    };
    rows.iter().map(line).collect()
}
