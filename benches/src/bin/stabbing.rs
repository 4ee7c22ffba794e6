//! Times the search for a line through a sequence of polygons: `stabbing` prints a table.
//!
//! Doors are axial rectangles around points of a line, across axes drawn at random. In half of the sequences
//! one door is displaced. Tilted sequences have five polygons with 23 edges, as in figure 7.3 of Teller 1992.

#![allow(clippy::print_stdout, reason = "a measurement")]

use std::time::Instant;

use dashu_int::IBig;
use sightline_exact::{PointOrigin, Polygon, QueryLimits, Stabbed, stab};
use sightline_numbers::random::SplitMix64;

/// The number of sequences of each kind.
const EACH: usize = 40;
/// The denominator of coordinates, which are multiples of its reciprocal.
const UNIT: i64 = 1 << 10;

/// Convex polygons about the origin, about ten units wide.
const FIVE: [[i64; 2]; 5] = [[0, 10], [-10, 3], [-6, -8], [6, -8], [10, 3]];
const FOUR: [[i64; 2]; 4] = [[9, 2], [-2, 9], [-9, -2], [2, -9]];

fn main() {
    let mut random = SplitMix64::new(1);
    println!("| sequence | edges | stabbed | blocked | undecided | median | longest |");
    println!("|---|--:|--:|--:|--:|--:|--:|");
    for doors in [4, 16, 64, 256, 1024, 4096] {
        for moved in [false, true] {
            let each = if doors > 256 { EACH / 8 } else { EACH };
            let name = if moved {
                "doors, one moved aside"
            } else {
                "doors"
            };
            time(
                &format!("{doors} {name}"),
                (0..each)
                    .map(|_| axial(doors, moved, &mut random))
                    .collect(),
            );
        }
    }
    time(
        "5 tilted polygons",
        (0..EACH * 10).map(|_| tilted(&mut random)).collect(),
    );
}

/// Times the sequences and prints a line of the table.
fn time(name: &str, sequences: Vec<Vec<Polygon>>) {
    let edges = sequences[0].iter().map(|p| p.points().len()).sum::<usize>();
    let (mut counts, mut took) = ([0; 3], Vec::new());
    for portals in &sequences {
        let start = Instant::now();
        let (found, _) = stab(portals, &QueryLimits::default(), &|| false);
        took.push(start.elapsed());
        counts[match found {
            Stabbed::Line(_) => 0,
            Stabbed::Blocked => 1,
            Stabbed::Undecided(_) => 2,
        }] += 1;
    }
    took.sort_unstable();
    let [stabbed, blocked, undecided] = counts;
    let (median, most) = (took[took.len() / 2], took[took.len() - 1]);
    println!(
        "| {name} | {edges} | {stabbed} | {blocked} | {undecided} | {median:.1?} | {most:.1?} |"
    );
}

fn between(random: &mut SplitMix64, least: i64, most: i64) -> i64 {
    least + (random.bits() % (most - least + 1) as u64) as i64
}

/// Creates a polygon from corners in units of `1 / UNIT`.
fn polygon(corners: &[[i64; 3]]) -> Option<Polygon> {
    let exact = |c: &[i64; 3]| {
        let [x, y, z] = c.map(IBig::from);
        PointOrigin::Exact(Box::new([x, y, z, IBig::from(UNIT)]))
    };
    Polygon::exact(corners.iter().map(exact).collect()).ok()
}

fn axial(doors: usize, moved: bool, random: &mut SplitMix64) -> Vec<Polygon> {
    let mut t = 0;
    let mut portals = Vec::new();
    for k in 0..doors {
        t += between(random, 500, 1500);
        let axis = [0, 0, 1, 2][between(random, 0, 3) as usize];
        let at = [t, t * 7 / 10, t / 2];
        let mut range = |axis: usize| {
            [
                at[axis] - between(random, 50, 2000),
                at[axis] + between(random, 50, 2000),
            ]
        };
        let (mut u, v) = (range((axis + 1) % 3), range((axis + 2) % 3));
        if moved && k == doors * 2 / 3 {
            u = [u[1] + 3000, u[1] + 4000];
        }
        let corner = |i: usize, j: usize| {
            let mut p = at;
            p[(axis + 1) % 3] = u[i];
            p[(axis + 2) % 3] = v[j];
            p
        };
        portals.extend(polygon(&[
            corner(0, 0),
            corner(1, 0),
            corner(1, 1),
            corner(0, 1),
        ]));
    }
    portals
}

fn tilted(random: &mut SplitMix64) -> Vec<Polygon> {
    let mut portals = Vec::new();
    while portals.len() < 5 {
        let n = if portals.len() % 2 == 0 { 5 } else { 4 };
        // The plane is z = 3k + (a x + b y) / 16, with x and y multiples of 16.
        let (a, b) = (between(random, -4, 4), between(random, -4, 4));
        let (x, y, r) = (
            between(random, -40, 40),
            between(random, -40, 40),
            between(random, 32, 76),
        );
        let skew = between(random, -5, 5);
        let corner = |i: usize| {
            let [u, v] = if n == 5 { FIVE[i] } else { FOUR[i] };
            let [x, y] = [x + r * (10 * u + skew * v) / 100, y + r * v / 10];
            [
                16 * x,
                16 * y,
                3 * UNIT * portals.len() as i64 + a * x + b * y,
            ]
        };
        let corners: Vec<[i64; 3]> = (0..n).map(corner).collect();
        portals.extend(polygon(&corners));
    }
    portals
}
