//! The contribution of each visible item to the view, for each cell: one byte per item.
//!
//! The section contains cells + 1 offsets as u64. Then follows, for each cell, one byte per item of its
//! visible set in ascending order. The low four bits are the level of the mean share, and the high four bits
//! the level of the maximum share. A share is a fraction of all directions around a viewpoint. Level 0 means
//! that no line that measured contributions met the item. Level k > 0 means that the share is between 2^(k −
//! 16) and 2^(k − 15); level 1 also includes all smaller shares.

use crate::error::PvsError;
use crate::layout::{Section, u64_at};

/// The highest level.
const MOST: u8 = 15;

/// The share of the view that an item fills, as seen from a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contribution {
    mean: u8,
    greatest: u8,
}

impl Contribution {
    /// Creates the contribution of an item from two shares of all directions, each 0 if no line met the item.
    /// `mean` is the average over the cell, and `greatest` the maximum over single viewpoints.
    pub fn new(mean: f64, greatest: f64) -> Self {
        Self {
            mean: level(mean),
            greatest: level(greatest),
        }
    }

    /// Returns the contribution as a byte of the file.
    pub fn byte(self) -> u8 {
        self.mean | self.greatest << 4
    }

    /// Creates a contribution from a byte of the file.
    pub fn from_byte(byte: u8) -> Self {
        Self {
            mean: byte & MOST,
            greatest: byte >> 4,
        }
    }

    /// Returns the bounds of the mean share, lower first, as fractions of all directions. Both bounds are 0
    /// if no line met the item.
    pub fn mean(self) -> [f64; 2] {
        shares(self.mean)
    }

    /// Returns the bounds of the maximum share from one viewpoint, in the form of [`Self::mean`].
    pub fn greatest(self) -> [f64; 2] {
        shares(self.greatest)
    }
}

fn level(share: f64) -> u8 {
    if share <= 0.0 {
        return 0;
    }
    // Comparisons with powers of two are exact, so the level does not depend on the machine.
    (1..MOST).find(|k| share < shares(*k)[1]).unwrap_or(MOST)
}

fn shares(level: u8) -> [f64; 2] {
    match level {
        0 => [0.0, 0.0],
        1 => [0.0, power(1)],
        k => [power(k - 1), power(k)],
    }
}

/// Returns 2^(k − 15).
fn power(k: u8) -> f64 {
    f64::from(1u32 << k.min(MOST)) / f64::from(1u32 << MOST)
}

/// Returns the bytes of a cell's contributions in the section of a file with `cells` cells.
pub(crate) fn of_cell(section: &[u8], cell: u32, cells: u32) -> Result<&[u8], PvsError> {
    let head = (cells as usize + 1) * 8;
    let [from, to] = [0, 1].map(|k| u64_at(section, (cell as usize + k) * 8) as usize);
    let bytes = head
        .checked_add(from)
        .zip(head.checked_add(to))
        .and_then(|(a, b)| section.get(a..b));
    bytes.ok_or_else(|| {
        Section::Contributions
            .malformed("the contributions of a cell reach beyond the end of the section")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_contains_its_share() {
        for share in [1e-9, 1e-5, 3.1e-5, 1e-3, 0.124, 0.125, 0.3, 0.5, 0.9, 1.0] {
            let c = Contribution::from_byte(Contribution::new(share, share / 2.0).byte());
            for (at, expected) in [(c.mean(), share), (c.greatest(), share / 2.0)] {
                assert!(
                    at[0] <= expected
                        && expected <= at[1]
                        && at[1] <= (2.0 * expected).max(power(1)),
                    "{share} {at:?}"
                );
            }
        }
        assert_eq!(Contribution::new(0.0, 0.0).mean(), [0.0, 0.0]);
    }
}
