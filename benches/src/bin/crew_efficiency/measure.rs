//! Bakes tiles of a scene with one thread and records them.

use std::path::Path;
use std::sync::Arc;

use sightline_bake::{BakeScene, Control, Watcher, run_tile};
use sightline_model::{JobSpec, Method, Node, TileOutput, codec, default_block_cells};
use sightline_numbers::random::SplitMix64;
use sightline_pvs::{Builder, Cell, CellTree, Header, Node as PvsNode, Object};
use sightline_sampling::embree::CpuBackend;
use sightline_sampling::sight::Sight;
use sightline_sampling::{Backend, CubeSpec};
use sightline_scene::Scene;
use sightline_viewcells::Division;

use crate::AnyError;
use crate::clock::timed;
use crate::record::{As, Recorder};
use crate::trace::{BlockTrace, SceneTrace, Trace};

/// Watches nothing and never stops the tile.
struct Unwatched;

impl Watcher for Unwatched {
    fn rendered(&self, _samples: u64) {}
    fn cell_done(&self) {}
    fn cancelled(&self) -> bool {
        false
    }
}

/// What to measure.
pub struct Wanted {
    /// Cells along each axis.
    pub cells: [u32; 3],
    /// The target error; the default of the program when absent.
    pub target_error: Option<f64>,
    /// Tiles to measure; the rest of the job is drawn from them.
    pub blocks: usize,
    /// Recordings as a leader, of which the least times count.
    pub repeats: usize,
    /// Seed of the choice of tiles.
    pub seed: u64,
}

/// Measures a scene.
///
/// # Errors
/// The scene cannot be read, or Embree is missing.
pub fn measure(path: &Path, wanted: &Wanted) -> Result<Trace, AnyError> {
    let (scene, load) = timed(|| sightline_scene::load(path));
    let blob = scene?.to_blob();
    let (scene, parse) = timed(|| {
        // A worker checks the digest of what it fetched.
        let _ = blake3::hash(&blob);
        Scene::from_blob("the scene as a worker fetches it", &blob)
    });
    let scene = Arc::new(scene?);
    let mut spec = JobSpec::new(
        scene.digest().0,
        Division::Grid(wanted.cells),
        scene.bounds(),
    );
    if let Some(target) = wanted.target_error {
        spec.sampling.target_error = target;
    }
    spec.block_cells = default_block_cells(scene.len(), &spec.sampling, Method::Aggressive);
    spec.check()?;
    let (prepared, facts) = timed(|| -> Result<_, AnyError> {
        let prepared = BakeScene::new(Arc::clone(&scene))?;
        let backend = CpuBackend::new(Arc::clone(&scene), CubeSpec::of(&spec.sampling))?;
        prepared.sampling().for_lines();
        prepared.sampling().fine_rows(spec.sampling.granularity);
        Sight::new(&backend, prepared.sampling().traced())?;
        Ok((prepared, backend))
    });
    let (prepared, backend) = prepared?;
    let bytes = blob.len() as u64;
    drop(blob);
    let (_, plan) = spec.plan()?;
    let leaves: Vec<u32> = plan.leaves().collect();
    let mut blocks = Vec::new();
    for tile in chosen(&leaves, wanted) {
        let cells = plan.tiles[tile as usize].cells;
        let block = tile_trace(&spec, (tile, cells), &prepared, &backend, wanted.repeats)?;
        eprintln!(
            "tile {tile}: {:.2} s, {} phases",
            block.alone() as f64 / 1e9,
            block.phases.len()
        );
        blocks.push(block);
    }
    let cells = wanted.cells.iter().map(|c| u64::from(*c)).product();
    Ok(Trace {
        scene: SceneTrace {
            load,
            bytes,
            parse,
            facts,
        },
        tiles: leaves.len(),
        cells,
        blocks,
    })
}

/// The tiles to measure: all, or some by chance.
fn chosen(leaves: &[u32], wanted: &Wanted) -> Vec<u32> {
    let mut leaves = leaves.to_vec();
    if wanted.blocks < leaves.len() {
        let mut random = SplitMix64::named(&[wanted.seed]);
        for i in 0..wanted.blocks {
            let other = i + (random.bits() % (leaves.len() - i) as u64) as usize;
            leaves.swap(i, other);
        }
        leaves.truncate(wanted.blocks);
    }
    leaves
}

/// Bakes a tile several times and records it.
fn tile_trace(
    spec: &JobSpec,
    (tile, cells): (u32, u64),
    scene: &BakeScene,
    backend: &dyn Backend,
    repeats: usize,
) -> Result<BlockTrace, AnyError> {
    let bake = |role| -> Result<_, AnyError> {
        let recorder = Recorder::new(role, cells);
        let control = Control {
            watcher: &Unwatched,
            deadline: None,
            crew: &recorder,
        };
        let done = run_tile(spec, tile, scene, backend, &[], control)?;
        Ok((recorder.ended(done.bytes.len() as u64), done.bytes))
    };
    let (first, bytes) = bake(As::Leader)?;
    let mut leader = first.block;
    for _ in 1..repeats.max(1) {
        leader.least(&bake(As::Leader)?.0.block);
    }
    let (helper, other) = bake(As::Helper(first.outcomes))?;
    if other != bytes || helper.block.phases.len() != leader.phases.len() {
        return Err("recording has changed the tile".into());
    }
    let mut block = helper.block;
    block.least(&leader);
    block.assemble = assemble(scene.scene(), &bytes)?;
    Ok(block)
}

/// The time to read a tile's output and to write its sets as a result.
fn assemble(scene: &Scene, bytes: &[u8]) -> Result<u64, AnyError> {
    let build = || -> Result<(), AnyError> {
        let TileOutput::Cells(sets) = codec::decode(bytes, scene.len())? else {
            return Ok(());
        };
        let node = |node: &Node| match node {
            Node::Split(s) => PvsNode::Split {
                axis: s.axis as u8,
                at: s.at as f32,
            },
            Node::Cell => PvsNode::Leaf,
        };
        let largest = f64::from(u32::MAX) as f32;
        let tree = CellTree::new(
            [[0.0; 3], [largest; 3]],
            sets.nodes.iter().map(node).collect(),
        )?;
        let mut builder = Builder::new(Header {
            triangles: scene.len(),
            method: spec_method(),
            tree,
            objects: vec![Object {
                name: String::new(),
                first: 0,
                count: scene.len(),
                source: None,
            }],
            info_json: String::new(),
        })?;
        let cells = sets.cells.iter().map(|c| Cell {
            visible: &c.visible,
            undecided: &[],
            flags: 0,
        });
        builder.push_cells(&cells.collect::<Vec<_>>())?;
        builder.finish(&mut Vec::new())?;
        Ok(())
    };
    let (built, time) = timed(build);
    built?;
    Ok(time)
}

/// The only method whose tiles have crews.
fn spec_method() -> String {
    Method::Aggressive.to_string()
}
