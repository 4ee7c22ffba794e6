//! Deciding a view cell from a list of all triangles that it may see: which of them have a witness.
//!
//! What is not on the list is hidden, as whoever made the list has proved. Triangles that meet the cell are
//! visible, closed surfaces hide some of the others, rays show most of the visible ones, and what is left is
//! undecided. No query is asked, so this takes a small fraction of the time of [`crate::decide()`].

use sightline_certificate::Witness;

use crate::cells::rays;
use crate::cells::task::{Decided, Task};
use crate::cells::work::{State, Work};

/// Segments tried for one triangle. Most that are left are hidden, and more tries show few of the others.
const TRIES: u32 = 16;

/// Decides every triangle with area among those of [`Task::listed`]. The task's `seen` and `above` are not
/// used.
pub fn decide_listed(task: &Task<'_>) -> Decided {
    let mut work = Work::new(task);
    let listed = task.listed.unwrap_or_default();
    work.meeting();
    work.keep_to_listed();
    work.enclose();
    let open =
        |id: &u32| work.state[*id as usize] == State::Open && task.scene.occluders().is_target(*id);
    let wanted: Vec<u32> = listed.iter().copied().filter(open).collect();
    let tried = (&wanted[..], TRIES);
    let (found, rays) = rays::witnesses(
        task.scene.occluders(),
        &work.sources,
        tried,
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
        } else if work.state[id as usize] == State::Open {
            // No query was asked, so there is no reason to count.
            work.state[id as usize] = State::Undecided;
        }
    }
    work.finish()
}
