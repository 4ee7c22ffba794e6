//! Runs of the fuzz targets `soup` and `tets` on random, mutated and formerly failing inputs.

use sightline_tetra::fuzzing::{seed, soup, tets};

/// A xorshift64* generator, which has a fixed sequence for each seed.
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

/// Coordinates that are equal, nearly equal, or at the limits of single precision.
const NUMBERS: [f32; 14] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    2.0,
    3.0,
    1.0 + f32::EPSILON,
    1e-30,
    1e-45,
    1e20,
    -1e20,
    3e37,
    0.1,
];

#[test]
fn engines_agree_on_soups_of_any_numbers() {
    let mut random = Random::new(0x5eed_0001);
    let mut built = 0;
    for _ in 0..120 {
        let points = 4 + 3 * random.below(6);
        let bytes: Vec<u8> = (0..points * 3)
            .flat_map(|_| NUMBERS[random.below(NUMBERS.len())].to_le_bytes())
            .collect();
        built += usize::from(soup(&bytes));
    }
    assert!(built > 90, "{built} soups had cells");
    // Arbitrary bits are coordinates too.
    for _ in 0..40 {
        let bytes: Vec<u8> = (0..12 * (4 + 3 * random.below(4)))
            .map(|_| random.below(256) as u8)
            .collect();
        soup(&bytes);
    }
}

#[test]
fn altered_files_are_rejected_or_harmless() {
    let seed = seed();
    assert!(tets(&seed));
    let mut random = Random::new(0x5eed_0002);
    let mut read = 0;
    for _ in 0..1000 {
        let mut bytes = seed.clone();
        for _ in 0..1 + random.below(3) {
            let at = random.below(bytes.len() / 4) * 4;
            let value = match random.below(5) {
                0 => u32::MAX,
                1 => random.below(64) as u32,
                2 => 1 << random.below(32),
                3 => f32::to_bits([f32::INFINITY, f32::NEG_INFINITY, f32::NAN][random.below(3)]),
                _ => f32::to_bits(NUMBERS[random.below(NUMBERS.len())]),
            };
            bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        if random.below(20) == 0 {
            bytes.truncate(random.below(bytes.len()));
        }
        read += usize::from(tets(&bytes));
    }
    assert!(read > 30, "{read} altered files were read");
}
