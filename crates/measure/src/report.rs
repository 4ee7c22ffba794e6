//! The results of a measurement, in their printed form.

use std::path::PathBuf;

use sightline_numbers::ids::CellIndex;

/// The measures over all frames. A frame is one visibility cube of 6·resolution² pixels. Errors and region
/// sizes are fractions of this number.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Report {
    /// The number of frames (viewpoints).
    pub frames: u64,
    /// The side of a cube's face in pixels.
    pub resolution: u32,
    /// The mean over the frames of the fraction of wrong pixels.
    pub mean_error: f64,
    /// The 99th percentile by nearest rank: the ⌈0.99·frames⌉-th smallest error.
    pub p99_error: f64,
    /// The error of the worst frame.
    pub max_error: f64,
    /// The mean over all frames of the number of connected wrong regions (a count).
    pub mean_regions: f64,
    /// The mean of the largest region's size over the frames with an error, as in the paper; 0 without
    /// errors.
    pub mean_max_region: f64,
    /// The size of the largest region of all frames.
    pub max_region: f64,
    /// The number of frames with a wrong pixel.
    pub frames_with_error: u64,
    /// The number of view cells that contain a viewpoint.
    pub cells_visited: u64,
    /// The number of different triangles visible in any frame.
    pub triangles_seen: u64,
    /// The frames with the largest errors, worst first. Of equal errors, the earlier frame comes first.
    pub worst: Vec<Frame>,
    /// The durations of errors; only for a camera path.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path: Option<PathReport>,
}

/// The measures of one frame.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Frame {
    /// The index of the frame, from 0.
    pub frame: u64,
    /// The viewpoint of the frame, in world space.
    pub viewpoint: [f32; 3],
    /// The view cell that contains the viewpoint.
    pub cell: CellIndex,
    /// The fraction of wrong pixels.
    pub error: f64,
    /// The number of connected wrong regions.
    pub regions: u32,
    /// The size of the largest region, as a fraction of all pixels.
    pub max_region: f64,
    /// The number of different wrong triangles.
    pub wrong_triangles: u64,
    /// The path of the frame's image; `None` if no image was written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<PathBuf>,
}

/// The durations of errors on a camera path. One error is one triangle that is wrong in consecutive frames.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PathReport {
    /// The number of such errors.
    pub errors: u64,
    /// The mean number of consecutive frames of an error; 0 without errors.
    pub mean_frames: f64,
    /// The maximum number of consecutive frames of an error.
    pub max_frames: u64,
}

/// A counter that follows wrong triangles from frame to frame.
#[derive(Default)]
pub(crate) struct Durations {
    /// The triangles that were wrong in the last frame, ascending, each with the number of frames so far.
    lasting: Vec<(u32, u64)>,
    errors: u64,
    frames: u64,
    longest: u64,
}

impl Durations {
    /// Adds the wrong triangles of the next frame, ascending.
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

/// Returns the nearest-rank percentile of ascending values, or `None` without values. `percent` must be in
/// 1…100.
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
        // Triangle 1 is wrong for one frame, 5 for three, 9 for one, then 1 and 5 for one frame each.
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
