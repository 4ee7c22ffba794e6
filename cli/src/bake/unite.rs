//! `sightline bake --from`: writes the cells by cost of a fine result, without sampling.

use std::time::Instant;

use serde_json::Value;
use sightline::words::human;
use sightline::{
    CellBudgetOptions, Error, JobOptions, NamedResult, SceneSource, check_scene, open, read_scene,
    unite_cells,
};

use crate::args::cli::BakeArgs;
use crate::bake::resources::peak_memory;
use crate::results::info::Summary;
use crate::terminal::progress::Terminal;

/// Unites the sets of the result `args.from`.
pub fn run(args: &BakeArgs, from: &std::path::Path, json: bool) -> Result<(), Error> {
    let start = Instant::now();
    refuse_unused(args)?;
    let Some(choice) = args.job.by_cost.choice()? else {
        return Err(Error::usage("--from needs --cell-budget or --byte-budget").about("from"));
    };
    let terminal = Terminal::new();
    let source = SceneSource::File(args.scene.clone());
    let scene = read_scene(&source, &args.kinds.options, &terminal)?;
    let fine = open(from)?;
    let named = NamedResult::new(&fine, from);
    check_scene(&scene, &args.scene, named)?;
    let viewpoints = args.job.viewpoints.viewpoints.as_deref();
    unite_cells(named, &choice, viewpoints, &args.output, &terminal)?;
    terminal.end();
    let summary = Summary::open(&args.output)?;
    if json {
        let mut value = serde_json::to_value(&summary).map_err(Error::internal)?;
        value["output"] = args.output.display().to_string().into();
        value["seconds"] = start.elapsed().as_secs_f64().into();
        value["peak_memory_bytes"] = peak_memory().into();
        return crate::terminal::stdout::print(&value.to_string());
    }
    let mut lines = summary.lines();
    lines.push(format!(
        "united from {} in {}; wrote {}",
        from.display(),
        human(start.elapsed()),
        args.output.display()
    ));
    crate::terminal::stdout::print(&lines.join("\n"))
}

/// Rejects options that have no use without sampling.
fn refuse_unused(args: &BakeArgs) -> Result<(), Error> {
    let options = &args.job;
    let mut rest = options.clone();
    rest.by_cost = CellBudgetOptions {
        fine: options.by_cost.fine,
        ..CellBudgetOptions::default()
    };
    rest.viewpoints.viewpoints = None;
    let fields = |options: &JobOptions| serde_json::to_value(options).map_err(Error::internal);
    let (rest, usual) = (fields(&rest)?, fields(&JobOptions::default())?);
    let mut names: Vec<String> = rest
        .as_object()
        .into_iter()
        .flatten()
        .filter(|(name, value): &(&String, &Value)| usual[name.as_str()] != **value)
        .map(|(name, _)| format!("--{}", name.replace('_', "-")))
        .collect();
    let others = [
        ("--workers", args.workers.is_some()),
        ("--data-dir", args.data_dir.is_some()),
    ];
    let given = others.iter().filter(|(_, is_given)| *is_given);
    names.extend(given.map(|(name, _)| (*name).to_owned()));
    match names.is_empty() {
        true => Ok(()),
        false => Err(Error::usage(format!(
            "{} and --from cannot be given together: --from takes the sets of an earlier bake",
            names.join(", ")
        ))),
    }
}
