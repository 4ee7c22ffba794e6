//! Values for texels that have none: from their neighbours ring by ring, then from ever coarser images.
//!
//! Texels whose part of the surface is inside of closed solids are filled in the same way, so that no
//! darkness of an inside comes through at the foot of a wall.

use crate::image::{Image, State};

/// Fills as many rings of texels around those that have values.
pub(crate) fn rings(image: &mut Image, count: usize) {
    let [width, height] = image.size;
    let known = |s: State| matches!(s, State::Own | State::Filled);
    let around = |at: usize| {
        let (x, y) = (at % width, at / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.flat_map(move |y| {
            (x.saturating_sub(1)..(x + 2).min(width)).map(move |x| y * width + x)
        })
    };
    let mut front: Vec<usize> = (0..image.states.len())
        .filter(|at| !known(image.states[*at]) && around(*at).any(|n| known(image.states[n])))
        .collect();
    for _ in 0..count {
        // All of a ring from what was known before it.
        let values: Vec<f64> = front
            .iter()
            .map(|at| {
                let (mut sum, mut weight) = (0.0, 0.0);
                for n in around(*at).filter(|n| known(image.states[*n])) {
                    // Neighbours across a corner count for less.
                    let w = if n % width == at % width || n / width == at / width {
                        1.0
                    } else {
                        0.5
                    };
                    sum += w * image.values[n];
                    weight += w;
                }
                sum / weight
            })
            .collect();
        for (at, value) in front.iter().zip(values) {
            image.values[*at] = value;
            image.states[*at] = State::Filled;
        }
        let mut next: Vec<usize> = front
            .iter()
            .flat_map(|at| around(*at))
            .filter(|n| !known(image.states[*n]))
            .collect();
        next.sort_unstable();
        next.dedup();
        front = next;
    }
}

/// A size, and for each cell the sum of values and their number.
type Level = ([usize; 2], Vec<(f64, f64)>);

/// Fills all that is left: each texel takes the mean of the smallest square around it, of a power of two,
/// that has values. Without any value all become 1.
pub(crate) fn rest(image: &mut Image) {
    let known = |s: State| matches!(s, State::Own | State::Filled);
    // Sums and numbers of values; each level has half the side of the one before.
    let first = image.values.iter().zip(&image.states);
    let first = first
        .map(|(v, s)| if known(*s) { (*v, 1.0) } else { (0.0, 0.0) })
        .collect();
    let mut levels: Vec<Level> = vec![(image.size, first)];
    while let Some((size, below)) = levels.last().filter(|(size, _)| size[0] > 1 || size[1] > 1) {
        let half = size.map(|n| n.div_ceil(2));
        let mut level = vec![(0.0, 0.0); half[0] * half[1]];
        for (at, (sum, count)) in below.iter().enumerate() {
            let cell = &mut level[at / size[0] / 2 * half[0] + at % size[0] / 2];
            *cell = (cell.0 + sum, cell.1 + count);
        }
        levels.push((half, level));
    }
    for at in 0..image.values.len() {
        if known(image.states[at]) {
            continue;
        }
        let (x, y) = (at % image.size[0], at / image.size[0]);
        let means = levels
            .iter()
            .enumerate()
            .map(|(k, (size, cells))| cells[(y >> k) * size[0] + (x >> k)]);
        image.values[at] = means
            .into_iter()
            .find(|c| c.1 > 0.0)
            .map_or(1.0, |c| c.0 / c.1);
        image.states[at] = State::Filled;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_grow_from_what_is_known() {
        let mut image = Image::of(
            [9, 9],
            [(40, 1.0, 0.25, false), (41, 1.0, 0.0, true)].into_iter(),
        );
        assert_eq!(
            (image.count(State::Own), image.count(State::Inside)),
            (1, 1)
        );
        rings(&mut image, 2);
        assert_eq!(
            (image.count(State::Own), image.count(State::Filled)),
            (1, 24)
        );
        assert!(
            image
                .values
                .iter()
                .zip(&image.states)
                .all(|(v, s)| *s == State::Empty || *v == 0.25)
        );
        rest(&mut image);
        assert!(image.values.iter().all(|v| *v == 0.25));
        let mut nothing = Image::of([3, 2], std::iter::empty());
        rings(&mut nothing, 4);
        rest(&mut nothing);
        assert_eq!(nothing.values, [1.0; 6]);
    }
}
