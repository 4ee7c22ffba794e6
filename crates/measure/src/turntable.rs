//! A frame as an animated PNG. The animation shows the view of a camera at the viewpoint that turns once
//! around the axis that points up.

use std::path::Path;

use glam::Vec3;
use sightline_files::{Access, NewFile};
use sightline_trace::CubeImage;

use crate::camera::Camera;
use crate::error::MeasureError;
use crate::images::colour;

/// The size of a picture, in pixels.
const SIZE: [u32; 2] = [400, 300];
/// Half the width of a picture at distance 1: a field of view of 90 degrees.
const SPREAD: f32 = 1.0;
/// The number of pictures of a turn.
const STEPS: u32 = 48;
/// The number of pictures per second.
const RATE: u16 = 12;

/// Writes the animation. `visible` is the cell's set as bits. `up` is 1 or 2, for y or z.
pub(crate) fn write(
    path: &Path,
    image: &CubeImage,
    visible: &[u64],
    up: usize,
) -> Result<(), MeasureError> {
    let failed = |reason: String| MeasureError::Image {
        path: path.to_owned(),
        reason,
    };
    let mut file = NewFile::begin(path, Access::Shared).map_err(|e| failed(e.to_string()))?;
    let [wide, high] = SIZE;
    let mut encoder = png::Encoder::new(&mut file, wide, high);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder
        .set_animated(STEPS, 0)
        .map_err(|e| failed(e.to_string()))?;
    encoder
        .set_frame_delay(1, RATE)
        .map_err(|e| failed(e.to_string()))?;
    let mut writer = encoder.write_header().map_err(|e| failed(e.to_string()))?;
    for step in 0..STEPS {
        let picture = picture(
            image,
            visible,
            up,
            std::f32::consts::TAU * step as f32 / STEPS as f32,
        );
        writer
            .write_image_data(&picture)
            .map_err(|e| failed(e.to_string()))?;
    }
    writer.finish().map_err(|e| failed(e.to_string()))?;
    file.commit().map_err(|e| failed(e.to_string()))
}

/// Returns the picture of the camera after a turn by an angle.
fn picture(image: &CubeImage, visible: &[u64], up: usize, angle: f32) -> Vec<u8> {
    let [wide, high] = SIZE;
    let vertical = if up == 2 { Vec3::Z } else { Vec3::Y };
    let ahead = if up == 2 { Vec3::Y } else { Vec3::NEG_Z };
    let forward = ahead * angle.cos() + ahead.cross(vertical) * angle.sin();
    // The frame is a cube around the viewpoint, which has directions and no position.
    let camera = Camera::new(Vec3::ZERO, forward, vertical, SIZE, SPREAD);
    let mut out = Vec::with_capacity((wide * high * 3) as usize);
    for y in 0..high {
        for x in 0..wide {
            out.extend(colour(image.id_along(camera.ray(x, y)), visible));
        }
    }
    out
}
