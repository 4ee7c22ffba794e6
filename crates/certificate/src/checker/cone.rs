//! Cones in six dimensions by the double description method (Motzkin et al. 1953), in integers.

use std::cell::OnceCell;
use std::cmp::Ordering;

use dashu_int::IBig;

use super::geometry::{Line, klein, reduced, sign};
use super::vector::Vector;

/// A pointed cone of full dimension, given by its extreme rays.
#[derive(Clone)]
pub struct Cone {
    rays: Vec<Ray>,
    /// The number of half-spaces so far. The bits of [`Ray::tight`] are indexed by half-space.
    halves: usize,
}

/// An extreme ray, and the half-spaces whose border contains it, as a set of bits.
#[derive(Clone)]
struct Ray {
    vector: Vector,
    tight: Vec<u64>,
}

fn has(set: &[u64], bit: usize) -> bool {
    set.get(bit / 64).is_some_and(|w| w >> (bit % 64) & 1 == 1)
}

fn insert(set: &mut Vec<u64>, bit: usize) {
    if set.len() <= bit / 64 {
        set.resize(bit / 64 + 1, 0);
    }
    set[bit / 64] |= 1 << (bit % 64);
}

/// Returns true if every bit that is in both `a` and `b` is in `whole`.
fn holds(whole: &[u64], a: &[u64], b: &[u64]) -> bool {
    a.iter()
        .zip(b)
        .enumerate()
        .all(|(i, (a, b))| a & b & !whole.get(i).copied().unwrap_or(0) == 0)
}

fn dot(a: &Line, b: &Line) -> IBig {
    (0..6).map(|i| &a[i] * &b[i]).sum()
}

impl Cone {
    /// Creates the cone of the given vectors, which must not be 0. Returns `None` unless the vectors span all
    /// six dimensions and are strictly on one side of some hyperplane.
    pub fn new(vectors: Vec<Line>) -> Option<Self> {
        // The dual cone {f : f·v ≥ 0 for all v} has one ray for every facet. Its construction starts with six
        // independent vectors.
        let vectors: Vec<Line> = vectors.into_iter().map(reduced).collect();
        let basis = independent(&vectors)?;
        let rows: [&Line; 6] = std::array::from_fn(|k| &vectors[basis[k]]);
        let mut dual = Self {
            rays: Vec::new(),
            halves: vectors.len(),
        };
        for k in 0..6 {
            let mut f = normal(std::array::from_fn(|i| rows[if i < k { i } else { i + 1 }]));
            if sign(&dot(&f, rows[k])) == Ordering::Less {
                f.iter_mut().for_each(|c| *c = -std::mem::take(c));
            }
            let mut tight = Vec::new();
            basis
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != k)
                .for_each(|(_, b)| insert(&mut tight, *b));
            dual.rays.push(Ray {
                vector: Vector::new(f),
                tight,
            });
        }
        for (number, v) in vectors
            .iter()
            .enumerate()
            .filter(|(n, _)| !basis.contains(n))
        {
            // f·v is the Klein form of f and of v with the first and the last three components exchanged.
            let turned = Vector::new(std::array::from_fn(|i| v[(i + 3) % 6].clone()));
            dual = dual.cut(&turned, number).0?;
        }
        // Facets are the dual's rays. A vector is on the facets whose functional is 0 on it.
        let facets = dual.rays.len();
        let on = |number: usize| {
            let mut set = Vec::new();
            dual.rays
                .iter()
                .enumerate()
                .filter(|(_, ray)| has(&ray.tight, number))
                .for_each(|(f, _)| insert(&mut set, f));
            set
        };
        let sets: Vec<Vec<u64>> = (0..vectors.len()).map(on).collect();
        // A vector that is not extreme is on fewer facets than an extreme one. Of parallel vectors, keep the
        // first.
        let among = |i: usize, j: usize| holds(&sets[j], &sets[i], &sets[i]);
        let extreme =
            |i: usize| (0..sets.len()).all(|j| i == j || !among(i, j) || (among(j, i) && i < j));
        let rays = (0..sets.len())
            .filter(|i| extreme(*i))
            .map(|i| Ray {
                vector: Vector::new(vectors[i].clone()),
                tight: sets[i].clone(),
            })
            .collect();
        Some(Self {
            rays,
            halves: facets,
        })
    }

    /// Returns the parts on the positive and on the negative side of a vector's polar hyperplane. A part
    /// without interior is `None`.
    pub fn split(self, line: &Vector) -> (Option<Self>, Option<Self>) {
        let number = self.halves;
        let (positive, negative) = self.cut(line, number);
        let with = |c: Option<Self>| {
            c.map(|c| Self {
                halves: number + 1,
                ..c
            })
        };
        (with(positive), with(negative))
    }

    /// Returns the parts on both sides of a line's hyperplane, which becomes half-space `number`.
    fn cut(self, line: &Vector, number: usize) -> (Option<Self>, Option<Self>) {
        let sides: Vec<Ordering> = self.rays.iter().map(|r| r.vector.side(line)).collect();
        if !sides.contains(&Ordering::Less) {
            // All rays are inside. The rays on the hyperplane become tight there.
            let mut all = self;
            all.rays
                .iter_mut()
                .zip(&sides)
                .filter(|(_, s)| **s == Ordering::Equal)
                .for_each(|(r, _)| insert(&mut r.tight, number));
            return (Some(all), None);
        }
        if !sides.contains(&Ordering::Greater) {
            return (None, Some(self));
        }
        let on_edges = self.crossed(line, &sides, number);
        let (mut inside, mut outside) = (Vec::new(), Vec::new());
        for (mut ray, side) in self.rays.into_iter().zip(sides) {
            match side {
                Ordering::Greater => inside.push(ray),
                Ordering::Less => outside.push(ray),
                Ordering::Equal => {
                    insert(&mut ray.tight, number);
                    inside.push(ray.clone());
                    outside.push(ray);
                }
            }
        }
        inside.extend(on_edges.iter().cloned());
        outside.extend(on_edges);
        let cone = |rays| {
            Some(Self {
                rays,
                halves: self.halves,
            })
        };
        (cone(inside), cone(outside))
    }

    /// Computes the rays in which a polar hyperplane crosses the edges between rays on different sides of the
    /// hyperplane.
    fn crossed(&self, line: &Vector, sides: &[Ordering], number: usize) -> Vec<Ray> {
        let rays_on = |which: Ordering| {
            (0..sides.len())
                .filter(|i| sides[*i] == which)
                .collect::<Vec<_>>()
        };
        let (above, below) = (rays_on(Ordering::Greater), rays_on(Ordering::Less));
        let values = vec![OnceCell::new(); sides.len()];
        let value =
            |k: usize| values[k].get_or_init(|| klein(self.rays[k].vector.line(), line.line()));
        let mut out = Vec::new();
        for p in above {
            for n in &below {
                let (s, t) = (&self.rays[p].tight, &self.rays[*n].tight);
                // An edge connects two rays if they are tight at four or more common half-spaces, and no
                // third ray is tight at all of these.
                if s.iter()
                    .zip(t)
                    .map(|(a, b)| (a & b).count_ones())
                    .sum::<u32>()
                    < 4
                    || (0..sides.len())
                        .any(|k| k != p && k != *n && holds(&self.rays[k].tight, s, t))
                {
                    continue;
                }
                let (u, v) = (self.rays[p].vector.line(), self.rays[*n].vector.line());
                // The ray is |value(v)|·u + |value(u)|·v.
                let (x, y) = (value(p), value(*n));
                let ray = reduced(std::array::from_fn(|i| &v[i] * x - &u[i] * y));
                let mut tight = s.iter().zip(t).map(|(a, b)| a & b).collect();
                insert(&mut tight, number);
                out.push(Ray {
                    vector: Vector::new(ray),
                    tight,
                });
            }
        }
        out
    }

    /// Returns true if all rays are on the side `side` of a polar hyperplane, or on the hyperplane.
    pub fn within(&self, line: &Vector, side: Ordering) -> bool {
        self.rays
            .iter()
            .all(|r| r.vector.side(line) != side.reverse())
    }

    /// Returns true if the Klein form is never negative, or never positive, on pairs of rays.
    pub fn unreal(&self) -> bool {
        let mut seen = Ordering::Equal;
        for (i, u) in self.rays.iter().enumerate() {
            for v in &self.rays[i..] {
                match (u.vector.side(&v.vector), seen) {
                    (Ordering::Equal, _) => {}
                    (s, Ordering::Equal) => seen = s,
                    (s, before) if s != before => return false,
                    _ => {}
                }
            }
        }
        true
    }
}

/// Returns the indices of six linearly independent vectors, found by elimination, or `None` if the vectors
/// span fewer dimensions.
fn independent(vectors: &[Line]) -> Option<[usize; 6]> {
    let mut rows: Vec<(Line, usize)> = Vec::new();
    let mut found = Vec::new();
    for (number, v) in vectors.iter().enumerate() {
        let mut v = v.clone();
        for (row, pivot) in &rows {
            if !v[*pivot].is_zero() {
                let (a, b) = (row[*pivot].clone(), v[*pivot].clone());
                v = reduced(std::array::from_fn(|i| &v[i] * &a - &row[i] * &b));
            }
        }
        if let Some(pivot) = v.iter().position(|c| !c.is_zero()) {
            rows.push((v, pivot));
            found.push(number);
            if let Ok(six) = <[usize; 6]>::try_from(found.clone()) {
                return Some(six);
            }
        }
    }
    None
}

/// Returns a vector orthogonal to five independent vectors: the signed minors of their matrix.
fn normal(rows: [&Line; 5]) -> Line {
    reduced(std::array::from_fn(|skip| {
        let columns: Vec<usize> = (0..6).filter(|c| *c != skip).collect();
        let m: Vec<Vec<IBig>> = rows
            .iter()
            .map(|r| columns.iter().map(|c| r[*c].clone()).collect())
            .collect();
        let d = determinant(m);
        if skip % 2 == 0 { d } else { -d }
    }))
}

/// Computes the determinant by Bareiss's elimination, in which every division is exact.
fn determinant(mut m: Vec<Vec<IBig>>) -> IBig {
    let n = m.len();
    let mut previous = IBig::ONE;
    let mut negative = false;
    for k in 0..n - 1 {
        let Some(pivot) = (k..n).find(|i| !m[*i][k].is_zero()) else {
            return IBig::ZERO;
        };
        if pivot != k {
            m.swap(pivot, k);
            negative = !negative;
        }
        for i in k + 1..n {
            for j in k + 1..n {
                m[i][j] = (&m[i][j] * &m[k][k] - &m[i][k] * &m[k][j]) / &previous;
            }
        }
        previous = m[k][k].clone();
    }
    let d = m[n - 1][n - 1].clone();
    if negative { -d } else { d }
}
