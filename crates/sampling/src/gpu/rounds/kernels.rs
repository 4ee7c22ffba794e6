//! The compute pipelines of a block's rounds, and the layouts of their bindings.

use rayon::prelude::*;

use super::super::line_scene::LineScene;
use super::super::pipelines::{buffer, entry, scoped};

/// Storage buffers that a kernel binds: the scene's six, the block's nine and the lists' thirteen.
pub(super) const STORAGE_BUFFERS: u32 = 28;

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
    GatherAimed,
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

/// Every kernel in the order of [`Kernel`], with the name of its entry point.
pub(super) const ENTRY_POINTS: [&str; 26] = [
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
    "gather_aimed",
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

/// Pipelines for the blocks of one scene.
pub(in super::super) struct Kernels {
    pipelines: Vec<wgpu::ComputePipeline>,
    pub(super) tables_layout: wgpu::BindGroupLayout,
    pub(super) lists_layout: wgpu::BindGroupLayout,
}

impl Kernels {
    /// Compiles the kernels. `halves` and `one_way` are the constants of `cast.wgsl`.
    ///
    /// # Errors
    /// The device's message.
    pub(super) fn new(
        device: &wgpu::Device,
        scene: &LineScene,
        (halves, one_way): (bool, bool),
    ) -> Result<Self, String> {
        let stage = wgpu::ShaderStages::COMPUTE;
        let storage = |read_only| buffer(wgpu::BufferBindingType::Storage { read_only }, false);
        let uniform = |dynamic| buffer(wgpu::BufferBindingType::Uniform, dynamic);
        let layout_of = |label, types: &[wgpu::BindingType]| {
            let entries: Vec<_> = (0..).zip(types).map(|(i, ty)| entry(i, stage, *ty)).collect();
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(label),
                entries: &entries,
            })
        };
        scoped(device, || {
            let [read, write] = [storage(true), storage(false)];
            let tables = layout_of(
                "tables",
                &[uniform(false), read, write, write, read, read, read, read, read, write],
            );
            let mut of_lists = vec![uniform(true), read];
            of_lists.resize(14, write);
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
            let mut constants = scene.constants.to_vec();
            constants
                .extend([("HALVES", f64::from(u8::from(halves))), ("ONE_WAY", f64::from(u8::from(one_way)))]);
            // Compiling takes a driver most of the time that a small block takes, so all threads do it.
            let pipelines = ENTRY_POINTS
                .par_iter()
                .map(|name| {
                    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                        label: Some(name),
                        layout: Some(&layout),
                        module: &module,
                        entry_point: Some(name),
                        compilation_options: wgpu::PipelineCompilationOptions {
                            constants: &constants,
                            ..Default::default()
                        },
                        cache: None,
                    })
                })
                .collect();
            Ok(Self { pipelines, tables_layout: tables, lists_layout: lists })
        })
    }

    pub(super) fn pipeline(&self, kernel: Kernel) -> &wgpu::ComputePipeline {
        &self.pipelines[kernel as usize]
    }
}
