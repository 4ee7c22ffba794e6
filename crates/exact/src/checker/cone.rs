//! Cones in six dimensions by the double description method, in integers.

use std::cmp::Ordering;

use dashu_int::IBig;

use super::line::{Line, klein, reduced, sign};

/// A pointed cone of full dimension by its extreme rays, and for each the half-spaces it lies on the border of.
#[derive(Clone)]
pub struct Cone {
    rays: Vec<(Line, Vec<u64>)>,
    /// How many half-spaces there are.
    halves: usize,
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

fn common(a: &[u64], b: &[u64]) -> Vec<u64> {
    a.iter().zip(b).map(|(x, y)| x & y).collect()
}

/// Whether every bit of `part` is in `whole`.
fn holds(whole: &[u64], part: &[u64]) -> bool {
    part.iter().enumerate().all(|(i, w)| w & !whole.get(i).copied().unwrap_or(0) == 0)
}

fn dot(a: &Line, b: &Line) -> IBig {
    (0..6).map(|i| &a[i] * &b[i]).sum()
}

impl Cone {
    /// The cone of the given vectors (none of them 0), which span all six dimensions and are all on one side of some
    /// hyperplane. None if they do not.
    pub fn of(vectors: Vec<Line>) -> Option<Self> {
        // The dual cone {f : f·v ≥ 0 for all v} has one ray for every facet. It starts with six independent vectors.
        let basis = independent(&vectors)?;
        let rows: [&Line; 6] = std::array::from_fn(|k| &vectors[basis[k]]);
        let mut dual = Self { rays: Vec::new(), halves: vectors.len() };
        for k in 0..6 {
            let mut f = normal(std::array::from_fn(|i| rows[if i < k { i } else { i + 1 }]));
            if sign(&dot(&f, rows[k])) == Ordering::Less {
                f.iter_mut().for_each(|c| *c = -std::mem::take(c));
            }
            let mut tight = Vec::new();
            basis.iter().enumerate().filter(|(i, _)| *i != k).for_each(|(_, b)| insert(&mut tight, *b));
            dual.rays.push((f, tight));
        }
        for (number, v) in vectors.iter().enumerate().filter(|(n, _)| !basis.contains(n)) {
            dual = dual.cut(&|f| dot(f, v), number).0?;
        }
        // Facets are the dual's rays; a vector is on those facets whose functional vanishes on it.
        let facets = dual.rays.len();
        let on = |number: usize| {
            let mut set = Vec::new();
            dual.rays
                .iter()
                .enumerate()
                .filter(|(_, (_, t))| has(t, number))
                .for_each(|(f, _)| insert(&mut set, f));
            set
        };
        let sets: Vec<Vec<u64>> = (0..vectors.len()).map(on).collect();
        // A vector that is not extreme is on fewer facets than some extreme one; of parallel ones the first is kept.
        let extreme = |i: usize| {
            (0..sets.len())
                .all(|j| i == j || !holds(&sets[j], &sets[i]) || (holds(&sets[i], &sets[j]) && i < j))
        };
        let rays = (0..sets.len())
            .filter(|i| extreme(*i))
            .map(|i| (reduced(vectors[i].clone()), sets[i].clone()))
            .collect();
        Some(Self { rays, halves: facets })
    }

    /// The parts inside and outside a line's hyperplane; none for a part of lower dimension.
    pub fn split(self, line: &Line) -> (Option<Self>, Option<Self>) {
        let number = self.halves;
        let (inside, outside) = self.cut(&|v| klein(v, line), number);
        let with = |c: Option<Self>| c.map(|c| Self { halves: number + 1, ..c });
        (with(inside), with(outside))
    }

    /// Both sides of a hyperplane given by a functional on rays, as half-space `number`.
    fn cut(self, value: &dyn Fn(&Line) -> IBig, number: usize) -> (Option<Self>, Option<Self>) {
        let sides: Vec<Ordering> = self.rays.iter().map(|(r, _)| sign(&value(r))).collect();
        if !sides.contains(&Ordering::Less) {
            // All inside; the rays on the hyperplane are tight there, too.
            let mut all = self;
            all.rays
                .iter_mut()
                .zip(&sides)
                .filter(|(_, s)| **s == Ordering::Equal)
                .for_each(|((_, t), _)| insert(t, number));
            return (Some(all), None);
        }
        if !sides.contains(&Ordering::Greater) {
            return (None, Some(self));
        }
        let keep = |which: Ordering| -> Vec<(Line, Vec<u64>)> {
            let kept = self.rays.iter().zip(&sides).filter(|(_, s)| **s == which || **s == Ordering::Equal);
            kept.map(|((r, t), s)| {
                let mut t = t.clone();
                if *s == Ordering::Equal {
                    insert(&mut t, number);
                }
                (r.clone(), t)
            })
            .collect()
        };
        let (mut inside, mut outside) = (keep(Ordering::Greater), keep(Ordering::Less));
        let of = |which: Ordering| (0..sides.len()).filter(|i| sides[*i] == which).collect::<Vec<_>>();
        for p in of(Ordering::Greater) {
            for n in of(Ordering::Less) {
                let ((u, s), (v, t)) = (&self.rays[p], &self.rays[n]);
                let both = common(s, t);
                if both.iter().map(|w| w.count_ones()).sum::<u32>() < 4 {
                    continue;
                }
                if (0..sides.len()).any(|k| k != p && k != n && holds(&self.rays[k].1, &both)) {
                    continue;
                }
                // Where the edge meets the hyperplane: |value(v)| of u and |value(u)| of v.
                let (x, y) = (value(u), -value(v));
                let ray = reduced(std::array::from_fn(|i| &v[i] * &x + &u[i] * &y));
                let mut tight = both;
                insert(&mut tight, number);
                inside.push((ray.clone(), tight.clone()));
                outside.push((ray, tight));
            }
        }
        let cone = |rays| Some(Self { rays, halves: self.halves });
        (cone(inside), cone(outside))
    }

    /// Whether all of it is on the positive side of a line's hyperplane, or on it.
    pub fn within(&self, line: &Line) -> bool {
        self.rays.iter().all(|(r, _)| sign(&klein(r, line)) != Ordering::Less)
    }

    /// Whether the Klein form has one sign, or 0, on all pairs of rays.
    pub fn unreal(&self) -> bool {
        let mut seen = Ordering::Equal;
        for (i, (u, _)) in self.rays.iter().enumerate() {
            for (v, _) in &self.rays[i..] {
                match (sign(&klein(u, v)), seen) {
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

/// Indices of six independent vectors, by elimination.
fn independent(vectors: &[Line]) -> Option<[usize; 6]> {
    let mut rows: Vec<(Line, usize)> = Vec::new();
    let mut found = Vec::new();
    for (number, v) in vectors.iter().enumerate() {
        let mut v = reduced(v.clone());
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

/// A vector orthogonal to five independent ones: the signed minors of their matrix.
fn normal(rows: [&Line; 5]) -> Line {
    reduced(std::array::from_fn(|skip| {
        let columns: Vec<usize> = (0..6).filter(|c| *c != skip).collect();
        let m: Vec<Vec<IBig>> =
            rows.iter().map(|r| columns.iter().map(|c| r[*c].clone()).collect()).collect();
        let d = determinant(m);
        if skip % 2 == 0 { d } else { -d }
    }))
}

/// Bareiss's elimination, in which every division is exact.
fn determinant(mut m: Vec<Vec<IBig>>) -> IBig {
    let n = m.len();
    let mut previous = IBig::ONE;
    let mut negative = false;
    for k in 0..n - 1 {
        let Some(pivot) = (k..n).find(|i| !m[*i][k].is_zero()) else { return IBig::ZERO };
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
