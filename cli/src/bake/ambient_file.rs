//! `sightline ambient -o`: writes the occlusion of a scene to a copy of its file.

use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

use rayon::prelude::*;
use serde_json::json;
use sightline::output::{Format, Output};
use sightline::process::threads;
use sightline::words::human;
use sightline::words::plural;
use sightline::{
    AmbientResult, Client, Endpoint, Error, ErrorKind, Local, OrderedReceivers, Submission,
};
use sightline_ambient::{AmbientScene, Receiver, Solver, SolverSettings};
use sightline_texels::{
    BitDepth, Plan, ReceiverValue, TexCoordSource, TextureSize, ValueTarget, WrittenFile,
};

use crate::args::ambient::{AmbientArgs, OcclusionTarget, Uv};
use crate::bake::ambient_distance::distance;
use crate::scenes::read::scene;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Writes a copy of the scene's file with its ambient occlusion to `path`.
pub fn run(args: &AmbientArgs, path: &Path, json: bool) -> Result<(), Error> {
    let start = Instant::now();
    sightline::process::use_threads(threads(None))?;
    let output = Output::check(path, Format::Glb, Some(&args.scene)).map_err(|e| {
        // The exit code for an output that would replace the scene has to be 3.
        let same = std::fs::canonicalize(path)
            .ok()
            .zip(std::fs::canonicalize(&args.scene).ok());
        match e.kind() {
            ErrorKind::Usage if same.is_some_and(|(a, b)| a == b) => Error::input(e.to_string()),
            _ => e,
        }
    })?;
    let scene = scene(&args.scene, &args.kinds)?;
    let distance = distance(args, &scene)?;
    let of_scene = |e: &dyn std::fmt::Display| Error::input(e.to_string());
    let name = args.scene.display().to_string();
    let bytes = std::fs::read(&args.scene).map_err(|e| Error::input(format!("{name}: {e}")))?;
    let plan = Plan::new(&name, &bytes, args.scene.parent(), &scene, &texels(args)?)
        .map_err(|e| of_scene(&e))?;
    plan.notes().iter().for_each(|note| say(note));
    let receivers: Vec<Receiver> = plan
        .receivers()
        .iter()
        .map(|r| Receiver {
            point: r.point,
            normal: r.normal,
            triangle: Some(r.triangle),
        })
        .collect();
    say(&format!(
        "{} in {}",
        plural(receivers.len(), "point"),
        plural(scene.triangles().len(), "triangle")
    ));
    let prepared = AmbientScene::new(&scene, false)?;
    let settings = SolverSettings {
        falloff: args.falloff.falloff(),
        ..SolverSettings::new(distance)
    };
    let ordered = OrderedReceivers::new(&Solver::new(&prepared, settings), &receivers);
    let terminal = Terminal::new();
    let AmbientResult { job, openness } = match &args.coordinator {
        Some(url) => {
            let submission = Submission {
                name: short(&args.scene),
                user: Some(String::new()),
                ..Submission::default()
            };
            let endpoint = Endpoint::new(url).with_credentials(args.keys.files().read()?);
            let client = Client::new(endpoint)?;
            client.ambient(&scene, &ordered, &submission, &terminal)?
        }
        None => {
            let local = Local {
                name: short(&args.scene),
                data_dir: args.data_dir.clone(),
                workers: args.workers,
                ..Local::default()
            };
            sightline::ambient(&scene, &ordered, &local, &terminal)?
        }
    };
    terminal.end();
    if openness.missing() > 0 {
        return Err(Error::job(format!(
            "{} of {} points have no openness, because their tiles failed; nothing is written. Run the same \
             command again to retry",
            openness.missing(),
            receivers.len()
        )));
    }
    let open = ordered.restore(&openness);
    let values: Vec<ReceiverValue> = receivers
        .par_iter()
        .zip(&open)
        .map(|(r, open)| ReceiverValue {
            open: f64::from(*open),
            inside: prepared.is_inside(r),
        })
        .collect();
    let written = plan.write(&values).map_err(|e| of_scene(&e))?;
    let mut part = output.begin()?;
    part.write_all(&written.glb)
        .map_err(|e| Error::writing(output.path(), &e))?;
    part.place()?;
    written.notes.iter().for_each(|note| say(note));
    report(
        args,
        path,
        &values,
        &Computed {
            written: &written,
            bound: openness.bound,
            job: job.id(),
            took: start.elapsed(),
        },
        json,
    )
}

/// Returns the settings of the texture or of the vertices from the flags.
fn texels(args: &AmbientArgs) -> Result<sightline_texels::Settings, Error> {
    let bits = match args.bits {
        8 => BitDepth::Eight,
        16 => BitDepth::Sixteen,
        other => {
            return Err(Error::usage(format!(
                "--bits {other} is not supported; give 8 or 16"
            )));
        }
    };
    Ok(sightline_texels::Settings {
        target: match args.to {
            OcclusionTarget::Texture => ValueTarget::Texture,
            OcclusionTarget::Vertices => ValueTarget::Vertices,
        },
        size: match (args.texel, args.resolution) {
            (Some(size), _) => TextureSize::Texel(size),
            (None, Some(side)) => TextureSize::Resolution(side),
            (None, None) => sightline_texels::Settings::default().size,
        },
        coordinates: match args.uv {
            None => TexCoordSource::Any,
            Some(Uv::Keep) => TexCoordSource::Keep,
            Some(Uv::Unwrap) => TexCoordSource::Unwrap,
        },
        bits,
    })
}

/// Returns a job name from the file name of `path`.
fn short(path: &Path) -> String {
    let name = path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    name.chars().filter(|c| !c.is_control()).take(32).collect()
}

/// The written file, and the properties of its values.
struct Computed<'a> {
    written: &'a WrittenFile,
    /// The bound on the error of every receiver's openness, from 0 to 1.
    bound: f64,
    /// The number of the job.
    job: u64,
    took: Duration,
}

/// Prints a summary of the written file.
fn report(
    args: &AmbientArgs,
    path: &Path,
    values: &[ReceiverValue],
    computed: &Computed<'_>,
    json: bool,
) -> Result<(), Error> {
    let Computed {
        written,
        bound,
        job,
        took,
    } = *computed;
    let facts = &written.facts;
    let inside = values.iter().filter(|v| v.inside).count();
    let mean = values
        .iter()
        .filter(|v| !v.inside)
        .map(|v| v.open)
        .sum::<f64>()
        / values.len().saturating_sub(inside).max(1) as f64;
    // The answers of jobs are rounded to single precision.
    let bound = bound + f64::from(f32::EPSILON) / 2.0;
    let is_texture = args.to == OcclusionTarget::Texture;
    let receivers = if is_texture {
        facts.texels
    } else {
        facts.vertices
    };
    if json {
        let texture = is_texture.then(|| {
            json!({"width": facts.width, "height": facts.height, "bits": args.bits, "kept": facts.kept,
                   "moved": facts.moved, "unwrapped": facts.unwrapped, "charts": facts.charts,
                   "seams": facts.seams})
        });
        let value = json!({
            "output": path.display().to_string(),
            "job": job,
            "points": values.len(),
            "receivers": receivers,
            "inside": inside,
            "mean_open": mean,
            "bound": bound,
            "seconds": took.as_secs_f64(),
            "texture": texture,
        });
        return print(&value.to_string());
    }
    let what = if is_texture {
        format!(
            "{} x {} texels, {receivers} of them on the surface",
            facts.width, facts.height
        )
    } else {
        format!("{receivers} vertices")
    };
    print(&format!(
        "{what}, from {} in {}; mean openness {mean:.4}, error per point at most {bound:.0e}\nwrote {}",
        plural(values.len(), "point"),
        human(took),
        path.display()
    ))
}
