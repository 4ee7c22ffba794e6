//! A picture that shows the reason why a target is visible or hidden. It shows the scene from one eye, with
//! the target in green, its blockers in red, and the outline of the target over both.

use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::Scene;
use sightline_trace::SKY;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sight::{Passed, SightLineTracer};

use crate::camera::Camera;
use crate::error::MeasureError;
use crate::images::{SEEN, WRONG};

/// The size of the picture, in pixels.
const SIZE: [u32; 2] = [960, 640];
/// The side of the tile of pixels that a packet of lines covers.
const TILE: u32 = 4;
const SKY_COLOUR: [u8; 3] = [236, 244, 252];
const OTHER: [u8; 3] = [176, 180, 188];
const OUTLINE: [u8; 3] = [20, 20, 20];
/// The colour of the mark at the end of a sight line.
const MARK: [u8; 3] = [250, 220, 0];
/// Half the side of the square that marks the end of a sight line, in pixels.
const MARK_SIDE: u32 = 4;
/// The maximum number of triangles whose outlines are drawn. More outlines would cover the picture.
const OUTLINED: usize = 2000;
/// The width of the picture as a multiple of the width of the target. `SPREADS` contains the minimum and
/// maximum of half the width of the picture at distance 1.
const MARGIN: f32 = 2.0;
const SPREADS: [f32; 2] = [0.02, 1.2];

/// The contents of the picture.
#[derive(Clone, Copy, Debug)]
pub struct Portrait<'a> {
    /// The position of the eye, in world space.
    pub eye: Vec3,
    /// The triangles of the target, ascending.
    pub target: &'a [u32],
    /// The triangles that hide the target, ascending.
    pub blockers: &'a [u32],
    /// The end of a line along which the target is visible; `None` if no such line is known.
    pub seen_at: Option<Vec3>,
    /// The vector that points up in the picture.
    pub vertical: Vec3,
}

impl Portrait<'_> {
    /// Returns the picture as a PNG. `step` has the meaning of the parameter of [`SightLineTracer::trace`].
    ///
    /// # Errors
    /// [`MeasureError`] if the device fails.
    pub fn draw(
        &self,
        scene: &Scene,
        sight: &SightLineTracer<'_>,
        step: f32,
    ) -> Result<Vec<u8>, MeasureError> {
        let camera = self.camera(scene);
        let ids = traced(&camera, sight, step)?;
        let [wide, high] = camera.size();
        let mut pixels: Vec<[u8; 3]> = (0..high)
            .flat_map(|y| (0..wide).map(move |x| (x, y)))
            .zip(&ids)
            .map(|((x, y), id)| self.colour(scene, camera.ray(x, y), *id))
            .collect();
        let mut dot = |(x, y): (u32, u32), colour| pixels[(y * wide + x) as usize] = colour;
        if self.target.len() <= OUTLINED {
            for corners in self.target.iter().map(|t| scene.triangles()[*t as usize].v) {
                for k in 0..3 {
                    camera
                        .along(corners[k], corners[(k + 1) % 3])
                        .for_each(|at| dot(at, OUTLINE));
                }
            }
        }
        if let Some((x, y)) = self.seen_at.and_then(|end| camera.along(end, end).next()) {
            for (x, y) in square(x, y).filter(|(x, y)| *x < wide && *y < high) {
                dot((x, y), MARK);
            }
        }
        let failed = |e: png::EncodingError| MeasureError::Encode {
            reason: e.to_string(),
        };
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, wide, high);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(failed)?;
        writer
            .write_image_data(pixels.as_flattened())
            .map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(out)
    }

    /// Returns a camera that looks at the end of the line or the middle of the target. The camera has all of
    /// the target in view if the target is not too near.
    fn camera(&self, scene: &Scene) -> Camera {
        let corners = || {
            self.target
                .iter()
                .flat_map(|t| scene.triangles()[*t as usize].v)
        };
        let (min, max) = corners().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(min, max), v| {
            (min.min(v), max.max(v))
        });
        let middle = if self.target.is_empty() {
            self.eye + Vec3::X
        } else {
            (min + max) / 2.0
        };
        let middle = self.seen_at.unwrap_or(middle);
        let radius = corners().map(|v| v.distance(middle)).fold(0.0, f32::max);
        let spread = MARGIN * radius / self.eye.distance(middle).max(f32::MIN_POSITIVE);
        let spread = spread.clamp(SPREADS[0], SPREADS[1]);
        Camera::new(self.eye, middle - self.eye, self.vertical, SIZE, spread)
    }

    /// Returns the colour of a triangle along a ray. The light is at the eye, so that faces can be
    /// distinguished.
    fn colour(&self, scene: &Scene, ray: Vec3, id: u32) -> [u8; 3] {
        if id == SKY {
            return SKY_COLOUR;
        }
        let base = match id {
            id if self.target.binary_search(&id).is_ok() => SEEN,
            id if self.blockers.binary_search(&id).is_ok() => WRONG,
            _ => OTHER,
        };
        let [a, b, c] = scene.triangles()[id as usize].v;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let light = 0.55 + 0.45 * normal.dot(ray.normalize_or_zero()).abs();
        base.map(|c| (f32::from(c) * light) as u8)
    }
}

/// Returns the triangle in each pixel, or [`SKY`], row by row from the top.
fn traced(
    camera: &Camera,
    sight: &SightLineTracer<'_>,
    step: f32,
) -> Result<Vec<u32>, MeasureError> {
    let [wide, high] = camera.size();
    let eye = camera.eye().to_array();
    let rows: Result<Vec<Vec<u32>>, MeasureError> = (0..high.div_ceil(TILE))
        .into_par_iter()
        .map(|row| {
            let mut packets = vec![Packet::default(); wide.div_ceil(TILE) as usize];
            for (tile, packet) in packets.iter_mut().enumerate() {
                for lane in 0..LANES as u32 {
                    let (x, y) = (tile as u32 * TILE + lane % TILE, row * TILE + lane / TILE);
                    packet.push(eye, camera.ray(x, y).to_array());
                }
            }
            sight.trace(&mut packets, &mut Passed::default(), step)?;
            let mut ids = vec![SKY; (TILE * wide) as usize];
            for (tile, packet) in packets.iter().enumerate() {
                for lane in 0..LANES {
                    let x = tile * TILE as usize + lane % TILE as usize;
                    if x < wide as usize {
                        ids[lane / TILE as usize * wide as usize + x] = packet.triangle[lane];
                    }
                }
            }
            Ok(ids)
        })
        .collect();
    let mut ids = rows?.concat();
    ids.truncate((wide * high) as usize);
    Ok(ids)
}

/// Returns the pixels of a frame around a pixel.
fn square(x: u32, y: u32) -> impl Iterator<Item = (u32, u32)> {
    let range = |c: u32| c.saturating_sub(MARK_SIDE)..=c + MARK_SIDE;
    range(y)
        .flat_map(move |py| range(x).map(move |px| (px, py)))
        .filter(move |(px, py)| px.abs_diff(x).max(py.abs_diff(y)) >= MARK_SIDE - 1)
}
