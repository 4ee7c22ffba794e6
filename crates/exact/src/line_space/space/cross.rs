//! Exact rays, computed from the lines whose hyperplanes contain them instead of from the rays from which
//! they were cut.
//!
//! Along a chain of cuts, the integers double in length with every cut, before common factors are removed. An
//! extreme ray is the only solution of K(x, l) = 0 for five independent lines l, whose integers are small.

use std::cmp::Ordering;

use dashu_int::IBig;

use super::solved_rays::{MOST_ERROR, functional, independent};
use super::{Space, Tight, VectorId, klein_exact};
use crate::arithmetic::number::{primitive, rounded};
use crate::geometry::predicates;

impl Space {
    /// Computes the exact components of a ray from at least five `lines` whose hyperplanes contain the ray.
    ///
    /// The function leaves the ray unchanged if its exact components are known, if it is a real line by
    /// construction, or if doubles cannot determine five independent lines or the ray's sign.
    pub fn sharpen_from(&mut self, ray: VectorId, lines: &[VectorId]) {
        // If a ray is a real line by construction, the integers computed from its points are smaller and have
        // no common factor.
        let near = (0.0..MOST_ERROR).contains(&self.near[ray.index()].error);
        if self.vectors[ray.index()].exact.is_some() || self.is_line(ray) || !near {
            return;
        }
        let rows = lines
            .iter()
            .map(|l| functional(&self.near[l.index()].x))
            .collect();
        let Some(chosen) = independent(rows) else {
            return;
        };
        let rows = chosen.map(|k| functional(self.exact(lines[k])));
        let mut x = cross(&rows);
        // Let x̂ be the solution, scaled so that no component exceeds 1 and one is at least 1/2. Let the
        // ray's doubles be cx̂ up to an error of 0.05. Then c ≥ 0.45, so c|x̂|² ≥ 0.22|x̂|. The error changes
        // this by at most 0.05·√6|x̂|, which does not change the sign.
        let along: f64 = rounded(&x)
            .iter()
            .zip(self.rounded(ray))
            .map(|(a, b)| a * b)
            .sum();
        if along.is_nan() || along.abs() < 0.1 {
            return;
        }
        let zeros = x
            .iter()
            .filter_map(|c| c.trailing_zeros())
            .min()
            .unwrap_or(0);
        for c in &mut x {
            let short: IBig = std::mem::take(c) >> zeros;
            *c = if along < 0.0 { -short } else { short };
        }
        self.improve(ray, &x);
        self.vectors[ray.index()].exact = Some(Box::new(x));
    }
}

impl Space {
    /// Computes a vector x ≠ 0 with K(x, l) = 0 for each of five independent lines l.
    pub fn orthogonal(&mut self, lines: [VectorId; 5]) -> [IBig; 6] {
        let mut x = cross(&lines.map(|line| functional(self.exact(line))));
        primitive(&mut x);
        x
    }

    /// Computes the six extreme rays of the cone of all vectors x for which K(x, l) is 0 or has the given
    /// sign, for six independent lines l.
    ///
    /// Each ray is returned with the set of lines that are tight at the ray; bit i of the set stands for
    /// `lines[i]`.
    pub fn dual_simplex(&mut self, lines: [(VectorId, Ordering); 6]) -> Vec<(VectorId, Tight)> {
        let exact = lines.map(|(line, _)| self.exact(line).clone());
        let rays = (0..6).map(|i| {
            let x = cross(&std::array::from_fn(|k| {
                functional(&exact[if k < i { k } else { k + 1 }])
            }));
            let side = predicates::sign(&klein_exact(&x, &exact[i]));
            let x = if side == lines[i].1 { x } else { x.map(|c| -c) };
            (x, 0b11_1111 & !(1 << i))
        });
        let rays: Vec<([IBig; 6], Tight)> = rays.collect();
        rays.into_iter()
            .map(|(x, tight)| (self.fixed(x), tight))
            .collect()
    }
}

/// Computes the vector orthogonal to five rows: the 5 × 5 minors of the rows, with alternating signs.
///
/// The vector is 0 if the rows are dependent.
fn cross(rows: &[[IBig; 6]; 5]) -> [IBig; 6] {
    let [a, b, c, d, e] = rows;
    let minor = |x: &[IBig; 6], y: &[IBig; 6], i: usize, j: usize| &x[i] * &y[j] - &x[j] * &y[i];
    let pairs = |x: &[IBig; 6], y: &[IBig; 6]| -> [[IBig; 6]; 6] {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| if i < j { minor(x, y, i, j) } else { IBig::ZERO })
        })
    };
    let (ab, cd) = (pairs(a, b), pairs(c, d));
    let triple =
        |i: usize, j: usize, k: usize| &cd[i][j] * &e[k] - &cd[i][k] * &e[j] + &cd[j][k] * &e[i];
    // The index into `triples` is the set of columns, as bits.
    let mut triples: [IBig; 64] = std::array::from_fn(|_| IBig::ZERO);
    for i in 0..6 {
        for j in i + 1..6 {
            for k in j + 1..6 {
                triples[1 << i | 1 << j | 1 << k] = triple(i, j, k);
            }
        }
    }
    std::array::from_fn(|without| {
        let columns: [usize; 5] = std::array::from_fn(|k| if k < without { k } else { k + 1 });
        let mut sum = IBig::ZERO;
        for i in 0..5 {
            for j in i + 1..5 {
                let rest = 63 & !(1 << without) & !(1 << columns[i]) & !(1 << columns[j]);
                let term = &ab[columns[i]][columns[j]] * &triples[rest];
                // Laplace expansion along the first two rows.
                if (i + j) % 2 == 1 {
                    sum += term
                } else {
                    sum -= term
                }
            }
        }
        if without % 2 == 0 { sum } else { -sum }
    })
}

#[cfg(test)]
impl Space {
    /// Creates the cone of six independent vectors.
    pub fn simplex(
        &mut self,
        corner_rays: &[[IBig; 6]; 6],
    ) -> (Vec<(VectorId, Tight)>, Vec<VectorId>) {
        let halves = std::array::from_fn::<_, 6, _>(|without| {
            let others = std::array::from_fn(|k| {
                functional(&corner_rays[if k < without { k } else { k + 1 }])
            });
            self.fixed(cross(&others))
        });
        let rays = (0..6)
            .map(|i| (self.fixed(corner_rays[i].clone()), 0b11_1111 & !(1 << i)))
            .collect();
        (rays, halves.into())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn cross_is_orthogonal_and_zero_only_for_dependent_rows(
            rows in prop::array::uniform5(prop::array::uniform6(-9i64..10)), bits in 0usize..80,
            mix in prop::array::uniform4(-2i64..3),
        ) {
            let wide = |rows: [[i64; 6]; 5]| rows.map(|r| r.map(|c| IBig::from(c) << bits));
            let wide_rows = wide(rows);
            let x = cross(&wide_rows);
            for row in &wide_rows {
                let sum: IBig = row.iter().zip(&x).map(|(a, b)| a * b).sum();
                prop_assert!(sum.is_zero());
            }
                    prop_assert_eq!(x.iter().all(IBig::is_zero), rank(rows) < 5);
            let mut dependent = rows;
            dependent[4] = std::array::from_fn(|k| (0..4).map(|i| mix[i] * rows[i][k]).sum());
            prop_assert!(cross(&wide(dependent)).iter().all(IBig::is_zero));
        }
    }

    /// Returns the rank of rows of small integers, by elimination without fractions (Bareiss 1968).
    fn rank(rows: [[i64; 6]; 5]) -> usize {
        let mut m = rows.map(|r| r.map(i128::from));
        let (mut rank, mut before) = (0, 1);
        for column in 0..6 {
            let Some(pivot) = (rank..5).find(|i| m[*i][column] != 0) else {
                continue;
            };
            m.swap(rank, pivot);
            for i in rank + 1..5 {
                for k in (column + 1..6).chain([column]) {
                    m[i][k] = (m[i][k] * m[rank][column] - m[i][column] * m[rank][k]) / before;
                }
            }
            before = m[rank][column];
            rank += 1;
            if rank == 5 {
                break;
            }
        }
        rank
    }
}
