//! The body of the fuzz target `certificate` on mutated valid certificates, and on inputs that once crashed
//! it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use sightline_certificate::fuzzing::certificate;
use support::{alone, raw, relying, sharing};

/// The number of mutations of each valid certificate.
const ROUNDS: usize = 2000;

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
        let at = r.below(bytes.len());
        match r.below(5) {
            0 => bytes[at] ^= 1 << r.below(8),
            1 => bytes[at] = [0, 1, 2, 3, 7, 11, 0x7f, 0x80, 0xff][r.below(9)],
            2 => bytes.truncate(at),
            3 => {
                let from = r.below(other.len());
                let piece = other[from..(from + r.below(30)).min(other.len())].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => {
                let end = (at + r.below(8)).min(bytes.len());
                bytes.drain(at..end);
            }
        }
    }
    bytes
}

#[test]
fn former_crash_inputs_do_not_crash() {
    let crashes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/crashes");
    let mut kept: Vec<_> = std::fs::read_dir(crashes)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    kept.sort();
    assert!(!kept.is_empty(), "the folder has a README at least");
    for path in kept {
        let _ = certificate(&std::fs::read(&path).unwrap());
    }
}

#[test]
fn mutated_certificates_do_not_crash() {
    let seeds = [alone(), sharing(), relying()].map(|c| raw(&c));
    for (s, seed) in seeds.iter().enumerate() {
        assert!(certificate(seed), "seed {s} must be valid");
        let mut r = Random::new(0x9e37_79b9_7f4a_7c15 + s as u64);
        let other = &seeds[(s + 1) % seeds.len()];
        let decoded = (0..ROUNDS)
            .filter(|_| certificate(&mutate(&mut r, seed.clone(), other)))
            .count();
        // If all mutations were rejected, or all were decoded, the test would reach little of the code.
        assert!(
            (ROUNDS / 100..ROUNDS - ROUNDS / 100).contains(&decoded),
            "seed {s}: {decoded} of {ROUNDS}"
        );
    }
}
