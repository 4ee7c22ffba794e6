//! The reduction of a cube image to a sample, with one pass over its pixels and dense scratch memory.
//!
//! The result equals the result of [`crate::cube::sample_of_image`], which sorts every run of pixels. This
//! reduction sorts only the ids that were seen.

use sightline_model::VisibilitySample;

use crate::cube::{CubeImage, SKY, Strata};

/// Scratch memory for scenes of a given size: eight bytes per triangle.
pub struct Reducer {
    masks: Vec<u32>,
    counts: Vec<u32>,
    seen: Vec<u32>,
}

impl Reducer {
    /// Creates scratch memory for ids below `triangles`.
    pub fn new(triangles: usize) -> Self {
        Self {
            masks: vec![0; triangles],
            counts: vec![0; triangles],
            seen: Vec::new(),
        }
    }

    /// Reduces `image`, whose ids must be below the size given to [`Reducer::new`]. The sample contains no
    /// pixels.
    pub fn reduce(&mut self, image: &CubeImage, strata: Strata) -> VisibilitySample {
        let n = image.resolution;
        for (row, pixels) in image.ids.chunks_exact(n as usize).enumerate() {
            let (face, y) = (row as u32 / n, row as u32 % n);
            let mut x = 0;
            for same in pixels.chunk_by(|a, b| a == b) {
                let (id, len) = (same[0], same.len() as u32);
                if id != SKY {
                    // A run may cross from the left half of a face to the right half.
                    let first = strata.of_pixel(face, x, y, n);
                    let last = strata.of_pixel(face, x + len - 1, y, n);
                    let mask = &mut self.masks[id as usize];
                    if *mask == 0 {
                        self.seen.push(id);
                    }
                    *mask |= 1 << first | 1 << last;
                    self.counts[id as usize] += len;
                }
                x += len;
            }
        }
        self.seen.sort_unstable();
        let mut sample = VisibilitySample {
            ids: Vec::with_capacity(self.seen.len()),
            strata: Vec::with_capacity(self.seen.len()),
            ..VisibilitySample::default()
        };
        let mut best = 0;
        for id in self.seen.drain(..) {
            sample.ids.push(id);
            sample
                .strata
                .push(std::mem::take(&mut self.masks[id as usize]));
            let count = std::mem::take(&mut self.counts[id as usize]);
            if count > best {
                best = count;
                sample.dominant = Some(id);
            }
        }
        sample
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn dense_reduction_equals_sorted_reduction(
            ids in proptest::collection::vec(prop_oneof![Just(SKY), 0u32..9], 6 * 5 * 5),
            twice in any::<bool>(),
        ) {
            let image = CubeImage { resolution: 5, ids };
            let mut reducer = Reducer::new(9);
            for strata in [Strata::One, Strata::Faces, Strata::Quadrants] {
                if twice { reducer.reduce(&image, strata); }
                let expected = crate::cube::sample_of_image(&image, strata, false);
                prop_assert_eq!(reducer.reduce(&image, strata), expected);
            }
        }
    }
}
