//! Visibility cubes on the cpu backend: item buffers that are traced in tiles of 4 × 4 pixels.

use std::sync::Mutex;

use glam::Vec3;
use rayon::prelude::*;
use sightline_model::VisibilitySample;

use super::float_mode::FloatMode;
use super::tracer::CpuTracer;
use crate::cube::{CubeImage, CubeSpec, SKY, face_basis};
use crate::error::TracerError;
use crate::packet::{Halves, LANES, LineTracer as _, Packet};
use crate::reduce::Reducer;
use crate::tracer::CubeRenderer;

/// The number of tiles that are traced at a time.
const BATCH: u32 = 256;

/// A renderer that traces cubes through one hierarchy, whose numbers are places in a list of ids.
pub(super) struct CpuRenderer {
    tracer: CpuTracer,
    /// The id of each number, in ascending order.
    ids: Vec<u32>,
    spec: CubeSpec,
    /// The scratch memory of the reduction, one for each thread that samples.
    reducers: Mutex<Vec<Reducer>>,
}

impl CpuRenderer {
    /// Creates a renderer. `ids` has the id for each number of a triangle, in ascending order.
    pub(super) fn new(tracer: CpuTracer, ids: Vec<u32>, spec: CubeSpec) -> Self {
        Self {
            tracer,
            ids,
            spec,
            reducers: Mutex::default(),
        }
    }

    /// Traces one cube. The image contains numbers; [`Self::to_ids`] maps them to ids.
    fn trace(&self, point: Vec3) -> Result<CubeImage, TracerError> {
        let _mode = FloatMode::set();
        let n = self.spec.resolution;
        let mut ids = vec![SKY; (6 * n * n) as usize];
        let at = |x: u32| (2 * x + 1) as f32 / n as f32 - 1.0;
        let tiles = n.div_ceil(4);
        let mut packets = Vec::new();
        for face in 0..6 {
            let [forward, right, up] = face_basis(face);
            // The pixels of a tile, lane by lane.
            let pixels = |tile: u32| {
                let (x0, y0) = (tile % tiles * 4, tile / tiles * 4);
                let pixel = move |lane: u32| (x0 + lane % 4, y0 + lane / 4);
                (0..LANES as u32)
                    .map(pixel)
                    .filter(move |(x, y)| *x < n && *y < n)
            };
            for first in (0..tiles * tiles).step_by(BATCH as usize) {
                let some = first..(first + BATCH).min(tiles * tiles);
                packets.clear();
                packets.extend(some.clone().map(|tile| {
                    let mut packet = Packet::default();
                    for (x, y) in pixels(tile) {
                        // The components are ±1, u and v in some order, so the sum is exact.
                        let direction = forward + right * at(x) + up * at(y);
                        packet.push(point.to_array(), direction.to_array());
                    }
                    packet
                }));
                self.tracer.trace(&mut packets, Halves::Rays, true)?;
                for (packet, tile) in packets.iter().zip(some) {
                    for ((x, y), triangle) in pixels(tile).zip(packet.triangle) {
                        ids[((face * n + y) * n + x) as usize] = triangle;
                    }
                }
            }
        }
        Ok(CubeImage { resolution: n, ids })
    }

    fn sample(&self, point: Vec3) -> Result<VisibilitySample, TracerError> {
        let image = self.trace(point)?;
        // The lock is poisoned if another sample panicked; then new scratch memory is allocated.
        let pop = || self.reducers.lock().ok().and_then(|mut r| r.pop());
        let mut reducer = pop().unwrap_or_else(|| Reducer::new(self.ids.len()));
        let mut sample = reducer.reduce(&image, self.spec.strata);
        if let Ok(mut pool) = self.reducers.lock() {
            pool.push(reducer);
        }
        // The ids ascend, so the mapping preserves the order, and the lowest of equal ids remains the lowest.
        for id in &mut sample.ids {
            *id = self.ids[*id as usize];
        }
        sample.dominant = sample.dominant.map(|d| self.ids[d as usize]);
        if self.spec.keep_pixels {
            sample.pixels = Some(self.to_ids(image).ids.into());
        }
        Ok(sample)
    }

    fn to_ids(&self, mut image: CubeImage) -> CubeImage {
        for id in image.ids.iter_mut().filter(|id| **id != SKY) {
            *id = self.ids[*id as usize];
        }
        image
    }
}

impl CubeRenderer for CpuRenderer {
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, TracerError> {
        points.par_iter().map(|p| self.sample(*p)).collect()
    }

    fn image(&self, point: Vec3) -> Result<CubeImage, TracerError> {
        Ok(self.to_ids(self.trace(point)?))
    }
}
