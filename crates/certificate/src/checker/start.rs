//! The region of line space between two polygons, as one or two pointed cones.

use std::cmp::Ordering;

use dashu_int::IBig;

use super::cone::Cone;
use super::geometry::{Line, height, join, klein, meet, sign};
use super::polygon::Side;

/// Returns the cones that together contain all lines from A to B. The entry of a cone without interior, or of
/// a cone that is not pointed, is `None`.
pub(super) fn start(a: &Side, b: &Side) -> Vec<Option<Cone>> {
    let mut lines = Vec::new();
    let mut along = Vec::new();
    let mut across = None;
    for p in &a.corners {
        for q in &b.corners {
            let line = join(p, q);
            let on = [height(&b.plane, p).is_zero(), height(&a.plane, q).is_zero()];
            if line.iter().all(IBig::is_zero) {
                continue;
            }
            if on == [true, true] {
                along.push(line.clone());
            } else if on == [false, false] && across.is_none() {
                across = Some(line.clone());
            }
            lines.push(line);
        }
    }
    let k = meet(&a.plane, &b.plane);
    // A line along k is a multiple of k, so the sign of any product of components that is not 0 determines
    // its direction.
    let way = |l: &Line| {
        l.iter()
            .zip(&k)
            .map(|(x, y)| sign(&(x * y)))
            .find(|s| *s != Ordering::Equal)
    };
    let both = along.iter().any(|l| way(l) == Some(Ordering::Greater))
        && along.iter().any(|l| way(l) == Some(Ordering::Less));
    match (both, across) {
        (true, Some(across)) => {
            let at_k = klein(&k, &across);
            // The vector v·f(k) − f(v)·k lies on the hyperplane f = 0. Choose its sign so that v has a
            // positive factor.
            let base: Vec<Line> = lines
                .iter()
                .map(|v| {
                    let at_v = klein(v, &across);
                    let flip = sign(&at_k) == Ordering::Less;
                    std::array::from_fn(|i| {
                        let x = &v[i] * &at_k - &k[i] * &at_v;
                        if flip { -x } else { x }
                    })
                })
                .filter(|v: &Line| !v.iter().all(IBig::is_zero))
                .collect();
            [k.clone(), k.map(|c| -c)]
                .into_iter()
                .map(|end| {
                    let mut rays = base.clone();
                    rays.push(end);
                    Cone::new(rays)
                })
                .collect()
        }
        _ => vec![Cone::new(lines)],
    }
}
