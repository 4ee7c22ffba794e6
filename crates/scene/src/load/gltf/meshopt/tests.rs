//! Tests of the decoders against the encoders of `meshopt-rs`.

use super::*;
use meshopt_rs::index::IndexEncodingVersion;
use meshopt_rs::index::{buffer as ix, sequence};
use meshopt_rs::vertex::VertexEncodingVersion;
use meshopt_rs::vertex::buffer as vx;
use proptest::prelude::*;

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

    /// Data encoded by another implementation are decoded.
    #[test]
    fn vertices_come_back(
        v in proptest::collection::vec(proptest::array::uniform12(any::<u8>()), 0..700),
        quiet in any::<u8>(),
    ) {
        // Masking makes groups of every width.
        let v: Vec<[u8; 12]> = v.into_iter().enumerate()
            .map(|(i, e)| e.map(|b| b & (quiet >> (i / 64 % 8)))).collect();
        let got = decode(&view("ATTRIBUTES", v.len(), 12, None), &pack_vertices(&v)).unwrap();
        prop_assert_eq!(got, v.concat());
    }

    #[test]
    fn wide_vertices_come_back(
        v in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 256), 1..70),
    ) {
        let v: Vec<[u8; 256]> = v.into_iter().map(|e| e.try_into().unwrap()).collect();
        let got = decode(&view("ATTRIBUTES", v.len(), 256, None), &pack_vertices(&v)).unwrap();
        prop_assert_eq!(got, v.concat());
    }

    /// Triangles come back up to the rotation of each, which the encoder may choose.
    #[test]
    fn triangle_lists_come_back(t in proptest::collection::vec(proptest::array::uniform3(0u32..40), 0..200)) {
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
    fn sequences_come_back(v in proptest::collection::vec(any::<u16>(), 0..300)) {
        let v: Vec<u32> = v.into_iter().map(u32::from).collect();
        let mut out = vec![0; sequence::encode_index_sequence_bound(v.len(), 65536)];
        let n = sequence::encode_index_sequence(&mut out, &v, IndexEncodingVersion::V1);
        prop_assert_eq!(decode(&view("INDICES", v.len(), 4, None), &out[..n]).unwrap(), le(&v));
    }

    #[test]
    fn noise_is_refused_or_decoded(
        head in prop_oneof![Just(0xa0u8), Just(0xe1), Just(0xd1)],
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

#[test]
fn exponents_are_applied() {
    let words: Vec<u32> = vec![0x0000_0003, 0xff00_0003, 0x01ff_ffff, 0x0000_0000];
    let mut bytes = le(&words);
    exponential(&mut bytes);
    let got: Vec<f32> = bytes.chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(got, [3.0, 1.5, -2.0, 0.0]);
}

#[test]
fn counts_beyond_the_data_are_refused_before_allocating() {
    let v = view("ATTRIBUTES", 1 << 40, 256, None);
    assert!(decode(&v, &[0xa0; 100]).is_err());
    assert!(decode(&view("TRIANGLES", 3 << 30, 4, None), &[0xe1; 100]).is_err());
}
