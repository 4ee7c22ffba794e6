//! `sightline ambient --points`: computes the openness of points, with one JSON line per point in input and
//! output.

use std::path::Path;

use serde_json::{Map, Value, json};
use sightline::Error;
use sightline::process::threads;
use sightline::words::plural;
use sightline_ambient::{
    AmbientScene, Light, LightLine, PointLine, Receiver, ReceiverResult, Solver, SolverSettings,
};

use crate::args::ambient::AmbientArgs;
use crate::bake::ambient_distance::distance;
use crate::scenes::read::scene;
use crate::terminal::json_lines::JsonLines;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// The number of points in a batch. The division into batches changes answers within their bounds, so it
/// depends only on the input.
const TOGETHER: usize = 1 << 16;
/// Maximum number of lights.
const MOST_LIGHTS: usize = 4096;

/// Prints the openness of every point of a file, in order.
pub fn run(args: &AmbientArgs, path: &Path) -> Result<(), Error> {
    sightline::process::use_threads(threads(args.threads.map(usize::from)))?;
    let scene = scene(&args.scene, &args.kinds)?;
    let distance = distance(args, &scene)?;
    let (names, lights) = match &args.lights {
        Some(path) => self::lights(path)?,
        None => Default::default(),
    };
    let settings = SolverSettings {
        falloff: args.falloff.falloff(),
        fragments: args.fragments,
        lights,
        ..SolverSettings::new(distance)
    };
    let prepared = AmbientScene::new(&scene, args.fragments)?;
    answer_all(
        path,
        scene.triangles().len(),
        &Solver::new(&prepared, settings),
        &names,
    )
}

/// Reads the names and shapes of the lights of a file.
fn lights(path: &Path) -> Result<(Vec<String>, Vec<Light>), Error> {
    let mut input = JsonLines::open(path, "--lights", r#"{"id":"lamp","polygon":[[x,y,z],…]}"#)?;
    let (mut names, mut lights): (Vec<String>, Vec<Light>) = (Vec::new(), Vec::new());
    loop {
        let (lines, failure) =
            input.read(|line: LightLine| line.light().map_err(|e| e.to_string()));
        let last = lines.is_empty();
        for (name, light) in lines {
            if names.contains(&name) {
                return Err(Error::input(format!(
                    "{}: two lights have the id {name:?}; give each light a different id",
                    input.name
                )));
            }
            if names.len() == MOST_LIGHTS {
                return Err(Error::input(format!(
                    "{} has more than {MOST_LIGHTS} lights; give at most {MOST_LIGHTS} lights per command",
                    input.name
                )));
            }
            names.push(name);
            lights.push(light);
        }
        match failure {
            Some(e) => return Err(e),
            None if last => return Ok((names, lights)),
            None => {}
        }
    }
}

fn answer_all(
    path: &Path,
    triangles: usize,
    solver: &Solver<'_>,
    lights: &[String],
) -> Result<(), Error> {
    let example = r#"{"id":1,"point":[x,y,z],"normal":[x,y,z],"triangle":t}"#;
    let mut input = JsonLines::open(path, "--points", example)?;
    let (mut points, mut most) = (0u64, 0.0f64);
    let mut waiting: Vec<(Value, Receiver)> = Vec::new();
    let ended = loop {
        let (lines, failure) = input.read(|line: PointLine| {
            let receiver = line.receiver(triangles).map_err(|e| e.to_string())?;
            Ok((receiver, line.id))
        });
        let last = lines.is_empty() || failure.is_some();
        waiting.extend(lines.into_iter().map(|(receiver, id)| (id, receiver)));
        while waiting.len() >= TOGETHER || (last && !waiting.is_empty()) {
            let rest = waiting.split_off(waiting.len().min(TOGETHER));
            let receivers: Vec<Receiver> = waiting.iter().map(|(_, r)| *r).collect();
            for ((id, _), answer) in waiting.iter().zip(solver.solve(&receivers, |_| {})) {
                most = most.max(answer.openness.bound);
                print(&in_json(id, &answer, solver.settings(), lights).to_string())?;
            }
            points += waiting.len() as u64;
            waiting = rest;
        }
        match failure {
            Some(e) => break Err(e),
            None if last => break Ok(()),
            None => {}
        }
    };
    if ended.is_err() {
        say("the command answered only the points before the bad line:");
    }
    say(&match points {
        0 => "0 points".to_owned(),
        _ => format!(
            "{}, error per point at most {most:.0e}",
            plural(points as usize, "point")
        ),
    });
    ended
}

/// Returns the openness of a point as JSON, in the printed form.
fn in_json(
    id: &Value,
    answer: &ReceiverResult,
    settings: &SolverSettings,
    lights: &[String],
) -> Value {
    let openness = &answer.openness;
    let mut line = json!({
        "id": id,
        "open": openness.open,
        "bound": openness.bound,
        "occluders": openness.occluders,
        "inside": answer.inside,
    });
    if !lights.is_empty() {
        let factors = lights
            .iter()
            .zip(&answer.lights)
            .map(|(name, factor)| (name.clone(), json!(factor)));
        line["lights"] = Value::Object(factors.collect::<Map<_, _>>());
    }
    if settings.fragments {
        let fragments = answer.fragments.iter().map(|f| {
            let directions: Vec<[f64; 3]> = f.directions.iter().map(|d| d.to_array()).collect();
            json!({"triangle": f.polygon, "directions": directions, "factor": f.factor})
        });
        line["fragments"] = fragments.collect();
    }
    line
}
