//! `sightline stab`: decides if a line passes through a sequence of polygons, with one JSON line per query in
//! input and output.

use std::time::Instant;

use dashu_int::IBig;
use glam::DVec3;
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Value, json};
use sightline::Error;
use sightline::process::threads;
use sightline_exact::{PointOrigin, Polygon, QueryLimits, Stabbed, Surface, Swath, antipenumbra};
use sightline_exact::{polygon, predicates, stab};

use crate::args::cli::StabArgs;
use crate::terminal::json_lines::JsonLines;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Maximum number of digits of a fraction's numerator and denominator.
const MOST_DIGITS: usize = 80;

/// One line of the input.
#[derive(Deserialize)]
struct StabInput {
    #[serde(default)]
    id: Value,
    portals: Vec<Vec<[Coordinate; 3]>>,
}

/// A coordinate of a corner: a number, or a fraction "p/q".
#[derive(Deserialize)]
#[serde(untagged)]
enum Coordinate {
    Number(f64),
    Fraction(String),
}

/// A checked query.
struct StabQuery {
    id: Value,
    portals: Vec<Polygon>,
}

/// Answers every query of a file, in order.
pub fn run(args: &StabArgs) -> Result<(), Error> {
    sightline::process::use_threads(threads(args.threads.map(usize::from)))?;
    let mut input = JsonLines::open(
        &args.queries,
        "--queries",
        r#"{"id":1,"portals":[[[x,y,z],…],…]}"#,
    )?;
    let limits = QueryLimits {
        regions: args.max_regions,
        ..QueryLimits::default()
    };
    let mut counts = [0u64; 3];
    let ended = loop {
        // A bad line ends the run, but only after all queries before it have been answered.
        let (queries, failure) = input.read(check);
        let last = queries.is_empty();
        let answers: Vec<(usize, Value)> = queries
            .into_par_iter()
            .map(|q| answer(&q, &limits, args.swaths))
            .collect();
        for (kind, value) in answers {
            counts[kind] += 1;
            print(&value.to_string())?;
        }
        match failure {
            Some(e) => break Err(e),
            None if last => break Ok(()),
            None => {}
        }
    };
    if ended.is_err() {
        say("the command answered only the queries before the bad line:");
    }
    let [stabbed, blocked, undecided] = counts;
    say(&format!(
        "{stabbed} stabbed, {blocked} blocked, {undecided} undecided"
    ));
    if undecided > 0 {
        say("a larger --max-regions may decide the undecided sequences");
    }
    ended
}

fn answer(query: &StabQuery, limits: &QueryLimits, with_swaths: bool) -> (usize, Value) {
    let start = Instant::now();
    let (found, _) = stab(&query.portals, limits, &|| false);
    let micros = start.elapsed().as_micros() as u64;
    let id = &query.id;
    match found {
        Stabbed::Line(ends) => {
            let line = shown(&query.portals, &ends);
            let mut value = json!({"id": id, "state": "stabbed", "line": line, "micros": micros});
            if with_swaths {
                add_swaths(&mut value, &query.portals, limits);
            }
            (0, value)
        }
        Stabbed::Blocked => (1, json!({"id": id, "state": "blocked", "micros": micros})),
        Stabbed::Undecided(reason) => (
            2,
            json!({"id": id, "state": "undecided", "reason": reason.to_string(), "micros": micros}),
        ),
    }
}

/// Adds the antipenumbra of a sequence to its answer, or the reason why the antipenumbra is unknown.
fn add_swaths(value: &mut Value, portals: &[Polygon], limits: &QueryLimits) {
    let start = Instant::now();
    let found = antipenumbra(portals, limits);
    value["swath_micros"] = (start.elapsed().as_micros() as u64).into();
    match found {
        Ok(found) => {
            let swath = |swath: &Swath| {
                let (kind, name, surface) = match &swath.surface {
                    Surface::Plane(plane) => ("VE", "plane", json!(plane)),
                    Surface::Quadric(quadric) => ("EEE", "quadric", json!(quadric)),
                };
                let mut value = json!({
                    "kind": kind, "boundary": swath.is_boundary, "loop": swath.in_loop, "edges": swath.edges,
                });
                value[name] = surface;
                value
            };
            value["polytope"] = json!(found.polytope);
            value["lines"] = found.lines.into();
            value["swaths"] = found.swaths.iter().map(swath).collect();
        }
        Err(why) => value["no_swaths"] = why.to_string().into(),
    }
}

/// Returns a line as numbers if the rounded line stabs the polygons as well, and otherwise as fractions.
fn shown(portals: &[Polygon], ends: &[PointOrigin; 2]) -> Value {
    let near = ends.each_ref().map(polygon::rounded);
    let given = near.map(PointOrigin::Given);
    let inside = |p: &Polygon| {
        let points = p.points();
        let n = points.len();
        let turns: Vec<_> = (0..n)
            .map(|k| predicates::orient([&given[0], &given[1], &points[k], &points[(k + 1) % n]]))
            .collect();
        turns[0] != std::cmp::Ordering::Equal && turns.iter().all(|t| *t == turns[0])
    };
    // Rounding does not change the order of the polygons along a line unless two of them meet.
    if near.iter().all(|p| p.is_finite())
        && near[0] != near[1]
        && portals.iter().all(inside)
        && in_order(portals, &given)
    {
        return json!(near.map(|p| p.to_array()));
    }
    let fractions = |p: &PointOrigin| {
        let [x, y, z, w] = predicates::integers(p);
        [x, y, z].map(|c| format!("{c}/{w}"))
    };
    json!(ends.each_ref().map(fractions))
}

/// Returns true if the line through p and q crosses the planes of the polygons in the order of the list.
fn in_order(portals: &[Polygon], [p, q]: &[PointOrigin; 2]) -> bool {
    let [a, b] = [p, q].map(predicates::integers);
    let places: Vec<(IBig, IBig)> = portals
        .iter()
        .map(|portal| {
            let plane = portal.plane();
            let (at_a, at_b) = (
                predicates::height(&plane, &a) * &b[3],
                predicates::height(&plane, &b) * &a[3],
            );
            let (n, d) = (at_a.clone(), at_a - at_b);
            if d < IBig::ZERO { (-n, -d) } else { (n, d) }
        })
        .collect();
    places.iter().all(|(_, d)| !d.is_zero())
        && places
            .windows(2)
            .all(|w| &w[0].0 * &w[1].1 < &w[1].0 * &w[0].1)
}

fn check(line: StabInput) -> Result<StabQuery, String> {
    if line.portals.is_empty() {
        return Err("the query has no polygons; give at least one polygon".to_owned());
    }
    let portals = line.portals.iter().enumerate().map(|(k, corners)| {
        let corners = corners.iter().map(point).collect::<Result<Vec<_>, _>>();
        corners
            .and_then(|corners| Polygon::exact(corners).map_err(|e| e.to_string()))
            .map_err(|why| format!("polygon {k}: {why}"))
    });
    Ok(StabQuery {
        portals: portals.collect::<Result<_, _>>()?,
        id: line.id,
    })
}

fn point(corner: &[Coordinate; 3]) -> Result<PointOrigin, String> {
    let mut numbers = [0.0; 3];
    let mut all = true;
    for (number, c) in numbers.iter_mut().zip(corner) {
        match c {
            // −0 and 0 are the same coordinate.
            Coordinate::Number(x) => *number = *x + 0.0,
            Coordinate::Fraction(_) => all = false,
        }
    }
    if all {
        return Ok(PointOrigin::Given(DVec3::from(numbers)));
    }
    // The numerators are over the product of the denominators.
    let mut parts = Vec::with_capacity(3);
    for c in corner {
        parts.push(match c {
            Coordinate::Number(x) => {
                let [n, _, _, d] =
                    predicates::integers(&PointOrigin::Given(DVec3::new(*x, 0.0, 0.0)));
                (n, d)
            }
            Coordinate::Fraction(text) => fraction(text)?,
        });
    }
    let [(x, a), (y, b), (z, c)] = [0, 1, 2].map(|i| parts[i].clone());
    Ok(PointOrigin::Exact(Box::new([
        x * &b * &c,
        y * &a * &c,
        z * &a * &b,
        a * b * c,
    ])))
}

fn fraction(text: &str) -> Result<(IBig, IBig), String> {
    let bad = || {
        format!(
            "{text:?} is not a fraction; give two whole numbers of at most {MOST_DIGITS} digits, \
             \"p/q\""
        )
    };
    let (n, d) = text.split_once('/').unwrap_or((text, "1"));
    let number = |t: &str| {
        if t.len() <= MOST_DIGITS + 1 {
            t.trim().parse::<IBig>().ok()
        } else {
            None
        }
    };
    let (n, d) = number(n).zip(number(d)).ok_or_else(bad)?;
    if d.is_zero() {
        return Err(format!(
            "{text:?} has a denominator of 0; give a denominator other than 0"
        ));
    }
    Ok(if d < IBig::ZERO { (-n, -d) } else { (n, d) })
}
