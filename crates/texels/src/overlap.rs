//! A test for overlapping triangles in the plane of texture coordinates.
//!
//! Triangles may touch, and may overlap by less than [`SLACK`] in some direction because of rounding.

/// Maximum allowed overlap, in texture coordinates: a sixteenth of a texel in an image 4096 texels wide.
pub(crate) const SLACK: f64 = 1.0 / 65536.0;

/// The corners of a triangle in texture coordinates.
pub(crate) type FlatTriangle = [[f64; 2]; 3];

/// Maximum number of triangles that are compared pairwise without a further division.
const FEW: usize = 24;
/// Maximum number of successive divisions of the triangles.
const DEEPEST: u32 = 40;

/// Finds two triangles that overlap, and returns their indices. `counts` returns true for the pairs of
/// indices to consider. If several such pairs exist, the choice depends only on the triangles.
pub(crate) fn overlap(
    triangles: &[FlatTriangle],
    counts: &dyn Fn(usize, usize) -> bool,
) -> Option<(usize, usize)> {
    // Triangles thinner than the slack cannot overlap by more than the slack.
    let all: Vec<usize> = (0..triangles.len())
        .filter(|i| !thin(&triangles[*i]))
        .collect();
    let mut open = vec![(all, 0)];
    while let Some((part, depth)) = open.pop() {
        if part.len() > FEW
            && depth < DEEPEST
            && let Some([low, high]) = divide(triangles, &part)
        {
            open.push((high, depth + 1));
            open.push((low, depth + 1));
            continue;
        }
        for (k, a) in part.iter().enumerate() {
            for b in &part[k + 1..] {
                if overlaps(&triangles[*a], &triangles[*b]) && counts(*a, *b) {
                    return Some(((*a).min(*b), (*a).max(*b)));
                }
            }
        }
    }
    None
}

/// Returns the minimum and maximum coordinate of a triangle on an axis.
fn extent(t: &FlatTriangle, axis: usize) -> [f64; 2] {
    let [a, b, c] = [0, 1, 2].map(|k| t[k][axis]);
    [a.min(b).min(c), a.max(b).max(c)]
}

/// Returns true if a triangle is too thin to overlap another triangle by more than the slack.
fn thin(t: &FlatTriangle) -> bool {
    !(0..2).all(|axis| {
        let [low, high] = extent(t, axis);
        high - low > SLACK
    })
}

/// Divides the triangles with the indices `part` at an axis-parallel line. Returns the indices on the lower
/// and on the higher side; triangles that cross the line are in both lists. Returns `None` if a list would
/// have more than 7/8 of the triangles.
fn divide(triangles: &[FlatTriangle], part: &[usize]) -> Option<[Vec<usize>; 2]> {
    let spread = |axis: usize| {
        let mut middles: Vec<f64> = part
            .iter()
            .map(|i| extent(&triangles[*i], axis).iter().sum::<f64>() / 2.0)
            .collect();
        middles.sort_unstable_by(f64::total_cmp);
        (
            middles[middles.len() - 1] - middles[0],
            middles[middles.len() / 2],
        )
    };
    let (across, down) = (spread(0), spread(1));
    let try_axis = |axis: usize, at: f64| {
        let low: Vec<usize> = part
            .iter()
            .copied()
            .filter(|i| extent(&triangles[*i], axis)[0] < at)
            .collect();
        let high: Vec<usize> = part
            .iter()
            .copied()
            .filter(|i| extent(&triangles[*i], axis)[1] > at)
            .collect();
        let most = low.len().max(high.len());
        (most * 8 <= part.len() * 7).then_some([low, high])
    };
    let order = if across.0 >= down.0 {
        [(0, across.1), (1, down.1)]
    } else {
        [(1, down.1), (0, across.1)]
    };
    order.into_iter().find_map(|(axis, at)| try_axis(axis, at))
}

/// Returns true if two triangles overlap by more than the slack on every axis and across every edge, by the
/// separating axis theorem.
fn overlaps(a: &FlatTriangle, b: &FlatTriangle) -> bool {
    for axis in 0..2 {
        let (a, b) = (extent(a, axis), extent(b, axis));
        if a[1].min(b[1]) - a[0].max(b[0]) <= SLACK {
            return false;
        }
    }
    for triangle in [a, b] {
        for k in 0..3 {
            let (p, q) = (triangle[k], triangle[(k + 1) % 3]);
            let normal = [p[1] - q[1], q[0] - p[0]];
            let length = (normal[0] * normal[0] + normal[1] * normal[1]).sqrt();
            if length == 0.0 {
                continue;
            }
            let range = |t: &FlatTriangle| {
                let [x, y, z] = t.map(|c| (c[0] * normal[0] + c[1] * normal[1]) / length);
                [x.min(y).min(z), x.max(y).max(z)]
            };
            let (a, b) = (range(a), range(b));
            if a[1].min(b[1]) - a[0].max(b[0]) <= SLACK {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: usize) -> Vec<FlatTriangle> {
        let at = |i: usize| i as f64 / n as f64;
        let square = |i: usize, j: usize| {
            let [a, b, c, d] = [
                [at(i), at(j)],
                [at(i + 1), at(j)],
                [at(i + 1), at(j + 1)],
                [at(i), at(j + 1)],
            ];
            [[a, b, c], [a, c, d]]
        };
        (0..n * n).flat_map(|k| square(k % n, k / n)).collect()
    }

    #[test]
    fn touching_triangles_do_not_overlap() {
        assert_eq!(overlap(&grid(40), &|_, _| true), None);
        // A fan, whose triangles all meet in one point.
        let rim = |k: usize| {
            let angle = k as f64 * std::f64::consts::TAU / 300.0;
            [0.5 + 0.4 * angle.cos(), 0.5 + 0.4 * angle.sin()]
        };
        let fan: Vec<FlatTriangle> = (0..300).map(|k| [[0.5, 0.5], rim(k), rim(k + 1)]).collect();
        assert_eq!(overlap(&fan, &|_, _| true), None);
    }

    #[test]
    fn overlapping_triangles_are_found_among_many() {
        let mut all = grid(40);
        all.push([[0.501, 0.501], [0.505, 0.501], [0.501, 0.505]]);
        let (a, b) = overlap(&all, &|_, _| true).unwrap();
        assert_eq!((a / 2, b), (20 * 40 + 20, 3200));
        assert_eq!(overlap(&all, &|_, b| b != 3200), None);
        // The same triangle twice, also with the opposite winding.
        let t = [[0.1, 0.1], [0.2, 0.1], [0.1, 0.2]];
        assert_eq!(
            overlap(&[t, [t[0], t[2], t[1]]], &|_, _| true),
            Some((0, 1))
        );
        // Crossing triangles without any corner inside the other triangle.
        let (flat, high) = (
            [[0.0, 0.4], [1.0, 0.4], [1.0, 0.6]],
            [[0.4, 0.0], [0.6, 1.0], [0.4, 1.0]],
        );
        assert_eq!(overlap(&[flat, high], &|_, _| true), Some((0, 1)));
    }
}
