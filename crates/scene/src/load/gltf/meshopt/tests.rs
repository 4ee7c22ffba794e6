//! Tests of the decoders against the encoders of `meshopt-rs`.

use meshopt_rs::index::IndexEncodingVersion;
use meshopt_rs::index::{buffer as ix, sequence};
use meshopt_rs::vertex::VertexEncodingVersion;
use meshopt_rs::vertex::buffer as vx;
use proptest::prelude::*;

use super::*;

fn view(mode: &str, count: usize, stride: usize, filter: Option<&str>) -> MeshoptView {
    MeshoptView {
        buffer: 0,
        byte_offset: 0,
        byte_length: 0,
        byte_stride: stride as u64,
        count: count as u64,
        mode: mode.into(),
        filter: filter.map(Into::into),
    }
}

fn pack_vertices<const N: usize>(v: &[[u8; N]]) -> Vec<u8> {
    let mut out = vec![0; vx::encode_vertex_buffer_bound(v.len(), N)];
    let n = vx::encode_vertex_buffer(&mut out, v, VertexEncodingVersion::default()).unwrap();
    out.truncate(n);
    out
}

fn le(v: &[u32]) -> Vec<u8> {
    v.iter().flat_map(|i| i.to_le_bytes()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Data encoded by another implementation are decoded correctly.
    #[test]
    fn vertices_round_trip(
        v in proptest::collection::vec(proptest::array::uniform12(any::<u8>()), 0..700),
        quiet in any::<u8>(),
    ) {
        // The mask creates groups of every width.
        let v: Vec<[u8; 12]> = v.into_iter().enumerate()
            .map(|(i, e)| e.map(|b| b & (quiet >> (i / 64 % 8)))).collect();
        let got = decode(&view("ATTRIBUTES", v.len(), 12, None), &pack_vertices(&v)).unwrap();
        prop_assert_eq!(got, v.concat());
    }

    #[test]
    fn wide_vertices_round_trip(
        v in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 256), 1..70),
    ) {
        let v: Vec<[u8; 256]> = v.into_iter().map(|e| e.try_into().unwrap()).collect();
        let got = decode(&view("ATTRIBUTES", v.len(), 256, None), &pack_vertices(&v)).unwrap();
        prop_assert_eq!(got, v.concat());
    }

    /// Triangles survive encoding up to their rotation, which the encoder may choose.
    #[test]
    fn triangles_round_trip(t in proptest::collection::vec(proptest::array::uniform3(0u32..40), 0..200)) {
        let flat = t.concat();
        let mut out = vec![0; ix::encode_index_buffer_bound(flat.len(), 40)];
        let n = ix::encode_index_buffer(&mut out, &flat, IndexEncodingVersion::V1).unwrap();
        let got = decode(&view("TRIANGLES", flat.len(), 4, None), &out[..n]).unwrap();
        prop_assert_eq!(got.len(), flat.len() * 4);
        for (t, g) in t.iter().zip(got.chunks(12)) {
            let [a, b, c] = *t;
            prop_assert!([[a, b, c], [b, c, a], [c, a, b]].iter().any(|r| le(r) == g));
        }
    }

    #[test]
    fn sequences_round_trip(v in proptest::collection::vec(any::<u16>(), 0..300)) {
        let v: Vec<u32> = v.into_iter().map(u32::from).collect();
        let mut out = vec![0; sequence::encode_index_sequence_bound(v.len(), 65536)];
        let n = sequence::encode_index_sequence(&mut out, &v, IndexEncodingVersion::V1);
        prop_assert_eq!(decode(&view("INDICES", v.len(), 4, None), &out[..n]).unwrap(), le(&v));
    }

    #[test]
    fn noise_is_rejected_or_decoded(
        head in prop_oneof![Just(0xa0u8), Just(0xa1), Just(0xe1), Just(0xd1)],
        body in proptest::collection::vec(any::<u8>(), 0..200),
        count in 0usize..100,
    ) {
        let data = [vec![head], body].concat();
        for (mode, stride) in [("ATTRIBUTES", 12), ("TRIANGLES", 4), ("INDICES", 2)] {
            if let Ok(out) = decode(&view(mode, count, stride, None), &data) {
                prop_assert_eq!(out.len(), count * stride);
            }
        }
    }
}

/// Data of version 1 that the C++ library encoded, with the bytes that its decoder returned. The data contain
/// every control mode, every width of deltas, every kind of channel and every supported filter.
#[test]
fn version_1_decodes_as_in_cpp_library() {
    let cases: serde_json::Value =
        serde_json::from_str(include_str!("../../../../tests/data/meshopt_v1.json")).unwrap();
    for case in cases.as_array().unwrap() {
        let bytes = |key: &str| {
            let text = case[key].as_str().unwrap();
            base64::Engine::decode(&base64::engine::general_purpose::STANDARD, text).unwrap()
        };
        let number = |key: &str| case[key].as_u64().unwrap() as usize;
        let view = view(
            "ATTRIBUTES",
            number("count"),
            number("stride"),
            case["filter"].as_str(),
        );
        let packed = bytes("packed");
        assert_eq!(
            decode(&view, &packed).unwrap(),
            bytes("bytes"),
            "{}",
            case["name"]
        );
        // Every byte is needed: a shorter stream is malformed.
        assert!(
            decode(&view, &packed[..packed.len() - 1]).is_err() || packed.len() < 64,
            "{}",
            case["name"]
        );
    }
}

#[test]
fn filters_check_strides() {
    let refusal = |filter, stride| {
        decode(&view("ATTRIBUTES", 1, stride, Some(filter)), &[0xa1; 600]).unwrap_err()
    };
    assert_eq!(
        refusal("QUATERNION", 4),
        "the filter QUATERNION needs a stride of [8] bytes, but the stride is 4"
    );
    assert_eq!(
        refusal("COLOR", 12),
        "the filter COLOR needs a stride of [4, 8] bytes, but the stride is 12"
    );
    assert!(
        refusal("OCTAHEDRAL", 4)
            .starts_with("the filter OCTAHEDRAL is unknown or not for positions")
    );
}

#[test]
fn exponents_are_applied() {
    let words: Vec<u32> = vec![0x0000_0003, 0xff00_0003, 0x01ff_ffff, 0x0000_0000];
    let mut bytes = le(&words);
    Filter::Exponential.apply(&mut bytes, 4);
    let got: Vec<f32> = bytes
        .chunks(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect();
    assert_eq!(got, [3.0, 1.5, -2.0, 0.0]);
}

#[test]
fn rejects_counts_beyond_data_before_allocation() {
    let v = view("ATTRIBUTES", 1 << 40, 256, None);
    assert!(decode(&v, &[0xa0; 100]).is_err());
    assert!(decode(&view("TRIANGLES", 3 << 30, 4, None), &[0xe1; 100]).is_err());
}
