//! Whether the evidence about a view cell shows what its set claims.
//!
//! What is claimed, and what is checked:
//!
//! 1. *All are accounted for.* Every triangle with area is in the set and seen, in the set and undecided, or hidden. What is seen
//!    meets the cell (a triangle clipped to the box leaves something) or has a witness; what is not in the set is in one of the
//!    groups of hidden triangles, of the cell or of a box that the cell lies in.
//! 2. *Seen.* A witness begins in the cell, ends inside the triangle, and no other triangle has a point on it, but for those in the
//!    triangle's plane. One that begins on a face of the cell and leaves through it may do so on a triangle in that face's plane.
//! 3. *Hidden.* A group's triangles lie in its box (or in its polygon, or are the one triangle), and neither the box nor the
//!    triangles have a point in common with the cell. A segment
//!    from the cell to the box leaves the cell through some face and enters the box through one; for every pair of faces between which
//!    that can be there is a proof ([`super::check_hidden`]) for the part of the box's face beyond the cell's. Faces without area
//!    let no open set of lines through. What a closed surface hides needs no proof ([`super::surfaces`]).
//!    What is hidden from a box is hidden from all cells in it; of the groups of a box the same is checked, with the box for the cell.

use std::cmp::Ordering;
use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;

use super::line::{Plane, Point, height, plane, point, reduced, sign};
use super::near::Triangles;
use super::witness::{around, inside, meets};
use super::{Corners, Refusal, check_hidden, check_polygons, clip};
use crate::evidence::{Evidence, Hidden, Shared, Target, Witness, faces};

/// Most corners of a polygon that is hidden as a whole: more than any has, and few enough to check at once.
const MOST_CORNERS: usize = 64;

/// What a result claims about one cell.
#[derive(Clone, Copy, Debug)]
pub struct CellClaims<'a> {
    /// Least and greatest corner of the cell.
    pub cell: [Vec3; 2],
    /// The set, ascending, with what is undecided.
    pub visible: &'a [u32],
    /// What of it is undecided, ascending.
    pub undecided: &'a [u32],
    /// The reasons.
    pub evidence: &'a Evidence,
    /// What is hidden from the box around the cell that its evidence names ([`Evidence::above`]).
    pub above: Option<&'a Shared>,
}

/// A single claim about a cell, to be checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Claim {
    /// That a triangle meets the cell.
    Meets(u32),
    /// The witness at this place in the evidence.
    Seen(usize),
    /// The group of hidden triangles at this place.
    Hidden(usize),
    /// The group at this place of what the evidence shares ([`Evidence::shared`]). No other cell need be looked at to check it.
    Shared(usize),
    /// The group at this place of [`CellClaims::above`]: who checks all cells of a result checks it with the cell that keeps it.
    Above(usize),
}

/// Why what is claimed of a cell is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CellRefusal {
    /// The cell is no box.
    #[error("the cell is not a box with a volume")]
    Cell,
    /// A set is not in order, or the evidence does not fit it.
    #[error("triangle {0}: {1}")]
    Account(u32, &'static str),
    /// A triangle neither meets the cell nor has a witness.
    #[error(
        "triangle {0} is said to be visible, but it does not meet the cell and there is no witness for it"
    )]
    NoWitness(u32),
    /// The cell names evidence about a box that it is not in.
    #[error("it rests on certificates for a box that it is not in, or that are not there")]
    Above,
    /// A witness does not show its triangle.
    #[error("the witness for triangle {0}: {1}")]
    Witness(u32, String),
    /// A group of hidden triangles.
    #[error("the certificate for {}: {reason}", group(triangles))]
    Hidden {
        /// The group.
        triangles: Vec<u32>,
        /// What is wrong.
        reason: String,
    },
}

fn group(triangles: &[u32]) -> String {
    match triangles {
        [one] => format!("triangle {one}"),
        [first, _] => format!("triangle {first} and another"),
        [first, ..] => format!("triangle {first} and {} others", triangles.len() - 1),
        [] => "no triangle".to_owned(),
    }
}

/// Checks that all triangles are accounted for, then each claim that `pick` picks, and gives the number of claims checked.
///
/// # Errors
/// [`CellRefusal`]: the first claim that does not hold.
pub fn check_cell(
    scene: &Triangles<'_>,
    claims: &CellClaims<'_>,
    pick: &(dyn Fn(Claim) -> bool + Sync),
) -> Result<u64, CellRefusal> {
    let [min, max] = claims.cell;
    if !(min.cmplt(max).all() && min.is_finite() && max.is_finite()) {
        return Err(CellRefusal::Cell);
    }
    let mut picked = account(scene, claims)?;
    picked.retain(|claim| pick(*claim));
    // Only evidence that speaks of surfaces needs them.
    let by_surface = |h: &Hidden| matches!(h.target, Target::Surfaces | Target::Half);
    let surfaces = if claims.evidence.hidden.iter().any(by_surface) { scene.surfaces().len() } else { 0 };
    let parity = vec![OnceLock::new(); surfaces];
    // Of several that do not hold, always the same is named. One by one: a box can take as long as a thousand triangles.
    let refusal =
        picked.par_iter().with_max_len(1).find_map_first(|claim| check(scene, claims, &parity, *claim).err());
    refusal.map_or(Ok(picked.len() as u64), Err)
}

/// Parities of a cell, by surface, as they are found out.
type Parities = [OnceLock<Option<bool>>];

fn check(
    scene: &Triangles<'_>,
    claims: &CellClaims<'_>,
    parity: &Parities,
    claim: Claim,
) -> Result<(), CellRefusal> {
    match claim {
        Claim::Meets(id) => {
            if !meets_box(&scene.all()[id as usize], claims.cell) {
                return Err(CellRefusal::NoWitness(id));
            }
        }
        Claim::Seen(at) => {
            let (id, witness) = &claims.evidence.seen[at];
            check_witness(scene, claims.cell, *id, witness).map_err(|e| CellRefusal::Witness(*id, e))?;
        }
        Claim::Hidden(at) => {
            let group = &claims.evidence.hidden[at];
            check_group(scene, claims.cell, parity, group)
                .map_err(|reason| CellRefusal::Hidden { triangles: group.triangles.clone(), reason })?;
        }
        Claim::Shared(at) => check_shared(scene, claims.evidence.shared.as_ref(), at)?,
        Claim::Above(at) => check_shared(scene, claims.above, at)?,
    }
    Ok(())
}

/// Accepts that a group of triangles is hidden from all of a box.
fn check_shared(scene: &Triangles<'_>, shared: Option<&Shared>, at: usize) -> Result<(), CellRefusal> {
    let Some((shared, group)) = shared.and_then(|s| Some((s, s.hidden.get(at)?))) else {
        return Err(CellRefusal::Above);
    };
    let [min, max] = shared.bounds;
    let checked = if !(min.cmplt(max).all() && min.is_finite() && max.is_finite()) {
        Err("the box it is about has no volume".to_owned())
    } else if matches!(group.target, Target::Surfaces | Target::Half) {
        Err("what surfaces hide is to be said for each cell".to_owned())
    } else {
        check_group(scene, shared.bounds, &[], group)
    };
    checked.map_err(|reason| CellRefusal::Hidden { triangles: group.triangles.clone(), reason })
}

/// All claims, if every triangle with area has one and only one.
fn account(scene: &Triangles<'_>, claims: &CellClaims<'_>) -> Result<Vec<Claim>, CellRefusal> {
    let refuse = |id: u32, what| Err(CellRefusal::Account(id, what));
    let n = scene.all().len();
    for set in [claims.visible, claims.undecided] {
        if let Some(w) = set.windows(2).find(|w| w[0] >= w[1]) {
            return refuse(w[1], "a set is not in order");
        }
        if let Some(id) = set.last().filter(|id| **id as usize >= n) {
            return refuse(*id, "there is no such triangle in the scene");
        }
    }
    /// What is known of a triangle so far.
    #[derive(Clone, Copy, PartialEq)]
    enum Known {
        Nothing,
        Visible,
        Undecided,
        Accounted,
    }
    let mut known = vec![Known::Nothing; n];
    claims.visible.iter().for_each(|id| known[*id as usize] = Known::Visible);
    for id in claims.undecided {
        if known[*id as usize] != Known::Visible {
            return refuse(*id, "it is undecided but not in the set");
        }
        known[*id as usize] = Known::Undecided;
    }
    let mut all = Vec::new();
    for (at, (id, _)) in claims.evidence.seen.iter().enumerate() {
        match known.get_mut(*id as usize) {
            Some(k @ Known::Visible) => *k = Known::Accounted,
            _ => return refuse(*id, "it has a witness and is not said to be visible, or has two"),
        }
        all.push(Claim::Seen(at));
    }
    for (at, group) in claims.evidence.hidden.iter().enumerate() {
        for id in &group.triangles {
            match known.get_mut(*id as usize) {
                Some(k @ Known::Nothing) => *k = Known::Accounted,
                _ => return refuse(*id, "it has a proof that it is hidden and is in the set, or has two"),
            }
        }
        all.push(Claim::Hidden(at));
    }
    if claims.above.is_some() != claims.evidence.above.is_some() {
        return Err(CellRefusal::Above);
    }
    if let Some(shared) = claims.above {
        let [min, max] = shared.bounds;
        if !(min.cmple(claims.cell[0]).all() && max.cmpge(claims.cell[1]).all()) {
            return Err(CellRefusal::Above);
        }
        for (at, group) in shared.hidden.iter().enumerate() {
            for id in &group.triangles {
                match known.get_mut(*id as usize) {
                    Some(k @ Known::Nothing) => *k = Known::Accounted,
                    _ => {
                        return refuse(
                            *id,
                            "it is hidden from a box around the cell and is in the set, or has two proofs",
                        );
                    }
                }
            }
            all.push(Claim::Above(at));
        }
    }
    all.extend((0..claims.evidence.shared.as_ref().map_or(0, |s| s.hidden.len())).map(Claim::Shared));
    for (id, (k, t)) in known.iter().zip(scene.all()).enumerate() {
        match k {
            Known::Visible => all.push(Claim::Meets(id as u32)),
            Known::Nothing if has_area(t) => {
                return refuse(id as u32, "it is not in the set, and there is no proof that it is hidden");
            }
            _ => {}
        }
    }
    Ok(all)
}

pub(super) fn exact(t: &[Vec3; 3]) -> [Point; 3] {
    t.map(|v| point(v.as_dvec3().to_array()))
}

pub(super) fn has_area(t: &[Vec3; 3]) -> bool {
    let [a, b, c] = exact(t);
    !plane([&a, &b, &c])[..3].iter().all(dashu_int::IBig::is_zero)
}

/// The plane of a face of a box, its normal pointing out.
fn face_plane([min, max]: [Vec3; 2], axis: usize, up: bool) -> Plane {
    let [x, y, z, w] = point([f64::from(if up { max[axis] } else { min[axis] }), 0.0, 0.0]);
    debug_assert!(y.is_zero() && z.is_zero());
    let mut out: Plane = std::array::from_fn(|_| dashu_int::IBig::ZERO);
    (out[axis], out[3]) = (w, x);
    if up { out } else { out.map(|c| -c) }
}

/// A face of a box, beginning at its least corner and going along the next axis first.
fn face([min, max]: [Vec3; 2], axis: usize, up: bool) -> Corners {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    [[false, false], [true, false], [true, true], [false, true]]
        .into_iter()
        .map(|[s, t]| {
            let mut p = min.as_dvec3();
            let max = max.as_dvec3();
            if up {
                p[axis] = max[axis];
            }
            if s {
                p[u] = max[u];
            }
            if t {
                p[v] = max[v];
            }
            point(p.to_array())
        })
        .collect()
}

/// Whether a closed triangle has a point in a closed box: what is left of it, clipped to one face after the other.
pub(super) fn meets_box(t: &[Vec3; 3], cell: [Vec3; 2]) -> bool {
    if !has_area(t) {
        return false;
    }
    let mut left: Vec<Point> = exact(t).into();
    for (axis, up) in faces() {
        let flat = face_plane(cell, axis, up);
        let heights: Vec<_> = left.iter().map(|p| height(&flat, p)).collect();
        let n = left.len();
        let mut kept = Vec::with_capacity(n + 1);
        for i in 0..n {
            let j = (i + 1) % n;
            if sign(&heights[i]) != Ordering::Greater {
                kept.push(left[i].clone());
            }
            if sign(&(&heights[i] * &heights[j])) == Ordering::Less {
                kept.push(cut(&left[i], &left[j], &flat));
            }
        }
        left = kept;
    }
    !left.is_empty()
}

/// Σ weight · point / Σ weight, for positive weights.
pub(super) fn mixed(points: &[Point], weights: &[dashu_int::IBig]) -> Point {
    let scale: dashu_int::IBig = points.iter().map(|p| &p[3]).product();
    let parts: Vec<dashu_int::IBig> = points.iter().zip(weights).map(|(p, w)| w * &scale / &p[3]).collect();
    let along = |k: usize| points.iter().zip(&parts).map(|(p, s)| &p[k] * s).sum();
    let total: dashu_int::IBig = weights.iter().sum();
    reduced([along(0), along(1), along(2), total * scale])
}

/// Where the segment between two points on different sides of a plane crosses it.
pub(super) fn cut(p: &Point, q: &Point, flat: &Plane) -> Point {
    let weight = |x: &Point| {
        let h = height(flat, x);
        if sign(&h) == Ordering::Less { -h } else { h }
    };
    let (s, t) = (weight(p), weight(q));
    reduced(std::array::from_fn(|k| &q[k] * &s + &p[k] * &t))
}

fn check_witness(scene: &Triangles<'_>, cell: [Vec3; 2], id: u32, witness: &Witness) -> Result<(), String> {
    let corners = exact(&scene.all()[id as usize]);
    let own = plane([&corners[0], &corners[1], &corners[2]]);
    let (p, q) = match witness {
        Witness::Floats([p, q]) => {
            let [p, q] = [p, q].map(|e| point(e.as_dvec3().to_array()));
            let sides = [sign(&height(&own, &p)), sign(&height(&own, &q))];
            if sides[0] == Ordering::Equal || sides[0] != sides[1].reverse() {
                return Err("it does not cross the triangle's plane".to_owned());
            }
            let at = cut(&p, &q, &own);
            (p, at)
        }
        Witness::Exact(ends) => (**ends).clone().into(),
    };
    if [&p, &q].iter().any(|e| sign(&e[3]) != Ordering::Greater) {
        return Err("an end of it is no point".to_owned());
    }
    let outside = |(axis, up)| sign(&height(&face_plane(cell, axis, up), &p)) == Ordering::Greater;
    if faces().any(outside) {
        return Err("it does not begin in the cell".to_owned());
    }
    if height(&own, &p).is_zero() {
        return Err("it runs in the triangle's plane".to_owned());
    }
    if !inside(&corners, &q) {
        return Err("it does not end inside the triangle".to_owned());
    }
    // The face it leaves the cell through, if it begins on one.
    let leaving = faces()
        .map(|(axis, up)| face_plane(cell, axis, up))
        .find(|f| height(f, &p).is_zero() && sign(&height(f, &q)) == Ordering::Greater);
    let bounds = |e: &Point| -> [Vec3; 2] {
        let sides: [(f64, f64); 3] = std::array::from_fn(|k| around(&e[k], &e[3]));
        // Rounding a double to single precision moves it by at most a step.
        let low = |x: f64| (x as f32).next_down();
        let high = |x: f64| (x as f32).next_up();
        let [x, y, z] = sides;
        [Vec3::new(low(x.0), low(y.0), low(z.0)), Vec3::new(high(x.1), high(y.1), high(z.1))]
    };
    for other in scene.along(bounds(&p), bounds(&q)) {
        if meets(&scene.all()[other as usize], &p, &q, [leaving.as_ref(), Some(&own)]) {
            return Err(format!("it meets triangle {other}"));
        }
    }
    Ok(())
}

/// Whether a point lies in a convex flat polygon, on its border perhaps.
fn within(polygon: &Corners, p: &Point) -> bool {
    let n = polygon.len();
    let flat = plane([&polygon[0], &polygon[1], &polygon[2]]);
    // A point off the plane: with it each edge spans a plane across, on whose same side all of the polygon is.
    let off: Point = std::array::from_fn(|i| {
        if i < 3 { &polygon[0][i] + &flat[i] * &polygon[0][3] } else { polygon[0][3].clone() }
    });
    let side = |i: usize, p: &Point| sign(&height(&plane([&polygon[i], &polygon[(i + 1) % n], &off]), p));
    let inner = side(0, &polygon[2]);
    height(&flat, p).is_zero() && (0..n).all(|i| side(i, p) != inner.reverse())
}

/// Accepts that a triangle is hidden from all of a cell by its surface: all of the cell is on the hidden side of its plane, or on
/// the plane.
fn hidden_by_surface(
    scene: &Triangles<'_>,
    cell: [Vec3; 2],
    parity: &Parities,
    id: u32,
) -> Result<(), &'static str> {
    let side = scene.surfaces().hidden_side(scene, cell, parity, id)?;
    let t = exact(&scene.all()[id as usize]);
    let flat = plane([&t[0], &t[1], &t[2]]);
    let corners = [face(cell, 0, false), face(cell, 0, true)].concat();
    if corners.iter().any(|p| sign(&height(&flat, p)) == side.reverse()) {
        return Err("the cell is not all on the hidden side of it");
    }
    Ok(())
}

fn check_group(
    scene: &Triangles<'_>,
    cell: [Vec3; 2],
    parity: &Parities,
    group: &Hidden,
) -> Result<(), String> {
    let all = scene.all();
    if group.triangles.iter().any(|id| *id as usize >= all.len()) {
        return Err("there is no such triangle in the scene".to_owned());
    }
    let targets: Vec<Corners> = match &group.target {
        Target::Surfaces => {
            if !group.proofs.is_empty() {
                return Err("surfaces need no proofs".to_owned());
            }
            let refusal = group.triangles.par_iter().find_map_first(|id| {
                hidden_by_surface(scene, cell, parity, *id).err().map(|e| format!("triangle {id}: {e}"))
            });
            return refusal.map_or(Ok(()), Err);
        }
        Target::Triangle | Target::Half => {
            let [id] = group.triangles[..] else { return Err("it is not about one triangle".to_owned()) };
            if meets_box(&all[id as usize], cell) {
                return Err("it meets the cell".to_owned());
            }
            if has_area(&all[id as usize]) { vec![exact(&all[id as usize]).into()] } else { Vec::new() }
        }
        Target::Polygon(corners) => {
            if corners.len() > MOST_CORNERS {
                return Err(format!("its polygon has more than {MOST_CORNERS} corners"));
            }
            let corners: Corners = corners.iter().map(|c| point(c.as_dvec3().to_array())).collect();
            let target = [corners];
            // The checks that follow are about a polygon that is convex and flat.
            check_polygons(&target).map_err(|e| e.to_string())?;
            for id in &group.triangles {
                if meets_box(&all[*id as usize], cell) {
                    return Err(format!("triangle {id} meets the cell"));
                }
                if !exact(&all[*id as usize]).iter().all(|p| within(&target[0], p)) {
                    return Err(format!("triangle {id} is not in its polygon"));
                }
            }
            target.into()
        }
        Target::Box([min, max]) => {
            let (min, max) = (*min, *max);
            if !(min.is_finite() && max.is_finite() && min.cmple(max).all()) {
                return Err("its box is none".to_owned());
            }
            let outside =
                |id: &&u32| all[**id as usize].iter().any(|v| v.cmplt(min).any() || v.cmpgt(max).any());
            if let Some(id) = group.triangles.iter().find(outside) {
                return Err(format!("triangle {id} is not in its box"));
            }
            if min.cmple(cell[1]).all() && max.cmpge(cell[0]).all() {
                return Err("its box touches the cell".to_owned());
            }
            faces()
                .filter(|(axis, up)| {
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    let area = min[u] < max[u] && min[v] < max[v];
                    // Some point of the cell is on the face's outer side.
                    let towards = if *up { cell[1][*axis] > max[*axis] } else { cell[0][*axis] < min[*axis] };
                    area && towards
                })
                .map(|(axis, up)| face([min, max], axis, up))
                .collect()
        }
    };
    // Where it is hidden on one side of its plane anyway, only what is on the other has to be proved.
    let half = match (&group.target, &group.triangles[..]) {
        (Target::Half, [id]) => {
            Some(scene.surfaces().hidden_side(scene, cell, parity, *id).map_err(str::to_owned)?)
        }
        _ => None,
    };
    let mut proofs = group.proofs.iter();
    let mut shown = Vec::with_capacity(group.proofs.len());
    for (axis, up) in faces() {
        let flat = face_plane(cell, axis, up);
        let from = face(cell, axis, up);
        for target in &targets {
            let Some(beyond) = clip(target, &flat, Ordering::Greater) else { continue };
            let proof = proofs.next().ok_or("a proof is missing for a pair of faces")?;
            let part = match half {
                None => Some(from.clone()),
                Some(side) => clip(&from, &plane([&target[0], &target[1], &target[2]]), side.reverse()),
            };
            shown.push((part, beyond, proof));
        }
    }
    if proofs.next().is_some() {
        return Err("it has more proofs than pairs of faces".to_owned());
    }
    let refusal = shown.par_iter().with_max_len(1).find_map_first(|(part, beyond, proof)| {
        check_hidden(all, part.as_slice(), std::slice::from_ref(beyond), proof).err()
    });
    match refusal {
        None => Ok(()),
        Some(e @ Refusal::Polygon) => Err(format!("a face is no polygon: {e}")),
        Some(e) => Err(e.to_string()),
    }
}
