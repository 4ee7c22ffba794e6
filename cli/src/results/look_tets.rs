//! `sightline look OUT.tets`: prints the triangles that are visible from points, with one JSON line per point
//! in input and output.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Value, json};
use sightline::Error;
use sightline::words::plural;
use sightline_tetra::surfaces::{BLOCKS, SHOWS};
use sightline_tetra::{
    Engine, LookError, Mode, Scratch, Target, Tets, TetsError, View, VisibleTriangles,
};

use crate::args::tetra::{LookArgs, LookEngine, LookMode};
use crate::results::look_lines::{self, LookReport};
use crate::terminal::json_lines::JsonLines;
use crate::terminal::stderr::say;

/// The default angle of modes that need one, in degrees.
const ANGLE: f64 = 0.2;
/// The default angle of the cone around a direction, in degrees.
const FOV: f64 = 90.0;

/// One line of the input.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewpointInput {
    #[serde(default)]
    id: Value,
    point: [f64; 3],
    direction: Option<[f64; 3]>,
    fov: Option<f64>,
    distance: Option<f64>,
    #[serde(default)]
    targets: Vec<TargetLine>,
}

/// A target box in an input line.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetLine {
    #[serde(default)]
    id: Value,
    min: [f64; 3],
    max: [f64; 3],
}

/// A checked query: a point with its view and its targets.
struct ViewpointQuery {
    id: Value,
    point: [f64; 3],
    view: View,
    targets: Vec<(Value, Target)>,
}

/// The state that all answers share.
struct Answering<'a> {
    tets: &'a Tets,
    mode: Mode,
    args: &'a LookArgs,
    /// True if some triangles block and do not show, so that a direction can end without a visible triangle.
    has_unseen: bool,
}

/// Opens a file of `sightline tetra`. The error contains the path.
pub fn open(path: &std::path::Path) -> Result<Tets, Error> {
    Tets::open(path).map_err(|e| match e {
        TetsError::Open { .. } => Error::input(e.to_string()),
        e => Error::input(format!("{}: {e}", path.display())),
    })
}

/// Answers every point of a file, in order.
pub fn run(args: &LookArgs) -> Result<(), Error> {
    let mode = mode(args)?;
    sightline::process::use_threads(args.threads.map_or(1, usize::from))?;
    let tets = open(&args.file)?;
    let has_unseen = tets
        .contents()
        .surfaces
        .flags
        .iter()
        .any(|f| f & (BLOCKS | SHOWS) == BLOCKS);
    let answering = Answering {
        tets: &tets,
        mode,
        args,
        has_unseen,
    };
    let example =
        r#"{"id":1,"point":[x,y,z],"direction":[x,y,z],"fov":90,"distance":50,"targets":[]}"#;
    let mut input = JsonLines::open(&args.points, "--points", example)?;
    // The first point selects the engine for all points, regardless of the batches.
    let mut engine = match args.engine.unwrap_or_default() {
        LookEngine::Auto => None,
        LookEngine::Tetra => Some(Engine::Cells),
        LookEngine::Bvh => Some(Engine::Boxes),
    };
    let pool: Mutex<Vec<Scratch>> = Mutex::default();
    let answers = |mut queries: Vec<ViewpointQuery>| {
        if let (None, Some(ViewpointQuery { point, view, .. })) = (engine, queries.first()) {
            // An error of the first point is reported with its line.
            engine = tets
                .faster(*point, view, mode, &mut Scratch::default())
                .ok();
        }
        queries
            .iter_mut()
            .for_each(|query| query.view.engine = engine.unwrap_or_default());
        let all = queries.into_par_iter().map(|query| {
            let mut scratch = pool
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .pop()
                .unwrap_or_default();
            let answer = answering
                .answer(query, &mut scratch)
                .map_err(|e| e.to_string());
            pool.lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(scratch);
            answer
        });
        all.collect()
    };
    let check = |line: ViewpointInput| query(line, args.witnesses);
    let (ended, medians) = look_lines::answer(&mut input, check, answers, "points");
    if let (Some(nanos), Some(count)) = (medians.nanos.get(), medians.count.get()) {
        say(&format!(
            "{}; medians per point: {:.1} µs, and {} visible",
            plural(medians.answers, "point"),
            nanos as f64 / 1e3,
            plural(count as usize, "triangle")
        ));
    }
    ended
}

/// Returns the mode of the arguments, with its angle in radians.
fn mode(args: &LookArgs) -> Result<Mode, Error> {
    let angle = args.angle.unwrap_or(ANGLE);
    if angle.is_nan() || angle <= 0.0 || angle > 180.0 {
        return Err(Error::input(format!(
            "--angle {angle} is out of range; give an angle above 0 and up to 180 degrees"
        )));
    }
    match args.mode.unwrap_or_default() {
        LookMode::Exact if args.angle.is_some() => Err(Error::usage(
            "--angle does not apply to --mode exact; give --mode aggressive or conservative, or \
             omit --angle"
                .to_owned(),
        )),
        LookMode::Exact => Ok(Mode::Exact),
        LookMode::Aggressive => Ok(Mode::Aggressive(angle.to_radians())),
        LookMode::Conservative => Ok(Mode::Conservative(angle.to_radians())),
    }
}

fn query(line: ViewpointInput, witnesses: bool) -> Result<ViewpointQuery, String> {
    let ViewpointInput {
        id,
        point,
        direction,
        fov,
        distance,
        targets,
    } = line;
    if fov.is_some() && direction.is_none() {
        return Err(
            "\"fov\" is an angle around a direction; give \"direction\", too, or omit \"fov\""
                .to_owned(),
        );
    }
    let angle = fov.unwrap_or(FOV).to_radians();
    let targets = targets
        .into_iter()
        .map(|t| {
            (
                t.id,
                Target {
                    low: t.min,
                    high: t.max,
                },
            )
        })
        .collect();
    let view = View {
        direction,
        angle,
        distance,
        witnesses,
        ..View::default()
    };
    Ok(ViewpointQuery {
        id,
        point,
        view,
        targets,
    })
}

impl Answering<'_> {
    fn answer(
        &self,
        query: ViewpointQuery,
        scratch: &mut Scratch,
    ) -> Result<LookReport, LookError> {
        let ViewpointQuery {
            id,
            point,
            view,
            targets,
        } = query;
        let start = Instant::now();
        let inside = self.tets.inside(point, scratch)?;
        let fractions: Vec<f64> = targets
            .iter()
            .map(|(_, target)| self.tets.sees_in(point, target, &view, self.mode, scratch))
            .collect::<Result<_, _>>()?;
        let seen = self.tets.look(point, &view, self.mode, scratch)?;
        let nanos = start.elapsed().as_nanos() as u64;
        let VisibleTriangles {
            visible,
            areas,
            witnesses,
            sky,
            unseen,
            dropped,
            cells,
            beams,
            ..
        } = seen;
        let mut line = json!({"id": id, "visible": visible});
        if self.args.areas {
            line["areas"] = json!(areas);
        }
        if self.args.witnesses {
            line["witnesses"] = json!(witnesses);
        }
        (line["sky"], line["dropped"]) = (json!(sky), json!(dropped));
        if self.has_unseen {
            line["unseen"] = json!(unseen);
        }
        line["inside"] = inside.into();
        if !targets.is_empty() {
            let share = |((id, _), fraction): (&(Value, Target), &f64)| {
                json!({
                    "id": id, "fraction": fraction
                })
            };
            line["targets"] = targets.iter().zip(&fractions).map(share).collect();
        }
        (line["cells"], line["beams"], line["micros"]) =
            (json!(cells), json!(beams), json!(nanos as f64 / 1e3));
        Ok(LookReport {
            line,
            nanos,
            count: visible.len() as u64,
        })
    }
}
