//! The judgement of one pixel.

use sightline_trace::SKY;

/// Returns true if a pixel that shows `id` is wrong. `visible` is a set as bits. `id` must be sky or below
/// the number of these bits.
pub(crate) fn is_wrong(visible: &[u64], id: u32) -> bool {
    id != SKY && visible[(id / 64) as usize] >> (id % 64) & 1 == 0
}
