//! The scene of the line tracer on the device: hierarchy, triangles and pipeline, in the layout of
//! `traverse.wgsl`. The module `tracer.rs` traces lines through the scene, and `rounds` casts whole rounds.
//!
//! **Limits.** A storage binding may be as small as 128 MiB, so nodes and triangles are each distributed over
//! up to [`PAGES`] bindings. A scene that still does not fit is rejected with an error that names the limit.

use std::sync::OnceLock;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::{Aabb, Scene, Triangle, TriangleId};

use super::nodes::{DeviceHierarchy, DeviceNode};
use super::pipelines::{buffer, entry, scoped};

/// The number of bindings for the nodes, and for the triangles. With rays and hits these are eight storage
/// bindings, which every device supports.
const PAGES: u64 = 3;
const NODE_BYTES: u64 = size_of::<DeviceNode>() as u64;
const CORNERS_BYTES: u64 = size_of::<Corners>() as u64;
/// The number of bytes that are converted and written at a time.
const PIECE: usize = 1 << 20;

/// The reason why lines cannot be traced.
#[derive(Clone, Debug)]
pub(super) enum Refusal {
    /// The scene does not fit this device.
    Unavailable(String),
    /// The device reported an error.
    Failed(String),
}

/// A triangle in the shader's layout: its scaled vertices, its id and the number of its side.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Corners {
    a: Vec3,
    id: u32,
    b: Vec3,
    side: u32,
    c: Vec3,
    unused_c: u32,
}

/// The uniform `Scene` in `traverse.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Uniform {
    low: Vec3,
    scale: f32,
    high: Vec3,
    unscale: f32,
    near: f32,
    unused: [u32; 3],
}

/// A scene on the device, with its hierarchy and bindings.
pub(super) struct DeviceLineScene {
    pipeline: OnceLock<Result<wgpu::ComputePipeline, String>>,
    /// The scene's bindings.
    pub(super) group: wgpu::BindGroup,
    /// The layout of the scene's bindings.
    pub(super) layout: wgpu::BindGroupLayout,
    /// The constants of `traverse.wgsl`.
    pub(super) constants: [(&'static str, f64); 4],
    /// The layout of the rays' bindings.
    pub(super) rays_layout: wgpu::BindGroupLayout,
    /// True if the scene has no triangle to hit.
    pub(super) empty: bool,
}

/// Returns the largest power of two that is at most `x`, and its inverse. Both are normal numbers. For
/// extreme `x`, returns the nearest such power.
fn power_below(x: f32) -> (f32, f32) {
    let exponent = ((x.to_bits() >> 23) & 0xff).clamp(1, 253);
    (
        f32::from_bits(exponent << 23),
        f32::from_bits((254 - exponent) << 23),
    )
}

impl DeviceLineScene {
    /// Builds the hierarchy over the triangles `distinct` of `scene` and copies it to the device, with at
    /// most `page_bytes` bytes per binding.
    ///
    /// # Errors
    /// [`Refusal::Unavailable`] if the scene does not fit, [`Refusal::Failed`] if the device reports an
    /// error.
    pub(super) fn new(
        device: &wgpu::Device,
        scene: &Scene,
        distinct: &[u32],
        page_bytes: u64,
    ) -> Result<Self, Refusal> {
        let bounds = scene.bounds();
        let (unscale, scale) = power_below(bounds.min.abs().max(bounds.max.abs()).max_element());
        let scaled = |id: u32| scene.triangles()[id as usize].v.map(|v| v * scale);
        // Ids that the scene lacks are ignored.
        let with_area = |id: &u32| {
            scene
                .triangles()
                .get(*id as usize)
                .is_some_and(|t| !t.is_degenerate())
        };
        let ids: Vec<u32> = distinct.par_iter().copied().filter(with_area).collect();
        let limits = device.limits();
        let page_bytes = page_bytes
            .min(limits.max_storage_buffer_binding_size)
            .min(limits.max_buffer_size);
        // The number is even, so that siblings are in the same page.
        let node_page = (page_bytes / (2 * NODE_BYTES) * 2).max(2);
        let triangle_page = (page_bytes / CORNERS_BYTES).max(1);
        let fits = |what: &str, count: usize, page: u64| {
            if count as u64 <= PAGES * page {
                return Ok(());
            }
            Err(Refusal::Unavailable(format!(
                "tracing lines needs {count} {what} on the device, which binds at most {PAGES} times {page} \
                 ({page_bytes} bytes a storage binding); use --backend cpu, or a device with larger bindings"
            )))
        };
        fits("triangles", ids.len(), triangle_page)?;
        let boxes: Vec<Aabb> = ids
            .par_iter()
            .map(|id| Triangle { v: scaled(*id) }.bounds())
            .collect();
        let bvh = DeviceHierarchy::build(&boxes)
            .map_err(|why| Refusal::Unavailable(format!("{why}; use --backend cpu")))?;
        drop(boxes);
        fits("nodes", bvh.nodes.len(), node_page)?;

        let root = bvh.nodes.first().copied().unwrap_or(DeviceNode::zeroed());
        let uniform = Uniform {
            low: root.low,
            scale,
            high: root.high,
            unscale,
            near: crate::near_distance(bounds) * scale,
            unused: [0; 3],
        };
        let corners = |place: &u32| {
            let id = ids[*place as usize];
            let [a, b, c] = scaled(id);
            Corners {
                a,
                id,
                b,
                side: scene.sides().side(TriangleId(id)) as u32,
                c,
                unused_c: 0,
            }
        };
        scoped(device, || {
            let nodes = pages(device, "line nodes", &bvh.nodes, node_page, |n| *n)?;
            let triangles = pages(device, "line triangles", &bvh.order, triangle_page, corners)?;
            let one_sided = !scene.sides().are_both();
            let scene = filled(
                device,
                "line scene",
                wgpu::BufferUsages::UNIFORM,
                &[uniform],
                |u| *u,
            )?;
            let paged = nodes.len() > 1 || triangles.len() > 1;
            // Every binding needs a buffer. Unused bindings have the first page, and the shader does not read
            // them.
            let page = |pages: &[wgpu::Buffer], i: usize| pages.get(i).or(pages.first()).cloned();
            let mut bound = vec![scene];
            for pages in [&nodes, &triangles] {
                bound.extend((0..PAGES as usize).filter_map(|i| page(pages, i)));
            }
            Ok(Self::bind(
                device,
                &bound,
                [
                    ("PAGED", f64::from(u8::from(paged))),
                    ("NODE_PAGE", node_page as f64),
                    ("TRIANGLE_PAGE", triangle_page as f64),
                    ("CULL", f64::from(u8::from(one_sided))),
                ],
            ))
        })
        .map(|made| Self {
            empty: ids.is_empty(),
            ..made
        })
        .map_err(Refusal::Failed)
    }

    /// Creates the scene's bindings from `bound`, in the shader's order, and the shader's `constants`.
    fn bind(
        device: &wgpu::Device,
        bound: &[wgpu::Buffer],
        constants: [(&'static str, f64); 4],
    ) -> Self {
        let stage = wgpu::ShaderStages::COMPUTE;
        let storage = |read_only| buffer(wgpu::BufferBindingType::Storage { read_only }, false);
        let uniform = buffer(wgpu::BufferBindingType::Uniform, false);
        let entries: Vec<_> = (0..bound.len() as u32)
            .map(|i| entry(i, stage, if i == 0 { uniform } else { storage(true) }))
            .collect();
        let layout_of = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(label),
                entries,
            })
        };
        let scene_layout = layout_of("line scene", &entries);
        let rays_layout = layout_of(
            "rays",
            &[
                entry(0, stage, storage(true)),
                entry(1, stage, storage(false)),
            ],
        );
        let entries: Vec<_> = (0..)
            .zip(bound)
            .map(|(binding, b)| wgpu::BindGroupEntry {
                binding,
                resource: b.as_entire_binding(),
            })
            .collect();
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("line scene"),
            layout: &scene_layout,
            entries: &entries,
        });
        let pipeline = OnceLock::new();
        Self {
            pipeline,
            group,
            layout: scene_layout,
            constants,
            rays_layout,
            empty: false,
        }
    }

    /// Returns the pipeline of packets, which the first call creates. Whole rounds on the device do not need
    /// it.
    ///
    /// # Errors
    /// The device's message if the pipeline cannot be created.
    pub(super) fn pipeline(&self, device: &wgpu::Device) -> Result<&wgpu::ComputePipeline, String> {
        let make = || {
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("lines"),
                bind_group_layouts: &[Some(&self.layout), Some(&self.rays_layout)],
                immediate_size: 0,
            });
            let source = concat!(include_str!("traverse.wgsl"), include_str!("trace.wgsl"));
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("lines"),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            });
            Ok(
                device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some("lines"),
                    layout: Some(&layout),
                    module: &module,
                    entry_point: Some("trace"),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &self.constants,
                        ..Default::default()
                    },
                    cache: None,
                }),
            )
        };
        self.pipeline
            .get_or_init(|| scoped(device, make))
            .as_ref()
            .map_err(Clone::clone)
    }
}

/// Creates buffers with the converted `items`, `page` items in each. Without items, creates one small buffer.
fn pages<T: Sync, P: Pod + Send>(
    device: &wgpu::Device,
    label: &str,
    items: &[T],
    page: u64,
    convert: impl Fn(&T) -> P + Sync,
) -> Result<Vec<wgpu::Buffer>, String> {
    if items.is_empty() {
        return Ok(vec![filled(
            device,
            label,
            wgpu::BufferUsages::STORAGE,
            &[()],
            |()| P::zeroed(),
        )?]);
    }
    // A page larger than the address space contains all items.
    let page = usize::try_from(page).unwrap_or(usize::MAX);
    items
        .chunks(page)
        .map(|run| filled(device, label, wgpu::BufferUsages::STORAGE, run, &convert))
        .collect()
}

/// Creates a buffer with the converted `items`.
pub(super) fn filled<T: Sync, P: Pod + Send>(
    device: &wgpu::Device,
    label: &str,
    usage: wgpu::BufferUsages,
    items: &[T],
    convert: impl Fn(&T) -> P + Sync,
) -> Result<wgpu::Buffer, String> {
    let made = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: (items.len() * size_of::<P>()) as u64,
        usage,
        mapped_at_creation: true,
    });
    {
        let mut view = made.get_mapped_range_mut(..).map_err(|e| e.to_string())?;
        let mut at = 0;
        for piece in items.chunks(PIECE / size_of::<P>().max(1)) {
            let run: Vec<P> = piece.par_iter().map(&convert).collect();
            let bytes: &[u8] = bytemuck::cast_slice(&run);
            view.slice(at..at + bytes.len()).copy_from_slice(bytes);
            at += bytes.len();
        }
    }
    made.unmap();
    Ok(made)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_exact_inverses() {
        for x in [1e-45f32, 1e-30, 0.75, 1.0, 1.5, 3e7, 1e30, f32::MAX] {
            let (unscale, scale) = power_below(x);
            assert!(
                (scale * unscale - 1.0).abs() < f32::EPSILON
                    && scale.is_normal()
                    && unscale.is_normal()
            );
            assert!(x < 1e-37 || (0.999..4.0).contains(&(x * scale)));
        }
    }
}
