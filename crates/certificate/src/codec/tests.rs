//! Tests of round trips, damage, and arbitrary bytes.

use dashu_int::IBig;
use glam::Vec3;
use proptest::prelude::*;
use sightline_numbers::Aabb;

use super::{decode, encode};
use crate::certificate::{
    CellCertificate, GroupCertificate, HiddenBox, HiddenGroup, Target, Witness,
};
use crate::proof::{OccluderTriangle, Proof, QueryPolygon, Step};

fn integer() -> impl Strategy<Value = IBig> {
    (any::<i64>(), 0usize..300).prop_map(|(x, up)| IBig::from(x) << up)
}

fn floats() -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-1e30f32..1e30).prop_map(Vec3::from)
}

fn proof() -> impl Strategy<Value = Proof> {
    let step = prop_oneof![
        Just(Step::Unreal),
        (
            any::<u32>(),
            any::<bool>(),
            prop::collection::vec(any::<u16>(), 0..5)
        )
            .prop_map(|(occluder, negative, cuts)| Step::Block {
                occluder,
                negative,
                cuts
            }),
        prop::array::uniform6(integer()).prop_map(|polar| Step::Split {
            polar: Box::new(polar)
        }),
        (any::<bool>(), any::<u16>(), any::<u16>()).prop_map(|(b, from, to)| Step::Divide {
            polygon: if b { QueryPolygon::B } else { QueryPolygon::A },
            from,
            to
        }),
    ];
    let occluder = prop::collection::vec(
        (0u32..1000, any::<bool>()).prop_map(OccluderTriangle::from),
        1..6,
    );
    (
        prop::collection::vec(occluder, 0..4),
        prop::collection::vec(step, 0..8),
    )
        .prop_map(|(occluders, steps)| Proof { occluders, steps })
}

fn bounds() -> impl Strategy<Value = Aabb> {
    (floats(), floats()).prop_map(|(min, max)| Aabb { min, max })
}

fn hidden() -> impl Strategy<Value = Vec<HiddenGroup>> {
    let target = prop_oneof![
        Just(Target::Triangle),
        Just(Target::Surfaces),
        Just(Target::Half),
        bounds().prop_map(Target::Box),
        prop::collection::vec(floats(), 0..5).prop_map(|c| Target::Polygon(c.into())),
    ];
    let ids = prop::collection::btree_set(0u32..1000, 1..8);
    let one =
        (target, ids, prop::collection::vec(proof(), 0..4)).prop_map(|(target, ids, proofs)| {
            HiddenGroup {
                target,
                triangles: ids.into_iter().collect(),
                proofs,
            }
        });
    prop::collection::vec(one, 0..5)
}

prop_compose! {
    fn certificate()(
        seen in prop::collection::btree_map(0u32..1000, prop_oneof![
            prop::array::uniform2(floats()).prop_map(Witness::Floats),
            prop::array::uniform2(prop::array::uniform4(integer())).prop_map(|e| Witness::Exact(Box::new(e))),
        ], 0..8),
        hidden in hidden(),
        shared in prop::option::of(
            (bounds(), hidden()).prop_filter("empty", |s| !s.1.is_empty())
        ),
        above in prop::option::of(any::<u32>()),
        apart in prop::collection::vec((bounds(), prop::collection::vec(proof(), 0..3)), 0..3),
    ) -> CellCertificate {
        CellCertificate {
            seen: seen.into_iter().collect(),
            hidden,
            shared: shared.map(|(bounds, hidden)| GroupCertificate { bounds, hidden }),
            above,
            apart: apart.into_iter().map(|(bounds, proofs)| HiddenBox { bounds, proofs }).collect(),
        }
    }
}

proptest! {
    #[test]
    fn certificates_round_trip(e in certificate()) {
        let bytes = encode(&e).unwrap();
        prop_assert_eq!(decode(&bytes, 1000).unwrap(), e);
    }

    #[test]
    fn damaged_bytes_are_rejected_or_canonical(
        e in certificate(),
        at in any::<usize>(),
        value in 1u8..,
        cut in 0usize..3,
    ) {
        let mut raw = zstd::stream::decode_all(encode(&e).unwrap().as_slice()).unwrap();
        let at = at % raw.len();
        raw[at] ^= value;
        raw.truncate(raw.len() - cut);
        if let Ok(other) = decode(&zstd::stream::encode_all(raw.as_slice(), 1).unwrap(), 1000) {
            // The encoding is canonical: the encoder writes all accepted bytes.
            let again = zstd::stream::decode_all(encode(&other).unwrap().as_slice()).unwrap();
            prop_assert_eq!(again, raw);
        }
    }

    #[test]
    fn decoder_does_not_panic_on_random_bytes(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = decode(&bytes, 1000);
        let _ = decode(&zstd::stream::encode_all(bytes.as_slice(), 1).unwrap(), 1000);
    }
}
