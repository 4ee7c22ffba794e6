//! The body of the fuzz target `query` on random bytes, and on inputs that once crashed it: the checker
//! accepts every answer. `SIGHTLINE_FUZZ_CASES` is the number of cases of each kind (default 200), and
//! `SIGHTLINE_FUZZ_SEED` the first seed (default 1).

#![allow(clippy::panic, clippy::print_stdout, reason = "tests")]

use sightline_exact::fuzzing::query;
use sightline_numbers::random::SplitMix64;

/// Returns `count` random bytes from a seed.
fn bytes(seed: u64, count: usize) -> Vec<u8> {
    let mut stream = SplitMix64::new(seed);
    (0..count.div_ceil(8))
        .flat_map(|_| stream.bits().to_le_bytes())
        .take(count)
        .collect()
}

fn variable(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).ok().map_or(otherwise, |v| {
        v.parse()
            .unwrap_or_else(|_| panic!("{name}={v} is no number"))
    })
}

/// Runs the fuzz target on random bytes of one kind.
///
/// Coordinates on a grid have few values, so that many points are in one plane, on one line or in one place.
fn run(kind: u8) {
    let (cases, first) = (
        variable("SIGHTLINE_FUZZ_CASES", 200),
        variable("SIGHTLINE_FUZZ_SEED", 1),
    );
    let mut found = [0u64; 3];
    for seed in first..first + cases {
        let size = [60, 100, 160, 250][(seed % 4) as usize] * if kind == 0 { 4 } else { 1 };
        let mut raw = bytes(seed, size);
        raw[0] = kind;
        let mask = [0x0f, 0x1f, 0x3f, 0xff][(seed / 4 % 4) as usize];
        if kind != 0 {
            // The bytes have a sign and a magnitude of few bits.
            raw[1..]
                .iter_mut()
                .for_each(|b| *b = (*b & mask).wrapping_sub(mask / 2));
            if seed % 2 == 0 {
                // One small triangle is on either side. All others are large and between them, so that they
                // hide part of the lines.
                let [small, large] = [3i8, 120]
                    .map(|most| move |b: u8| ((b.cast_signed() as i32 * most as i32) / 128) as u8);
                for (i, triangle) in raw[1..].chunks_mut(9).enumerate() {
                    for (k, b) in triangle.iter_mut().enumerate() {
                        *b = match (i, k % 3) {
                            (0, 2) => (-100i8).cast_unsigned() + *b % 8,
                            (1, 2) => 100 - *b % 8,
                            (0 | 1, _) | (_, 2) => small(b.wrapping_mul(37)),
                            _ => large(b.wrapping_mul(37)),
                        };
                    }
                }
            }
        }
        let result = std::panic::catch_unwind(|| query(&raw));
        let Ok(verdict) = result else {
            panic!("kind {kind}, seed {seed}")
        };
        found[verdict.map_or(2, usize::from)] += 1;
    }
    println!(
        "kind {kind}: {} hidden, {} visible, {} neither",
        found[0], found[1], found[2]
    );
    // With arbitrary floats, few scenes hide a triangle.
    let hidden = kind == 0 || found[0] > cases / 20;
    assert!(
        hidden && found[1] > cases / 20,
        "next to nothing was decided: {found:?}"
    );
}

#[test]
fn query_survives_former_crashes() {
    let crashes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/crashes");
    let entries = std::fs::read_dir(crashes).unwrap_or_else(|e| panic!("{e}"));
    let mut kept: Vec<_> = entries
        .map(|e| e.unwrap_or_else(|e| panic!("{e}")).path())
        .collect();
    kept.sort();
    assert!(!kept.is_empty(), "the folder has a README at least");
    for path in kept {
        let _ = query(&std::fs::read(&path).unwrap_or_else(|e| panic!("{e}")));
    }
}

#[test]
fn checker_accepts_answers_for_any_floats() {
    run(0);
}

#[test]
fn checker_accepts_answers_for_grid_points() {
    run(1);
}

#[test]
fn checker_accepts_answers_for_scaled_points() {
    run(2);
}
