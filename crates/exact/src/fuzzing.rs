//! Entry points for fuzz targets and property tests that accept arbitrary bytes.

use glam::{DVec3, Vec3};
use sightline_scene::{Object, Scene, Triangle};

use crate::checker::{self, CellClaims, Triangles, check_cell, check_hidden, check_witness};
use crate::evidence::codec;
use crate::{Limits, Occluders, Polygon, Verdict, sightlines};

/// Reads bytes (without their compression) as the evidence of a cell before two walls, and has everything
/// checked that they claim. Whether that is accepted does not matter here, only that nothing panics.
pub fn evidence(raw: &[u8]) {
    let wall = |z: f32| {
        let [a, b, c, d] =
            [[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]].map(|[x, y]| Vec3::new(x, y, z));
        [[a, b, c], [a, c, d]]
    };
    let triangles = [wall(1.0), wall(2.0), wall(3.0)].concat();
    let Ok(evidence) = codec::decode_raw(raw, triangles.len() as u32) else { return };
    let index = Triangles::new(&triangles);
    for visible in [&[][..], &[0, 1], &[0, 1, 2, 3, 4, 5]] {
        let cell = [Vec3::ZERO, Vec3::splat(0.5)];
        let above = evidence.shared.as_ref().filter(|_| evidence.above.is_some());
        let claims = CellClaims { cell, visible, undecided: &[], evidence: &evidence, above };
        let _ = check_cell(&index, &claims, &|_| true);
    }
}

/// Reads bytes as two triangles and others between them, and asks whether one sees the other. The first byte
/// says what coordinates are made of: any bits of floats, quarters from −32 to 31.75, or the upper half of a
/// byte on a scale of its own for each point. What was decided, if the bytes were triangles and it was.
///
/// # Panics
/// When the checker refuses a witness or a proof, or the two directions contradict each other: what no bytes
/// may bring about.
pub fn query(raw: &[u8]) -> Option<bool> {
    let (kind, raw) = raw.split_first()?;
    let mut bytes = raw.iter().copied();
    let mut coordinate = |scale: f32| match kind % 3 {
        0 => {
            let bits: Option<Vec<u8>> = (0..4).map(|_| bytes.next()).collect();
            bits.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        }
        1 => bytes.next().map(|b| f32::from(b.cast_signed()) / 4.0),
        _ => bytes.next().map(|b| f32::from(b.cast_signed() >> 4) * scale),
    };
    let mut scales = raw.iter().rev();
    let mut corner = || -> Option<Vec3> {
        let scale = f32::powi(2.0, i32::from(scales.next()? & 31) - 16);
        Some(Vec3::new(coordinate(scale)?, coordinate(scale)?, coordinate(scale)?))
    };
    let mut triangle = || Some([corner()?, corner()?, corner()?]);
    let (a, b) = (triangle()?, triangle()?);
    let triangles: Vec<[Vec3; 3]> = std::iter::from_fn(triangle).take(MOST_TRIANGLES).collect();
    let object = Object { name: "all".to_owned(), first: 0, count: triangles.len() as u32 };
    let scene =
        Scene::new("fuzz", triangles.iter().map(|v| Triangle { v: *v }).collect(), vec![object]).ok()?;
    let occluders = Occluders::new(&scene).ok()?;
    let ends: [[DVec3; 3]; 2] = [a, b].map(|t| t.map(|v| v.as_dvec3()));
    let [a, b] = ends.map(|t| Polygon::checked(&t).ok());
    let (a, b) = (a?, b?);
    let limits = Limits { regions: 300, vectors: 20_000, splits: 16, divisions: 4 };
    let [ca, cb] = ends.map(|t| [checker::corners(&t)]);
    let mut verdicts = [None, None];
    for (back, verdict) in verdicts.iter_mut().enumerate() {
        let (a, b, ca, cb) = if back == 0 { (&a, &b, &ca, &cb) } else { (&b, &a, &cb, &ca) };
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

/// Triangles in the way, at most: what is slow is no finding.
const MOST_TRIANGLES: usize = 24;
