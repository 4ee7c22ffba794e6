//! Tests that encoded outputs are decoded unchanged, and that damaged bytes are rejected.

use std::sync::Arc;

use proptest::prelude::*;
use sightline_viewcells::Split;

use super::write::{MANY, put_cell};
use super::*;
use crate::output::{CellSet, CellSets, Decision, Hits, SubtreeNode, VisibilitySample};
use crate::pairs::{PairTable, TilePairs};
use crate::statistics::CellStats;

fn ids() -> impl Strategy<Value = Vec<u32>> {
    proptest::collection::btree_set(0u32..1000, 0..20).prop_map(|s| s.into_iter().collect())
}

fn sample() -> impl Strategy<Value = VisibilitySample> {
    (
        ids(),
        any::<u32>(),
        proptest::option::of(0u32..1000),
        proptest::option::of(1usize..30),
    )
        .prop_map(|(ids, seed, dominant, pixels)| VisibilitySample {
            strata: ids.iter().map(|i| i.wrapping_mul(seed)).collect(),
            ids,
            dominant,
            pixels: pixels.map(|n| (0..n as u32).map(|i| (i / 3).wrapping_sub(1)).collect()),
        })
}

fn outputs() -> impl Strategy<Value = TileOutput> {
    let pack = proptest::collection::btree_map(any::<[u32; 3]>(), sample(), 0..6).prop_map(|m| {
        TileOutput::Pack(Pack {
            samples: m.into_iter().map(|(p, s)| (p, Arc::new(s))).collect(),
        })
    });
    let cells = (ids(), ids(), 0usize..3, any::<u32>(), any::<u32>()).prop_map(
        |(a, b, axis, at, samples)| {
            TileOutput::Cells(CellSets {
                portals: vec![1, 2, 3],
                pairs: (samples % 2 == 0).then(|| {
                    let table = |step: u32| {
                        let mut table = PairTable::empty(70);
                        (0..70)
                            .step_by(3)
                            .for_each(|c| table.insert(c, c.wrapping_mul(step) % 70));
                        table
                    };
                    let hidden = (at % 2 == 0).then(|| table(at));
                    TilePairs {
                        seen: table(samples),
                        hidden,
                    }
                }),
                nodes: vec![
                    SubtreeNode::Split(Split { axis, at }),
                    SubtreeNode::Cell,
                    SubtreeNode::Cell,
                ],
                cells: vec![
                    CellSet {
                        unreached: a.is_empty(),
                        hits: Some(Hits {
                            viewpoints: 16,
                            lines: 1536,
                            counts: a.iter().map(|id| [*id, *id / 16]).collect(),
                        }),
                        visible: a,
                        samples,
                        stats: CellStats {
                            rays: [1, u64::MAX, samples.into(), 4],
                            rounds: samples,
                            bound_look: 3,
                            unfinished: true,
                            ..CellStats::default()
                        },
                        ..CellSet::default()
                    },
                    CellSet {
                        samples: 7,
                        undecided: b.iter().copied().step_by(2).collect(),
                        decision: Some(Decision {
                            counts: vec![u64::from(at), u64::MAX],
                            certificate: samples.to_le_bytes().to_vec(),
                        }),
                        visible: b,
                        ..CellSet::default()
                    },
                ],
            })
        },
    );
    prop_oneof![pack, cells]
}

proptest! {
    #[test]
    fn outputs_round_trip(output in outputs()) {
        let bytes = encode(&output).unwrap();
        prop_assert_eq!(decode(&bytes, 1000).unwrap(), output);
    }

    #[test]
    fn damage_never_panics(
        output in outputs(),
        at in any::<prop::sample::Index>(),
        with in any::<u8>(),
        cut in any::<prop::sample::Index>(),
    ) {
        // Damage below the compression, which zstd's own checks do not detect.
        let mut raw = zstd::stream::decode_all(encode(&output).unwrap().as_slice()).unwrap();
        let i = at.index(raw.len());
        raw[i] = with;
        raw.truncate(cut.index(raw.len()) + 1);
        let _ = decode(&zstd::stream::encode_all(raw.as_slice(), 1).unwrap(), 1000);
    }
}

/// Decodes mutations of valid outputs. `SIGHTLINE_FUZZ_SEED` selects other mutations.
#[test]
fn fuzzed_outputs_do_not_crash() {
    use proptest::strategy::ValueTree as _;
    use proptest::test_runner::TestRunner;
    use sightline_numbers::random::SplitMix64;

    let mut runner = TestRunner::deterministic();
    let seeds: Vec<Vec<u8>> = (0..60)
        .map(|_| encode(&outputs().new_tree(&mut runner).unwrap().current()).unwrap())
        .map(|bytes| zstd::stream::decode_all(bytes.as_slice()).unwrap())
        .collect();
    assert!(seeds.iter().all(|seed| fuzzing::tile(seed)));
    let first = std::env::var("SIGHTLINE_FUZZ_SEED").map_or(1, |text| text.parse().unwrap());
    let mut random = SplitMix64::new(first);
    let mut below = |n: usize| (random.bits() % n.max(1) as u64) as usize;
    let (rounds, mut decoded) = (6000, 0);
    for round in 0..rounds {
        let mut bytes = seeds[below(seeds.len())].clone();
        for _ in 0..1 + below(3) {
            let at = below(bytes.len());
            match below(5) {
                0 if !bytes.is_empty() => bytes[at] ^= 1 << below(8),
                1 if !bytes.is_empty() => bytes[at] = [0, 1, 2, 3, 0x7f, 0x80, 0xff][below(7)],
                // A large number.
                2 => drop(bytes.splice(at..at, [0xff, 0xff, 0xff, [0x0f, 0xff][below(2)], 0x01])),
                3 => {
                    let other = &seeds[below(seeds.len())];
                    bytes.splice(at..at, other.iter().copied().take(below(40)));
                }
                _ => drop(bytes.drain(at..(at + below(6)).min(bytes.len()))),
            }
        }
        let ran = std::panic::catch_unwind(|| fuzzing::tile(&bytes));
        decoded += usize::from(ran.unwrap_or_else(|_| panic!("round {round}: {bytes:02x?}")));
    }
    // If all mutations were rejected, or all decoded, the test would cover little of the code.
    assert!(
        (rounds / 50..rounds - rounds / 50).contains(&decoded),
        "{decoded} of {rounds} were decoded"
    );
}

/// Checks the limit on pixels: a few bytes can announce 400 MB of equal pixels for each sample.
#[test]
fn pixels_unpack_to_no_more_than_limit() {
    let most = 1u32 << 20;
    let sample = |k: u32| {
        let sample = VisibilitySample {
            pixels: Some(vec![7; 3 << 17].into()),
            ..VisibilitySample::default()
        };
        ([k, 0, 0], Arc::new(sample))
    };
    let pack = |n: u32| {
        encode(&TileOutput::Pack(Pack {
            samples: (0..n).map(sample).collect(),
        }))
        .unwrap()
    };
    let read = |bytes: &[u8], keep: bool| super::read(bytes, 1000, b"P", most.into(), &|_| keep);
    assert!(pack(3).len() < 100, "the pixels are one run each");
    // 1.5 MB of pixels per sample.
    assert_eq!(read(&pack(0), true).map(|_| ()), Ok(()));
    assert_eq!(
        read(&pack(1), true),
        Err(CodecError("the unpacked pixels exceed the tile's limit"))
    );
    assert!(
        read(&pack(3), false).is_ok(),
        "pixels that are not kept cost no memory"
    );
    assert!(decode(&pack(3), 1000).is_ok());
}

#[test]
fn parallel_encoding_equals_sequential_encoding() {
    let cell = |k: u32| CellSet {
        visible: (0..MANY as u32 / 4).map(|i| i * (k + 1)).collect(),
        samples: k,
        ..CellSet::default()
    };
    let split = |at| SubtreeNode::Split(Split { axis: 0, at });
    let nodes = vec![
        split(4),
        split(2),
        SubtreeNode::Cell,
        SubtreeNode::Cell,
        split(6),
        SubtreeNode::Cell,
        SubtreeNode::Cell,
    ];
    let sets = CellSets {
        nodes,
        cells: (0..4).map(cell).collect(),
        pairs: None,
        portals: Vec::new(),
    };
    let mut one_by_one = Vec::new();
    sets.cells
        .iter()
        .for_each(|c| put_cell(c, &mut one_by_one).unwrap());
    let output = TileOutput::Cells(sets);
    let bytes = encode(&output).unwrap();
    let raw = zstd::stream::decode_all(bytes.as_slice()).unwrap();
    // The output has no pairs and no portals.
    one_by_one.extend([0, 0]);
    assert!(raw.ends_with(&one_by_one));
    assert_eq!(decode(&bytes, 4 * MANY as u32).unwrap(), output);
}

#[test]
fn decoder_rejects_ids_beyond_scene() {
    let sets = CellSets {
        nodes: vec![SubtreeNode::Cell],
        cells: vec![CellSet {
            visible: vec![5],
            samples: 1,
            ..CellSet::default()
        }],
        pairs: None,
        portals: Vec::new(),
    };
    let bytes = encode(&TileOutput::Cells(sets)).unwrap();
    assert!(decode(&bytes, 6).is_ok());
    assert!(decode(&bytes, 5).is_err());
    assert!(decode(b"", 5).is_err());
}

#[test]
fn undecided_items_must_be_in_set() {
    let sets = |undecided: &[u32]| {
        let cell = CellSet {
            visible: vec![2, 5],
            undecided: undecided.to_vec(),
            ..CellSet::default()
        };
        encode(&TileOutput::Cells(CellSets {
            nodes: vec![SubtreeNode::Cell],
            cells: vec![cell],
            pairs: None,
            portals: Vec::new(),
        }))
        .unwrap()
    };
    for fine in [&[][..], &[2], &[5], &[2, 5]] {
        assert!(decode(&sets(fine), 6).is_ok());
    }
    for wrong in [&[1][..], &[2, 3], &[2, 3, 5]] {
        assert!(decode(&sets(wrong), 6).is_err());
    }
}

/// Checks that unpacking stops at the limit. Four GiB of zeros have a few hundred kilobytes in zstd.
#[test]
fn rejects_decompression_bomb() {
    let zeros = std::io::Read::take(std::io::repeat(0), 4 << 30);
    let bomb = zstd::stream::encode_all(zeros, 1).unwrap();
    assert!(bomb.len() < 1 << 20, "{}", bomb.len());
    for is_pack in [false, true] {
        assert!(
            check(&bomb, 1000, is_pack, 1 << 20)
                .unwrap_err()
                .to_string()
                .contains("first byte")
        );
    }
    // With the correct first byte.
    let zeros = std::io::Read::chain(&b"C"[..], std::io::Read::take(std::io::repeat(0), 4 << 30));
    let bomb = zstd::stream::encode_all(zeros, 1).unwrap();
    assert!(
        check(&bomb, 1000, false, 1 << 20)
            .unwrap_err()
            .to_string()
            .contains("exceeds the tile's limit")
    );
}
