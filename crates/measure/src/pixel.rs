//! The judgement of one pixel.

use sightline_trace::SKY;

/// Whether a pixel that shows `id` is wrong. `id` is sky or has its bit in `visible`.
pub(crate) fn is_wrong(visible: &[u64], id: u32) -> bool {
    id != SKY && visible[(id / 64) as usize] >> (id % 64) & 1 == 0
}
