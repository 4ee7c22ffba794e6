//! The body of the fuzz target `rewrite`, which the tests also call.

use sightline_scene::load::{LoadLimits, LoadOptions, load_bytes_with};

use crate::plan::Plan;
use crate::receivers::ReceiverValue;
use crate::settings::{BitDepth, Settings, TexCoordSource, TextureSize, ValueTarget};

/// The limits of the loaded scene, which bound the duration and memory of one call of [`rewrite`].
const LIMITS: LoadLimits = LoadLimits {
    triangles: 1 << 9,
    objects: 1 << 6,
};

/// Reads bytes as a glTF or GLB file, and writes values as a small texture and at its vertices. Returns true
/// if one of these methods succeeded.
///
/// # Panics
/// If a written file cannot be read, or has other triangles. No input may cause that.
pub fn rewrite(bytes: &[u8]) -> bool {
    let options = LoadOptions {
        limits: LIMITS,
        ..LoadOptions::default()
    };
    let Ok(loaded) = load_bytes_with("fuzz", bytes, None, &options) else {
        return false;
    };
    let scene = loaded.scene;
    let mut is_written = false;
    for (target, coordinates, bits) in [
        (ValueTarget::Texture, TexCoordSource::Any, BitDepth::Eight),
        (
            ValueTarget::Texture,
            TexCoordSource::Unwrap,
            BitDepth::Sixteen,
        ),
        (ValueTarget::Vertices, TexCoordSource::Any, BitDepth::Eight),
    ] {
        let settings = Settings {
            target,
            size: TextureSize::Resolution(16),
            coordinates,
            bits,
        };
        let Ok(plan) = Plan::new("fuzz", bytes, None, &scene, &settings) else {
            continue;
        };
        let value = |k: usize| ReceiverValue {
            open: (k % 7) as f64 / 6.0,
            inside: k % 5 == 4,
        };
        let values: Vec<ReceiverValue> = (0..plan.receivers().len()).map(value).collect();
        let Ok(written) = plan.write(&values) else {
            continue;
        };
        let again = load_bytes_with("written.glb", &written.glb, None, &options);
        let is_same = again
            .as_ref()
            .is_ok_and(|again| again.scene.triangles() == scene.triangles());
        assert!(
            is_same,
            "{settings:?}: the written file has other triangles than the scene: {:?}",
            again.err()
        );
        is_written = true;
    }
    is_written
}
