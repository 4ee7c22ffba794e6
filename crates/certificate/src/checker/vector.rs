//! Vectors of line space with their leading bits, which decide the sign of most Klein forms that are not 0.
//!
//! The leading bits are integers of fixed width. The truncation error of a component is less than one unit of
//! the last stored bit, which bounds the error of a sum of products. If the sum is within that bound of 0,
//! the exact integers decide the sign.

use std::cmp::Ordering;

use super::geometry::{Line, klein, sign};

/// The number of stored bits of the longest component. A sum of six products of two such numbers fits in an
/// `i128`.
const KEPT: usize = 60;

/// A vector, and its components in units of a common power of two, rounded down.
#[derive(Clone)]
pub struct Vector {
    line: Line,
    leading: [i64; 6],
    /// The sum of the absolute values of `leading`.
    size: i128,
}

impl Vector {
    /// Creates a vector and computes its leading bits.
    pub fn new(line: Line) -> Self {
        let longest = line
            .iter()
            .map(dashu_int::ops::BitTest::bit_len)
            .max()
            .unwrap_or(0);
        let unit = longest.saturating_sub(KEPT);
        let leading = line.each_ref().map(|c| {
            i64::try_from(c >> unit)
                .unwrap_or_else(|_| unreachable!("no component is longer than the longest"))
        });
        let size = leading.iter().map(|c| i128::from(*c).abs()).sum();
        Self {
            line,
            leading,
            size,
        }
    }

    /// Returns the exact vector.
    pub fn line(&self) -> &Line {
        &self.line
    }

    /// Returns the sign of the Klein form with another vector.
    pub fn side(&self, other: &Self) -> Ordering {
        let near: i128 = (0..6)
            .map(|i| i128::from(self.leading[i]) * i128::from(other.leading[(i + 3) % 6]))
            .sum();
        // For d and e less than 1, (a + d)(b + e) differs from ab by at most |a| + |b| + 1.
        if near.abs() >= self.size + other.size + 6 {
            near.cmp(&0)
        } else {
            sign(&klein(&self.line, &other.line))
        }
    }
}

#[cfg(test)]
mod tests {
    use dashu_int::IBig;
    use proptest::prelude::*;

    use super::*;

    fn component() -> impl Strategy<Value = IBig> {
        (any::<i64>(), 0usize..200, 0usize..64)
            .prop_map(|(x, up, down)| (IBig::from(x) << up) >> down)
    }

    proptest! {
        #[test]
        fn leading_bits_give_the_exact_sign(
            a in prop::array::uniform6(component()),
            mut b in prop::array::uniform6(component()),
            nudge in -2i8..3,
        ) {
            let check = |a: &Line, b: &Line| {
                let found = Vector::new(a.clone()).side(&Vector::new(b.clone()));
                prop_assert_eq!(found, sign(&klein(a, b)));
                Ok(())
            };
            check(&a, &b)?;
            // Test a vector with form 0, (a·y) x − (a·x) y, and its neighbours.
            let others: [IBig; 6] = std::array::from_fn(|i| b[(i + 1) % 6].clone());
            let (x, y) = (klein(&a, &b), klein(&a, &others));
            b = std::array::from_fn(|i| &b[i] * &y - &others[i] * &x);
            prop_assert!(klein(&a, &b).is_zero());
            check(&a, &b)?;
            b[0] += nudge;
            check(&a, &b)?;
        }
    }
}
