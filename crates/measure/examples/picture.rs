//! Draws a scene from outside with the set of one view cell. The triangles of the set are in colour, the
//! others are grey, and the cell is a box.
//!
//! ```sh
//! cargo run --release -p sightline-measure --example picture -- \
//!     SCENE OUT.pvs CELL EX,EY,EZ TX,TY,TZ OUT.png
//! ```
//!
//! The eye is at EX,EY,EZ and looks at TX,TY,TZ, in the scene's units and axes; y is up. The picture is
//! sampled from a cube of item buffers, so that the eye sees the same triangles as the error measures.

use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use sightline_pvs::Pvs;
use sightline_trace::cpu::CpuBackend;
use sightline_trace::{CubeSpec, SKY, Strata, Tracer as _};

const SIZE: [u32; 2] = [1200, 700];
/// The number of fine pixels along each axis that are averaged to one pixel.
const FINE: u32 = 2;
/// Half the width of the picture at distance 1 from the eye.
const SPREAD: f32 = 0.62;
const SKY_COLOR: Vec3 = Vec3::new(0.93, 0.96, 1.0);
const SEEN: Vec3 = Vec3::new(0.98, 0.55, 0.12);
const OTHER: Vec3 = Vec3::new(0.72, 0.74, 0.77);
const BOX: Vec3 = Vec3::new(0.05, 0.25, 0.85);
/// Half the width of a line of the box, in fine pixels.
const PEN: f32 = 3.0;

fn point(text: &str) -> Result<Vec3, Box<dyn std::error::Error>> {
    let parts = text
        .split(',')
        .map(str::parse)
        .collect::<Result<Vec<f32>, _>>()?;
    Ok(Vec3::from_array(
        parts
            .try_into()
            .map_err(|_| "give three numbers as in 1,2,3")?,
    ))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, scene, result, cell, eye, target, out] = args.as_slice() else {
        return Err("usage: picture SCENE OUT.pvs CELL EX,EY,EZ TX,TY,TZ OUT.png".into());
    };
    let scene = Arc::new(sightline_scene::load(Path::new(scene))?);
    let pvs = Pvs::open(result)?;
    let cell: u32 = cell.parse()?;
    let mut set = Vec::new();
    pvs.visible(cell, &mut set)?;
    let bounds = pvs
        .cell_bounds(cell)
        .ok_or("the result has no cell with this number")?
        .map(Vec3::from);
    let (eye, target) = (point(eye)?, point(target)?);

    let forward = (target - eye).normalize();
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);
    let (wide, high) = (SIZE[0] * FINE, SIZE[1] * FINE);
    // Convert a fine pixel to its ray from the eye, and a point back to a pixel.
    let scale = 2.0 * SPREAD / wide as f32;
    let ray = |x: u32, y: u32| {
        let u = (x as f32 + 0.5 - wide as f32 / 2.0) * scale;
        let v = (high as f32 / 2.0 - y as f32 - 0.5) * scale;
        forward + right * u + up * v
    };
    let project = |p: Vec3| {
        let d = p - eye;
        let depth = d.dot(forward);
        (depth > 0.0).then(|| {
            let (u, v) = (d.dot(right) / depth, d.dot(up) / depth);
            [u / scale + wide as f32 / 2.0, high as f32 / 2.0 - v / scale]
        })
    };

    let spec = CubeSpec {
        resolution: 4096,
        strata: Strata::One,
        keep_pixels: false,
    };
    let backend = CpuBackend::new(Arc::clone(&scene), spec)?;
    let image = backend.prepare(None)?.image(eye)?;
    let light = Vec3::new(0.45, 0.8, 0.35).normalize();
    let mut fine: Vec<Vec3> = Vec::with_capacity((wide * high) as usize);
    for y in 0..high {
        for x in 0..wide {
            let d = ray(x, y);
            let id = image.id_along(d);
            fine.push(if id == SKY {
                SKY_COLOR
            } else {
                let [a, b, c] = scene.triangles()[id as usize].v;
                let normal = (b - a).cross(c - a).normalize_or_zero();
                let normal = if normal.dot(d) > 0.0 { -normal } else { normal };
                let shade = 0.55 + 0.45 * normal.dot(light).max(0.0);
                shade
                    * if set.binary_search(&id).is_ok() {
                        SEEN
                    } else {
                        OTHER
                    }
            });
        }
    }
    let corner = |k: usize| Vec3::from_array(std::array::from_fn(|a| bounds[k >> a & 1][a]));
    for (from, to) in (0..8)
        .flat_map(|k| [1, 2, 4].map(|bit| (k, k | bit)))
        .filter(|(k, l)| k != l)
    {
        let (Some([x0, y0]), Some([x1, y1])) = (project(corner(from)), project(corner(to))) else {
            continue;
        };
        let steps = (x1 - x0).abs().max((y1 - y0).abs()).ceil().max(1.0);
        for step in 0..=steps as u32 {
            let t = step as f32 / steps;
            let (x, y) = (x0 + (x1 - x0) * t, y0 + (y1 - y0) * t);
            for (px, py) in around(x, y) {
                if px < wide && py < high {
                    fine[(py * wide + px) as usize] = BOX;
                }
            }
        }
    }
    let mut pixels = Vec::with_capacity((SIZE[0] * SIZE[1] * 3) as usize);
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            let mut sum = Vec3::ZERO;
            for (i, j) in (0..FINE).flat_map(|i| (0..FINE).map(move |j| (i, j))) {
                sum += fine[((y * FINE + j) * wide + x * FINE + i) as usize];
            }
            pixels.extend(
                (sum / (FINE * FINE) as f32)
                    .to_array()
                    .map(|c| (c.clamp(0.0, 1.0) * 255.0) as u8),
            );
        }
    }
    let mut encoder = png::Encoder::new(std::fs::File::create(out)?, SIZE[0], SIZE[1]);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    encoder.write_header()?.write_image_data(&pixels)?;
    Ok(())
}

/// Returns the fine pixels under a pen at a position.
fn around(x: f32, y: f32) -> impl Iterator<Item = (u32, u32)> {
    let range = |c: f32| (c - PEN).max(0.0) as u32..=(c + PEN).max(0.0) as u32;
    range(y).flat_map(move |py| range(x).map(move |px| (px, py)))
}
