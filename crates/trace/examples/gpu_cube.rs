//! Measures the time of a cube on the GPU backend: `gpu_cube [resolution] [cubes] [triangles]`.
//!
//! The scene has random triangles in a box. The example renders the whole scene and a superset of 10 000
//! triangles. The printed digests are of the seen triangles: they are the same on every run of a profile.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use sightline_scene::{Object, Scene, Triangle};
use sightline_trace::gpu::{AdapterChoice, GpuBackend, adapters};
use sightline_trace::sequence::Hashed;
use sightline_trace::{CubeSpec, Strata, Tracer};

#[allow(clippy::print_stdout, reason = "this program's output is its purpose")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).map(|a| a.parse::<u32>());
    let mut argument = |default| arguments.next().unwrap_or(Ok(default));
    let (resolution, cubes, count) = (
        argument(256)?,
        argument(20)?.max(1),
        argument(100_000)?.max(1),
    );
    let mut random = Hashed::new(&[1]);
    let size = 2.0 * (count as f32).powf(-1.0 / 3.0);
    let triangles: Vec<Triangle> = (0..count)
        .map(|_| {
            let c = random.point();
            Triangle {
                v: [0; 3].map(|_| c + (random.point() - 0.5) * size),
            }
        })
        .collect();
    let points: Vec<Vec3> = (0..cubes).map(|_| random.point()).collect();
    let objects = vec![Object {
        name: "random".into(),
        first: 0,
        count,
    }];
    let scene = Arc::new(Scene::new("random", triangles, objects)?);
    for adapter in adapters() {
        println!("{adapter:?}");
    }
    let start = Instant::now();
    let spec = CubeSpec {
        resolution,
        strata: Strata::Faces,
        keep_pixels: false,
    };
    let backend = GpuBackend::new(scene, spec, AdapterChoice::AllowSoftware)?;
    println!(
        "{}: made in {:.0} ms",
        backend.profile(),
        start.elapsed().as_secs_f64() * 1e3
    );
    let stride = (count / 10_000).max(1);
    let superset: Vec<u32> = (0..count).step_by(stride as usize).take(10_000).collect();
    for (name, superset) in [
        ("whole scene", None),
        ("superset of 10 000", Some(superset.as_slice())),
    ] {
        let start = Instant::now();
        let renderer = backend.prepare(superset)?;
        let prepared = start.elapsed().as_secs_f64() * 1e3;
        renderer.samples(&points[..1])?;
        let start = Instant::now();
        let samples = renderer.samples(&points)?;
        let each = start.elapsed().as_secs_f64() * 1e3 / f64::from(cubes);
        let seen = samples.iter().map(|s| s.ids.len()).sum::<usize>() / samples.len();
        // FNV-1a over ids and strata.
        let words = samples.iter().flat_map(|s| s.ids.iter().chain(&s.strata));
        let digest = words.fold(0xcbf2_9ce4_8422_2325u64, |h, w| {
            (h ^ u64::from(*w)).wrapping_mul(0x0100_0000_01b3)
        });
        println!(
            "{name}: prepared in {prepared:.1} ms, {each:.2} ms a cube of {resolution}², {seen} seen, \
                {digest:016x}"
        );
    }
    Ok(())
}
