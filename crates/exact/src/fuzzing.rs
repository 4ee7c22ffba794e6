//! The body of the fuzz target `query`, which the tests also call.

use glam::{DVec3, Vec3};
use sightline_certificate::checker::{self, check_hidden, check_witness};
use sightline_scene::{Object, Scene, Triangle};

use crate::{Occluders, Polygon, QueryLimits, Verdict, sightlines};

/// Decodes bytes as two triangles A and B and at most 24 occluding triangles, and queries whether A sees B.
///
/// The first byte selects the encoding of a coordinate: four bytes as an `f32`, one signed byte in quarters
/// (from −32 to 31.75), or the upper four bits of a signed byte times a power of two per point. The function
/// returns true if A sees B, and false if B is hidden. It returns `None` if the bytes are not valid triangles
/// or the query stays undecided.
///
/// # Panics
/// If the checker rejects a witness or a proof, or if the query from B to A contradicts the query from A to
/// B. Such a panic is an error in the search or the checker; no input may cause it.
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
    let limits = QueryLimits {
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
                assert!(
                    checked.is_ok(),
                    "the checker rejected a witness: {checked:?}"
                );
                *verdict = Some(true);
            }
            Verdict::Hidden(proof) => {
                let checked = check_hidden(&triangles, ca, cb, &proof);
                assert!(checked.is_ok(), "the checker rejected a proof: {checked:?}");
                *verdict = Some(false);
            }
            Verdict::Undecided(_) => {}
        }
    }
    if let [Some(there), Some(back)] = verdicts {
        assert_eq!(
            there, back,
            "the query from A to B contradicts the query from B to A"
        );
    }
    verdicts[0].or(verdicts[1])
}

/// The maximum number of occluding triangles; a run with more would be slow.
const MOST_TRIANGLES: usize = 24;
