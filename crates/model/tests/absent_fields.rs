//! The presence of the numbers, flags and choices of a job's message: each can be given its smallest legal
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

/// A field of the job's message: the message around it, the values to try, and a job that may have it.
struct Row {
    /// The message and the field.
    field: &'static str,
    /// The smallest legal value.
    smallest: f64,
    /// A smaller value, which is rejected; `None` where no smaller one can be written.
    below: Option<f64>,
    /// The value that an absent field stands for; `None` where absence has another meaning or is
    /// rejected.
    default: Option<f64>,
    /// The job.
    job: fn() -> v1::JobSpec,
}

/// Returns a job that gives its scene and its view box.
fn plain() -> v1::JobSpec {
    let view_box = vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    v1::JobSpec {
        scene: vec![7; 32],
        view_box,
        ..v1::JobSpec::default()
    }
}

fn exact() -> v1::JobSpec {
    v1::JobSpec {
        method: Some(v1::Method::Exact.into()),
        ..plain()
    }
}

fn grid() -> v1::JobSpec {
    v1::JobSpec {
        division: Some(v1::job_spec::Division::Grid(v1::Grid::default())),
        ..plain()
    }
}

fn adaptive() -> v1::JobSpec {
    let adaptive = v1::Adaptive {
        triangle_budget: Some(5),
        max_depth: None,
    };
    v1::JobSpec {
        division: Some(v1::job_spec::Division::Adaptive(adaptive)),
        ..plain()
    }
}

fn cubes() -> v1::JobSpec {
    let sampling = v1::Sampling {
        sampler: Some(v1::Sampler::Cubes.into()),
        ..v1::Sampling::default()
    };
    v1::JobSpec {
        sampling: Some(sampling),
        ..plain()
    }
}

fn guided() -> v1::JobSpec {
    let sampling = v1::Sampling {
        sampler: Some(v1::Sampler::Guided.into()),
        ..v1::Sampling::default()
    };
    v1::JobSpec {
        sampling: Some(sampling),
        ..plain()
    }
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
        ambient: Some(ambient),
        ..v1::JobSpec::default()
    }
}

/// Every number, flag and choice of a job.
const ROWS: &[Row] = &[
    Row {
        field: "JobSpec.backend",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: plain,
    },
    Row {
        field: "JobSpec.seed",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: plain,
    },
    Row {
        field: "JobSpec.time_budget_ms",
        smallest: 1.0,
        below: Some(0.0),
        default: None,
        job: plain,
    },
    Row {
        field: "JobSpec.block_cells",
        smallest: 1.0,
        below: Some(0.0),
        default: Some(512.0),
        job: plain,
    },
    Row {
        field: "JobSpec.method",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: plain,
    },
    Row {
        field: "JobSpec.certificates",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: exact,
    },
    // 0 is the name of an unknown axis, as in all enums of proto3 without a default.
    Row {
        field: "JobSpec.up",
        smallest: 1.0,
        below: None,
        default: None,
        job: plain,
    },
    Row {
        field: "Grid.x",
        smallest: 1.0,
        below: Some(0.0),
        default: Some(8.0),
        job: grid,
    },
    Row {
        field: "Grid.y",
        smallest: 1.0,
        below: Some(0.0),
        default: Some(8.0),
        job: grid,
    },
    Row {
        field: "Grid.z",
        smallest: 1.0,
        below: Some(0.0),
        default: Some(8.0),
        job: grid,
    },
    Row {
        field: "Adaptive.triangle_budget",
        smallest: 1.0,
        below: Some(0.0),
        default: None,
        job: adaptive,
    },
    Row {
        field: "Adaptive.max_depth",
        smallest: 1.0,
        below: Some(0.0),
        default: Some(12.0),
        job: adaptive,
    },
    Row {
        field: "Sampling.resolution",
        smallest: 8.0,
        below: Some(0.0),
        default: Some(256.0),
        job: cubes,
    },
    Row {
        field: "Sampling.measure",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: cubes,
    },
    Row {
        field: "Sampling.error_threshold",
        smallest: 0.0,
        below: Some(-1e-9),
        default: Some(0.1),
        job: cubes,
    },
    Row {
        field: "Sampling.interior_threshold",
        smallest: 0.0,
        below: Some(-1e-9),
        default: Some(0.5),
        job: cubes,
    },
    Row {
        field: "Sampling.min_distance",
        smallest: 1.0 / 1024.0,
        below: Some(0.0),
        default: Some(0.5),
        job: cubes,
    },
    Row {
        field: "Sampling.solids",
        smallest: 0.0,
        below: None,
        default: Some(1.0),
        job: cubes,
    },
    Row {
        field: "Sampling.superset",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: cubes,
    },
    Row {
        field: "Sampling.sampler",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: plain,
    },
    Row {
        field: "Sampling.target_error",
        smallest: 1e-6,
        below: Some(0.0),
        default: Some(1e-4),
        job: plain,
    },
    Row {
        field: "Sampling.max_error",
        smallest: 1e-5,
        below: Some(0.0),
        default: None,
        job: plain,
    },
    Row {
        field: "Sampling.rays",
        smallest: 1.0,
        below: Some(0.0),
        default: Some(200_000.0),
        job: guided,
    },
    Row {
        field: "Sampling.granularity",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: plain,
    },
    Row {
        field: "Sampling.min_share",
        smallest: 1e-6,
        below: Some(0.0),
        default: None,
        job: plain,
    },
    Row {
        field: "Sampling.far",
        smallest: f32::MIN_POSITIVE as f64,
        below: Some(0.0),
        default: None,
        job: plain,
    },
    Row {
        field: "Sampling.cell_to_cell",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: plain,
    },
    Row {
        field: "Sampling.contributions",
        smallest: 0.0,
        below: None,
        default: Some(0.0),
        job: plain,
    },
    Row {
        field: "Ambient.bytes",
        smallest: 0.0,
        below: None,
        default: None,
        job: ambient,
    },
    Row {
        field: "Ambient.points",
        smallest: 1.0,
        below: Some(0.0),
        default: None,
        job: ambient,
    },
    Row {
        field: "Ambient.lights",
        smallest: 0.0,
        below: None,
        default: None,
        job: ambient,
    },
];

/// A field with the fields of messages that lead to it, outermost first.
#[derive(Clone, Debug)]
struct Leaf {
    path: Vec<u32>,
    field: FieldDescriptorProto,
}

/// Finds the fields with a single number, flag or choice of a message and of the messages in it.
fn leaves(set: &FileDescriptorSet, name: &str, path: &[u32], all: &mut BTreeMap<String, Leaf>) {
    let of = |message: &&DescriptorProto| format!(".sightline.v1.{}", message.name()) == name;
    let message = set
        .file
        .iter()
        .flat_map(|file| &file.message_type)
        .find(of)
        .unwrap();
    for field in &message.field {
        let inner: Vec<u32> = path
            .iter()
            .copied()
            .chain([field.number() as u32])
            .collect();
        match field.r#type() {
            Type::Message => leaves(set, field.type_name(), &inner, all),
            // An empty text or list is not a legal value of any field, so that absence needs no bit.
            Type::Bytes | Type::String => {}
            _ if field.label() == Label::Repeated => {}
            _ => {
                let leaf = Leaf {
                    path: inner,
                    field: field.clone(),
                };
                all.insert(format!("{}.{}", message.name(), field.name()), leaf);
            }
        }
    }
}

fn all_leaves() -> BTreeMap<String, Leaf> {
    let set = FileDescriptorSet::decode(sightline_proto::DESCRIPTORS).unwrap();
    let mut all = BTreeMap::new();
    leaves(&set, ".sightline.v1.JobSpec", &[], &mut all);
    all
}

/// Returns the job with one field given, as a client writes it.
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
    // A message that follows another one is merged into it.
    v1::JobSpec::decode(&*[job.encode_to_vec(), bytes].concat()).unwrap()
}

fn read(message: &v1::JobSpec) -> Result<JobSpec, String> {
    JobSpec::from_proto(message, Some(SceneFacts::default())).map_err(|e| e.to_string())
}

#[test]
fn every_number_flag_and_choice_of_a_job_is_optional_and_tested() {
    let leaves = all_leaves();
    let implicit: Vec<&String> = leaves
        .iter()
        .filter(|(_, leaf)| !leaf.field.proto3_optional())
        .map(|(name, _)| name)
        .collect();
    assert!(
        implicit.is_empty(),
        "0 cannot be told from absence; make these `optional`: {implicit:?}"
    );
    let tested: BTreeSet<&str> = ROWS.iter().map(|row| row.field).collect();
    let known: BTreeSet<&str> = leaves.keys().map(String::as_str).collect();
    assert_eq!(tested, known, "add a row for each field of a job");
}

#[test]
fn smallest_legal_values_come_through_the_message() {
    let leaves = all_leaves();
    for row in ROWS {
        let (leaf, job) = (&leaves[row.field], (row.job)());
        let given = with(&job, leaf, row.smallest);
        let spec = read(&given).unwrap_or_else(|e| panic!("{}: {e}", row.field));
        let written = spec.to_proto();
        assert_eq!(
            with(&written, leaf, row.smallest),
            written,
            "{} has another value",
            row.field
        );
        assert_eq!(read(&written).as_ref(), Ok(&spec), "{}", row.field);
        if let Some(below) = row.below {
            assert!(
                read(&with(&job, leaf, below)).is_err(),
                "{} is {below}",
                row.field
            );
        }
        if let Ok(absent) = read(&job) {
            let is_same = row.default == Some(row.smallest) || (row.job)() == given;
            assert_eq!(absent.key() == spec.key(), is_same, "{}", row.field);
        }
    }
}

#[test]
fn written_default_makes_the_key_of_an_absent_field() {
    let leaves = all_leaves();
    for row in ROWS {
        let (leaf, job) = (&leaves[row.field], (row.job)());
        let Some(default) = row.default else { continue };
        let (absent, given) = (
            read(&job).unwrap(),
            read(&with(&job, leaf, default)).unwrap(),
        );
        assert_eq!(absent, given, "{}", row.field);
        assert_eq!(absent.key(), given.key(), "{}", row.field);
    }
}

#[test]
fn defaults_depend_on_method_scene_and_bound() {
    let of = |job: v1::JobSpec, triangles| {
        let facts = SceneFacts {
            triangles,
            bounds: None,
        };
        JobSpec::from_proto(&job, Some(facts)).unwrap()
    };
    assert_eq!(of(exact(), 100).block_cells, 8);
    assert_eq!(of(plain(), 100).block_cells, 512);
    assert_eq!(of(plain(), 10_000_000).block_cells, 64);
    let portals = v1::JobSpec {
        method: Some(v1::Method::Portals.into()),
        ..plain()
    };
    assert_eq!(
        of(portals, 100).backend,
        sightline_model::BackendChoice::None
    );
    let sampling = v1::Sampling {
        max_error: Some(0.01),
        ..v1::Sampling::default()
    };
    assert_eq!(
        of(
            v1::JobSpec {
                sampling: Some(sampling),
                ..plain()
            },
            100
        )
        .sampling
        .target_error,
        0.01
    );
    // The scene is enough where its bounds are known.
    let scene = v1::JobSpec {
        scene: vec![7; 32],
        ..v1::JobSpec::default()
    };
    assert!(
        JobSpec::from_proto(&scene, None)
            .unwrap_err()
            .to_string()
            .contains("view box")
    );
    let bounds = Some(sightline_numbers::Aabb::new(
        glam::Vec3::ZERO,
        glam::Vec3::ONE,
    ));
    let spec = JobSpec::from_proto(
        &scene,
        Some(SceneFacts {
            triangles: 100,
            bounds,
        }),
    )
    .unwrap();
    assert_eq!(spec, of(plain(), 100));
}
