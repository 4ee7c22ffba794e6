//! `sightline view`: a result and its scene as a page, written as one file or served on this machine.

use std::io::IsTerminal as _;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use sightline::Error;
use sightline::NamedResult;
use sightline::output::{Format, Output};
use sightline::viewpoints::region_of_result;
use sightline::words::plural;
use sightline_pvs::Pvs;
use sightline_scene::Scene;
use sightline_view::{Ask, Map, View, Worst, page};

use crate::args::results::ViewArgs;
use crate::results::info::Summary;
use crate::results::info_cells;
use crate::results::view_server;
use crate::scenes::read::scene_of;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Most cells for which a viewpoint is looked for in the region that walls enclose.
const MOST_PLACES: u32 = 1 << 15;

/// Makes the page, and writes or serves it.
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
    let mut view = View::of(&pvs, scene.as_deref())?;
    let of_served = scene.as_deref().filter(|_| served);
    view.ask = of_served.and_then(|scene| Ask::about(scene, view_server::PATH, None));
    view.title = title(&args.result, args.scene.as_deref());
    view.about = Summary::of(&args.result)?.lines().join("\n");
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
        Some(cell) if cell < pvs.cells() => cell,
        Some(cell) => {
            return Err(Error::usage(format!(
                "--cell {cell}: {} has {}, from 0",
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
        None => serve_page(args, page, (pvs, scene), json),
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

/// A viewpoint for each cell, where viewpoints are in a region alone; NaN where none was found.
fn places(pvs: &Pvs, scene: Option<&Scene>, result: &Path) -> Result<Vec<[f32; 3]>, Error> {
    let Some(scene) = scene.filter(|_| pvs.cells() <= MOST_PLACES) else {
        return Ok(Vec::new());
    };
    let Some(region) = region_of_result(NamedResult::new(pvs, result), scene)? else {
        return Ok(Vec::new());
    };
    let viewpoint_in = |cell: u32| {
        let [min, max] = pvs.cell_bounds(cell)?;
        region.any_in(sightline_scene::Aabb::new(min.into(), max.into()))
    };
    Ok((0..pvs.cells())
        .map(|cell| viewpoint_in(cell).map_or([f32::NAN; 3], |p| p.to_array()))
        .collect())
}

/// The worst frames of what `sightline measure` has printed.
fn worst(file: &Path, pvs: &Pvs) -> Result<Vec<Worst>, Error> {
    let bad = |what: String| {
        Error::input(format!(
            "{}: {what}; give --worst a file with what `sightline measure` printed",
            file.display()
        ))
    };
    let text = std::fs::read_to_string(file).map_err(|e| bad(format!("it cannot be read: {e}")))?;
    let report: Value =
        serde_json::from_str(&text).map_err(|e| bad(format!("it is no JSON: {e}")))?;
    let frames = report["worst"]
        .as_array()
        .ok_or_else(|| bad("it has no list \"worst\"".to_owned()))?;
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
            cell,
            error: value["error"].as_f64()?,
        })
    };
    let all: Option<Vec<Worst>> = frames.iter().map(frame).collect();
    all.ok_or_else(|| {
        bad("a frame of its list \"worst\" is malformed, or of another result".to_owned())
    })
}

/// Serves the page on this machine until it is interrupted.
fn serve_page(
    args: &ViewArgs,
    page: String,
    (pvs, scene): (Pvs, Option<Arc<Scene>>),
    json: bool,
) -> Result<(), Error> {
    let runtime = sightline::process::runtime()?;
    let ended = runtime.block_on(async {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
        let listener = tokio::net::TcpListener::bind(address).await.map_err(|e| {
            Error::usage(format!(
                "{address} cannot be listened on: {e}; give another --port, or 0 for any"
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
        // A query that is under way would delay a graceful end.
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
