//! The body of the fuzz target `rewrite` on mutated valid files, and on inputs that once crashed it.
#![allow(clippy::unwrap_used, reason = "tests")]

mod support;

use serde_json::json;
use sightline_texels::fuzzing::rewrite;
use support::{Maker, add_cube, cube_primitive};

/// The number of mutations of each valid file.
const ROUNDS: usize = 400;
/// Numbers that parsers often handle incorrectly.
const NUMBERS: &[&str] = &[
    "0",
    "-1",
    "1",
    "2",
    "3",
    "4",
    "8",
    "255",
    "256",
    "5121",
    "5123",
    "5125",
    "5126",
    "65536",
    "4294967295",
    "4294967296",
    "18446744073709551616",
    "1e38",
    "1e39",
    "1e400",
    "-0",
    "0.5",
    "null",
    "[]",
    "{}",
    "\"x\"",
];

/// The generator xorshift64*, which is small and has a fixed sequence for each seed.
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

/// Changes a GLB, and corrects the lengths in its header. Otherwise the reader would reject most changes at
/// the header.
fn mutate(r: &mut Random, glb: &[u8]) -> Vec<u8> {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    let (mut text, mut binary) = (
        glb[20..20 + word(12)].to_vec(),
        glb[28 + word(12)..].to_vec(),
    );
    for _ in 0..1 + r.below(3) {
        match r.below(8) {
            0 if !text.is_empty() => {
                let at = r.below(text.len());
                text[at] ^= 1 << r.below(7);
            }
            1 if !binary.is_empty() => {
                let at = r.below(binary.len());
                binary[at] ^= 1 << r.below(8);
            }
            2 if binary.len() > 4 => {
                let words = [0u32, 1, 0x7f80_0000, 0x7fc0_0000, 0x3f80_0000, u32::MAX];
                let at = r.below(binary.len() / 4) * 4;
                binary[at..at + 4].copy_from_slice(&words[r.below(words.len())].to_le_bytes());
            }
            3 => binary.truncate(r.below(binary.len())),
            _ => {
                let at = r.below(text.len());
                let Some(start) = text[at..]
                    .iter()
                    .position(u8::is_ascii_digit)
                    .map(|p| p + at)
                else {
                    continue;
                };
                let len = text[start..]
                    .iter()
                    .take_while(|c| c.is_ascii_digit())
                    .count();
                text.splice(start..start + len, NUMBERS[r.below(NUMBERS.len())].bytes());
            }
        }
    }
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut out = b"glTF".to_vec();
    for n in [2, 28 + text.len() + binary.len(), text.len()] {
        out.extend((n as u32).to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(text);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    out
}

/// Creates files with and without texture coordinates, colours, materials and shared meshes.
fn seeds() -> Vec<Vec<u8>> {
    let mut cube = Maker::new();
    let primitive = cube_primitive(&mut cube);
    let mesh = cube.mesh(primitive);
    cube.node(json!({ "mesh": mesh, "name": "box" }));
    cube.node(json!({ "mesh": mesh, "translation": [3, 0, 0], "scale": [1, 2, 1] }));

    let mut square = Maker::new();
    let positions = square.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0., 1., 1., 0.]);
    let uv = square.floats("VEC2", &[0., 0., 1., 0., 0., 1., 1., 1.]);
    let indices = square.indices(&[0, 1, 2, 2, 1, 3]);
    let material = square.push("materials", json!({ "name": "floor", "doubleSided": true }));
    let mesh = square.mesh(json!({
        "attributes": { "POSITION": positions, "TEXCOORD_0": uv, "TEXCOORD_1": uv },
        "indices": indices, "material": material,
    }));
    square.node(json!({ "mesh": mesh }));

    let mut list = Maker::new();
    let (positions, indices) = add_cube(&mut list);
    let one = json!({ "attributes": { "POSITION": positions }, "indices": indices });
    let other = json!({ "attributes": { "POSITION": positions }, "indices": indices, "mode": 5 });
    let mesh = list.push("meshes", json!({ "primitives": [one, other] }));
    list.node(json!({ "mesh": mesh, "rotation": [0, 0, 0, 1], "extras": { "kept": [1, 2] } }));
    [cube, square, list].iter().map(Maker::glb).collect()
}

#[test]
fn inputs_that_once_crashed_do_not() {
    let crashes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/crashes");
    let mut kept: Vec<_> = std::fs::read_dir(crashes)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    kept.sort();
    assert!(!kept.is_empty(), "the folder has a README at least");
    for path in kept {
        let _ = rewrite(&std::fs::read(&path).unwrap());
    }
}

#[test]
fn mutated_files_are_rewritten_or_rejected() {
    for (s, seed) in seeds().iter().enumerate() {
        assert!(rewrite(seed), "seed {s} must be valid");
        let mut r = Random::new(0x9e37_79b9_7f4a_7c15 + s as u64);
        let written = (0..ROUNDS)
            .filter(|_| rewrite(&mutate(&mut r, seed)))
            .count();
        // If nearly all mutations are rejected, or nearly all written, the test reaches little of the code.
        assert!(
            (ROUNDS / 100..ROUNDS - ROUNDS / 100).contains(&written),
            "{s}: {written} of {ROUNDS}"
        );
    }
}
