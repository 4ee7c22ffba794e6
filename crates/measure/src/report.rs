//! What was measured, as it is printed.

use std::path::PathBuf;

/// The measures over all frames. A frame is one visibility cube of 6·resolution² pixels; errors and region
/// sizes are fractions of that.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Report {
    /// Number of frames (viewpoints).
    pub frames: u64,
    /// Side of a cube's face in pixels.
    pub resolution: u32,
    /// Mean over the frames of the fraction of wrong pixels.
    pub mean_error: f64,
    /// 99th percentile by nearest rank: the ⌈0.99·frames⌉-th smallest error.
    pub p99_error: f64,
    /// The error of the worst frame.
    pub max_error: f64,
    /// Mean over all frames of the number of connected wrong regions (a count).
    pub mean_regions: f64,
    /// Mean of the largest region's size over the frames that have an error, as in the paper; 0 when none
    /// has.
    pub mean_max_region: f64,
    /// The largest region of all frames.
    pub max_region: f64,
    /// Number of frames with a wrong pixel.
    pub frames_with_error: u64,
    /// Number of view cells with a viewpoint in them.
    pub cells_visited: u64,
    /// Number of different triangles seen in any frame.
    pub triangles_seen: u64,
    /// The frames with the greatest errors, worst first; of equal ones the earlier first.
    pub worst: Vec<Frame>,
    /// How long errors last; on a camera path only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path: Option<PathReport>,
}

/// One frame.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Frame {
    /// Its index, from 0.
    pub frame: u64,
    /// Where it was seen from, world space.
    pub viewpoint: [f32; 3],
    /// The view cell that lies in.
    pub cell: u32,
    /// Fraction of wrong pixels.
    pub error: f64,
    /// Number of connected wrong regions.
    pub regions: u32,
    /// Size of the largest of them.
    pub max_region: f64,
    /// Number of different wrong triangles.
    pub wrong_triangles: u64,
    /// Its image, where one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<PathBuf>,
}

/// How long errors last on a camera path. One error is one triangle, wrong in consecutive frames.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PathReport {
    /// Number of such errors.
    pub errors: u64,
    /// Mean number of consecutive frames an error lasts; 0 when there is none.
    pub mean_frames: f64,
    /// The greatest number of consecutive frames.
    pub max_frames: u64,
}

/// Follows wrong triangles from frame to frame.
#[derive(Default)]
pub(crate) struct Durations {
    /// Triangles wrong in the last frame, ascending, with the number of frames they have been so.
    lasting: Vec<(u32, u64)>,
    errors: u64,
    frames: u64,
    longest: u64,
}

impl Durations {
    /// Takes the next frame's wrong triangles, ascending.
    pub fn push(&mut self, wrong: &[u32]) {
        let before = std::mem::take(&mut self.lasting);
        let mut before = before.into_iter().peekable();
        for &id in wrong {
            while before.next_if(|b| b.0 < id).is_some() {}
            let frames = before.next_if(|b| b.0 == id).map_or(0, |b| b.1) + 1;
            self.errors += u64::from(frames == 1);
            self.frames += 1;
            self.longest = self.longest.max(frames);
            self.lasting.push((id, frames));
        }
    }

    pub fn report(&self) -> PathReport {
        let mean_frames = if self.errors == 0 {
            0.0
        } else {
            self.frames as f64 / self.errors as f64
        };
        PathReport {
            errors: self.errors,
            mean_frames,
            max_frames: self.longest,
        }
    }
}

/// The nearest-rank percentile of ascending values, `percent` in 1…100; `None` when there are none.
pub(crate) fn nearest_rank<T: Copy>(ascending: &[T], percent: u64) -> Option<T> {
    let rank = (ascending.len() as u64 * percent).div_ceil(100);
    ascending
        .get(usize::try_from(rank).ok()?.checked_sub(1)?)
        .copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_rank_is_a_value_that_occurs() {
        let hundred: Vec<u64> = (1..=100).collect();
        assert_eq!(nearest_rank(&hundred, 99), Some(99));
        assert_eq!(nearest_rank(&hundred, 100), Some(100));
        assert_eq!(nearest_rank(&[3, 8], 99), Some(8));
        assert_eq!(nearest_rank(&[3, 8], 50), Some(3));
        assert_eq!(nearest_rank::<u64>(&[], 99), None);
    }

    #[test]
    fn durations_count_consecutive_frames() {
        let mut d = Durations::default();
        for wrong in [&[1, 5][..], &[5, 9], &[5], &[], &[1, 5]] {
            d.push(wrong);
        }
        // 1 for one frame, 5 for three, 9 for one, then 1 and 5 for one frame each.
        assert_eq!(
            d.report(),
            PathReport {
                errors: 5,
                mean_frames: 7.0 / 5.0,
                max_frames: 3
            }
        );
        assert_eq!(
            Durations::default().report(),
            PathReport {
                errors: 0,
                mean_frames: 0.0,
                max_frames: 0
            }
        );
    }
}
