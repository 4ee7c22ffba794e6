//! The visibility cube: its geometry, the directions of its pixels, and its reduction to a sample.
//!
//! The cube follows Nirenstein 2003, section 4.1.1, and Nirenstein and Blake 2004, section 3.1.
//!
//! All backends share these conventions. Face `f` looks along axis `f / 2`, in positive direction if `f` is
//! even. The right vector of a face is the next axis, and the up vector the axis after it (cyclically), for
//! both signs. Pixel (x, y) of a face with side n has the direction forward + u·right + v·up with u =
//! (2x+1)/n − 1 and v = (2y+1)/n − 1. A cube image stores the faces one after another, each row by row from y
//! = 0.

use glam::Vec3;
use sightline_model::{CubeParams, ErrorMeasure, Sampler, VisibilitySample};

/// The id of a pixel that sees no triangle.
pub const SKY: u32 = u32::MAX;

/// The parameters of rendered cubes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CubeSpec {
    /// The side length of a face in pixels, 1…4096.
    pub resolution: u32,
    /// The angular strata.
    pub strata: Strata,
    /// True if samples contain their pixels, which only Err′ needs.
    pub keep_pixels: bool,
}

impl CubeSpec {
    /// Returns the cubes that a sampler needs, or the default cubes if it renders none.
    pub fn from_sampler(sampler: &Sampler) -> Self {
        Self::new(&sampler.cube_params().copied().unwrap_or_default())
    }

    /// Returns the cubes that the error measure of `params` needs.
    pub fn new(params: &CubeParams) -> Self {
        Self {
            resolution: params.resolution.get(),
            strata: match params.measure {
                ErrorMeasure::Sets | ErrorMeasure::Uniform => Strata::One,
                ErrorMeasure::Pixels | ErrorMeasure::Strata => Strata::Quadrants,
            },
            keep_pixels: params.measure == ErrorMeasure::Pixels,
        }
    }
}

/// The strata of directions for the error measure Err″ (Nirenstein and Blake 2004, section 3.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strata {
    /// One stratum: Err″ equals Err.
    One,
    /// One stratum for each face: 6.
    Faces,
    /// Two by two strata for each face: 24.
    Quadrants,
}

impl Strata {
    /// Returns the number of strata.
    pub fn count(self) -> u32 {
        match self {
            Self::One => 1,
            Self::Faces => 6,
            Self::Quadrants => 24,
        }
    }

    /// Returns the stratum of pixel (x, y) of `face` if a face has a side of `n` pixels.
    pub fn of_pixel(self, face: u32, x: u32, y: u32, n: u32) -> u32 {
        match self {
            Self::One => 0,
            Self::Faces => face,
            Self::Quadrants => face * 4 + u32::from(2 * y >= n) * 2 + u32::from(2 * x >= n),
        }
    }
}

/// Returns the forward, right and up unit vectors of a face.
pub fn face_basis(face: u32) -> [Vec3; 3] {
    let axis = (face / 2) as usize % 3;
    let unit = |i: usize| Vec3::AXES[i % 3];
    let forward = if face.is_multiple_of(2) {
        unit(axis)
    } else {
        -unit(axis)
    };
    [forward, unit(axis + 1), unit(axis + 2)]
}

/// Six item buffers around a point: for each pixel the id of the triangle seen, or [`SKY`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CubeImage {
    /// The side length n of a face in pixels.
    pub resolution: u32,
    /// The ids of the pixels: 6·n·n ids, face by face, row by row.
    pub ids: Vec<u32>,
}

impl CubeImage {
    /// Returns the triangle that is seen in a direction other than zero, or [`SKY`].
    pub fn id_along(&self, direction: Vec3) -> u32 {
        let n = self.resolution;
        let ahead = |face: &u32| direction.dot(face_basis(*face)[0]);
        let face = (0..6)
            .max_by(|a, b| ahead(a).total_cmp(&ahead(b)))
            .unwrap_or(0);
        let [forward, right, up] = face_basis(face);
        let depth = direction.dot(forward);
        let place = |c: f32| (((c / depth + 1.0) * n as f32 / 2.0) as u32).min(n - 1);
        self.ids[((face * n + place(direction.dot(up))) * n + place(direction.dot(right))) as usize]
    }
}

/// Reduces a full cube image on the CPU. This function is the reference for every backend's own reduction.
pub fn sample_of_image(image: &CubeImage, strata: Strata, keep_pixels: bool) -> VisibilitySample {
    let n = image.resolution;
    // (id, stratum bit, run length): runs along a row keep the list short.
    let mut runs: Vec<(u32, u32, u32)> = Vec::new();
    for (row, pixels) in image.ids.chunks_exact(n as usize).enumerate() {
        let (face, y) = (row as u32 / n, row as u32 % n);
        for (x, &id) in pixels.iter().enumerate() {
            if id == SKY {
                continue;
            }
            let bit = 1u32 << strata.of_pixel(face, x as u32, y, n);
            match runs.last_mut() {
                Some(last) if last.0 == id && last.1 == bit => last.2 += 1,
                _ => runs.push((id, bit, 1)),
            }
        }
    }
    let pixels = keep_pixels.then(|| image.ids.as_slice().into());
    VisibilitySample {
        pixels,
        ..VisibilitySample::from_runs(runs)
    }
}

/// Returns the distance along a face's forward axis below which triangles are neither seen nor block.
///
/// The distance is 2⁻⁴⁰ of the scene's largest extent, at most 2⁻²⁴. Tracers of lines measure it in lengths
/// of the direction.
///
/// A sample in the plane of an axis-aligned wall, as on a face where a view cell meets a wall, has that wall
/// at distance zero exactly and sees along both its sides. Otherwise, `f32` coordinates of the scene cannot
/// place a vertex this close to a sample, so no other triangle is clipped. All backends use this value.
pub fn near_distance(bounds: sightline_scene::Aabb) -> f32 {
    let extent = (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max_element();
    // The extent is 0 only if all triangles are degenerate. Then no triangle is visible.
    // A direction can be as long as the scene. Without a limit, a line of a scene of 10⁸ units would ignore
    // the blockers in 10⁻⁴ of its length; 2⁻²⁴ of a length is below the rounding of its ends.
    ((extent * 2f64.powi(-40)) as f32).clamp(1e-30, 2f32.powi(-24))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn direction_through_pixel_meets_its_id() {
        let n = 8;
        let image = CubeImage {
            resolution: n,
            ids: (0..6 * n * n).collect(),
        };
        for id in 0..6 * n * n {
            let (face, y, x) = (id / (n * n), id / n % n, id % n);
            let [forward, right, up] = face_basis(face);
            let at = |k: u32| (k as f32 + 0.5) / n as f32 * 2.0 - 1.0;
            assert_eq!(
                image.id_along((forward + right * at(x) + up * at(y)) * 3.0),
                id
            );
        }
    }
}
