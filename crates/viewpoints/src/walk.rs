//! The parts that a segment crosses, each with the midpoint of the segment's section in the part (Amanatides
//! and Woo 1987).

use crate::PartPlanes;

/// Minimum length of a segment's section in a part that [`walk`] reports, as a fraction of the part's
/// smallest side.
const LEAST: f64 = 1.0 / 256.0;

/// Calls `each` with every part that a ray crosses, and a point of the ray in this part. Skips parts in which
/// the section of the ray is shorter than 1/256 of the smallest side of the part.
///
/// The ray starts at `origin`, has the direction `direction`, and ends at the distance `end`, in multiples of
/// the length of `direction`.
pub fn walk(
    parts: &PartPlanes,
    origin: [f32; 3],
    direction: [f32; 3],
    end: f64,
    mut each: impl FnMut([u32; 3], [f32; 3]),
) {
    let Some(mut part) = parts.of_point(origin) else {
        return;
    };
    let (o, d) = (origin.map(f64::from), direction.map(f64::from));
    let sides = parts.sides();
    let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut from = 0.0f64;
    loop {
        let bounds = parts.bounds(part);
        let size = f64::from((bounds.max - bounds.min).min_element());
        let leaves = |a: usize| match d[a] {
            0.0 => f64::INFINITY,
            x if x > 0.0 => (f64::from(bounds.max[a]) - o[a]) / x,
            x => (f64::from(bounds.min[a]) - o[a]) / x,
        };
        let axis = (1..3).fold(0, |best, a| if leaves(a) < leaves(best) { a } else { best });
        let to = leaves(axis).min(end);
        if (to - from) * length >= size * LEAST {
            let middle = 0.5 * (from + to);
            each(part, [0, 1, 2].map(|a| (o[a] + d[a] * middle) as f32));
        }
        if leaves(axis) >= end {
            return;
        }
        from = to.max(from);
        part[axis] = if d[axis] > 0.0 {
            part[axis] + 1
        } else {
            part[axis].wrapping_sub(1)
        };
        if part[axis] >= sides[axis] {
            return;
        }
    }
}
