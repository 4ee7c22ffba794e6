//! The decision of a view cell from a list of all triangles that may be visible from it: witnesses for some
//! of these triangles.
//!
//! The caller that made the list has proved that all other triangles are hidden. Triangles that meet the cell
//! are visible, closed surfaces hide some of the others, rays show most visible triangles, and the remaining
//! triangles are undecided. The function runs no query, so it needs only a small fraction of the time of
//! [`crate::decide()`].

use sightline_certificate::Witness;
use sightline_scene::TriangleId;

use crate::cells::rays;
use crate::cells::task::{CellDecisions, CellTask};
use crate::cells::work::{CellWork, TriangleState};

/// The number of segments tried per triangle.
///
/// Most triangles without a witness after these segments are hidden, so that more segments would show few
/// others.
const TRIES: u32 = 16;

/// Decides, without queries, every triangle with area among the triangles of [`CellTask::listed`].
///
/// The fields `seen` and `above` of the task are not used.
pub fn decide_listed(task: &CellTask<'_>) -> CellDecisions {
    let mut work = CellWork::new(task);
    let listed = task.listed.unwrap_or_default();
    work.meeting();
    work.keep_to_listed();
    work.enclose();
    let open = |id: &u32| {
        work.state[*id as usize] == TriangleState::Open
            && task.scene.occluders().is_target(TriangleId(*id))
    };
    let wanted: Vec<u32> = listed.iter().copied().filter(open).collect();
    let (found, rays) = rays::witnesses(
        task.scene.occluders(),
        &work.sources,
        &wanted,
        TRIES,
        task.seed,
        task.stop,
    );
    work.decided.statistics.rays = rays;
    for (id, ends) in found {
        work.see(id, |_| Witness::Floats(ends));
    }
    let is_stopped = (task.stop)();
    for id in wanted {
        if is_stopped {
            work.leave(id, None);
        } else if work.state[id as usize] == TriangleState::Open {
            // No query ran, so the triangle is not counted in the statistics by reason.
            work.state[id as usize] = TriangleState::Undecided;
        }
    }
    work.finish()
}
