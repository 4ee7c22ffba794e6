//! Visibility cubes of scenes with kinds or sides: item buffers of the blocking triangles, and the
//! see-through triangles in front of each pixel.
//!
//! The cubes are traced as sight lines, on either backend, because rasterised item buffers have one layer.
//! Scenes of opaque triangles with two sides use their backend's own renderer.

use glam::Vec3;
use rayon::prelude::*;
use sightline_model::VisibilitySample;

use crate::cube::{CubeImage, CubeSpec, SKY, face_basis, sample_of_image};
use crate::error::TracerError;
use crate::packet::{LANES, Packet};
use crate::prepared::PreparedScene;
use crate::sight::{Passed, SightLineTracer, least_step};
use crate::tracer::{CubeRenderer, Tracer};

/// The number of packets traced at a time.
const BATCH: usize = 1024;

/// Prepares the rendering of a scene of any kinds and sides, up to the distance `far`.
///
/// Opaque scenes with two sides and without such a distance use [`Tracer::prepare`]. Otherwise the whole
/// scene is traced, independent of the superset.
///
/// # Errors
/// The errors of [`Tracer::prepare`].
pub fn renderer<'a>(
    backend: &'a dyn Tracer,
    scene: &'a PreparedScene,
    spec: CubeSpec,
    superset: Option<&[u32]>,
    far: Option<f64>,
) -> Result<Box<dyn CubeRenderer + 'a>, TracerError> {
    let plain = scene.scene().kinds().all_opaque() && scene.scene().sides().are_both();
    if plain && far.is_none() {
        return backend.prepare(superset);
    }
    let step = least_step(scene.scene().bounds());
    Ok(Box::new(Layered {
        sight: SightLineTracer::new(backend, scene.traced())?.up_to(far),
        spec,
        step,
    }))
}

struct Layered<'a> {
    sight: SightLineTracer<'a>,
    spec: CubeSpec,
    /// The step of [`SightLineTracer::trace`].
    step: f32,
}

impl CubeRenderer for Layered<'_> {
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, TracerError> {
        points
            .par_iter()
            .map(|p| {
                let (image, passed) = self.layers(*p)?;
                let sample = sample_of_image(&image, self.spec.strata, self.spec.keep_pixels);
                let n = image.resolution;
                let runs = passed.iter().map(|(pixel, triangle)| {
                    let (face, y, x) = (pixel / (n * n), pixel / n % n, pixel % n);
                    (*triangle, 1 << self.spec.strata.of_pixel(face, x, y, n))
                });
                Ok(sample.with(runs))
            })
            .collect()
    }

    fn image(&self, point: Vec3) -> Result<CubeImage, TracerError> {
        Ok(self.layers(point)?.0)
    }

    fn layers(&self, point: Vec3) -> Result<(CubeImage, Vec<(u32, u32)>), TracerError> {
        let n = self.spec.resolution;
        let at = |x: u32| (2 * x + 1) as f32 / n as f32 - 1.0;
        // Tiles of 4×4 pixels keep packets coherent.
        let tiles = n.div_ceil(4);
        let mut ids = vec![SKY; (6 * n * n) as usize];
        let mut between = Vec::new();
        let (mut packets, mut passed) = (Vec::new(), Passed::default());
        let mut pixels: Vec<[u32; LANES]> = Vec::new();
        for first in (0..6 * tiles * tiles).step_by(BATCH) {
            packets.clear();
            pixels.clear();
            for k in first..(first + BATCH as u32).min(6 * tiles * tiles) {
                let (face, tile) = (k / (tiles * tiles), k % (tiles * tiles));
                let [forward, right, up] = face_basis(face);
                let (mut packet, mut own) = (Packet::default(), [0; LANES]);
                for lane in 0..LANES as u32 {
                    let (x, y) = (tile % tiles * 4 + lane % 4, tile / tiles * 4 + lane / 4);
                    if x < n && y < n {
                        own[packet.count] = (face * n + y) * n + x;
                        packet.push(
                            point.to_array(),
                            (forward + right * at(x) + up * at(y)).to_array(),
                        );
                    }
                }
                packets.push(packet);
                pixels.push(own);
            }
            self.sight.trace(&mut packets, &mut passed, self.step)?;
            for (k, (packet, own)) in packets.iter().zip(&pixels).enumerate() {
                for lane in 0..packet.count {
                    ids[own[lane] as usize] = packet.triangle[lane];
                    between.extend(passed.on(k, lane).map(|t| (own[lane], t)));
                }
            }
        }
        Ok((CubeImage { resolution: n, ids }, between))
    }
}
