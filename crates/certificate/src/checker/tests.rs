//! Tests of proofs and witnesses that the checker must accept, and of altered ones that it must reject.

use glam::{DVec3, Vec3};

use super::geometry::point;
use super::*;
use crate::proof::{OccluderTriangle, Proof, QueryPolygon, Step};

/// Returns two squares that face each other at a distance of 10.
fn squares() -> [Vec<Corners>; 2] {
    [0.0, 10.0].map(|z| {
        vec![corners(
            &[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| DVec3::new(x, y, z)),
        )]
    })
}

fn refused(scene: &[[Vec3; 3]], occluder: Vec<(u32, bool)>) -> Option<Refusal> {
    let [a, b] = squares();
    let occluder: Vec<OccluderTriangle> = occluder.into_iter().map(Into::into).collect();
    let block = |negative| Step::Block {
        occluder: 0,
        negative,
        cuts: Vec::new(),
    };
    let proofs = [false, true].map(|n| Proof {
        occluders: vec![occluder.clone()],
        steps: vec![block(n)],
    });
    let [x, y] = proofs.map(|p| check_hidden(scene, &a, &b, &p));
    x.err().and(y.err())
}

#[test]
fn triangle_blocks_only_between_polygons() {
    let v = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let wall = [v(-9.0, -9.0, 5.0), v(30.0, -9.0, 5.0), v(-9.0, 30.0, 5.0)];
    assert_eq!(refused(&[wall], vec![(0, false)]), None);
    let aside = wall.map(|p| p + Vec3::X * 50.0);
    assert!(matches!(
        refused(&[aside], vec![(0, false)]),
        Some(Refusal::False { .. })
    ));
    let behind = wall.map(|p| p + Vec3::Z * 50.0);
    assert!(matches!(
        refused(&[behind], vec![(0, false)]),
        Some(Refusal::False { .. })
    ));
    // A triangle in B's plane does not block.
    let in_plane = wall.map(|p| p + Vec3::Z * 5.0);
    assert!(matches!(
        refused(&[in_plane], vec![(0, false)]),
        Some(Refusal::False { .. })
    ));
    assert_eq!(
        refused(&[wall], vec![(1, false)]),
        Some(Refusal::Occluder(0))
    );
}

#[test]
fn occluder_needs_boundary_and_area() {
    let v = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let aside = [v(50.0, 0.0, 5.0), v(60.0, 0.0, 5.0), v(50.0, 9.0, 5.0)];
    // Both sides of a sheet form no occluder, because every edge cancels.
    assert_eq!(
        refused(&[aside, aside], vec![(0, false), (1, true)]),
        Some(Refusal::Occluder(0))
    );
    assert_eq!(refused(&[aside], vec![]), Some(Refusal::Occluder(0)));
    let point = [v(0.5, 0.5, 5.0); 3];
    assert_eq!(
        refused(&[point], vec![(0, false)]),
        Some(Refusal::Occluder(0))
    );
    let twice = [v(0.5, 0.5, 5.0), v(0.5, 0.5, 5.0), v(2.0, 0.5, 5.0)];
    assert_eq!(
        refused(&[twice], vec![(0, false)]),
        Some(Refusal::Occluder(0))
    );
    // The triangle is collinear and passes through B's plane, where the occluder needs a separate plane.
    let needle = [v(0.5, 0.5, 5.0), v(0.5, 0.5, 15.0), v(0.5, 0.5, 25.0)];
    assert!(refused(&[needle], vec![(0, false)]).is_some());
}

#[test]
fn triangles_of_opposite_windings_have_no_common_plane() {
    let v = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    // The triangle is behind B. It would block if the first of three copies, which cancels, could reverse the
    // plane.
    let behind = [
        v(-9.0, -9.0, 12.0),
        v(30.0, -9.0, 12.0),
        v(-9.0, 30.0, 12.0),
    ];
    for first in [false, true] {
        let occluder = vec![(0, first), (0, !first), (0, !first)];
        assert!(matches!(
            refused(&[behind], occluder),
            Some(Refusal::False { .. })
        ));
    }
    // The triangle crosses B's plane and is next to all lines on the side of A.
    let leaning = [v(-9.0, -9.0, 10.5), v(30.0, -9.0, 10.5), v(0.5, 90.0, 9.5)];
    for first in [false, true] {
        let occluder = vec![(0, first), (0, !first), (0, !first)];
        assert!(matches!(
            refused(&[leaning], occluder),
            Some(Refusal::False { .. })
        ));
    }
}

#[test]
fn rejects_invalid_polygon() {
    let [a, b] = squares();
    let in_line = [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let bad = [
        corners(&in_line.map(|[x, y]| DVec3::new(x, y, 0.0))),
        a[0][..2].to_vec(),
        a[0].iter().map(|p| p.clone().map(|c| -c)).collect(),
        vec![
            a[0][0].clone(),
            a[0][2].clone(),
            a[0][1].clone(),
            a[0][3].clone(),
        ],
    ];
    for bad in bad {
        assert_eq!(
            check_hidden(&[], std::slice::from_ref(&bad), &b, &Proof::default()),
            Err(Refusal::Polygon)
        );
        let [p, q] = [[0.5, 0.5, 0.0], [0.5, 0.5, 10.0]].map(point);
        assert_eq!(
            check_witness(&[], &[bad], &b, &p, &q),
            Err(Refusal::Polygon)
        );
    }
}

#[test]
fn rejects_witness_end_with_negative_weight() {
    let [a, b] = squares();
    let wall = [[-9.0, -9.0, 5.0], [30.0, -9.0, 5.0], [-9.0, 30.0, 5.0]].map(Vec3::from);
    let [p, q] = [[0.5, 0.5, 0.0], [0.5, 0.5, 10.0]].map(point);
    assert_eq!(check_witness(&[], &a, &b, &p, &q), Ok(()));
    assert!(check_witness(&[wall], &a, &b, &p, &q).is_err());
    assert!(check_witness(&[wall], &a, &b, &p, &q.map(|c| -c)).is_err());
}

#[test]
fn rejects_division_without_area() {
    let [a, b] = squares();
    for (from, to) in [
        (65535, 0),
        (0, 65535),
        (0, 1),
        (0, 2),
        (1, 1),
        (1, 2),
        (7, 0),
    ] {
        let steps = vec![Step::Divide {
            polygon: QueryPolygon::A,
            from,
            to,
        }];
        let claim = Proof {
            occluders: Vec::new(),
            steps,
        };
        assert!(
            matches!(
                check_hidden(&[], &a, &b, &claim),
                Err(Refusal::Unknown { .. })
            ),
            "{from} {to}"
        );
    }
    // Repeated division keeps the integers short, and the proof ends too early.
    let steps = vec![
        Step::Divide {
            polygon: QueryPolygon::A,
            from: 1,
            to: 5
        };
        200
    ];
    let claim = Proof {
        occluders: Vec::new(),
        steps,
    };
    assert_eq!(
        check_hidden(&[], &a, &b, &claim),
        Err(Refusal::Length("too few"))
    );
}

#[test]
fn rejects_proofs_of_wrong_length() {
    let [a, b] = squares();
    assert_eq!(
        check_hidden(&[], &a, &b, &Proof::default()),
        Err(Refusal::Length("too few"))
    );
    let steps = vec![Step::Unreal];
    let claim = Proof {
        occluders: Vec::new(),
        steps,
    };
    assert!(matches!(
        check_hidden(&[], &a, &b, &claim),
        Err(Refusal::False { step: 0, .. })
    ));
}
