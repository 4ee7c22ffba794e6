//! A camera: its position and direction, and the rays of its pixels.

use glam::Vec3;

/// The nearest depth at which a line is drawn, as a fraction of the depth of its farther end.
const NEAR: f32 = 1e-4;

/// A camera in world space.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    eye: Vec3,
    /// The axes of the camera: unit vectors, perpendicular to each other.
    forward: Vec3,
    right: Vec3,
    up: Vec3,
    /// The width and height in pixels.
    size: [u32; 2],
    /// The distance of neighbouring pixels at distance 1 from the eye, in world units.
    scale: f32,
}

impl Camera {
    /// Creates a camera at `eye` that looks along `forward`. `vertical` points up in the picture as far as
    /// possible. `size` is in pixels, and `spread` is half the width of the picture at distance 1.
    pub fn new(eye: Vec3, forward: Vec3, vertical: Vec3, size: [u32; 2], spread: f32) -> Self {
        let forward = forward.try_normalize().unwrap_or(Vec3::X);
        let right = forward
            .cross(vertical)
            .try_normalize()
            .unwrap_or_else(|| forward.any_orthonormal_vector());
        Self {
            eye,
            forward,
            right,
            up: right.cross(forward),
            size,
            scale: 2.0 * spread / size[0] as f32,
        }
    }

    /// Returns the position of the eye.
    pub fn eye(&self) -> Vec3 {
        self.eye
    }

    /// Returns the width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Returns the direction of the centre of a pixel, of any length. (0, 0) is the upper left pixel.
    pub fn ray(&self, x: u32, y: u32) -> Vec3 {
        let [wide, high] = self.size.map(|n| n as f32);
        let u = (x as f32 + 0.5 - wide / 2.0) * self.scale;
        let v = (high / 2.0 - y as f32 - 0.5) * self.scale;
        self.forward + self.right * u + self.up * v
    }

    /// Returns the pixels along a segment of world space, from end to end. Omits the part behind the camera.
    pub fn along(&self, from: Vec3, to: Vec3) -> impl Iterator<Item = (u32, u32)> + use<> {
        let ends = self
            .clipped(from, to)
            .map(|ends| ends.map(|d| self.flat(d)));
        // A segment behind the camera becomes NaN, which contains no pixel.
        let [[x0, y0], [x1, y1]] = ends.unwrap_or([[f32::NAN; 2]; 2]);
        // A segment that passes near the eye is long in the picture, and only a part of it is inside.
        let steps = (x1 - x0).abs().max((y1 - y0).abs()).ceil().clamp(1.0, 1e5) as u32;
        let [wide, high] = self.size.map(|n| n as f32);
        (0..=steps).filter_map(move |step| {
            let t = step as f32 / steps as f32;
            let (x, y) = (x0 + (x1 - x0) * t, y0 + (y1 - y0) * t);
            ((0.0..wide).contains(&x) && (0.0..high).contains(&y)).then_some((x as u32, y as u32))
        })
    }

    /// Returns the part of a segment in front of the camera, relative to the eye.
    fn clipped(&self, from: Vec3, to: Vec3) -> Option<[Vec3; 2]> {
        let ends = [from - self.eye, to - self.eye];
        let depth = ends.map(|d| d.dot(self.forward));
        let near = NEAR * depth[0].abs().max(depth[1].abs());
        let at = |end: usize| match depth[end] >= near {
            true => ends[end],
            false => ends[end].lerp(
                ends[1 - end],
                (near - depth[end]) / (depth[1 - end] - depth[end]),
            ),
        };
        (depth[0].max(depth[1]) > near).then(|| [at(0), at(1)])
    }

    /// Returns the position in the picture of a point in front of the camera, relative to the eye.
    fn flat(&self, d: Vec3) -> [f32; 2] {
        let depth = d.dot(self.forward);
        let (u, v) = (d.dot(self.right) / depth, d.dot(self.up) / depth);
        let [wide, high] = self.size.map(|n| n as f32);
        [u / self.scale + wide / 2.0, high / 2.0 - v / self.scale]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_of_pixel_ends_in_pixel() {
        let eye = Vec3::new(1.0, 2.0, 3.0);
        let camera = Camera::new(eye, Vec3::new(1.0, -0.3, 0.2), Vec3::Z, [40, 30], 0.7);
        for (x, y) in [(0, 0), (39, 0), (0, 29), (17, 11), (39, 29)] {
            let end = eye + camera.ray(x, y) * 5.0;
            assert_eq!(camera.along(end, end).next(), Some((x, y)));
        }
    }

    #[test]
    fn segments_behind_camera_are_clipped() {
        let camera = Camera::new(Vec3::ZERO, Vec3::Y, Vec3::Z, [40, 40], 1.0);
        let at = |y: f32| Vec3::new(0.5, y, 0.0);
        assert_eq!(camera.along(at(-1.0), at(-2.0)).count(), 0);
        let drawn: Vec<(u32, u32)> = camera.along(at(1.0), at(-1.0)).collect();
        assert_eq!(drawn.first(), Some(&(30, 20)));
        assert!(drawn.iter().all(|p| p.0 >= 30 && p.1 == 20), "{drawn:?}");
    }

    #[test]
    fn camera_along_vertical_has_valid_axes() {
        let camera = Camera::new(Vec3::ZERO, Vec3::Z, Vec3::Z, [4, 4], 1.0);
        assert!(camera.ray(0, 0).is_finite() && camera.ray(0, 0) != camera.ray(3, 0));
    }
}
