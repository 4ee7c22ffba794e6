//! The body of the fuzz target `certificate`, which the tests call, too.

use glam::Vec3;
use sightline_numbers::Aabb;

use crate::checker::{CellClaims, Triangles, check_cell};
use crate::codec;

/// Decodes bytes without compression as the certificate of a cell in front of three walls, and checks all
/// claims. Returns true if the bytes are a certificate, even if the checker rejects its claims. No input may
/// cause a panic.
pub fn certificate(raw: &[u8]) -> bool {
    let wall = |z: f32| {
        let [a, b, c, d] =
            [[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]].map(|[x, y]| Vec3::new(x, y, z));
        [[a, b, c], [a, c, d]]
    };
    let triangles = [wall(1.0), wall(2.0), wall(3.0)].concat();
    let Ok(certificate) = codec::decode_raw(raw, triangles.len() as u32) else {
        return false;
    };
    let index = Triangles::new(&triangles);
    for visible in [&[][..], &[0, 1], &[0, 1, 2, 3, 4, 5]] {
        let cell = Aabb::new(Vec3::ZERO, Vec3::splat(0.5));
        let above = certificate
            .shared
            .as_ref()
            .filter(|_| certificate.above.is_some());
        let claims = CellClaims {
            cell,
            visible,
            undecided: &[],
            certificate: &certificate,
            above,
        };
        let _ = check_cell(&index, &claims, &|_| true);
    }
    true
}
