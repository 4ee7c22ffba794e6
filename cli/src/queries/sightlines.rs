//! `sightline sightlines`: decides the exact visibility between pairs of polygons, with one JSON line per
//! query in input and output.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Value, json};
use sightline::Error;
use sightline::process::threads;
use sightline::words::human;
use sightline_certificate::checker;
use sightline_exact::{
    Occluders, Polygon, QueryCost, QueryLimits, Verdict, polygon, predicates, sightlines,
};
use sightline_scene::{Scene, TriangleId};

use crate::args::cli::SightlinesArgs;
use crate::scenes::read::scene;
use crate::terminal::json_lines::JsonLines;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// One line of the input.
#[derive(Deserialize)]
struct SightlineInput {
    #[serde(default)]
    id: Value,
    a: Vec<[f64; 3]>,
    b: Vec<[f64; 3]>,
}

/// A checked query.
struct SightlineQuery {
    id: Value,
    a: Vec<Polygon>,
    b: Vec<Polygon>,
}

/// The triangles of a scene, as input of the checker.
#[derive(Default)]
struct Blocking {
    only: Vec<[glam::Vec3; 3]>,
    /// All triangles by id. A triangle that does not block has no area here, so that it cannot be an
    /// occluder.
    by_id: Vec<[glam::Vec3; 3]>,
}

impl Blocking {
    fn from_scene(scene: &Scene) -> Self {
        let blocks = |t: u32| scene.kinds().kind(TriangleId(t)).blocks();
        let each = (0..).zip(scene.triangles());
        Self {
            only: each
                .clone()
                .filter(|(t, _)| blocks(*t))
                .map(|(_, t)| t.v)
                .collect(),
            by_id: each
                .map(|(t, v)| if blocks(t) { v.v } else { [v.v[0]; 3] })
                .collect(),
        }
    }
}

/// Totals over all queries of a run.
#[derive(Default)]
struct Totals {
    visible: u64,
    hidden: u64,
    undecided: u64,
    cost: QueryCost,
}

/// Answers every query of a file, in order.
pub fn run(args: &SightlinesArgs) -> Result<(), Error> {
    sightline::process::use_threads(threads(args.threads.map(usize::from)))?;
    let mut input = JsonLines::open(
        &args.queries,
        "--queries",
        r#"{"id":1,"a":[[x,y,z],…],"b":[[x,y,z],…]}"#,
    )?;
    let scene = scene(&args.scene, &args.kinds)?;
    sightline::without_masks(&scene)?;
    let occluders = Occluders::new(&scene)?;
    let raw = if args.check {
        Blocking::from_scene(&scene)
    } else {
        Blocking::default()
    };
    let limits = QueryLimits {
        regions: args.max_regions,
        ..QueryLimits::default()
    };
    let start = Instant::now();
    let progress = Terminal::new();
    let mut totals = Totals::default();
    let done = AtomicU64::new(0);
    let ended = loop {
        // A bad line ends the run, but only after all queries before it have been answered.
        let (queries, failure) = input.read(checked);
        let last = queries.is_empty();
        let total = input.lines;
        let answers: Vec<Result<(Value, Verdict, QueryCost), Error>> = queries
            .into_par_iter()
            .map(|query| {
                let answer = answer(&occluders, &query, &limits, &raw, args.check);
                progress.count_so_far(done.fetch_add(1, Ordering::Relaxed) + 1, total, "queries");
                answer
            })
            .collect();
        for answer in answers {
            let (value, verdict, cost) = answer.inspect_err(|_| progress.end())?;
            match verdict {
                Verdict::Visible(_) => totals.visible += 1,
                Verdict::Hidden(_) => totals.hidden += 1,
                Verdict::Undecided(_) => totals.undecided += 1,
            }
            totals.cost += cost;
            print(&value.to_string())?;
        }
        match failure {
            Some(e) => break Err(e),
            None if last => break Ok(()),
            None => {}
        }
    };
    progress.end();
    if ended.is_err() {
        say("the command answered only the queries before the bad line:");
    }
    report(&totals, start.elapsed(), args.check);
    ended
}

/// Prints the totals of the answers and their query statistics to stderr.
fn report(totals: &Totals, took: std::time::Duration, checked: bool) {
    let d = totals.cost.decisions;
    let all = (d.filtered + d.refined + d.spanned + d.exact).max(1);
    say(&format!(
        "{} visible, {} hidden, {} undecided in {}{}; {} regions of line space, {} decisions, {:.2} % of \
         them by exact arithmetic",
        totals.visible,
        totals.hidden,
        totals.undecided,
        human(took),
        if checked {
            ", each witness and proof of these accepted by the checker"
        } else {
            ""
        },
        totals.cost.regions,
        d.filtered + d.refined + d.spanned + d.exact,
        100.0 * d.exact as f64 / all as f64,
    ));
    if totals.undecided > 0 {
        say("a larger --max-regions may decide the undecided pairs");
    }
}

/// Answers one query. Returns the answer as JSON, the verdict, and the cost.
fn answer(
    scene: &Occluders,
    query: &SightlineQuery,
    limits: &QueryLimits,
    raw: &Blocking,
    check: bool,
) -> Result<(Value, Verdict, QueryCost), Error> {
    let start = Instant::now();
    let (verdict, cost) = sightlines(scene, &query.a, &query.b, limits);
    let micros = start.elapsed().as_micros() as u64;
    if check {
        let exact = |polygons: &[Polygon]| -> Vec<checker::Corners> {
            polygons
                .iter()
                .map(|p| p.points().iter().map(predicates::integers).collect())
                .collect()
        };
        let (a, b) = (exact(&query.a), exact(&query.b));
        let refused = match &verdict {
            Verdict::Visible(ends) => {
                let [p, q] = [&ends[0], &ends[1]].map(predicates::integers);
                checker::check_witness(&raw.only, &a, &b, &p, &q)
            }
            Verdict::Hidden(proof) => checker::check_hidden(&raw.by_id, &a, &b, proof),
            Verdict::Undecided(_) => Ok(()),
        };
        refused.map_err(|e| {
            Error::internal(format!(
                "query {}: the checker rejects the answer: {e}; this is a fault of the program, \
                 please report it with the scene",
                query.id
            ))
        })?;
    }
    let point = |p| polygon::rounded(p).to_array();
    let value = match &verdict {
        Verdict::Visible(ends) => {
            let witness = [point(&ends[0]), point(&ends[1])];
            json!({"id": query.id, "state": "visible", "witness": witness, "micros": micros})
        }
        Verdict::Hidden(proof) => {
            json!({"id": query.id, "state": "hidden", "blockers": proof.blockers(), "micros": micros})
        }
        Verdict::Undecided(reason) => {
            json!({"id": query.id, "state": "undecided", "reason": reason.to_string(), "micros": micros})
        }
    };
    Ok((value, verdict, cost))
}

fn checked(line: SightlineInput) -> Result<SightlineQuery, String> {
    let polygon = |name: &str, corners: &[[f64; 3]]| {
        let corners: Vec<DVec3> = corners.iter().map(|c| DVec3::from(*c)).collect();
        Polygon::checked(&corners).map_err(|e| format!("polygon {name}: {e}"))
    };
    let (a, b) = (polygon("a", &line.a)?, polygon("b", &line.b)?);
    Ok(SightlineQuery { id: line.id, a, b })
}
