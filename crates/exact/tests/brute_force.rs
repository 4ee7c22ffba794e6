//! Tests of random small scenes against many random segments: no segment may be free if the verdict is
//! hidden.

mod common;

use std::cmp::Ordering;

use common::{Corners, Random, World, check};
use glam::{DVec3, Vec3};
use sightline_certificate::proof::Step;
use sightline_exact::{Polygon, Verdict, polygon};
use sightline_geometry::predicates::orient3d_sign;

/// The magnitude above which a volume or area in doubles certainly has the right sign.
///
/// In scenes no larger than 16, volumes and areas in doubles are off by less than 1e-10. They change by less
/// if the ends of a segment move to their positions without rounding.
const CLEAR: f64 = 1e-7;

/// Computes six times the volume.
fn volume(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    (b - a).cross(c - a).dot(d - a)
}

/// Returns true if certainly no point of the segment is in the triangle.
fn misses(p: DVec3, q: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    let (x, y) = (volume(a, b, c, p), volume(a, b, c, q));
    if x.min(y) > CLEAR || x.max(y) < -CLEAR {
        return true;
    }
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    sides.iter().any(|s| *s > CLEAR) && sides.iter().any(|s| *s < -CLEAR)
}

/// The two triangles of a query, and the scene's triangles except triangles that do not block.
struct Pair {
    a: Corners,
    b: Corners,
    blockers: Vec<[DVec3; 3]>,
}

impl Pair {
    fn new(triangles: &[Corners], a: Corners, b: Corners) -> Self {
        let doubles = |t: &Corners| t.map(|p| p.as_dvec3());
        let in_plane = |base: &Corners, t: &Corners| {
            t.iter()
                .all(|p| orient3d_sign(base[0], base[1], base[2], *p) == Ordering::Equal)
        };
        let blockers = triangles
            .iter()
            .filter(|t| !in_plane(&a, t) && !in_plane(&b, t))
            .map(doubles)
            .collect();
        Self { a, b, blockers }
    }

    /// Returns true if the segment from inside A to inside B is certainly free.
    ///
    /// The segment must also certainly not run in the plane of A or B.
    fn free(&self, p: DVec3, q: DVec3) -> bool {
        let off = |t: &Corners, x: DVec3| {
            let [a, b, c] = t.map(|p| p.as_dvec3());
            volume(a, b, c, x).abs() > CLEAR
        };
        off(&self.a, q) && off(&self.b, p) && self.blockers.iter().all(|t| misses(p, q, *t))
    }
}

/// Returns a random point in a triangle, not on its border.
fn within(random: &mut Random, t: &Corners) -> DVec3 {
    let [a, b, c] = t.map(|p| p.as_dvec3());
    loop {
        // Some points are close to a corner or an edge.
        let near = [1.0, 1.0, 1e-1, 1e-2][random.below(4)];
        let (x, y) = (random.unit() * near, random.unit());
        let w = [1.0 - x - y, x, y];
        if w.iter().all(|w| *w > 1e-6) {
            let turn = random.below(3);
            return a * w[turn] + b * w[(turn + 1) % 3] + c * w[(turn + 2) % 3];
        }
    }
}

/// Returns the point at which the line meets a triangle, unless the point is near the triangle's border.
fn met(t: &Corners, o: DVec3, d: DVec3) -> Option<DVec3> {
    let [a, b, c] = t.map(|p| p.as_dvec3());
    let n = (b - a).cross(c - a);
    let along = n.dot(d);
    if along.abs() < 1e-3 {
        return None;
    }
    let p = o + d * (n.dot(a - o) / along);
    let area = n.length_squared();
    let w = [
        (b - p).cross(c - p).dot(n),
        (c - p).cross(a - p).dot(n),
        (a - p).cross(b - p).dot(n),
    ];
    w.iter().all(|w| *w / area > 1e-6).then_some(p)
}

/// Searches for a free segment.
fn search(random: &mut Random, pair: &Pair, tries: usize) -> Option<[DVec3; 2]> {
    for n in 0..tries {
        let (p, q) = if n % 2 == 0 || pair.blockers.is_empty() {
            (within(random, &pair.a), within(random, &pair.b))
        } else {
            // The line passes close to two edges of the scene, to find the way through a narrow gap.
            let mut beside = || {
                let t = pair.blockers[random.below(pair.blockers.len())];
                let k = random.below(3);
                let at = t[k].lerp(t[(k + 1) % 3], random.unit());
                at + random.direction() * [1e-1, 1e-2, 1e-3, 1e-4][random.below(4)]
            };
            let (x, y) = (beside(), beside());
            match (met(&pair.a, x, y - x), met(&pair.b, x, y - x)) {
                (Some(p), Some(q)) => (p, q),
                _ => continue,
            }
        };
        if pair.free(p, q) {
            return Some([p, q]);
        }
    }
    None
}

/// Creates a triangle within `reach` of a point, with whole coordinates or any coordinates.
fn triangle(random: &mut Random, whole: bool, around: DVec3, reach: f64) -> Corners {
    loop {
        let t = [0; 3].map(|_| {
            let p = around + DVec3::from([0; 3].map(|_| random.between(-reach, reach)));
            if whole {
                p.round().as_vec3()
            } else {
                p.as_vec3()
            }
        });
        if (t[1] - t[0]).cross(t[2] - t[0]).length() > 0.5 {
            return t;
        }
    }
}

/// Creates a scene with a wall across most of it, so that enough is hidden.
fn scene(random: &mut Random, whole: bool, reach: f64) -> World {
    let count = 5 + random.below(30);
    let mut triangles: Vec<Corners> = (0..count)
        .map(|_| triangle(random, whole, DVec3::ZERO, reach))
        .collect();
    let z = if whole {
        0.0
    } else {
        random.between(-0.5, 0.5) as f32
    };
    let corner = |x: f32, y: f32| Vec3::new(x * reach as f32, y * reach as f32, z);
    triangles.push([corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0)]);
    triangles.push([corner(-1.0, -1.0), corner(1.0, 1.0), corner(-0.5, 1.0)]);
    World::new(triangles)
}

/// Creates two small triangles on both sides of the wall, or any two triangles.
fn ends(random: &mut Random, whole: bool, reach: f64) -> [Corners; 2] {
    let (up, size) = if random.below(4) > 0 {
        (reach - 1.0, 1.4)
    } else {
        (0.0, reach)
    };
    [-up, up].map(|z| triangle(random, whole, DVec3::Z * z, size))
}

#[test]
fn no_segment_is_free_between_hidden_polygons() {
    let (mut seen, mut hidden, mut found, mut undecided) = (0, 0, 0, Vec::new());
    for seed in 0..600 {
        let mut random = Random::new(seed);
        let whole = seed % 3 > 0;
        let reach = [2.0, 3.0, 4.0][random.below(3)];
        let world = scene(&mut random, whole, reach);
        for _ in 0..4 {
            let [a, b] = ends(&mut random, whole, reach);
            let pair = Pair::new(&world.triangles, a, b);
            let [a, b] = [a, b].map(|t| t.map(|p| p.as_dvec3()));
            let free = search(&mut random, &pair, 20_000);
            match world.try_sees(&a, &b) {
                Ok(true) => {
                    seen += 1;
                    found += usize::from(free.is_some());
                }
                Ok(false) => {
                    hidden += 1;
                    assert_eq!(free, None, "{a:?} {b:?} {:?}", world.triangles);
                }
                Err(why) => undecided.push(why),
            }
        }
    }
    assert!(
        undecided.is_empty(),
        "{} of {}: {}",
        undecided.len(),
        seen + hidden,
        undecided[0]
    );
    // Both kinds must be frequent, and segments must find most visible pairs; otherwise the test would show
    // little.
    assert!(seen > 500 && hidden > 500, "{seen} seen, {hidden} hidden");
    assert!(found * 10 > seen * 9, "{found} of {seen} found");
}

#[test]
fn checker_rejects_altered_witnesses_and_proofs() {
    let (mut witnesses, mut proofs) = (0, 0);
    for seed in 0..300 {
        let mut random = Random::new(1000 + seed);
        let whole = seed % 3 > 0;
        let world = scene(&mut random, whole, 3.0);
        let [a, b] = ends(&mut random, whole, 3.0);
        let [x, y] = [a, b].map(|t| [Polygon::triangle(t.map(|p| p.as_dvec3())).unwrap()]);
        let Ok(verdict) = world.verdict(&x, &y) else {
            continue;
        };
        let mut triangles = world.triangles.clone();
        match &verdict {
            Verdict::Visible(ends) => {
                // The added triangle lies across the middle of the segment.
                let [p, q] = [0, 1].map(|i| polygon::rounded(&ends[i]));
                let (u, v) = (q - p).normalize().any_orthonormal_pair();
                let at = |s: f64, t: f64| ((p + q) / 2.0 + (u * s + v * t) * 1e-3).as_vec3();
                triangles.push([at(1.0, 0.0), at(-1.0, 1.0), at(-1.0, -1.0)]);
                assert!(check(&triangles, &x, &y, &verdict).is_err(), "{seed}");
                triangles.pop();
                // The ends are not inside the moved polygons.
                let away = [Polygon::triangle(b.map(|p| p.as_dvec3() + DVec3::X * 100.0)).unwrap()];
                assert!(check(&triangles, &x, &away, &verdict).is_err(), "{seed}");
                assert!(check(&triangles, &away, &y, &verdict).is_err(), "{seed}");
                witnesses += 1;
            }
            Verdict::Hidden(proof) => {
                for blocker in proof.blockers() {
                    let was = triangles[blocker as usize];
                    triangles[blocker as usize] = was.map(|p| p + Vec3::splat(100.0));
                    if search(&mut random, &Pair::new(&triangles, a, b), 2000).is_some() {
                        assert!(
                            check(&triangles, &x, &y, &verdict).is_err(),
                            "{seed} without {blocker}"
                        );
                        proofs += 1;
                    }
                    triangles[blocker as usize] = was;
                }
                // With one step more, or one step less, the number of remaining parts is not zero. (A step
                // that leaves one part may be unnecessary.)
                for at in 0..proof.steps.len() {
                    let mut other = proof.clone();
                    other.steps.insert(at, Step::Unreal);
                    assert!(
                        check(&triangles, &x, &y, &Verdict::Hidden(other)).is_err(),
                        "{seed}, step {at}"
                    );
                    let parts = match &proof.steps[at] {
                        Step::Block { cuts, .. } => cuts.len(),
                        Step::Unreal => 0,
                        Step::Split { .. } | Step::Divide { .. } => 2,
                    };
                    let mut other = proof.clone();
                    other.steps.remove(at);
                    let accepted = check(&triangles, &x, &y, &Verdict::Hidden(other)).is_ok();
                    assert!(!accepted || parts == 1, "{seed} without step {at}");
                }
            }
            Verdict::Undecided(_) => {}
        }
    }
    assert!(
        witnesses > 50 && proofs > 50,
        "{witnesses} witnesses, {proofs} proofs"
    );
}

#[test]
fn misses_rejects_segments_that_meet_triangle() {
    let t = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let ends = |x: f64, y: f64| [DVec3::new(x, y, -1.0), DVec3::new(x, y, 1.0)];
    for (x, y, free) in [
        (0.3, 0.3, false),
        (0.0, 0.0, false),
        (0.5, 0.5, false),
        (-1e-12, 0.5, false),
        (-1e-3, 0.5, true),
        (0.7, 0.7, true),
    ] {
        let [p, q] = ends(x, y);
        assert_eq!(misses(p, q, t), free, "{x} {y}");
        assert_eq!(misses(q, p, t), free, "{x} {y}");
    }
    // The segments lie in the triangle's plane, end before it, and end on it.
    assert!(!misses(
        DVec3::new(-1.0, 0.2, 0.0),
        DVec3::new(1.0, 0.2, 0.0),
        t
    ));
    assert!(misses(
        DVec3::new(0.3, 0.3, 1.0),
        DVec3::new(0.3, 0.3, 1e-3),
        t
    ));
    assert!(!misses(
        DVec3::new(0.3, 0.3, 1.0),
        DVec3::new(0.3, 0.3, 0.0),
        t
    ));
}
