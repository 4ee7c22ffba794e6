//! Occlusion tests of rays, which the comparison with ray-traced ambient occlusion uses.

use std::ffi::CStr;
use std::sync::Arc;

use sightline_scene::{Scene, Triangle, TriangleId};

use super::library::{Device, Layer, RayHit16, TriangleScene};
use crate::error::TracerError;
use crate::packet::{LANES, Packet};

/// The blocking triangles of a scene, met from both sides, with any instruction set of this machine.
pub struct Occlusion(TriangleScene);

impl Occlusion {
    /// Builds Embree's hierarchy.
    ///
    /// # Errors
    /// [`TracerError`] if Embree is not installed or reports an error.
    pub fn new(scene: &Scene) -> Result<Self, TracerError> {
        let config = format!("threads={},set_affinity=0\0", rayon::current_num_threads());
        let config = CStr::from_bytes_until_nul(config.as_bytes())
            .map_err(|e| TracerError::Unavailable(format!("Embree cannot be configured: {e}")))?;
        let device = Arc::new(Device::new(config)?);
        let blocking: Vec<[f32; 9]> = (0..scene.len())
            .filter(|id| scene.blocks(TriangleId(*id)))
            .map(|id| bytemuck::cast::<Triangle, [f32; 9]>(scene.triangles()[id as usize]))
            .collect();
        let layer = Layer {
            count: blocking.len(),
            triangles: blocking.into_iter(),
            fronts: None,
            is_passed: false,
        };
        let built = TriangleScene::new(&device, [layer]).map_err(|reason| TracerError::Failed {
            profile: "embree".to_owned(),
            reason,
        })?;
        if !built.has_occluded() {
            return Err(TracerError::Unavailable(
                "this Embree was built without rtcOccluded16; install another build".to_owned(),
            ));
        }
        Ok(Self(built))
    }

    /// Returns for each ray of a packet whether a triangle blocks it between two distances, in lengths of the
    /// direction.
    pub fn hidden(&self, packet: &Packet, from: f32, to: f32) -> [bool; LANES] {
        let mut rays = RayHit16::new();
        (rays.org, rays.dir) = (packet.origin, packet.direction);
        (rays.tnear, rays.tfar) = ([from; LANES], [to; LANES]);
        let valid = std::array::from_fn(|lane| if lane < packet.count { -1 } else { 0 });
        self.0.occluded(&valid, &mut rays);
        rays.tfar.map(|far| far < 0.0)
    }
}
