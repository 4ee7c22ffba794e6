//! A short fuzz run with fixed seeds: small valid files with a few thousand mutations must load or be
//! rejected, without a panic and without excessive memory. Files that once crashed a parser are stored in
//! `crashes/` and run first.
//!
//! The long runs with coverage are in `fuzz/`; this run only guards against regressions. There is only one
//! test, because it measures the memory of the whole process.
#![allow(clippy::unwrap_used, unsafe_code)]

mod support;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use sightline_scene::load::{LoadOptions, load_bytes_with};
use sightline_scene::{fuzzing, load_bytes};
use support::*;

/// An allocator that wraps the system's allocator and counts the allocated bytes and their peak.
struct Counting;

static HELD: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: every call is passed to the system's allocator unchanged. The counting does not access memory of
// the caller.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let held = HELD.fetch_add(layout.size(), Relaxed) + layout.size();
        PEAK.fetch_max(held, Relaxed);
        // SAFETY: the caller observes `alloc`'s contract, which is the system's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, p: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Relaxed);
        // SAFETY: `p` came from `alloc` above with this layout.
        unsafe { System.dealloc(p, layout) }
    }
}

/// Maximum memory in bytes of one run beyond its input. The limits of `fuzzing` allow 16384 triangles (0.6
/// MB), which are copied into a canonical blob and a PLY file and back.
const MOST: usize = 12 << 20;

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

/// Numbers that parsers often handle incorrectly.
const NUMBERS: &[&str] = &[
    "0",
    "-1",
    "1",
    "2",
    "3",
    "255",
    "256",
    "65535",
    "65536",
    "2147483647",
    "-2147483648",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "1e38",
    "1e39",
    "1e308",
    "1e400",
    "nan",
    "inf",
    "-0",
    "0.5",
    "null",
    "[]",
    "{}",
    "\"x\"",
];

fn mutate(r: &mut Random, seeds: &[Vec<u8>], seed: usize) -> Vec<u8> {
    let mut b = seeds[seed].clone();
    for _ in 0..1 + r.below(4) {
        if b.is_empty() {
            break;
        }
        let at = r.below(b.len());
        match r.below(7) {
            0 => b[at] ^= 1 << r.below(8),
            1 => b[at] = [0, 1, 0x7f, 0x80, 0xff, b'\n', b' ', b'-'][r.below(8)],
            2 => b.truncate(at),
            3 => {
                // Insert a piece of this file or of another file.
                let other = &seeds[r.below(seeds.len())];
                let from = r.below(other.len());
                let piece = other[from..(from + r.below(40)).min(other.len())].to_vec();
                b.splice(at..at, piece);
            }
            4 => {
                let end = (at + r.below(20)).min(b.len());
                b.drain(at..end);
            }
            5 => {
                // Replace a word of binary data by a critical number.
                let v = [
                    0u32,
                    1,
                    0x7fff_ffff,
                    0x8000_0000,
                    u32::MAX,
                    0x7f80_0000,
                    0x7fc0_0000,
                ][r.below(7)];
                for (d, s) in b[at..].iter_mut().zip(v.to_le_bytes()) {
                    *d = s;
                }
            }
            _ => {
                // Replace a number in the text.
                let Some(start) = b[at..].iter().position(u8::is_ascii_digit).map(|p| p + at)
                else {
                    continue;
                };
                let len = b[start..].iter().take_while(|c| c.is_ascii_digit()).count();
                b.splice(start..start + len, NUMBERS[r.below(NUMBERS.len())].bytes());
            }
        }
    }
    b
}

/// A function of [`fuzzing`].
type Target = fn(&[u8]) -> bool;
/// The number of mutations of each seed file.
const ROUNDS: usize = 4000;

/// Runs `target` and checks its peak memory.
fn run(target: Target, bytes: &[u8], what: &str) -> bool {
    let before = HELD.load(Relaxed);
    PEAK.store(before, Relaxed);
    let accepted = target(bytes);
    let used = PEAK.load(Relaxed) - before;
    assert!(
        used <= MOST + 600 * bytes.len(),
        "{what}: {used} bytes for an input of {}",
        bytes.len()
    );
    accepted
}

#[test]
fn mutated_files_load_or_are_rejected() {
    let crashes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/crashes");
    let mut kept: Vec<_> = std::fs::read_dir(&crashes)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    kept.sort();
    for path in kept {
        let bytes = std::fs::read(&path).unwrap();
        for target in [
            fuzzing::obj,
            fuzzing::ply,
            fuzzing::gltf,
            fuzzing::scene_blob,
        ] {
            run(target, &bytes, &path.display().to_string());
        }
    }

    let json = |g: &Gltf| {
        use base64::Engine;
        let mut j = g.json.clone();
        let data = base64::engine::general_purpose::STANDARD.encode(&g.bin);
        j["buffers"] =
            serde_json::json!([{"byteLength": g.bin.len(), "uri": format!("data:;base64,{data}")}]);
        j.to_string().into_bytes()
    };
    let blob = load_bytes("a.obj", OBJ.as_bytes(), None).unwrap().to_blob();
    let masked = card(&[0, 5], |_| {});
    let options = LoadOptions {
        alpha_textures: true,
        ..LoadOptions::default()
    };
    let masked_blob = load_bytes_with("a.glb", &masked.glb(), None, &options)
        .unwrap()
        .scene
        .to_blob();
    let families: [(Target, &str, Vec<Vec<u8>>); 4] = [
        (fuzzing::obj, "obj", vec![OBJ.into()]),
        (
            fuzzing::ply,
            "ply",
            vec![
                PLY.into(),
                binary_ply(false, &SQUARE, 3),
                binary_ply(true, &SQUARE, 3),
            ],
        ),
        (
            fuzzing::gltf,
            "gltf",
            vec![
                json(&rich()),
                json(&packed_square()),
                json(&draco_square()),
                rich().glb(),
                packed_square().glb(),
                draco_square().glb(),
                square().glb(),
                json(&masked),
                masked.glb(),
            ],
        ),
        (fuzzing::scene_blob, "scene_blob", vec![blob, masked_blob]),
    ];
    for (target, name, seeds) in families {
        for (s, seed) in seeds.iter().enumerate() {
            assert!(run(target, seed, name), "seed {s} of {name} must be valid");
            let mut accepted = 0;
            let mut r = Random::new(0x9e37_79b9_7f4a_7c15 + s as u64);
            for i in 0..ROUNDS {
                let bytes = mutate(&mut r, &seeds, s);
                accepted += usize::from(run(
                    target,
                    &bytes,
                    &format!("{name}, seed {s}, mutation {i}"),
                ));
            }
            // If nearly all mutations fail, or nearly all pass, the test reaches little of a parser.
            assert!(
                (ROUNDS / 100..ROUNDS - ROUNDS / 100).contains(&accepted),
                "{name}, seed {s}: {accepted} of {ROUNDS} accepted"
            );
        }
    }
}
