//! The scene of the fuzz target: a cell in front of three parallel walls, and its handwritten certificate.

#![allow(dead_code, reason = "each test file uses a part")]

use dashu_int::IBig;
use glam::Vec3;
use sightline_certificate::proof::{OccluderTriangle, Proof, Step};
use sightline_certificate::{CellCertificate, GroupCertificate, HiddenGroup, Target, Witness};
use sightline_numbers::Aabb;

/// The bounds of the cell.
pub const CELL: Aabb = Aabb::new(Vec3::ZERO, Vec3::splat(0.5));

/// Returns the corners of the wall at height `z`.
pub fn corners(z: f32) -> [Vec3; 4] {
    [[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]].map(|[x, y]| Vec3::new(x, y, z))
}

/// Returns the two triangles of each of three walls.
pub fn triangles() -> Vec<[Vec3; 3]> {
    [1.0, 2.0, 3.0]
        .into_iter()
        .flat_map(|z| {
            let [a, b, c, d] = corners(z);
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

/// Returns the proofs that the first wall hides a target above it, for all faces of the cell but the lower
/// one.
fn proofs() -> Vec<Proof> {
    let occluder = vec![
        OccluderTriangle {
            triangle: 0,
            reversed: false,
        },
        OccluderTriangle {
            triangle: 1,
            reversed: false,
        },
    ];
    let steps = vec![Step::Block {
        occluder: 0,
        negative: false,
        cuts: Vec::new(),
    }];
    vec![
        Proof {
            occluders: vec![occluder],
            steps
        };
        5
    ]
}

/// Returns the two groups of triangles that the first wall hides.
pub fn hidden() -> Vec<HiddenGroup> {
    let polygon = Target::Polygon(corners(2.0).into());
    let [least, _, greatest, _] = corners(3.0);
    vec![
        HiddenGroup {
            target: polygon,
            triangles: vec![2, 3],
            proofs: proofs(),
        },
        HiddenGroup {
            target: Target::Box(Aabb::new(least, greatest)),
            triangles: vec![4, 5],
            proofs: proofs(),
        },
    ]
}

fn seen() -> Vec<(u32, Witness)> {
    let float = Witness::Floats([Vec3::new(0.25, 0.125, 0.25), Vec3::new(0.25, 0.125, 1.5)]);
    let exact = Witness::Exact(Box::new(
        [[1, 2, 2, 8], [1, 2, 8, 8]].map(|p| p.map(IBig::from)),
    ));
    vec![(0, float), (1, exact)]
}

/// Returns a certificate that stores all of its reasons itself.
pub fn alone() -> CellCertificate {
    CellCertificate {
        seen: seen(),
        hidden: hidden(),
        ..CellCertificate::default()
    }
}

/// Returns a certificate that shares its hidden groups with later cells.
pub fn sharing() -> CellCertificate {
    let shared = GroupCertificate {
        bounds: CELL,
        hidden: hidden(),
    };
    CellCertificate {
        seen: seen(),
        shared: Some(shared),
        above: Some(0),
        ..CellCertificate::default()
    }
}

/// Returns a certificate that relies on the hidden groups of the previous cell.
pub fn relying() -> CellCertificate {
    CellCertificate {
        seen: seen(),
        above: Some(1),
        ..CellCertificate::default()
    }
}

/// Returns the bytes of a certificate without compression.
pub fn raw(certificate: &CellCertificate) -> Vec<u8> {
    let bytes = sightline_certificate::codec::encode(certificate).unwrap();
    zstd::stream::decode_all(bytes.as_slice()).unwrap()
}
