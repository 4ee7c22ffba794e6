//! The body of the fuzz target `rewrite`, which the tests call too.

use sightline_scene::load::{Limits, Options, load_bytes_with};

use crate::plan::Plan;
use crate::receivers::Value;
use crate::settings::{Bits, Coordinates, Settings, Size, Target};

/// Limits of one run, so that it is fast and its memory bounded.
const LIMITS: Limits = Limits {
    triangles: 1 << 9,
    objects: 1 << 6,
};

/// Bytes as a glTF or GLB file that gets values, as a small texture and at its vertices. Returns whether it
/// got them in one of these ways.
///
/// # Panics
/// When a file is written that cannot be read, or has other triangles. No bytes may cause that.
pub fn rewrite(bytes: &[u8]) -> bool {
    let options = Options {
        limits: LIMITS,
        ..Options::default()
    };
    let Ok(loaded) = load_bytes_with("fuzz", bytes, None, &options) else {
        return false;
    };
    let scene = loaded.scene;
    let mut is_written = false;
    for (target, coordinates, bits) in [
        (Target::Texture, Coordinates::Any, Bits::Eight),
        (Target::Texture, Coordinates::Unwrap, Bits::Sixteen),
        (Target::Vertices, Coordinates::Any, Bits::Eight),
    ] {
        let settings = Settings {
            target,
            size: Size::Resolution(16),
            coordinates,
            bits,
        };
        let Ok(plan) = Plan::new("fuzz", bytes, None, &scene, &settings) else {
            continue;
        };
        let value = |k: usize| Value {
            open: (k % 7) as f64 / 6.0,
            inside: k % 5 == 4,
        };
        let values: Vec<Value> = (0..plan.receivers().len()).map(value).collect();
        let Ok(written) = plan.write(&values) else {
            continue;
        };
        let again = load_bytes_with("written.glb", &written.glb, None, &options);
        let is_same = again
            .as_ref()
            .is_ok_and(|again| again.scene.triangles() == scene.triangles());
        assert!(
            is_same,
            "{settings:?}: the file that was written has other triangles: {:?}",
            again.err()
        );
        is_written = true;
    }
    is_written
}
