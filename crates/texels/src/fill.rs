//! The filling of texels without values: ring by ring from neighbouring texels, then from increasingly coarse
//! images.
//!
//! Texels whose surface is inside closed solids are filled in the same way. So dark values from inside a
//! solid do not show at the foot of a wall.

use crate::image::{TexelImage, TexelState};

/// Fills `count` rings of texels around the texels that have values.
pub(crate) fn rings(image: &mut TexelImage, count: usize) {
    let [width, height] = image.size;
    let known = |s: TexelState| matches!(s, TexelState::Own | TexelState::Filled);
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
        // Compute a whole ring from the values that existed before the ring.
        let values: Vec<f64> = front
            .iter()
            .map(|at| {
                let (mut sum, mut weight) = (0.0, 0.0);
                for n in around(*at).filter(|n| known(image.states[*n])) {
                    // Diagonal neighbours have half the weight.
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
            image.states[*at] = TexelState::Filled;
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

/// A coarse image: its width and height, and for each of its cells the sum and the number of known values.
type FillLevel = ([usize; 2], Vec<(f64, f64)>);

/// Fills all remaining texels. Each texel gets the mean of the known values in a square around the texel: the
/// smallest square of a coarse image, 2, 4, 8 … texels wide, that contains a known value. If no texel has a
/// value, all texels become 1.
pub(crate) fn rest(image: &mut TexelImage) {
    let known = |s: TexelState| matches!(s, TexelState::Own | TexelState::Filled);
    // The coarse images. Each has half the width and height of the previous image.
    let first = image.values.iter().zip(&image.states);
    let first = first
        .map(|(v, s)| if known(*s) { (*v, 1.0) } else { (0.0, 0.0) })
        .collect();
    let mut levels: Vec<FillLevel> = vec![(image.size, first)];
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
        image.states[at] = TexelState::Filled;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_grow_from_known_texels() {
        let mut image = TexelImage::from_samples(
            [9, 9],
            [(40, 1.0, 0.25, false), (41, 1.0, 0.0, true)].into_iter(),
        );
        assert_eq!(
            (
                image.count(TexelState::Own),
                image.count(TexelState::Inside)
            ),
            (1, 1)
        );
        rings(&mut image, 2);
        assert_eq!(
            (
                image.count(TexelState::Own),
                image.count(TexelState::Filled)
            ),
            (1, 24)
        );
        assert!(
            image
                .values
                .iter()
                .zip(&image.states)
                .all(|(v, s)| *s == TexelState::Empty || *v == 0.25)
        );
        rest(&mut image);
        assert!(image.values.iter().all(|v| *v == 0.25));
        let mut nothing = TexelImage::from_samples([3, 2], std::iter::empty());
        rings(&mut nothing, 4);
        rest(&mut nothing);
        assert_eq!(nothing.values, [1.0; 6]);
    }
}
