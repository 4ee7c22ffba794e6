//! The report as one HTML document without scripts.

use std::fmt::Write as _;

use sightline_formats::html::escaped;
use sightline_measure::{Frame, Report};
use sightline_numbers::ids::CellIndex;

use crate::blame::Blame;
use crate::budget::{Budget, OverBudget};
use crate::plots::{cumulative, percent, scatter, scatter_with};

/// The smallest value of the logarithmic axes. Frames and cells with a lower error are at the left border.
const LEAST: f64 = 1e-7;
/// The maximum number of listed cells.
const LISTED: usize = 60;

const STYLE: &str = "
:root { color-scheme: light dark; font: 15px/1.45 system-ui, sans-serif; }
body { max-width: 62em; margin: 1.5em auto; padding: 0 1em; }
h1 { font-size: 1.4em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; width: 100%; }
th, td { text-align: left; padding: .25em .8em .25em 0; border-bottom: 1px solid #8883; vertical-align: top; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
svg { width: 100%; max-width: 520px; font-size: 12px; fill: currentColor; }
.plots { display: flex; flex-wrap: wrap; gap: 1em; } .plots figure { flex: 1 1 24em; margin: 0; }
.frames { display: flex; flex-wrap: wrap; gap: 1em; } .frames figure { margin: 0; }
.frames img { width: 27em; max-width: 100%; image-rendering: pixelated; }
pre { white-space: pre-wrap; }
";

/// The contents of the document.
pub struct PageHeader<'a> {
    /// The title of the document.
    pub title: String,
    /// The summary of the result, line by line.
    pub summary: Vec<String>,
    /// The error of the result, with all frames.
    pub error: &'a Report,
    /// The worst frames with their pictures as PNG.
    pub frames: Vec<(Frame, Vec<u8>)>,
    /// The number of triangles in each cell's set, and the bound on the cell's missed sight lines if it is
    /// known.
    pub cells: Vec<(u64, Option<f64>)>,
    /// The divisions of a result with cells by cost; `None` for other cells.
    pub by_cost: Option<Divisions>,
    /// The budget; `None` for a report without one.
    pub budget: Option<Budget>,
    /// The cells that exceed the budget, or without a budget the cells that draw most.
    pub over: Vec<OverBudget>,
    /// The objects and openings that are responsible for the costs.
    pub blame: Blame,
}

/// The divisions of a fine grid into cells by cost, each with the bytes of its sets and its expected set.
#[derive(Clone, Debug, PartialEq)]
pub struct Divisions {
    /// Divisions at vertices of the lower convex hull.
    pub hull: Vec<[f64; 2]>,
    /// The division of the result.
    pub chosen: [f64; 2],
    /// The unit of the expected set.
    pub unit: String,
}

/// Formats a point with at most two decimals.
fn point(p: [f32; 3]) -> String {
    let [x, y, z] = p.map(|c| {
        let text = format!("{c:.2}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    });
    format!("({x}, {y}, {z})")
}

fn table(out: &mut String, head: &[&str], rows: impl Iterator<Item = Vec<String>>) {
    let cells = |tag: &str, row: &[String]| {
        let cell = |text: &String| match text.starts_with(|c: char| c.is_ascii_digit()) {
            true => format!("<{tag} class=\"n\">{text}</{tag}>"),
            false => format!("<{tag}>{text}</{tag}>"),
        };
        row.iter().map(cell).collect::<String>()
    };
    let names: Vec<String> = head.iter().map(|name| (*name).to_owned()).collect();
    out.push_str("<table><thead><tr>");
    out.push_str(&cells("th", &names));
    out.push_str("</tr></thead><tbody>");
    rows.for_each(|row| {
        out.push_str("<tr>");
        out.push_str(&cells("td", &row));
        out.push_str("</tr>");
    });
    out.push_str("</tbody></table>");
}

/// Returns the document. `base64` encodes bytes as text.
pub fn page(about: &PageHeader<'_>, base64: &dyn Fn(&[u8]) -> String) -> String {
    let mut out = format!(
        "<!doctype html><!-- sightline report --><html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><title>{0}</title>\
         <style>{STYLE}</style></head><body>\
         <h1>{0}</h1><pre>{1}</pre>",
        escaped(&about.title),
        escaped(&about.summary.join("\n"))
    );
    error(&mut out, about, base64);
    divisions(&mut out, about.by_cost.as_ref());
    budget(&mut out, about);
    blame(&mut out, &about.blame);
    out.push_str("</body></html>\n");
    out
}

// Writing to a string cannot fail, so the results of `write!` are dropped.

fn error(out: &mut String, about: &PageHeader<'_>, base64: &dyn Fn(&[u8]) -> String) {
    let e = about.error;
    let _ = write!(
        out,
        "<h2>Error</h2><p>Fraction of wrong pixels from {} random viewpoints, in all directions, at {}×{} \
         pixels per face: {} on average, {} at the 99th percentile, {} at most.</p><div class=\"plots\">",
        e.frames,
        e.resolution,
        e.resolution,
        percent(e.mean_error),
        percent(e.p99_error),
        percent(e.max_error)
    );
    let frames: Vec<f64> = e.worst.iter().map(|f| f.error).collect();
    let _ = write!(
        out,
        "<figure>{}</figure>",
        cumulative(&frames, LEAST, "wrong pixels of a frame")
    );
    let bounds: Vec<f64> = about.cells.iter().filter_map(|(_, bound)| *bound).collect();
    if !bounds.is_empty() {
        let name = "bound on missed sight lines of a cell";
        let _ = write!(out, "<figure>{}</figure>", cumulative(&bounds, LEAST, name));
    }
    let size = |cell: CellIndex| about.cells.get(cell.at()).map_or(0, |c| c.0) as f64;
    let points: Vec<[f64; 2]> = e
        .worst
        .iter()
        .map(|f| [size(f.cell), f.error * 100.0])
        .collect();
    let names = [
        "triangles in the set of a frame's cell",
        "wrong pixels in %",
    ];
    let _ = write!(
        out,
        "<figure>{}</figure></div><h2>Worst frames</h2>",
        scatter(&points, names)
    );
    if about.frames.is_empty() {
        out.push_str("<p>No frame has a wrong pixel.</p>");
        return;
    }
    out.push_str(
        "<p>Green is in the set, red is missing from it, black is sky. The faces +x, +y and +z are above −x, \
         −y and −z.</p><div class=\"frames\">",
    );
    for (frame, picture) in &about.frames {
        let _ = write!(
            out,
            "<figure><img alt=\"\" src=\"data:image/png;base64,{}\"><figcaption>cell {} from {}: {} of the \
             pixels wrong, {} triangles missing</figcaption></figure>",
            base64(picture),
            frame.cell,
            point(frame.viewpoint),
            percent(frame.error),
            frame.wrong_triangles
        );
    }
    out.push_str("</div>");
}

fn divisions(out: &mut String, by_cost: Option<&Divisions>) {
    let Some(by_cost) = by_cost else { return };
    let expected = format!("expected set in {}", escaped(&by_cost.unit));
    let names = ["bytes of sets", &*expected];
    let plot = scatter_with(&by_cost.hull, Some(by_cost.chosen), names);
    let _ = write!(
        out,
        "<h2>Cells by cost</h2><p>The expected set and the bytes of the best divisions of the fine grid for \
         different budgets. The red point is this result.</p><figure>{plot}</figure>"
    );
}

fn budget(out: &mut String, about: &PageHeader<'_>) {
    match &about.budget {
        None => out.push_str(
            "<h2>Costliest cells</h2><p>No budget was given, so these are the cells that draw the most \
             triangles. --budget FILE lists the cells that exceed a budget.</p>",
        ),
        Some(budget) => {
            let limit = |n: Option<u64>, what: &str| n.map(|n| format!("{n} {what}"));
            let limits = [
                limit(budget.triangles, "triangles"),
                limit(budget.objects, "objects"),
                limit(budget.bytes, "bytes"),
            ];
            let limits: Vec<String> = limits.into_iter().flatten().collect();
            let count = about.over.len();
            let _ = write!(
                out,
                "<h2>Cells over budget</h2><p>{count} of {} cells draw more than {}.{}</p>",
                about.cells.len(),
                limits.join(" or "),
                if count > LISTED { format!(" The worst {LISTED}:") } else { String::new() }
            );
        }
    }
    let row = |over: &OverBudget| {
        let named: Vec<String> = over
            .costliest
            .iter()
            .map(|(name, n)| format!("{} ({n})", escaped(name)))
            .collect();
        vec![
            over.cell.to_string(),
            format!("{} to {}", point(over.bounds[0]), point(over.bounds[1])),
            over.triangles.to_string(),
            over.objects.to_string(),
            over.bytes.to_string(),
            named.join(", "),
        ]
    };
    let head = [
        "cell",
        "box",
        "triangles",
        "objects",
        "bytes",
        "costliest objects (drawn triangles)",
    ];
    table(out, &head, about.over.iter().take(LISTED).map(row));
}

fn blame(out: &mut String, blame: &Blame) {
    let what = if blame.are_clusters {
        "cluster"
    } else {
        "object"
    };
    out.push_str("<h2>Openings</h2>");
    if blame.openings.is_empty() {
        let _ = write!(
            out,
            "<p>No {what} is seen through a single opening from most cells.</p>"
        );
    } else {
        let _ = write!(
            out,
            "<p>Boxes through which most cells see a costly {what}, and the estimated fraction of all drawn \
             triangles that are not drawn if the box is closed. The estimates come from sampled segments.</p>"
        );
        let row = |(number, closed): (usize, &crate::blame::Closed)| {
            let [min, max] = closed.opening.bounds;
            vec![
                (number + 1).to_string(),
                format!("{} to {}", point(min), point(max)),
                percent(closed.saves),
                closed.objects.to_string(),
            ]
        };
        let head = ["opening", "box", "saves", "objects seen through the box"];
        table(out, &head, blame.openings.iter().enumerate().map(row));
    }
    let _ = write!(out, "<h2>Blame</h2><p>The costliest {what}s.</p><ul>");
    for object in &blame.objects {
        let through = object.through.map_or_else(String::new, |n| {
            format!(
                " through opening {}; closing the opening saves {} of all drawn triangles",
                n + 1,
                percent(blame.openings.get(n).map_or(0.0, |o| o.saves))
            )
        });
        let _ = write!(
            out,
            "<li><b>{}</b> is seen from {} cells and has {} of all drawn triangles{through}</li>",
            escaped(&object.name),
            object.cells,
            percent(object.share)
        );
    }
    out.push_str("</ul>");
}
