//! The partition of a scene along its walls for the method portals, before the work of a job starts.

use std::collections::BTreeSet;

use sightline_model::{JobSpec, Method};
use sightline_portals::Partition;
use sightline_scene::kinds::SurfaceKind;
use sightline_scene::{Object, Scene, TriangleId};
use sightline_worker::TracedScene;

use crate::error::Error;
use crate::observer::{Observer, note};
use crate::words::plural;

/// Partitions the scene of a job that needs the partition, and prints notes about the effect of portals. The
/// workers of this process use the partition.
pub(super) fn partition(
    loaded: &TracedScene,
    job: &JobSpec,
    observer: &dyn Observer,
) -> Result<(), Error> {
    let scene = loaded.scene.scene();
    let has_doors =
        (0..scene.len()).any(|id| scene.kinds().kind(TriangleId(id)) == SurfaceKind::Door);
    let Some(task) = job.visibility() else {
        return Ok(());
    };
    let is_needed = matches!(task.method, Method::Portals { .. })
        || task.has_portals() && has_doors && task.time_budget().is_none();
    if !is_needed {
        return Ok(());
    }
    let partition = loaded
        .scene
        .partition(task, &|| observer.is_cancelled())
        .map_err(|e| match observer.is_cancelled() {
            true => Error::cancelled("interrupted"),
            false => Error::internal(e),
        })?;
    for line in in_words(&partition, scene) {
        note(observer, line);
    }
    Ok(())
}

/// Formats the effect of portals on a scene.
fn in_words(partition: &Partition, scene: &Scene) -> Vec<String> {
    let mut lines = vec![match partition.leaves() {
        0 | 1 => {
            "no wall divides the space of the viewpoints, so walls hide nothing within this space; \
        exact queries hide more triangles (--method verified)"
                .to_owned()
        }
        parts => format!(
            "walls divide the scene into {}",
            plural(parts, "convex part")
        ),
    }];
    let doors = partition.doors();
    let is_door =
        |o: &&Object| o.count > 0 && scene.kinds().kind(TriangleId(o.first)) == SurfaceKind::Door;
    let names = scene
        .objects()
        .iter()
        .filter(is_door)
        .map(|o| o.name.as_str());
    let useless: BTreeSet<&str> = names.filter(|name| !doors.contains(name)).collect();
    if !useless.is_empty() {
        lines.push(format!(
            "note: {} cannot be shut at run time, because the doors cover no opening: a door must lie \
             exactly in the plane of its wall, or within a thick wall",
            useless.into_iter().collect::<Vec<_>>().join(", ")
        ));
    }
    lines
}
