//! On which side of lines the rays of a region are, as sets of bits: which occluder takes most of a region is asked of many.
//!
//! Rounded and without bounds: what is taken first matters to the time a query takes, never to its answer.

use crate::cone::Region;
use crate::vector::{Id, Space, klein};

/// A set of a region's rays. Only so many are looked at; few regions have more.
pub type Bits = [u64; 4];
/// Rays in a [`Bits`].
const MOST: usize = 256;

/// For each line the rays of the region at hand that pass it on either side.
#[derive(Default)]
pub struct Rows {
    /// Which region they are about.
    region: u32,
    /// By the lines' numbers.
    rows: Vec<Row>,
    rays: Vec<[f64; 6]>,
}

#[derive(Clone, Copy, Default)]
struct Row {
    region: u32,
    /// Rays on the positive side, on the negative side; on both those on the line.
    sides: [Bits; 2],
}

impl Rows {
    /// Goes on to another region.
    pub fn begin(&mut self, space: &Space, region: &Region) {
        self.region += 1;
        self.rays.clear();
        self.rays.extend(region.rays.iter().take(MOST).map(|(r, _)| *space.rounded(*r)));
    }

    /// All rays.
    pub fn all(&self) -> Bits {
        std::array::from_fn(|k| match self.rays.len().saturating_sub(64 * k) {
            n @ 0..64 => (1 << n) - 1,
            _ => u64::MAX,
        })
    }

    /// The rays on one side of a line.
    pub fn side(&mut self, space: &Space, line: Id, negative: bool) -> Bits {
        let number = space.line_number(line);
        if self.rows.len() <= number {
            self.rows.resize(number + 1, Row::default());
        }
        if self.rows[number].region != self.region {
            let of = space.rounded(line);
            let mut sides = [[0; 4]; 2];
            for (i, ray) in self.rays.iter().enumerate() {
                let s = klein(ray, of);
                let bit = 1u64 << (i % 64);
                sides[0][i / 64] |= if s >= 0.0 { bit } else { 0 };
                sides[1][i / 64] |= if s <= 0.0 { bit } else { 0 };
            }
            self.rows[number] = Row { region: self.region, sides };
        }
        self.rows[number].sides[usize::from(negative)]
    }
}

/// What is in both sets.
pub fn both(a: Bits, b: Bits) -> Bits {
    std::array::from_fn(|k| a[k] & b[k])
}

/// How many rays are in a set.
pub fn count(of: Bits) -> u32 {
    of.iter().map(|b| b.count_ones()).sum()
}
