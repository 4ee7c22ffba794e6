//! `sightline view`: shows a result and its scene as a page, which it writes to a file or serves on this
//! machine.

use std::io::IsTerminal as _;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use sightline::NamedResult;
use sightline::output::{Format, Output};
use sightline::viewpoints::region_of_result;
use sightline::words::plural;
use sightline::{CellIndex, Error};
use sightline_pvs::Pvs;
use sightline_scene::Scene;
use sightline_view::{Map, View, ViewRequest, Worst, page};

use crate::args::results::ViewArgs;
use crate::results::info::Summary;
use crate::results::info_cells;
use crate::results::view_server;
use crate::scenes::read::scene_of;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Maximum number of cells of a result for which the command searches a viewpoint per cell, if walls enclose
/// the viewpoints.
const MOST_PLACES: u32 = 1 << 15;

/// Creates the page, and writes or serves it.
pub fn run(args: &ViewArgs, json: bool) -> Result<(), Error> {
    let output = args
        .output
        .as_ref()
        .map(|path| Output::check(path, Format::Html, Some(&args.result)))
        .transpose()?;
    let pvs = sightline::open(&args.result)?;
    let scene = match &args.scene {
        Some(path) => Some(scene_of(
            path,
            &args.kinds,
            NamedResult::new(&pvs, &args.result),
        )?),
        None => None,
    };
    let served = output.is_none();
    let mut view = View::new(&pvs, scene.as_deref())?;
    let of_served = scene.as_deref().filter(|_| served);
    view.ask = of_served.and_then(|scene| ViewRequest::about(scene, view_server::PATH, None));
    view.title = title(&args.result, args.scene.as_deref());
    view.about = Summary::open(&args.result)?.lines().join("\n");
    if let Some(up) = args.up {
        view.up = if up.to_string() == "z" { 2 } else { 1 };
    }
    view.maps.extend(
        info_cells::maps(&pvs)?
            .into_iter()
            .filter(Map::says_something),
    );
    view.places = places(&pvs, scene.as_deref(), &args.result)?;
    view.worst = args
        .worst
        .as_deref()
        .map(|file| worst(file, &pvs))
        .transpose()?
        .unwrap_or_default();
    view.start = match args.cell {
        Some(cell) if cell < pvs.cells() => CellIndex(cell),
        Some(cell) => {
            return Err(Error::usage(format!(
                "--cell {cell} does not exist: {} has {}, numbered from 0",
                args.result.display(),
                plural(pvs.cells() as usize, "cell")
            )));
        }
        None => view.start,
    };
    let page = page(&view).map_err(|e| Error::input(format!("{}: {e}", args.result.display())))?;
    match output {
        Some(output) => {
            output.write(|out| {
                out.write_all(page.as_bytes())
                    .map_err(|e| Error::writing(output.path(), &e))
            })?;
            let (path, bytes) = (output.path().display().to_string(), page.len());
            print(&match json {
                true => serde_json::json!({"output": path, "bytes": bytes}).to_string(),
                false => format!("wrote {path}, {bytes} bytes: open it in a browser"),
            })
        }
        None => serve_page(args, page, pvs, scene, json),
    }
}

fn title(result: &Path, scene: Option<&Path>) -> String {
    let name = |path: &Path| {
        path.file_name()
            .unwrap_or(path.as_os_str())
            .to_string_lossy()
            .into_owned()
    };
    match scene {
        Some(scene) => format!("{} – {}", name(result), name(scene)),
        None => name(result),
    }
}

/// Returns a viewpoint for each cell if walls restrict the viewpoints to a region, and otherwise an empty
/// list. The coordinates are NaN for a cell without a found viewpoint.
fn places(pvs: &Pvs, scene: Option<&Scene>, result: &Path) -> Result<Vec<[f32; 3]>, Error> {
    let Some(scene) = scene.filter(|_| pvs.cells() <= MOST_PLACES) else {
        return Ok(Vec::new());
    };
    let Some(region) = region_of_result(NamedResult::new(pvs, result), scene)? else {
        return Ok(Vec::new());
    };
    let viewpoint_in = |cell: CellIndex| {
        let [min, max] = pvs.cell_bounds(cell.0)?;
        region.any_in(sightline_scene::Aabb::new(min.into(), max.into()))
    };
    Ok((0..pvs.cells())
        .map(|cell| viewpoint_in(CellIndex(cell)).map_or([f32::NAN; 3], |p| p.to_array()))
        .collect())
}

/// Reads the worst frames from the output of `sightline measure`.
fn worst(file: &Path, pvs: &Pvs) -> Result<Vec<Worst>, Error> {
    let bad = |what: String| {
        Error::input(format!(
            "{}: {what}; give --worst the output of `sightline measure --json`",
            file.display()
        ))
    };
    let text =
        std::fs::read_to_string(file).map_err(|e| bad(format!("the file cannot be read: {e}")))?;
    let report: Value =
        serde_json::from_str(&text).map_err(|e| bad(format!("the content is not JSON: {e}")))?;
    let frames = report["worst"]
        .as_array()
        .ok_or_else(|| bad("the list \"worst\" is missing".to_owned()))?;
    let frame = |value: &Value| {
        let at = value["viewpoint"].as_array().filter(|at| at.len() == 3)?;
        let mut viewpoint = [0.0; 3];
        for (x, value) in viewpoint.iter_mut().zip(at) {
            *x = value.as_f64()? as f32;
        }
        let cell = u32::try_from(value["cell"].as_u64()?)
            .ok()
            .filter(|cell| *cell < pvs.cells())?;
        Some(Worst {
            viewpoint,
            cell: CellIndex(cell),
            error: value["error"].as_f64()?,
        })
    };
    let all: Option<Vec<Worst>> = frames.iter().map(frame).collect();
    all.ok_or_else(|| {
        bad("a frame of the list \"worst\" is malformed, or belongs to another result".to_owned())
    })
}

/// Serves the page on this machine until it is interrupted.
fn serve_page(
    args: &ViewArgs,
    page: String,
    pvs: Pvs,
    scene: Option<Arc<Scene>>,
    json: bool,
) -> Result<(), Error> {
    let runtime = sightline::process::runtime()?;
    let ended = runtime.block_on(async {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
        let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
            Error::usage(format!(
                "the page cannot be served at {address}: {e}; give another --port, or 0 for any free port"
            ))
        })?;
        let port = listener.local_addr().map_err(Error::internal)?.port();
        let url = format!("http://127.0.0.1:{port}/");
        print(&match json {
            true => serde_json::json!({"url": url}).to_string(),
            false => format!(
                "{url} shows {} until you press Ctrl-C",
                args.result.display()
            ),
        })?;
        if !args.no_open && std::io::stdout().is_terminal() {
            open(&url);
        }
        let server = axum::serve(listener, view_server::pages(page, &args.result, pvs, scene));
        // A running query would delay a graceful end, so the server is dropped.
        tokio::select! {
            ended = async { server.await } => ended.map_err(Error::internal),
            () = crate::terminal::interrupt::stop_signal() => Ok(()),
        }
    });
    runtime.shutdown_timeout(Duration::from_millis(200));
    ended
}

/// Opens an address in the user's browser.
fn open(url: &str) {
    let (program, before): (&str, &[&str]) = if cfg!(target_os = "macos") {
        ("open", &[])
    } else if cfg!(windows) {
        ("cmd", &["/c", "start", ""])
    } else {
        ("xdg-open", &[])
    };
    let nothing = Stdio::null;
    let opened = Command::new(program)
        .args(before)
        .arg(url)
        .stdin(nothing())
        .stdout(nothing())
        .stderr(nothing())
        .spawn();
    if let Err(e) = opened {
        say(&format!(
            "note: no browser was opened ({program}: {e}); open the address yourself"
        ));
    }
}
