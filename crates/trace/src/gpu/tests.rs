//! Tests of the raster path that need private items: paging, and the loss of the device.

use glam::Vec3;
use sightline_scene::Object;

use super::pipelines::MAX_RESOLUTION;
use super::*;
use crate::cube::Strata;

/// Returns small triangles around the origin, the same at every call.
fn shell(count: u32) -> Arc<Scene> {
    let triangles: Vec<_> = (0..count)
        .map(|i| {
            let a = i as f32 * 2.399_963;
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
            let r = (1.0 - z * z).sqrt();
            let c = Vec3::new(r * a.cos(), r * a.sin(), z) * (2.0 + (i % 7) as f32 * 0.3);
            sightline_scene::Triangle {
                v: [
                    c,
                    c + Vec3::new(0.3, 0.1, 0.2),
                    c + Vec3::new(-0.1, 0.25, -0.2),
                ],
            }
        })
        .collect();
    let objects = vec![Object {
        name: "shell".into(),
        first: 0,
        count,
    }];
    Arc::new(Scene::new("shell", triangles, objects).expect("valid"))
}

const SPEC: CubeSpec = CubeSpec {
    resolution: 48,
    strata: Strata::Quadrants,
    keep_pixels: false,
};

fn backend(scene: &Arc<Scene>, page_bytes: u64) -> Option<GpuBackend> {
    match GpuBackend::with_pages(
        scene.clone(),
        SPEC,
        &AdapterChoice::AllowSoftware,
        page_bytes,
    ) {
        Ok(backend) => Some(backend),
        Err(TracerError::Unavailable(why)) if std::env::var_os("CI").is_none() => {
            println!("not run: {why}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Checks that the division of triangles into buffers and draw calls, and the culling of clusters, change no
/// bit.
#[test]
fn pages_and_draws_do_not_change_pixels() {
    let scene = shell(1000);
    let (Some(one), Some(many)) = (backend(&scene, PAGE_BYTES), backend(&scene, 1)) else {
        return;
    };
    let eyes = [
        Vec3::ZERO,
        Vec3::new(2.2, 0.3, -0.4),
        Vec3::new(0.0, -5.0, 40.0),
    ];
    let expected = one.prepare(None).unwrap().samples(&eyes).unwrap();
    assert!(expected.iter().all(|s| !s.ids.is_empty()));
    for backend in [&one, &many] {
        for style in [DrawStyle::HARDWARE, DrawStyle::SOFTWARE] {
            let ids = backend.drawn().unwrap().whole.ids.clone();
            let geometry = Geometry::upload(
                &backend.gpu.device,
                scene.triangles(),
                ids,
                backend.page_bytes,
                style,
            )
            .unwrap();
            let renderer =
                GpuRenderer::new(&backend.gpu, &backend.buffers, Arc::new(geometry)).unwrap();
            assert_eq!(expected, renderer.samples(&eyes).unwrap(), "{style:?}");
            for (eye, sample) in eyes.iter().zip(&expected) {
                let image = renderer.image(*eye).unwrap();
                assert_eq!(
                    *sample,
                    crate::cube::sample_of_image(&image, SPEC.strata, false)
                );
            }
        }
    }
}

#[test]
fn lost_device_is_error() {
    let Some(backend) = backend(&shell(200), PAGE_BYTES) else {
        return;
    };
    let renderer = backend.prepare(None).unwrap();
    renderer.samples(&[Vec3::ZERO]).unwrap();
    backend.gpu.device.destroy();
    for _ in 0..2 {
        let error = renderer.samples(&[Vec3::ZERO; 6]).unwrap_err();
        assert!(matches!(error, TracerError::Failed { .. }), "{error}");
    }
    assert!(backend.prepare(Some(&[1, 2])).is_err());
}

/// Checks that the next backend with the same choice uses a returned device, unless the device has failed.
#[test]
fn next_backend_uses_returned_device() {
    let scene = shell(10);
    let Some(any) = backend(&scene, PAGE_BYTES) else {
        return;
    };
    let Some(first) = adapters().first().cloned() else {
        panic!("an adapter without a summary")
    };
    // No other test uses this choice.
    let choice = AdapterChoice::Named(first.name[..first.name.len() - 1].to_owned());
    drop(any);
    for lost in [false, true] {
        let backend = GpuBackend::new(scene.clone(), SPEC, choice.clone()).unwrap();
        backend
            .prepare(None)
            .unwrap()
            .samples(&[Vec3::ZERO])
            .unwrap();
        if lost {
            backend.gpu.device.destroy();
            backend
                .prepare(None)
                .unwrap()
                .samples(&[Vec3::ZERO])
                .unwrap_err();
        }
        drop(backend);
        let spare = spare::take(&choice);
        assert_eq!(spare.is_some(), !lost);
        spare.map_or_else(spare::none_opened, spare::give_back);
    }
}

#[test]
fn impossible_requests_are_rejected_with_reason() {
    let scene = shell(10);
    for resolution in [0, MAX_RESOLUTION + 1, u32::MAX] {
        let spec = CubeSpec { resolution, ..SPEC };
        let refused = GpuBackend::new(scene.clone(), spec, AdapterChoice::AllowSoftware);
        assert!(matches!(refused, Err(TracerError::Unavailable(_))));
    }
    let Some(backend) = backend(&scene, PAGE_BYTES) else {
        return;
    };
    assert!(backend.prepare(Some(&[10])).is_err());
    assert!(
        backend
            .prepare(None)
            .unwrap()
            .samples(&[Vec3::NAN])
            .is_err()
    );
    let named = GpuBackend::new(scene, SPEC, AdapterChoice::Named("no such adapter".into()));
    assert!(matches!(named, Err(TracerError::Unavailable(text)) if text.contains("there are")));
}
