//! Tests of the presence of numbers, flags and choices in a job's message. Each can have its smallest legal
//! value, and an absent one has its default.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::collections::{BTreeMap, BTreeSet};

use prost::Message as _;
use prost::bytes::BufMut as _;
use prost::encoding::{WireType, encode_key, encode_varint};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorSet};
use sightline_model::{JobSpec, SceneFacts};
use sightline_proto::v1;

/// A field of the job's message: its path, the values to test, and a job that may have the field.
struct Row {
    /// The names of the fields that lead to this field, separated by periods.
    path: &'static str,
    /// The smallest legal value.
    smallest: f64,
    /// A smaller value, which is rejected; `None` if no smaller value can be encoded.
    below: Option<f64>,
    /// The default of an absent field; `None` if absence has another meaning or is rejected.
    default: Option<f64>,
    /// The function that creates the job.
    job: fn() -> v1::JobSpec,
}

const UNIT: [f32; 6] = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0];

fn grid() -> v1::GridCells {
    let view_box = UNIT.to_vec();
    v1::GridCells {
        view_box,
        ..v1::GridCells::default()
    }
}

fn adaptive_cells() -> v1::Adaptive {
    v1::Adaptive {
        triangle_budget: Some(5),
        max_depth: None,
        view_box: UNIT.to_vec(),
    }
}

fn job(method: v1::visibility::Method) -> v1::JobSpec {
    let task = v1::Visibility {
        method: Some(method),
        ..v1::Visibility::default()
    };
    v1::JobSpec {
        scene: vec![7; 32],
        task: Some(v1::job_spec::Task::Visibility(task)),
    }
}

fn sampling(sampler: v1::sampling::Sampler) -> v1::Sampling {
    v1::Sampling {
        sampler: Some(sampler),
        ..v1::Sampling::default()
    }
}

fn aggressive(sampler: v1::sampling::Sampler) -> v1::JobSpec {
    job(v1::visibility::Method::Aggressive(v1::Aggressive {
        sampling: Some(sampling(sampler)),
        items: None,
        completion: None,
    }))
}

fn lines_of(cells: v1::lines::Cells) -> v1::sampling::Sampler {
    v1::sampling::Sampler::Lines(v1::Lines {
        cells: Some(cells),
        ..v1::Lines::default()
    })
}

fn cubes_of(cells: v1::cubes::Cells) -> v1::sampling::Sampler {
    v1::sampling::Sampler::Cubes(v1::Cubes {
        cells: Some(cells),
        ..v1::Cubes::default()
    })
}

fn lines() -> v1::JobSpec {
    aggressive(lines_of(v1::lines::Cells::Grid(grid())))
}

fn by_cost() -> v1::JobSpec {
    let budget = Some(v1::cells_by_cost::Budget::CellBudget(5));
    let cells_by_cost = Some(v1::CellsByCost {
        budget,
        ..v1::CellsByCost::default()
    });
    aggressive(lines_of(v1::lines::Cells::Grid(v1::GridCells {
        cells_by_cost,
        ..grid()
    })))
}

fn adaptive() -> v1::JobSpec {
    aggressive(lines_of(v1::lines::Cells::Adaptive(adaptive_cells())))
}

fn guided() -> v1::JobSpec {
    aggressive(v1::sampling::Sampler::Guided(v1::Guided {
        cells: Some(v1::guided::Cells::Grid(grid())),
        ..v1::Guided::default()
    }))
}

fn cubes() -> v1::JobSpec {
    let view_box = UNIT.to_vec();
    aggressive(cubes_of(v1::cubes::Cells::Grid(v1::CubeGrid {
        view_box,
        ..v1::CubeGrid::default()
    })))
}

fn deep_cubes() -> v1::JobSpec {
    aggressive(cubes_of(v1::cubes::Cells::Adaptive(adaptive_cells())))
}

fn exact() -> v1::JobSpec {
    job(v1::visibility::Method::Exact(v1::Exact {
        sampling: Some(sampling(lines_of(v1::lines::Cells::Grid(grid())))),
        ..v1::Exact::default()
    }))
}

fn portals() -> v1::JobSpec {
    job(v1::visibility::Method::Portals(v1::Portals {
        cells: Some(v1::portals::Cells::Grid(grid())),
        time_budget_ms: None,
    }))
}

fn ambient() -> v1::JobSpec {
    let (bytes, points, lights) = (Some(1000), Some(5), Some(2));
    let ambient = v1::Ambient {
        receivers: vec![9; 32],
        bytes,
        points,
        lights,
    };
    v1::JobSpec {
        scene: vec![7; 32],
        task: Some(v1::job_spec::Task::Ambient(ambient)),
    }
}

const fn row(
    path: &'static str,
    smallest: f64,
    below: Option<f64>,
    default: Option<f64>,
    job: fn() -> v1::JobSpec,
) -> Row {
    Row {
        path,
        smallest,
        below,
        default,
        job,
    }
}

/// The rows for every number, flag and named value of a job.
#[rustfmt::skip]
const ROWS: &[Row] = &[
    row("visibility.far", f32::MIN_POSITIVE as f64, Some(0.0), None, lines),
    row("visibility.cell_to_cell", 0.0, None, Some(0.0), lines),
    row("visibility.seed", 0.0, None, Some(0.0), lines),
    // 0 is the name of an unknown axis, as in all enums of proto3 without a default.
    row("visibility.up", 1.0, None, None, lines),
    row("visibility.aggressive.items", 0.0, None, Some(0.0), lines),
    row("visibility.aggressive.completion", 0.0, None, Some(1.0), lines),
    row("visibility.exact.effort", 0.0, None, Some(0.0), exact),
    row("visibility.exact.certificates", 0.0, None, Some(0.0), exact),
    row("visibility.exact.sampling.lines.grid.tile_cells", 1.0, Some(0.0), Some(8.0), exact),
    row("visibility.portals.time_budget_ms", 1.0, Some(0.0), None, portals),
    row("visibility.portals.grid.tile_cells", 1.0, Some(0.0), Some(64.0), portals),
    row("visibility.aggressive.sampling.backend", 0.0, None, Some(0.0), lines),
    row("visibility.aggressive.sampling.contributions", 0.0, None, Some(0.0), lines),
    row("visibility.aggressive.sampling.lines.target_error", 1e-6, Some(0.0), Some(1e-4), lines),
    row("visibility.aggressive.sampling.lines.max_error", 1e-5, Some(0.0), None, lines),
    row("visibility.aggressive.sampling.lines.min_share", 1e-6, Some(0.0), None, lines),
    row("visibility.aggressive.sampling.lines.time_budget_ms", 1.0, Some(0.0), None, lines),
    row("visibility.aggressive.sampling.lines.grid.x", 1.0, Some(0.0), Some(8.0), lines),
    row("visibility.aggressive.sampling.lines.grid.y", 1.0, Some(0.0), Some(8.0), lines),
    row("visibility.aggressive.sampling.lines.grid.z", 1.0, Some(0.0), Some(8.0), lines),
    row("visibility.aggressive.sampling.lines.grid.tile_cells", 1.0, Some(0.0), Some(512.0), lines),
    row("visibility.aggressive.sampling.lines.grid.cells_by_cost.cell_budget", 1.0, Some(0.0), None, lines),
    row("visibility.aggressive.sampling.lines.grid.cells_by_cost.byte_budget", 1.0, Some(0.0), None, lines),
    row("visibility.aggressive.sampling.lines.grid.cells_by_cost.cell_cost", 0.0, None, Some(0.0), by_cost),
    row("visibility.aggressive.sampling.lines.adaptive.triangle_budget", 1.0, Some(0.0), None, adaptive),
    row("visibility.aggressive.sampling.lines.adaptive.max_depth", 1.0, Some(0.0), Some(12.0), adaptive),
    row("visibility.aggressive.sampling.cubes.adaptive.max_depth", 1.0, Some(0.0), Some(12.0), deep_cubes),
    row("visibility.aggressive.sampling.guided.rays", 1.0, Some(0.0), Some(200_000.0), guided),
    row("visibility.aggressive.sampling.guided.crediting", 0.0, None, Some(0.0), guided),
    row("visibility.aggressive.sampling.guided.time_budget_ms", 1.0, Some(0.0), None, guided),
    row("visibility.aggressive.sampling.cubes.grid.x", 1.0, Some(0.0), Some(8.0), cubes),
    row("visibility.aggressive.sampling.cubes.grid.y", 1.0, Some(0.0), Some(8.0), cubes),
    row("visibility.aggressive.sampling.cubes.grid.z", 1.0, Some(0.0), Some(8.0), cubes),
    row("visibility.aggressive.sampling.cubes.resolution", 8.0, Some(0.0), Some(256.0), cubes),
    row("visibility.aggressive.sampling.cubes.measure", 0.0, None, Some(0.0), cubes),
    row("visibility.aggressive.sampling.cubes.error_threshold", 0.0, Some(-1e-9), Some(0.1), cubes),
    row("visibility.aggressive.sampling.cubes.interior_threshold", 0.0, Some(-1e-9), Some(0.5), cubes),
    row("visibility.aggressive.sampling.cubes.min_distance", 1.0 / 1024.0, Some(0.0), Some(0.5), cubes),
    row("visibility.aggressive.sampling.cubes.solids", 0.0, None, Some(1.0), cubes),
    row("visibility.aggressive.sampling.cubes.superset", 0.0, None, Some(0.0), cubes),
    row("ambient.bytes", 0.0, None, None, ambient),
    row("ambient.points", 1.0, Some(0.0), None, ambient),
    row("ambient.lights", 0.0, None, None, ambient),
];

/// A field with the numbers of the fields that lead to it, outermost first.
#[derive(Clone, Debug)]
struct Leaf {
    path: Vec<u32>,
    /// The name of the field's message and the name of the field.
    name: String,
    field: FieldDescriptorProto,
}

fn descriptors() -> FileDescriptorSet {
    FileDescriptorSet::decode(sightline_proto::DESCRIPTORS).unwrap()
}

fn message<'a>(set: &'a FileDescriptorSet, name: &str) -> &'a DescriptorProto {
    let is_named = |message: &&DescriptorProto| format!(".sightline.v1.{}", message.name()) == name;
    set.file
        .iter()
        .flat_map(|file| &file.message_type)
        .find(is_named)
        .unwrap()
}

/// Collects the fields with a single number, flag or named value of a message and of its nested messages.
fn leaves(set: &FileDescriptorSet, name: &str, all: &mut BTreeMap<String, FieldDescriptorProto>) {
    let message = message(set, name);
    for field in &message.field {
        match field.r#type() {
            Type::Message => leaves(set, field.type_name(), all),
            // An empty text or list is not a legal value of any field, so absence needs no bit.
            Type::Bytes | Type::String => {}
            _ if field.label() == Label::Repeated => {}
            _ => {
                all.insert(
                    format!("{}.{}", message.name(), field.name()),
                    field.clone(),
                );
            }
        }
    }
}

fn all_leaves() -> BTreeMap<String, FieldDescriptorProto> {
    let mut all = BTreeMap::new();
    leaves(&descriptors(), ".sightline.v1.JobSpec", &mut all);
    all
}

impl Row {
    /// Finds the field that the row describes.
    fn leaf(&self) -> Leaf {
        let set = descriptors();
        let mut descriptor = message(&set, ".sightline.v1.JobSpec");
        let (mut path, mut found) = (Vec::new(), None);
        for name in self.path.split('.') {
            let field = descriptor.field.iter().find(|field| field.name() == name);
            let field = field.unwrap_or_else(|| panic!("{}: there is no field {name}", self.path));
            path.push(field.number() as u32);
            found = Some((format!("{}.{name}", descriptor.name()), field.clone()));
            if field.r#type() == Type::Message {
                descriptor = message(&set, field.type_name());
            }
        }
        let (name, field) = found.unwrap();
        Leaf { path, name, field }
    }
}

/// Returns the job with one field set, as a client encodes it.
fn with(job: &v1::JobSpec, leaf: &Leaf, value: f64) -> v1::JobSpec {
    let (last, outer) = leaf.path.split_last().unwrap();
    let mut bytes = Vec::new();
    match leaf.field.r#type() {
        Type::Double => {
            encode_key(*last, WireType::SixtyFourBit, &mut bytes);
            bytes.put_f64_le(value);
        }
        Type::Uint32 | Type::Uint64 | Type::Bool | Type::Enum => {
            encode_key(*last, WireType::Varint, &mut bytes);
            encode_varint(value as u64, &mut bytes);
        }
        other => panic!(
            "{}: write a field of type {other:?} here",
            leaf.field.name()
        ),
    }
    for number in outer.iter().rev() {
        let mut around = Vec::new();
        encode_key(*number, WireType::LengthDelimited, &mut around);
        encode_varint(bytes.len() as u64, &mut around);
        around.extend(bytes);
        bytes = around;
    }
    // Decoding merges a message with the message that follows it.
    v1::JobSpec::decode(&*[job.encode_to_vec(), bytes].concat()).unwrap()
}

fn read(message: &v1::JobSpec) -> Result<JobSpec, String> {
    JobSpec::from_message(message, &SceneFacts::default()).map_err(|e| e.to_string())
}

#[test]
fn every_scalar_field_of_job_is_optional_and_tested() {
    let leaves = all_leaves();
    // A field of a oneof is absent if another field of the oneof, or none, is given.
    let is_optional =
        |field: &FieldDescriptorProto| field.proto3_optional() || field.oneof_index.is_some();
    let implicit: Vec<&String> = leaves
        .iter()
        .filter(|(_, field)| !is_optional(field))
        .map(|(name, _)| name)
        .collect();
    assert!(
        implicit.is_empty(),
        "0 cannot be told from absence; make these `optional`: {implicit:?}"
    );
    let tested: BTreeSet<String> = ROWS.iter().map(|row| row.leaf().name).collect();
    let known: BTreeSet<String> = leaves.into_keys().collect();
    assert_eq!(tested, known, "add a row for each field of a job");
}

#[test]
fn smallest_legal_values_round_trip() {
    for row in ROWS {
        let (leaf, job) = (row.leaf(), (row.job)());
        let given = with(&job, &leaf, row.smallest);
        let spec = read(&given).unwrap_or_else(|e| panic!("{}: {e}", row.path));
        let written = spec.to_message();
        assert_eq!(
            with(&written, &leaf, row.smallest),
            written,
            "{} has another value",
            row.path
        );
        assert_eq!(read(&written).as_ref(), Ok(&spec), "{}", row.path);
        if let Some(below) = row.below {
            assert!(
                read(&with(&job, &leaf, below)).is_err(),
                "{} is {below}",
                row.path
            );
        }
        if let Ok(absent) = read(&job) {
            let is_same = row.default == Some(row.smallest) || job == given;
            assert_eq!(absent.key() == spec.key(), is_same, "{}", row.path);
        }
    }
}

#[test]
fn written_default_has_key_of_absent_field() {
    for row in ROWS {
        let Some(default) = row.default else { continue };
        let job = (row.job)();
        let (absent, given) = (
            read(&job).unwrap(),
            read(&with(&job, &row.leaf(), default)).unwrap(),
        );
        assert_eq!(absent, given, "{}", row.path);
        assert_eq!(absent.key(), given.key(), "{}", row.path);
    }
}

#[test]
fn defaults_depend_on_scene_and_bound() {
    let scene = v1::JobSpec {
        scene: vec![7; 32],
        task: None,
    };
    assert!(read(&scene).unwrap_err().contains("view-box"));
    let bounds = Some(sightline_numbers::Aabb::new(
        glam::Vec3::ZERO,
        glam::Vec3::ONE,
    ));
    let spec_for = |triangles| {
        let facts = SceneFacts {
            triangles,
            bounds,
            ..SceneFacts::default()
        };
        JobSpec::from_message(&scene, &facts).unwrap()
    };
    // The scene suffices if its bounds are known.
    assert_eq!(Ok(spec_for(100)), read(&lines()));
    assert_ne!(spec_for(10_000_000), spec_for(100));
    let row = ROWS
        .iter()
        .find(|row| row.path.ends_with("max_error"))
        .unwrap();
    let bounded = with(&lines(), &row.leaf(), 0.01);
    let target = ROWS
        .iter()
        .find(|row| row.path.ends_with("target_error"))
        .unwrap();
    assert_eq!(read(&bounded), read(&with(&bounded, &target.leaf(), 0.01)));
}
