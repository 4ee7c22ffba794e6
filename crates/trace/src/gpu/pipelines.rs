//! Objects created once per device: pipelines, the atlas of the item buffers, and small uniform buffers.
//!
//! The six faces are in one texture, in two rows of three, so that a cube is one render pass with one clear.
//! Face f has its origin at column (f mod 3)·n, row (f div 3)·n.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::cube::face_basis;

/// Maximum number of cubes of a batch, as in `reduce.wgsl`.
pub(super) const CUBES: u32 = 64;

/// The number of bytes between the uniforms of two faces: the largest offset alignment that a device may
/// require.
pub(super) const FACE_STRIDE: u64 = 256;

/// Maximum side length of a face in pixels, from [`crate::CubeSpec`].
pub(super) const MAX_RESOLUTION: u32 = 4096;

/// The uniforms of one face, in the layout of `raster.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct FaceUniform {
    right: Vec3,
    near: f32,
    up: Vec3,
    unused_a: f32,
    forward: Vec3,
    unused_b: f32,
    eye: Vec3,
    unused_c: f32,
}

/// Returns the uniforms of the six faces of a cube around each of `eyes`, [`FACE_STRIDE`] bytes apart.
pub(super) fn face_uniforms(eyes: &[Vec3], near: f32) -> Vec<u8> {
    let mut bytes = vec![0; eyes.len() * 6 * FACE_STRIDE as usize];
    let faces = eyes
        .iter()
        .flat_map(|eye| (0..6).map(|face| (*eye, face_basis(face))));
    for ((eye, [forward, right, up]), to) in faces.zip(bytes.chunks_exact_mut(FACE_STRIDE as usize))
    {
        let uniform = FaceUniform {
            right,
            near,
            up,
            forward,
            eye,
            ..FaceUniform::zeroed()
        };
        to[..size_of::<FaceUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
    }
    bytes
}

/// A fault that a device has reported.
#[derive(Clone, Debug)]
pub(super) enum DeviceFault {
    /// The device's memory is full. A later attempt may succeed.
    Memory(String),
    /// The device does not support the request, now or later.
    Refused(String),
}

impl DeviceFault {
    /// Returns the device's message.
    pub(super) fn into_message(self) -> String {
        match self {
            Self::Memory(message) | Self::Refused(message) => message,
        }
    }
}

/// Runs `make` and returns the first error that the device reports about it. Work of `make` in other threads
/// is not observed.
pub(super) fn scoped<T>(
    device: &wgpu::Device,
    make: impl FnOnce() -> Result<T, String>,
) -> Result<T, String> {
    scoped_by_kind(device, || make().map_err(DeviceFault::Refused))
        .map_err(DeviceFault::into_message)
}

/// Runs `make` like [`scoped`], and returns the kind of the error.
pub(super) fn scoped_by_kind<T>(
    device: &wgpu::Device,
    make: impl FnOnce() -> Result<T, DeviceFault>,
) -> Result<T, DeviceFault> {
    let internal = device.push_error_scope(wgpu::ErrorFilter::Internal);
    let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
    let validation = device.push_error_scope(wgpu::ErrorFilter::Validation);
    let made = make();
    // Every scope is popped, innermost first, even if one contains an error.
    let [invalid, full, broken] =
        [validation, memory, internal].map(|scope| pollster::block_on(scope.pop()));
    // A buffer for which there was no memory is invalid at its use.
    match (full, invalid.or(broken)) {
        (Some(error), _) => Err(DeviceFault::Memory(error.to_string())),
        (None, Some(error)) => Err(DeviceFault::Refused(error.to_string())),
        (None, None) => made,
    }
}

/// The pipelines and targets for one resolution.
pub(super) struct Kit {
    pub(super) raster: wgpu::RenderPipeline,
    pub(super) reduce: wgpu::ComputePipeline,
    pub(super) gather: wgpu::ComputePipeline,
    pub(super) close: wgpu::ComputePipeline,
    pub(super) tally_layout: wgpu::BindGroupLayout,
    pub(super) items: wgpu::Texture,
    pub(super) items_view: wgpu::TextureView,
    pub(super) depth_view: wgpu::TextureView,
    /// The uniforms of the faces of a batch of cubes, and their binding.
    pub(super) faces: wgpu::Buffer,
    pub(super) faces_group: wgpu::BindGroup,
    /// The parameters of the reduction.
    pub(super) params: wgpu::Buffer,
}

impl Kit {
    /// Creates pipelines and targets for faces of `n` by `n` pixels.
    pub(super) fn new(device: &wgpu::Device, n: u32) -> Self {
        let raster_code = device.create_shader_module(wgpu::include_wgsl!("raster.wgsl"));
        let reduce_code = device.create_shader_module(wgpu::include_wgsl!("reduce.wgsl"));
        let faces_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("faces"),
            entries: &[entry(
                0,
                wgpu::ShaderStages::VERTEX,
                buffer(wgpu::BufferBindingType::Uniform, true),
            )],
        });
        let storage = buffer(wgpu::BufferBindingType::Storage { read_only: false }, false);
        let items_binding = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Uint,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let stage = wgpu::ShaderStages::COMPUTE;
        let tally_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("tally"),
            entries: &[
                entry(0, stage, items_binding),
                entry(1, stage, storage),
                entry(2, stage, storage),
                entry(3, stage, storage),
                entry(4, stage, buffer(wgpu::BufferBindingType::Uniform, false)),
            ],
        });
        let faces = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("faces"),
            size: 6 * FACE_STRIDE * u64::from(CUBES),
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let faces_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("faces"),
            layout: &faces_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer: &faces,
                    offset: 0,
                    size: wgpu::BufferSize::new(size_of::<FaceUniform>() as u64),
                }),
            }],
        });
        let params = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("reduction"),
            size: 16,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let target = |label, format, usage| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width: 3 * n,
                    height: 2 * n,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: usage | wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            })
        };
        let items = target(
            "items",
            wgpu::TextureFormat::R32Uint,
            wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_SRC,
        );
        let depth = target(
            "depth",
            wgpu::TextureFormat::Depth32Float,
            wgpu::TextureUsages::empty(),
        );
        let compute = |entry_point| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: Some(&layout(device, &tally_layout)),
                module: &reduce_code,
                entry_point: Some(entry_point),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        };
        Self {
            raster: raster_pipeline(device, &raster_code, &layout(device, &faces_layout)),
            reduce: compute("reduce"),
            gather: compute("gather"),
            close: compute("close"),
            items_view: items.create_view(&wgpu::TextureViewDescriptor::default()),
            depth_view: depth.create_view(&wgpu::TextureViewDescriptor::default()),
            tally_layout,
            items,
            faces,
            faces_group,
            params,
        }
    }
}

/// Creates the pipeline that draws both sides of every triangle.
///
/// Reversed depth is cleared to 0 and compared with "greater", so the nearest triangle wins. Of two triangles
/// at the same depth the first triangle drawn wins.
fn raster_pipeline(
    device: &wgpu::Device,
    code: &wgpu::ShaderModule,
    layout: &wgpu::PipelineLayout,
) -> wgpu::RenderPipeline {
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("item buffer"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module: code,
            entry_point: Some("corner"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: 12,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &wgpu::vertex_attr_array![0 => Float32x3],
            })],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: wgpu::TextureFormat::Depth32Float,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: code,
            entry_point: Some("item"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(wgpu::TextureFormat::R32Uint.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn layout(device: &wgpu::Device, group: &wgpu::BindGroupLayout) -> wgpu::PipelineLayout {
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(group)],
        immediate_size: 0,
    })
}

pub(super) fn buffer(ty: wgpu::BufferBindingType, has_dynamic_offset: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty,
        has_dynamic_offset,
        min_binding_size: None,
    }
}

pub(super) fn entry(
    binding: u32,
    visibility: wgpu::ShaderStages,
    ty: wgpu::BindingType,
) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty,
        count: None,
    }
}
