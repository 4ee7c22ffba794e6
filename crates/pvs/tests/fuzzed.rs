//! The body of the fuzz target `pvs` on mutated valid files, and on inputs that once crashed it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use sightline_pvs::fuzzing::pvs;
use sightline_pvs::portals::{LEAF, NONE};
use sightline_pvs::{
    Builder, CellPairs, CellTree, Column, Contribution, Header, Items, Node, Object, Portal,
    Portals, Relation, Source,
};

/// The number of mutations of each valid file.
const ROUNDS: usize = 8000;

/// A random number generator (xorshift64*) with a fixed sequence per seed.
struct Random(u64);

impl Random {
    /// Creates the generator of a seed. `SIGHTLINE_FUZZ_SEED` selects other sequences.
    fn new(seed: u64) -> Self {
        let other =
            std::env::var("SIGHTLINE_FUZZ_SEED").map_or(0, |text| text.parse().expect("a number"));
        Self(seed.wrapping_add(0x9e37_79b9_7f4a_7c15u64.wrapping_mul(other)))
    }

    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as usize % n.max(1)
    }
}

fn mutate(r: &mut Random, mut bytes: Vec<u8>, other: &[u8]) -> Vec<u8> {
    for _ in 0..1 + r.below(3) {
        if bytes.is_empty() {
            break;
        }
        // Half of the mutations are in the header and the table of sections.
        let most = if r.below(2) == 0 {
            bytes.len()
        } else {
            bytes.len().min(400)
        };
        let at = r.below(most);
        match r.below(7) {
            0 => bytes[at] ^= 1 << r.below(8),
            1 => bytes[at] = [0, 1, 2, 3, 7, 0x7f, 0x80, 0xff][r.below(8)],
            2 if r.below(8) == 0 => bytes.truncate(at),
            3 => {
                let from = r.below(other.len());
                let piece = other[from..(from + r.below(30)).min(other.len())].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => {
                let end = (at + r.below(8)).min(bytes.len());
                bytes.drain(at..end);
            }
            5 => {
                // Write a number that is too large, negative, or not a number.
                let v = [
                    0u32,
                    1,
                    9999,
                    0x7fff_ffff,
                    0x8000_0000,
                    u32::MAX,
                    0x7f80_0000,
                    0x7fc0_0000,
                ][r.below(8)];
                bytes[at..]
                    .iter_mut()
                    .zip(v.to_le_bytes())
                    .for_each(|(b, v)| *b = v);
            }
            _ => bytes[at] = bytes[at].wrapping_add(1),
        }
    }
    bytes
}

fn finished(builder: Builder) -> Vec<u8> {
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    file
}

fn header(triangles: u32, levels: usize) -> Header {
    let mut nodes = vec![Node::Leaf];
    for level in 0..levels {
        let at = 0.5 / (level + 1) as f32;
        nodes.splice(
            0..0,
            [
                Node::Split {
                    axis: (level % 3) as u8,
                    at,
                },
                Node::Leaf,
            ],
        );
    }
    let tree = CellTree::new([[0.0; 3], [1.0; 3]], nodes).unwrap();
    let source = Some(Source {
        node: 1,
        mesh: 2,
        primitive: 0,
        instance: Some(3),
    });
    let object = |name: &str, first, count| Object {
        name: name.into(),
        first,
        count,
        source,
    };
    let objects = vec![object("wall", 0, 4), object("tree", 4, triangles - 4)];
    Header {
        triangles,
        method: "aggressive".into(),
        tree,
        objects,
        info_json: "{}".into(),
    }
}

/// Creates a file with every optional section but portals, for each kind of items.
fn full(items: Option<&Items>) -> Vec<u8> {
    let mut builder = Builder::new(header(10, 2)).unwrap();
    if let Some(items) = items {
        builder.set_items(items).unwrap();
    }
    builder
        .set_columns(vec![Column {
            name: "rays".into(),
            values: vec![90, 70_000, u64::MAX],
        }])
        .unwrap();
    let contribution = |n: usize| vec![Contribution::new(0.25, 0.5); n];
    for visible in [&[0, 1][..], &[1], &[]] {
        builder
            .push_cell(
                visible,
                &visible[..visible.len() / 2],
                u32::from(visible.is_empty()),
            )
            .unwrap();
        builder.push_certificate(b"hidden by that").unwrap();
        builder
            .push_contributions(&contribution(visible.len()))
            .unwrap();
    }
    let mut visible = Relation::empty(3).unwrap();
    (0..3).for_each(|cell| visible.insert(cell, cell));
    builder
        .set_pairs(&CellPairs {
            visible,
            undecided: Some(Relation::empty(3).unwrap()),
        })
        .unwrap();
    builder.set_region(vec![1, 2, 3]);
    finished(builder)
}

/// Creates a file with four rooms in a row and an opening between each pair of neighbours.
fn divided() -> Vec<u8> {
    let opening = |x: u32, door: u32| Portal {
        leaves: [x - 1, x],
        plane: x - 1,
        door,
        corners: [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]]
            .map(|[y, z]| [f64::from(x) / 4.0, y, z])
            .to_vec(),
    };
    let portals = Portals {
        size: 1.0,
        planes: (1..4)
            .map(|x| [1.0, 0.0, 0.0, f64::from(x) / 4.0])
            .collect(),
        nodes: vec![[1, 1, 2], [0, LEAF, LEAF + 1], [2, LEAF + 2, LEAF + 3]],
        doors: vec!["front".into()],
        portals: vec![opening(1, NONE), opening(2, 0), opening(3, NONE)],
        leaves: (0..4).map(|leaf| vec![leaf, leaf + 4]).collect(),
    };
    let mut builder = Builder::new(header(8, 0)).unwrap();
    builder.set_portals(portals.encode()).unwrap();
    builder
        .push_cell(&[0, 1, 2, 3, 4, 5, 6, 7], &[], 0)
        .unwrap();
    finished(builder)
}

#[test]
fn former_crash_inputs_do_not_crash() {
    let crashes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/crashes");
    let mut paths: Vec<_> = std::fs::read_dir(crashes)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    paths.sort();
    assert!(!paths.is_empty(), "the folder has a README at least");
    for path in paths {
        pvs(&std::fs::read(&path).unwrap());
    }
}

#[test]
fn mutated_results_do_not_crash() {
    let clusters = Items::Clusters(vec![vec![0, 3], vec![1], vec![4, 5, 9]]);
    let seeds = [
        full(None),
        full(Some(&clusters)),
        full(Some(&Items::Objects { never: vec![1, 9] })),
        divided(),
    ];
    for (s, seed) in seeds.iter().enumerate() {
        assert!(pvs(seed), "seed {s} must be valid");
    }
    let mut r = Random::new(0x9e37_79b9_7f4a_7c15);
    let rounds = ROUNDS * seeds.len();
    let mut opened = 0;
    for round in 0..rounds {
        let (seed, other) = (&seeds[round % seeds.len()], &seeds[r.below(seeds.len())]);
        let bytes = mutate(&mut r, seed.clone(), other);
        let ran = std::panic::catch_unwind(|| pvs(&bytes));
        opened += usize::from(ran.unwrap_or_else(|_| panic!("round {round}: {bytes:02x?}")));
    }
    // If all mutations were rejected, or all were opened, the test would reach little of the code.
    assert!(
        (rounds / 50..rounds - rounds / 50).contains(&opened),
        "{opened} of {rounds} were opened"
    );
}
