//! `sightline report`: writes a result's error, its cells over budget and the responsible openings as one
//! HTML document.

use std::path::Path;
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use sightline::Error;
use sightline::NamedResult;
use sightline::output::{Format, Output};
use sightline::tracers::{note_other, open_tracer};
use sightline::viewpoints::region_of_result;
use sightline::words::plural;
use sightline_measure::{Frame, Report, Viewpoints, WorstFrameOptions, measure};
use sightline_pvs::Pvs;
use sightline_report::{
    Blame, Budget, Costs, Divisions, OverBudget, PageHeader, blame, over_budget, page,
};
use sightline_trace::sight::{SightLineTracer, least_step};
use sightline_trace::{CubeSpec, PreparedScene, Strata, layers};

use crate::args::results::ReportArgs;
use crate::results::info::Summary;
use crate::results::info_cells;
use crate::scenes::read::scene_of;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// The number of worst frames that are shown.
const FRAMES: usize = 6;
/// The number of cells that are listed without a budget.
const COSTLIEST: usize = 20;

/// The minimum saving of an opening that the summary on stdout names, as a fraction of all drawn triangles.
const WORTH: f64 = 0.005;

/// Writes the report.
pub fn run(args: &ReportArgs, as_json: bool) -> Result<(), Error> {
    let output = Output::check(&args.output, Format::Html, Some(&args.result))?;
    let budget = args.budget.as_deref().map(budget).transpose()?;
    if !(8..=1024).contains(&args.resolution) {
        return Err(Error::usage(format!(
            "--resolution {} is not between 8 and 1024 pixels",
            args.resolution
        )));
    }
    sightline::process::use_threads(sightline::process::threads(None))?;
    let pvs = sightline::open(&args.result)?;
    let found = look(args, &pvs)?;
    let costs = &found.costs;
    let over = over_budget(&pvs, &found.by_object, budget.as_ref(), COSTLIEST);
    let bounds = info_cells::bounds_of_cells(&pvs)?;
    let sizes = costs
        .cells
        .iter()
        .map(|drawn| drawn.iter().map(|(_, count)| u64::from(*count)).sum());
    let summary = Summary::open(&args.result)?;
    let about = PageHeader {
        title: title(&args.result),
        by_cost: divisions(&summary.info),
        summary: summary.lines(),
        error: &found.error,
        frames: found.frames,
        cells: sizes.zip(bounds).collect(),
        budget,
        over: over.clone(),
        blame: found.blame.clone(),
    };
    let text = page(&about, &|bytes| STANDARD.encode(bytes));
    output.write(|out| {
        out.write_all(text.as_bytes())
            .map_err(|e| Error::writing(output.path(), &e))
    })?;
    tell(
        &output,
        &found.error,
        budget.is_some().then_some(&over),
        &found.blame,
        as_json,
    )?;
    if args.fail_over_budget && budget.is_some() && !over.is_empty() {
        let cells = plural(over.len(), "cell");
        return Err(Error::different(format!("{cells} are over the budget")));
    }
    Ok(())
}

/// Returns the divisions of a result with cells by cost.
fn divisions(info: &Value) -> Option<Divisions> {
    let choice = info.get("cells_by_cost")?;
    let point =
        |division: &Value| Some([division["bytes"].as_f64()?, division["expected"].as_f64()?]);
    Some(Divisions {
        hull: choice["hull"]
            .as_array()?
            .iter()
            .filter_map(point)
            .collect(),
        chosen: point(&choice["chosen"])?,
        unit: choice["cost"].as_str()?.to_owned(),
    })
}

fn title(result: &Path) -> String {
    result
        .file_name()
        .unwrap_or(result.as_os_str())
        .to_string_lossy()
        .into_owned()
}

/// Reads a budget.
fn budget(path: &Path) -> Result<Budget, Error> {
    let bad = |e: String| {
        Error::input(format!(
            "{}: {e}; give --budget a JSON object with some of \"triangles\", \"objects\", \"bytes\" and \
             \"bytes_per_triangle\"",
            path.display()
        ))
    };
    let text =
        std::fs::read_to_string(path).map_err(|e| bad(format!("the file cannot be read: {e}")))?;
    let budget: Budget = serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
    if (budget.triangles, budget.objects, budget.bytes) == (None, None, None) {
        return Err(bad("the budget contains no limit".to_owned()));
    }
    Ok(budget)
}

/// The measurements of a report.
struct ReportContents {
    error: Report,
    /// The worst frames with their pictures.
    frames: Vec<(Frame, Vec<u8>)>,
    costs: Costs,
    /// The costs by objects, for budgets.
    by_object: Costs,
    blame: Blame,
}

/// Measures the error, and searches for openings.
fn look(args: &ReportArgs, pvs: &Pvs) -> Result<ReportContents, Error> {
    let result = NamedResult::new(pvs, &args.result);
    let scene = scene_of(&args.scene, &args.kinds, result)?;
    let region = region_of_result(result, &scene)?;
    let is_place = |p: [f32; 3]| {
        pvs.find_cell(p)
            .is_some_and(|c| pvs.is_reached(c).unwrap_or(false))
            && region.as_ref().is_none_or(|region| region.holds(p.into()))
    };
    let views =
        Viewpoints::random_where(args.viewpoints, args.seed, pvs.tree().view_box(), is_place);
    let spec = CubeSpec {
        resolution: args.resolution,
        strata: Strata::One,
        keep_pixels: false,
    };
    let (profile, backend) = open_tracer(args.backend, &scene, spec, &Terminal::new())?;
    let step = least_step(scene.bounds());
    let prepared = PreparedScene::new(Arc::clone(&scene))?;
    let info: Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    let made = info["profile"].as_str().unwrap_or_default();
    note_other(made, &profile, &Terminal::new());
    let far = info["spec"]["visibility"]["far"].as_f64();
    let renderer =
        layers::renderer(&*backend, &prepared, spec, None, far).map_err(Error::internal)?;
    let folder = tempfile::tempdir().map_err(Error::internal)?;
    let options = WorstFrameOptions {
        images_dir: Some(folder.path().to_owned()),
        turntable: None,
        images: FRAMES,
        worst: args.viewpoints as usize,
    };
    let progress = Terminal::new();
    let report = measure(&*renderer, pvs, &views, &options, &mut |done, total| {
        progress.count(done, total, "frames");
        true
    });
    progress.end();
    let error = report.map_err(|e| Error::input(e.to_string()))?;
    let mut frames = Vec::new();
    for frame in error.worst.iter().filter(|frame| frame.error > 0.0) {
        if let Some(path) = &frame.image {
            frames.push((frame.clone(), std::fs::read(path).map_err(Error::internal)?));
        }
    }
    let input =
        |e: sightline_report::ReportError| Error::input(format!("{}: {e}", args.result.display()));
    let costs = Costs::count(pvs, &scene).map_err(input)?;
    let by_object = Costs::count_objects(pvs, &scene).map_err(input)?;
    let sight = SightLineTracer::new(&*backend, prepared.traced())
        .map_err(Error::internal)?
        .up_to(far);
    // Viewpoints inside walls count if they count in the sets of the result.
    let in_region = |p: glam::Vec3| region.as_ref().is_none_or(|region| region.holds(p));
    let blame = blame(&sight, pvs, &scene, &costs, args.seed, step, &in_region).map_err(input)?;
    Ok(ReportContents {
        error,
        frames,
        costs,
        by_object,
        blame,
    })
}

/// Prints a summary of the report to stdout.
fn tell(
    output: &Output,
    error: &Report,
    over: Option<&Vec<OverBudget>>,
    blame: &Blame,
    as_json: bool,
) -> Result<(), Error> {
    let path = output.path().display().to_string();
    if as_json {
        return print(
            &json!({
                "output": path, "mean_error": error.mean_error, "p99_error": error.p99_error,
                "max_error": error.max_error, "over_budget": over,
                "blame": blame,
            })
            .to_string(),
        );
    }
    print(&format!("wrote {path}"))?;
    if let Some(over) = over {
        print(&format!("cells over budget: {}", over.len()))?;
    }
    if let Some(best) = blame.openings.first().filter(|best| best.saves >= WORTH) {
        let [min, max] = best.opening.bounds;
        print(&format!(
            "closing the opening in the box {min:?} to {max:?} would save about {:.1} % of the triangles \
             that all cells draw",
            best.saves * 100.0
        ))?;
    } else {
        say("the command found no single opening whose closing would save much");
    }
    Ok(())
}
