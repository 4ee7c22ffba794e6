//! Places modulo two primes, for sums of quotients that would be too long as integers.
//!
//! The primes have 61 bits and are taken from the scene's digest. Two different quotients of integers of n
//! bits agree modulo such a prime only where it divides their difference, which at most n / 30 primes do, of
//! the some 2⁵⁴ there are; so sums that agree modulo both are equal but for an input made for this digest.

use dashu_int::IBig;
use dashu_int::ops::DivRem;

/// A number modulo the two primes.
pub(crate) type Both = [u64; 2];
/// A place modulo the two primes.
pub(crate) type ResiduePlace = [Both; 3];

/// Arithmetic modulo two primes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    primes: Both,
}

impl Field {
    /// The primes that follow two numbers in the digest.
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

    pub fn add(&self, a: Both, b: Both) -> Both {
        std::array::from_fn(|i| (a[i] + b[i]) % self.primes[i])
    }

    pub fn sub(&self, a: Both, b: Both) -> Both {
        std::array::from_fn(|i| (a[i] + self.primes[i] - b[i]) % self.primes[i])
    }

    pub fn mul(&self, a: Both, b: Both) -> Both {
        std::array::from_fn(|i| mul(a[i], b[i], self.primes[i]))
    }

    /// The inverse; of 0 it is 0.
    pub fn inverse(&self, a: Both) -> Both {
        std::array::from_fn(|i| pow(a[i], self.primes[i] - 2, self.primes[i]))
    }

    pub fn integer(&self, x: &IBig) -> Both {
        std::array::from_fn(|i| {
            let prime = IBig::from(self.primes[i]);
            let (_, rest) = x.div_rem(&prime);
            let rest = if rest < IBig::ZERO {
                rest + prime
            } else {
                rest
            };
            // A rest of a division by 61 bits has no more.
            u64::try_from(rest).unwrap_or_default()
        })
    }

    /// A vertex in homogeneous coordinates.
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

    pub fn dot(&self, a: &ResiduePlace, b: &ResiduePlace) -> Both {
        self.add(
            self.add(self.mul(a[0], b[0]), self.mul(a[1], b[1])),
            self.mul(a[2], b[2]),
        )
    }

    /// Twice the area of a loop in its plane as a vector.
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

    /// A name of the line through two places: its direction and moment, scaled to be the same for all pairs.
    pub fn line(&self, a: &ResiduePlace, b: &ResiduePlace) -> [ResiduePlace; 2] {
        let d = self.difference(b, a);
        let first: Both =
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

/// Miller's test with bases that decide every number of 64 bits (Sinclair, 2011).
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
    fn the_primes_are_primes() {
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
