//! The body of the fuzz target `query`, which the tests call too.

use glam::{DVec3, Vec3};
use sightline_certificate::checker::{self, check_hidden, check_witness};
use sightline_scene::{Object, Scene, Triangle};

use crate::{Limits, Occluders, Polygon, Verdict, sightlines};

/// Decodes bytes as two triangles and occluding triangles, and asks whether one of the two sees the other.
/// The first byte selects the coordinates: any bits of floats, quarters from −32 to 31.75, or the upper half
/// of a byte on a scale of its own for each point. Returns the decision: `None` if the bytes are too short or
/// the query stays undecided.
///
/// # Panics
/// If the checker refuses a witness or a proof, or the queries in the two directions contradict each other.
/// No bytes may cause that.
pub fn query(raw: &[u8]) -> Option<bool> {
    let (kind, raw) = raw.split_first()?;
    let mut bytes = raw.iter().copied();
    let mut coordinate = |scale: f32| match kind % 3 {
        0 => {
            let bits: Option<Vec<u8>> = (0..4).map(|_| bytes.next()).collect();
            bits.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        }
        1 => bytes.next().map(|b| f32::from(b.cast_signed()) / 4.0),
        _ => bytes
            .next()
            .map(|b| f32::from(b.cast_signed() >> 4) * scale),
    };
    let mut scales = raw.iter().rev();
    let mut corner = || -> Option<Vec3> {
        let scale = f32::powi(2.0, i32::from(scales.next()? & 31) - 16);
        Some(Vec3::new(
            coordinate(scale)?,
            coordinate(scale)?,
            coordinate(scale)?,
        ))
    };
    let mut triangle = || Some([corner()?, corner()?, corner()?]);
    let (a, b) = (triangle()?, triangle()?);
    let triangles: Vec<[Vec3; 3]> = std::iter::from_fn(triangle).take(MOST_TRIANGLES).collect();
    let object = Object {
        name: "all".to_owned(),
        first: 0,
        count: triangles.len() as u32,
    };
    let scene = Scene::new(
        "fuzz",
        triangles.iter().map(|v| Triangle { v: *v }).collect(),
        vec![object],
    )
    .ok()?;
    let occluders = Occluders::new(&scene).ok()?;
    let ends: [[DVec3; 3]; 2] = [a, b].map(|t| t.map(|v| v.as_dvec3()));
    let [a, b] = ends.map(|t| Polygon::checked(&t).ok());
    let (a, b) = (a?, b?);
    let limits = Limits {
        regions: 300,
        vectors: 20_000,
        splits: 16,
        divisions: 4,
    };
    let [ca, cb] = ends.map(|t| [checker::corners(&t)]);
    let mut verdicts = [None, None];
    for (back, verdict) in verdicts.iter_mut().enumerate() {
        let (a, b, ca, cb) = if back == 0 {
            (&a, &b, &ca, &cb)
        } else {
            (&b, &a, &cb, &ca)
        };
        match sightlines(&occluders, a, b, &limits).0 {
            Verdict::Visible(ends) => {
                let [p, q] = ends.each_ref().map(crate::geometry::predicates::integers);
                let checked = check_witness(&triangles, ca, cb, &p, &q);
                assert!(checked.is_ok(), "a witness was refused: {checked:?}");
                *verdict = Some(true);
            }
            Verdict::Hidden(proof) => {
                let checked = check_hidden(&triangles, ca, cb, &proof);
                assert!(checked.is_ok(), "a proof was refused: {checked:?}");
                *verdict = Some(false);
            }
            Verdict::Undecided(_) => {}
        }
    }
    if let [Some(there), Some(back)] = verdicts {
        assert_eq!(there, back, "A sees B and B does not see A");
    }
    verdicts[0].or(verdicts[1])
}

/// Most occluding triangles, so that a run is fast.
const MOST_TRIANGLES: usize = 24;
