//! What fuzz targets and tests feed with any bytes.

use glam::Vec3;

use crate::checker::{CellClaims, Triangles, check_cell};
use crate::evidence::codec;

/// Reads bytes (without their compression) as the evidence of a cell before two walls, and has everything checked that they claim.
/// Whether that is accepted does not matter here, only that nothing panics.
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
        let claims = CellClaims { cell, visible, undecided: &[], evidence: &evidence };
        let _ = check_cell(&index, &claims, &|_| true);
    }
}
