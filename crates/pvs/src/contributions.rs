//! How much of the view each visible item takes, for each cell: a byte an item.
//!
//! The section has cells + 1 offsets as u64 and then, for each cell, a byte for each item of its visible set
//! in ascending order: the level of the mean share in the low four bits, that of the greatest share in the
//! high four. A share is a fraction of all directions around a viewpoint. Level 0 says that no line that
//! measured contributions met the item; level k > 0 that the share is from 2^(k − 16) up to 2^(k − 15), and
//! level 1 also holds what is smaller.

use crate::error::PvsError;
use crate::layout::{Section, u64_at};

/// Highest level.
const MOST: u8 = 15;

/// How much of the view an item takes, seen from a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contribution {
    mean: u8,
    greatest: u8,
}

impl Contribution {
    /// The contribution of an item that takes the share `mean` of all directions on average over the cell,
    /// and `greatest` from one viewpoint; 0 when no line met it.
    pub fn new(mean: f64, greatest: f64) -> Self {
        Self {
            mean: level(mean),
            greatest: level(greatest),
        }
    }

    /// As a byte of the file.
    pub fn byte(self) -> u8 {
        self.mean | self.greatest << 4
    }

    /// From a byte of the file.
    pub fn from_byte(byte: u8) -> Self {
        Self {
            mean: byte & MOST,
            greatest: byte >> 4,
        }
    }

    /// The least and the greatest mean share that it stands for, as fractions of all directions. Both are 0
    /// when no line met the item.
    pub fn mean(self) -> [f64; 2] {
        shares(self.mean)
    }

    /// The same for the greatest share from one viewpoint.
    pub fn greatest(self) -> [f64; 2] {
        shares(self.greatest)
    }
}

fn level(share: f64) -> u8 {
    if share <= 0.0 {
        return 0;
    }
    // Comparisons with powers of two are exact, so the level is the same on every machine.
    (1..MOST).find(|k| share < shares(*k)[1]).unwrap_or(MOST)
}

fn shares(level: u8) -> [f64; 2] {
    match level {
        0 => [0.0, 0.0],
        1 => [0.0, power(1)],
        k => [power(k - 1), power(k)],
    }
}

/// 2^(k − 15).
fn power(k: u8) -> f64 {
    f64::from(1u32 << k.min(MOST)) / f64::from(1u32 << MOST)
}

/// The bytes of a cell's contributions in the section of a file with `cells` cells.
pub(crate) fn of_cell(section: &[u8], cell: u32, cells: u32) -> Result<&[u8], PvsError> {
    let head = (cells as usize + 1) * 8;
    let [from, to] = [0, 1].map(|k| u64_at(section, (cell as usize + k) * 8) as usize);
    let bytes = head
        .checked_add(from)
        .zip(head.checked_add(to))
        .and_then(|(a, b)| section.get(a..b));
    bytes.ok_or_else(|| Section::Contributions.malformed("a cell's part is beyond its end"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_holds_the_share_it_was_made_of() {
        for share in [1e-9, 1e-5, 3.1e-5, 1e-3, 0.124, 0.125, 0.3, 0.5, 0.9, 1.0] {
            let c = Contribution::from_byte(Contribution::new(share, share / 2.0).byte());
            for (at, of) in [(c.mean(), share), (c.greatest(), share / 2.0)] {
                assert!(
                    at[0] <= of && of <= at[1] && at[1] <= (2.0 * of).max(power(1)),
                    "{share} {at:?}"
                );
            }
        }
        assert_eq!(Contribution::new(0.0, 0.0).mean(), [0.0, 0.0]);
    }
}
