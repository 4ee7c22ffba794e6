//! The bodies of the fuzz targets `points` and `lights` on mutated valid lines, and on inputs that once
//! crashed them.
#![allow(clippy::unwrap_used, reason = "tests")]

use sightline_ambient::fuzzing::{lights, points};

/// The number of mutations of each valid file.
const ROUNDS: usize = 1500;

const POINTS: &str = r#"{"id":1,"point":[0.5,0.25,0],"normal":[0,0,1],"triangle":1}
{"id":"b","point":[1,0,0.5],"normal":[-1,0,1e-9]}
{"point":[0,0,2],"normal":[3,-4,12],"triangle":5}
"#;
const LIGHTS: &str = r#"{"id":"lamp","polygon":[[-1,-1,1],[3,-1,1],[-1,3,1]]}
{"id":2,"polygon":[[0,0,2],[1,0,2],[1,1,2],[0,1,2]]}
"#;
/// Numbers that change the meaning of a line.
const NUMBERS: &[&str] = &[
    "0",
    "-1",
    "1",
    "2",
    "5",
    "9",
    "255",
    "4294967295",
    "4294967296",
    "1e-9",
    "1e-30",
    "1e-45",
    "1e-300",
    "1e29",
    "3.4e38",
    "3.5e38",
    "1e300",
    "1e400",
    "-0.0",
    "0.5",
    "nan",
    "null",
    "[]",
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

fn mutate(r: &mut Random, seed: &str) -> Vec<u8> {
    let mut bytes = seed.as_bytes().to_vec();
    for _ in 0..1 + r.below(4) {
        if bytes.is_empty() {
            break;
        }
        let at = r.below(bytes.len());
        match r.below(8) {
            0 => bytes[at] ^= 1 << r.below(8),
            1 => bytes.truncate(at),
            2 => {
                let end = (at + r.below(12)).min(bytes.len());
                bytes.drain(at..end);
            }
            3 => {
                let from = r.below(seed.len());
                let piece = seed.as_bytes()[from..(from + r.below(30)).min(seed.len())].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => {
                // Replace a number by another number.
                let Some(start) = bytes[at..]
                    .iter()
                    .position(u8::is_ascii_digit)
                    .map(|p| p + at)
                else {
                    continue;
                };
                let len = bytes[start..]
                    .iter()
                    .take_while(|c| c.is_ascii_digit())
                    .count();
                bytes.splice(start..start + len, NUMBERS[r.below(NUMBERS.len())].bytes());
            }
        }
    }
    bytes
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
        let bytes = std::fs::read(&path).unwrap();
        let _ = points(&bytes);
        let _ = lights(&bytes);
    }
}

#[test]
fn mutated_points_and_lights_are_answered_or_rejected() {
    for (target, seed) in [(points as fn(&[u8]) -> bool, POINTS), (lights, LIGHTS)] {
        for (s, line) in seed.lines().chain([seed]).enumerate() {
            assert!(target(line.as_bytes()), "{line} must be valid");
            let mut r = Random::new(0x9e37_79b9_7f4a_7c15 + s as u64);
            let taken = (0..ROUNDS)
                .filter(|_| target(&mutate(&mut r, line)))
                .count();
            // If nearly all mutations are rejected, or nearly all accepted, the test reaches little of the
            // code.
            assert!(
                (ROUNDS / 100..ROUNDS - ROUNDS / 100).contains(&taken),
                "{line}: {taken} of {ROUNDS}"
            );
        }
    }
}
