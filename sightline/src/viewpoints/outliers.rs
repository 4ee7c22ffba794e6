//! A note about few triangles far from all others: they stretch the bounds that the view cells divide.

use glam::Vec3;
use sightline_scene::{Aabb, Scene, Triangle};

use crate::observer::{Observer, note};

/// The fraction of the triangles that the core of a scene may omit on each side of each axis.
const OMITTED: f64 = 0.025;
/// The ratio of the bounds' length to the core's length above which a note is printed.
const STRETCHED: f32 = 20.0;
/// The number of triangles, evenly spaced in the scene's order, whose centres give the quantiles.
const MOST_CENTRES: usize = 10_000;
/// The number of triangles below which a scene has no core.
const FEWEST: usize = 100;

/// Prints a note if few triangles stretch the scene's bounds.
pub(super) fn note_outliers(scene: &Scene, observer: &dyn Observer) {
    let Some((core, farthest)) = core_and_farthest(scene) else {
        return;
    };
    let ratio = longest(scene.bounds()) / longest(core);
    // The core of a scene whose central triangles are points has no length.
    if !(ratio > STRETCHED && ratio.is_finite()) {
        return;
    }
    let object = scene
        .objects()
        .iter()
        .find(|o| (o.first..o.first + o.count).contains(&farthest));
    let farthest = match object {
        Some(object) => format!("triangle {farthest} of object {:?}", object.name),
        None => format!("triangle {farthest}"),
    };
    let corner = |v: Vec3| format!("{},{},{}", v.x, v.y, v.z);
    note(
        observer,
        format!(
            "note: the view cells divide the scene's bounds, which are {ratio:.0} times as long as the box \
             around the central 95 % of the triangles. The farthest is {farthest}. To divide only the \
             central box, add --view-box {},{}",
            corner(core.min),
            corner(core.max)
        ),
    );
}

/// Returns the box around the triangles whose centres are between the quantiles [`OMITTED`] and 1 −
/// [`OMITTED`] on each axis, and the triangle that is farthest from it. Returns `None` for scenes of few
/// triangles, and if the box between the quantiles is already long.
fn core_and_farthest(scene: &Scene) -> Option<(Aabb, u32)> {
    let triangles = scene.triangles();
    if triangles.len() < FEWEST {
        return None;
    }
    let centre = |t: &Triangle| {
        let bounds = t.bounds();
        bounds.min * 0.5 + bounds.max * 0.5
    };
    let step = triangles.len().div_ceil(MOST_CENTRES);
    let centres: Vec<Vec3> = triangles.iter().step_by(step).map(centre).collect();
    let omitted = (centres.len() as f64 * OMITTED) as usize;
    let (mut low, mut high) = (Vec3::ZERO, Vec3::ZERO);
    for axis in 0..3 {
        let mut places: Vec<f32> = centres.iter().map(|c| c[axis]).collect();
        let most = places.len() - 1 - omitted;
        low[axis] = *places.select_nth_unstable_by(omitted, f32::total_cmp).1;
        high[axis] = *places.select_nth_unstable_by(most, f32::total_cmp).1;
    }
    let centre_box = Aabb::new(low, high);
    if longest(scene.bounds()) <= STRETCHED * longest(centre_box) {
        return None;
    }
    let central = triangles.iter().filter(|t| centre_box.contains(centre(t)));
    let core = central.fold(centre_box, |core, t| core.union(t.bounds()));
    let distance = |t: &Triangle| (centre(t) - centre(t).clamp(core.min, core.max)).length();
    let farthest = (0u32..)
        .zip(triangles)
        .max_by(|a, b| distance(a.1).total_cmp(&distance(b.1)))?;
    Some((core, farthest.0))
}

fn longest(bounds: Aabb) -> f32 {
    (bounds.max - bounds.min).max_element()
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use sightline_scene::Object;

    use super::*;
    use crate::observer::Note;

    /// An observer that keeps the notes.
    #[derive(Default)]
    struct Notes(Mutex<Vec<String>>);

    impl Observer for Notes {
        fn note(&self, note: &Note) {
            self.0.lock().unwrap().push(note.text.clone());
        }
    }

    /// Returns the notes about 300 triangles in a cube of 10 units, and one at `place`.
    fn notes(place: f32) -> Vec<String> {
        let at = |x: f32, y: f32, z: f32| Triangle {
            v: [
                Vec3::new(x, y, z),
                Vec3::new(x + 1.0, y, z),
                Vec3::new(x, y + 1.0, z),
            ],
        };
        let mut triangles: Vec<Triangle> = (0..300)
            .map(|i| at((i % 10) as f32, (i / 10 % 10) as f32, (i * 7 % 10) as f32))
            .collect();
        triangles.push(at(place, 0.0, 0.0));
        let object = |name: &str, first, count| Object {
            name: name.to_owned(),
            first,
            count,
        };
        let objects = vec![object("house", 0, 300), object("tower", 300, 1)];
        let scene = Scene::new("test", triangles, objects).unwrap();
        let notes = Notes::default();
        note_outliers(&scene, &notes);
        notes.0.into_inner().unwrap()
    }

    #[test]
    fn distant_object_is_named_with_box_without_it() {
        assert!(notes(50.0).is_empty());
        let [text] = <[String; 1]>::try_from(notes(30_000.0)).unwrap();
        assert!(text.contains("triangle 300 of object \"tower\""), "{text}");
        assert!(text.contains("--view-box 0,0,0,10,10,9"), "{text}");
    }
}
