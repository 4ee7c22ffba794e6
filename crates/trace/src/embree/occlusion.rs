//! Whether rays meet anything: what ambient occlusion by rays asks, to compare with.

use std::ffi::CStr;
use std::sync::Arc;

use sightline_scene::{Scene, Triangle};

use super::library::{Device, Layer, RayHit16, TriangleScene};
use crate::error::BackendError;
use crate::packet::{LANES, Packet};

/// The blocking triangles of a scene, from both sides, with any instruction set of this machine.
pub struct Occlusion(TriangleScene);

impl Occlusion {
    /// Builds Embree's hierarchy.
    ///
    /// # Errors
    /// [`BackendError`] when Embree is not installed or refuses.
    pub fn new(scene: &Scene) -> Result<Self, BackendError> {
        let config = format!("threads={},set_affinity=0\0", rayon::current_num_threads());
        let config = CStr::from_bytes_until_nul(config.as_bytes())
            .map_err(|e| BackendError::Unavailable(format!("Embree cannot be configured: {e}")))?;
        let device = Arc::new(Device::new(config)?);
        let blocking: Vec<[f32; 9]> = (0..scene.len())
            .filter(|id| scene.blocks(*id))
            .map(|id| bytemuck::cast::<Triangle, [f32; 9]>(scene.triangles()[id as usize]))
            .collect();
        let layer = Layer {
            count: blocking.len(),
            triangles: blocking.into_iter(),
            fronts: None,
            is_passed: false,
        };
        let built =
            TriangleScene::new(&device, [layer]).map_err(|reason| BackendError::Failed {
                profile: "cpu".to_owned(),
                reason,
            })?;
        if !built.has_occluded() {
            return Err(BackendError::Unavailable(
                "this Embree has no rtcOccluded16".to_owned(),
            ));
        }
        Ok(Self(built))
    }

    /// Whether the rays of a packet meet anything between two distances, in lengths of their directions.
    pub fn hidden(&self, packet: &Packet, from: f32, to: f32) -> [bool; LANES] {
        let mut rays = RayHit16::new();
        (rays.org, rays.dir) = (packet.origin, packet.direction);
        (rays.tnear, rays.tfar) = ([from; LANES], [to; LANES]);
        let valid = std::array::from_fn(|lane| if lane < packet.count { -1 } else { 0 });
        self.0.occluded(&valid, &mut rays);
        rays.tfar.map(|far| far < 0.0)
    }
}
