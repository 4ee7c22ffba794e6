//! `sightline tetra`: divides the space between surfaces into convex cells and writes a file, or checks a
//! file.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use serde_json::json;
use sightline::Error;
use sightline::output::{Format, Output};
use sightline::process::threads;
use sightline::words::human;
use sightline::words::plural;
use sightline_scene::Scene;
use sightline_tetra::check::check;
use sightline_tetra::file::write;
use sightline_tetra::surfaces::{FLAT, Surfaces};
use sightline_tetra::{BuildError, BuildObserver, BuildStage, TetsError, build};

use crate::args::tetra::TetraArgs;
use crate::bake::resources::peak_memory;
use crate::results::look_tets::open;
use crate::scenes::read::scene;
use crate::scenes::tetra_vtk::export;
use crate::terminal::memory;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// The peak memory per face of a cell while tetrahedra are exported, in bytes. Measured: 430 to 540 on four
/// scenes (`peak_memory_bytes` of `sightline --json tetra … --export`).
const EXPORT: u64 = 480;

/// Builds cells and writes their file, or checks a file.
pub fn run(args: &TetraArgs, json: bool) -> Result<(), Error> {
    sightline::process::use_threads(threads(args.threads.map(usize::from)))?;
    match (&args.tets, &args.output) {
        (Some(tets), None) if args.check => checked(args, tets, json),
        (None, Some(output)) => built(args, output, json),
        _ => Err(Error::usage(
            "give -o OUT.tets and one scene, or --check SCENE OUT.tets".to_owned(),
        )),
    }
}

/// Reads the scene, and returns an error if cells cannot represent it.
fn read(args: &TetraArgs) -> Result<Arc<Scene>, Error> {
    if args.kinds.options.cull_back_faces {
        return Err(Error::usage(
            "cells need both sides of triangles; omit --cull-back-faces".to_owned(),
        ));
    }
    let scene = scene(&args.scene, &args.kinds)?;
    sightline::without_masks(&scene)?;
    Ok(scene)
}

/// An observer that shows progress, and ends the work before it exceeds the available memory.
struct Follower {
    progress: Terminal,
    taken_before: u64,
}

impl BuildObserver for Follower {
    fn done(&self, stage: BuildStage, done: u64, total: u64) {
        let what = match stage {
            BuildStage::Points => "points",
            BuildStage::Cut => "tetrahedra cut",
            BuildStage::Faces => "tetrahedra gathered",
        };
        if done > 0 {
            self.progress.count_so_far(done, total, what);
        }
    }

    fn needs(&self, bytes: u64) -> Result<(), String> {
        self.may_take("the cells", bytes)
    }
}

impl Follower {
    /// Checks that memory is available for `bytes` in total since the start.
    fn may_take(&self, what: &str, bytes: u64) -> Result<(), String> {
        let taken = memory::resident()
            .unwrap_or_default()
            .saturating_sub(self.taken_before);
        match memory::available() {
            Some(free) if bytes.saturating_sub(taken) > free => Err(format!(
                "{what} need at least {} of memory, and {} are free; end other programs, divide the \
                 scene, or use a machine with more memory",
                memory::in_words(bytes),
                memory::in_words(free)
            )),
            _ => Ok(()),
        }
    }
}

fn built(args: &TetraArgs, output: &Path, json: bool) -> Result<(), Error> {
    let start = Instant::now();
    let file = Output::check(output, Format::Tets, Some(&args.scene))?;
    let mesh = args
        .export
        .as_ref()
        .map(|path| Output::check(path, Format::Vtu, Some(&args.scene)));
    let mesh = mesh.transpose()?;
    if mesh.as_ref().is_some_and(|mesh| mesh.is(&file)) {
        return Err(Error::usage(format!(
            "-o and --export both name {}; give two different files",
            output.display()
        )));
    }
    let scene = read(args)?;
    let follower = Follower {
        progress: Terminal::new(),
        taken_before: memory::resident().unwrap_or_default(),
    };
    let built = build(&scene, &follower);
    follower.progress.end();
    let built = built.map_err(|e| match e {
        BuildError::Cells(e @ sightline_tetra::cells::CellsError::NotConforming { .. }) => {
            Error::internal(e)
        }
        e => Error::input(format!("{}: {e}", args.scene.display())),
    })?;
    drop(scene);
    file.write(|out| {
        write(out, &built.contents()).map_err(|e| match e {
            TetsError::Write(e) => Error::writing(output, &e),
            e => Error::internal(e),
        })
    })?;
    let exported = mesh.map(|mesh| {
        let bytes = built.contents().cells.face_count() as u64 * EXPORT;
        follower
            .may_take("the tetrahedra of --export", bytes)
            .map_err(|why| {
                Error::input(format!(
                    "{} is complete, but the file of --export was not written: {why}",
                    output.display()
                ))
            })?;
        export(&built.contents(), &mesh)
    });
    let exported = exported.transpose()?;
    let bytes = std::fs::metadata(output)
        .map_err(|e| Error::writing(output, &e))?
        .len();
    let contents = built.contents();
    let (triangles, vertices) = (
        contents.surfaces.triangles.len(),
        contents.surfaces.points.len(),
    );
    let (added, cells) = (contents.cells.meets.len(), contents.cells.cell_count());
    let seconds = start.elapsed();
    let peak = peak_memory();
    if json {
        let mut value = json!({
            "output": output.display().to_string(),
            "triangles": triangles, "vertices": vertices, "added": added,
            "tetrahedra": built.tetrahedra, "cells": cells, "faces": contents.cells.face_count(),
            "cut": built.counts.cut, "whole": built.counts.whole, "meetings": built.counts.meetings,
            "signs": built.counts.decisions.all, "integers": built.counts.decisions.integers,
            "bytes": bytes, "seconds": seconds.as_secs_f64(), "peak_memory_bytes": peak,
        });
        if let Some(exported) = exported {
            value["exported"] = exported.into();
        }
        return print(&value.to_string());
    }
    print(&format!(
        "{} with {}: {} Delaunay tetrahedra, {} of them cut by triangles; result: {} with {}",
        plural(triangles, "triangle"),
        plural(vertices, "point"),
        built.tetrahedra,
        built.counts.cut,
        plural(cells, "cell"),
        plural(added, "added point"),
    ))?;
    if let (Some(exported), Some(path)) = (exported, &args.export) {
        print(&format!("wrote {}: {exported} tetrahedra", path.display()))?;
    }
    let peak = peak.map_or("unknown on this system".to_owned(), memory::in_words);
    print(&format!(
        "wrote {}: {} in {}, peak memory {peak}",
        output.display(),
        memory::in_words(bytes),
        human(seconds)
    ))
}

fn checked(args: &TetraArgs, path: &Path, json: bool) -> Result<(), Error> {
    let start = Instant::now();
    let refused = |why: String| {
        if json {
            print(&json!({"accepted": false, "reason": why}).to_string())?;
        }
        Err(Error::input(why))
    };
    let of_file = |why: String| format!("{}: {why}", path.display());
    let tets = match open(path) {
        Ok(tets) => tets,
        Err(e) => return refused(e.to_string()),
    };
    let scene = read(args)?;
    let contents = tets.contents();
    if let Err(e) = contents.expect_scene(&scene.digest().0) {
        return refused(of_file(e.to_string()));
    }
    if Surfaces::new(&scene)?.view() != contents.surfaces {
        return refused(of_file(
            "the triangles of the file differ from the triangles of the scene; build the file \
             again"
                .to_owned(),
        ));
    }
    if let Err(fault) = check(&contents) {
        return refused(of_file(format!("{fault}; build the file again")));
    }
    let (cells, triangles) = (
        contents.cells.cell_count(),
        contents.surfaces.triangles.len(),
    );
    let with_area = contents
        .surfaces
        .flags
        .iter()
        .filter(|f| **f & FLAT == 0)
        .count();
    say(&format!("checked in {}", human(start.elapsed())));
    match json {
        true => {
            print(&json!({"accepted": true, "cells": cells, "triangles": triangles}).to_string())
        }
        false => print(&format!(
            "accepted: {} fill the box without overlap, neighbours agree, and each of {} with an area is \
             covered once",
            plural(cells, "cell"),
            plural(with_area, "triangle")
        )),
    }
}
