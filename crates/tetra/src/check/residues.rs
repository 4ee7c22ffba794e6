//! Positions modulo two primes, for sums of quotients that would be too long as integers.
//!
//! The primes have 61 bits and are derived from the scene's digest. Two different quotients of integers of n
//! bits agree modulo such a prime only if the prime divides their difference. At most n / 30 of about 2⁵⁴
//! such primes do. So sums that agree modulo both primes are equal, unless an input was constructed for this
//! digest.

use dashu_int::IBig;
use dashu_int::ops::DivRem;

/// A number modulo the two primes.
pub(crate) type ResiduePair = [u64; 2];
/// The x, y and z coordinate of a position, or of a vector, modulo the two primes.
pub(crate) type ResiduePlace = [ResiduePair; 3];

/// Arithmetic modulo two primes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    primes: ResiduePair,
}

impl Field {
    /// Creates the field of two primes: the first primes that follow two numbers in the digest.
    pub fn new(digest: &[u8; 32]) -> Self {
        let start = |from: usize| {
            let bytes = std::array::from_fn(|i| digest[from + i]);
            (u64::from_le_bytes(bytes) >> 4) | (1 << 60) | 1
        };
        let next = |from: u64| {
            (from..)
                .step_by(2)
                .find(|n| is_prime(*n))
                .unwrap_or((1 << 61) - 1)
        };
        let first = next(start(0));
        let second = next(start(8));
        Self {
            primes: [
                first,
                if second == first {
                    next(first + 2)
                } else {
                    second
                },
            ],
        }
    }

    pub fn add(&self, a: ResiduePair, b: ResiduePair) -> ResiduePair {
        std::array::from_fn(|i| (a[i] + b[i]) % self.primes[i])
    }

    pub fn sub(&self, a: ResiduePair, b: ResiduePair) -> ResiduePair {
        std::array::from_fn(|i| (a[i] + self.primes[i] - b[i]) % self.primes[i])
    }

    pub fn mul(&self, a: ResiduePair, b: ResiduePair) -> ResiduePair {
        std::array::from_fn(|i| mul(a[i], b[i], self.primes[i]))
    }

    /// Computes the multiplicative inverse. The inverse of 0 is 0.
    pub fn inverse(&self, a: ResiduePair) -> ResiduePair {
        std::array::from_fn(|i| pow(a[i], self.primes[i] - 2, self.primes[i]))
    }

    pub fn integer(&self, x: &IBig) -> ResiduePair {
        std::array::from_fn(|i| {
            let prime = IBig::from(self.primes[i]);
            let (_, rest) = x.div_rem(&prime);
            let rest = if rest < IBig::ZERO {
                rest + prime
            } else {
                rest
            };
            // The remainder of a division by a 61-bit prime fits in 61 bits.
            u64::try_from(rest).unwrap_or_default()
        })
    }

    /// Computes the residues of x/w, y/w and z/w for a vertex in homogeneous coordinates.
    pub fn place(&self, [x, y, z, w]: &[IBig; 4]) -> ResiduePlace {
        let by = self.inverse(self.integer(w));
        [x, y, z].map(|c| self.mul(self.integer(c), by))
    }

    pub fn difference(&self, a: &ResiduePlace, b: &ResiduePlace) -> ResiduePlace {
        std::array::from_fn(|i| self.sub(a[i], b[i]))
    }

    pub fn cross(&self, a: &ResiduePlace, b: &ResiduePlace) -> ResiduePlace {
        let minor = |i: usize, j: usize| self.sub(self.mul(a[i], b[j]), self.mul(a[j], b[i]));
        [minor(1, 2), minor(2, 0), minor(0, 1)]
    }

    pub fn dot(&self, a: &ResiduePlace, b: &ResiduePlace) -> ResiduePair {
        self.add(
            self.add(self.mul(a[0], b[0]), self.mul(a[1], b[1])),
            self.mul(a[2], b[2]),
        )
    }

    /// Computes twice the area vector of a planar loop of positions.
    pub fn area(&self, places: &[ResiduePlace]) -> ResiduePlace {
        let mut sum = ResiduePlace::default();
        for i in 1..places.len().saturating_sub(1) {
            let d = self.difference(&places[i], &places[0]);
            let e = self.difference(&places[i + 1], &places[0]);
            let part = self.cross(&d, &e);
            sum = std::array::from_fn(|k| self.add(sum[k], part[k]));
        }
        sum
    }

    /// Computes an identifier of the line through two positions.
    ///
    /// The identifier is the line's direction and moment, scaled so that all pairs of positions on the line
    /// have the same identifier.
    pub fn line(&self, a: &ResiduePlace, b: &ResiduePlace) -> [ResiduePlace; 2] {
        let d = self.difference(b, a);
        let first: ResiduePair =
            std::array::from_fn(|p| d.iter().map(|c| c[p]).find(|c| *c != 0).unwrap_or_default());
        let by = self.inverse(first);
        let direction = d.map(|c| self.mul(c, by));
        [direction, self.cross(a, &direction)]
    }
}

fn mul(a: u64, b: u64, prime: u64) -> u64 {
    (u128::from(a) * u128::from(b) % u128::from(prime)) as u64
}

fn pow(mut base: u64, mut exponent: u64, prime: u64) -> u64 {
    let mut result = 1;
    while exponent > 0 {
        if exponent & 1 == 1 {
            result = mul(result, base, prime);
        }
        base = mul(base, base, prime);
        exponent >>= 1;
    }
    result
}

/// Returns true if `n` is prime, by Miller's test with bases that decide every number of 64 bits (Sinclair,
/// 2011).
fn is_prime(n: u64) -> bool {
    if [3u64, 5, 7, 11, 13].iter().any(|p| n.is_multiple_of(*p)) {
        return false;
    }
    let zeros = (n - 1).trailing_zeros();
    let odd = (n - 1) >> zeros;
    [2, 325, 9375, 28178, 450_775, 9_780_504, 1_795_265_022u64]
        .iter()
        .all(|base| {
            let mut x = pow(base % n, odd, n);
            let mut is_probable = x == 1 || x == n - 1 || base.is_multiple_of(n);
            for _ in 1..zeros {
                x = mul(x, x, n);
                is_probable |= x == n - 1;
            }
            is_probable
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn field_uses_distinct_primes() {
        assert!(is_prime((1 << 61) - 1) && is_prime(1_000_000_007));
        assert!(!is_prime((1 << 59) - 1) && !is_prime(1_000_000_007 * 1_000_000_009));
        let field = Field::new(&[7; 32]);
        assert_ne!(field.primes[0], field.primes[1]);
        assert!(field.primes.iter().all(|p| is_prime(*p) && p >> 60 == 1));
        let x = field.integer(&IBig::from(-12345));
        assert_eq!(field.mul(x, field.inverse(x)), [1, 1]);
        assert_eq!(field.add(x, [12345; 2]), [0, 0]);
    }
}
