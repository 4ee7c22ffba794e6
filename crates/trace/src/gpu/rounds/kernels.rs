//! The compute pipelines of a block's rounds, and the layouts of their bindings.

use rayon::prelude::*;

use crate::gpu::line_scene::DeviceLineScene;
use crate::gpu::pipelines::{DeviceFault, buffer, entry, scoped_by_kind};

/// The number of storage buffers that a kernel binds: the scene's six, the block's ten and the lists'
/// fourteen.
pub(super) const STORAGE_BUFFERS: u32 = 30;

/// The kernels, by their entry points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kernel {
    MakeUniform,
    TraceRays,
    CreditLines,
    ClaimUniform,
    GatherUniform,
    ClaimNext,
    MakeFlood,
    ClaimFlood,
    GatherFlood,
    PlaceItems,
    CountCandidates,
    ListCandidates,
    MakeAimed,
    ClaimAimed,
    GatherAimed,
    MakeAimedFlood,
    MakeSeeds,
    MakeCheck,
    GatherCheck,
    GatherWords,
    PutWords,
    GatherPairs,
    PutPairs,
    JoinLines,
    CheckPairs,
    CountAims,
    MakeSegments,
    GatherSegments,
}

/// The names of the entry points, in the order of [`Kernel`].
pub(super) const ENTRY_POINTS: [&str; 28] = [
    "make_uniform",
    "trace_rays",
    "credit_lines",
    "claim_uniform",
    "gather_uniform",
    "claim_next",
    "make_flood",
    "claim_flood",
    "gather_flood",
    "place_items",
    "count_candidates",
    "list_candidates",
    "make_aimed",
    "claim_aimed",
    "gather_aimed",
    "make_aimed_flood",
    "make_seeds",
    "make_check",
    "gather_check",
    "gather_words",
    "put_words",
    "gather_pairs",
    "put_pairs",
    "join_lines",
    "check_pairs",
    "count_aims",
    "make_segments",
    "gather_segments",
];

const SOURCE: &str = concat!(
    include_str!("../traverse.wgsl"),
    include_str!("block.wgsl"),
    include_str!("cast.wgsl"),
    include_str!("uniform.wgsl"),
    include_str!("candidates.wgsl"),
    include_str!("others.wgsl"),
    include_str!("join.wgsl"),
);

/// The pipelines for the blocks of a scene.
pub(super) struct Kernels {
    pipelines: Vec<wgpu::ComputePipeline>,
    pub(super) tables_layout: wgpu::BindGroupLayout,
    pub(super) lists_layout: wgpu::BindGroupLayout,
}

impl Kernels {
    /// Compiles the kernels. `halves` and `one_way` are the constants of `cast.wgsl`.
    ///
    /// # Errors
    /// [`DeviceFault`] if the device cannot compile the kernels.
    pub(super) fn new(
        device: &wgpu::Device,
        scene: &DeviceLineScene,
        halves: bool,
        one_way: bool,
    ) -> Result<Self, DeviceFault> {
        let flags = [("HALVES", halves), ("ONE_WAY", one_way)]
            .map(|(name, is)| (name, f64::from(u8::from(is))));
        Self::with(device, scene, &[&scene.constants[..], &flags].concat())
    }

    /// Compiles the kernels with all constants of the shaders.
    pub(super) fn with(
        device: &wgpu::Device,
        scene: &DeviceLineScene,
        constants: &[(&str, f64)],
    ) -> Result<Self, DeviceFault> {
        let stage = wgpu::ShaderStages::COMPUTE;
        let storage = |read_only| buffer(wgpu::BufferBindingType::Storage { read_only }, false);
        let uniform = |dynamic| buffer(wgpu::BufferBindingType::Uniform, dynamic);
        let layout_of = |label, types: &[wgpu::BindingType]| {
            let entries: Vec<_> = (0..)
                .zip(types)
                .map(|(i, ty)| entry(i, stage, *ty))
                .collect();
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(label),
                entries: &entries,
            })
        };
        scoped_by_kind(device, || {
            let [read, write] = [storage(true), storage(false)];
            let [own, shared] = [uniform(false), uniform(true)];
            let of_tables = [
                own, read, write, write, read, read, read, read, read, write, read,
            ];
            let tables = layout_of("tables", &of_tables);
            let mut of_lists = vec![shared, read];
            of_lists.resize(15, write);
            let lists = layout_of("lists", &of_lists);
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("rounds"),
                bind_group_layouts: &[Some(&scene.layout), Some(&tables), Some(&lists)],
                immediate_size: 0,
            });
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("rounds"),
                source: wgpu::ShaderSource::Wgsl(SOURCE.into()),
            });
            // Compiling needs most of the time of a small block, so all threads compile. Each thread watches
            // for errors itself.
            let pipelines = ENTRY_POINTS.par_iter().map(|name| {
                scoped_by_kind(device, || {
                    Ok(
                        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                            label: Some(name),
                            layout: Some(&layout),
                            module: &module,
                            entry_point: Some(name),
                            compilation_options: wgpu::PipelineCompilationOptions {
                                constants,
                                ..Default::default()
                            },
                            cache: None,
                        }),
                    )
                })
            });
            let pipelines = pipelines.collect::<Result<_, DeviceFault>>()?;
            Ok(Self {
                pipelines,
                tables_layout: tables,
                lists_layout: lists,
            })
        })
    }

    pub(super) fn pipeline(&self, kernel: Kernel) -> &wgpu::ComputePipeline {
        &self.pipelines[kernel as usize]
    }
}
