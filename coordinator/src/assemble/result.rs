//! Assembles the result of a job from its leaf tiles: one tree, one visible set per cell, one `.pvs` file.
//! That of a job of ambient occlusion is in `openness.rs`.
//!
//! The bytes depend on the tiles' outputs and the job alone. Tiles are read one at a time.

use std::io::{BufWriter, Write};
use std::sync::Arc;

use sightline_model::codec::{self, CodecError};
use sightline_model::{
    ALGORITHM_VERSION, CellSet, CellSets, Granularity, PlannedJob, Task, TileOutput, Visibility,
};
use sightline_pvs::{
    Builder, Cell, CellTree, Contribution, Header, Items, NOT_REACHED, Node, Object, PvsError,
    SET_ASIDE, Source,
};
use sightline_viewcells::{CellBox, Division, Lattice, Outline, Tile, TileKind};

use crate::assemble::columns::Statistics;
use crate::assemble::openness::{self, AnswerError};
use crate::assemble::pairs::PairJoin;
use crate::ids::{Digest, TileIndex};
use crate::scheduler::Output;
use crate::state::{Coordinator, SceneFacts};
use crate::store::{BlobError, Blobs};
use crate::uploads::receivers::Fault;
use crate::uploads::scenes::{FactsError, facts};
use sightline_scene::clusters::clusters;
use sightline_scene::kinds::KindCount;
use sightline_scene::{Kinds, Scene, SceneError};

/// A result that cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AssembleError {
    /// A blob could not be read or written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// A tile's output does not fit the plan.
    #[error("tile {tile}: {reason}")]
    Tile {
        /// The tile.
        tile: TileIndex,
        /// How it differs.
        reason: &'static str,
    },
    /// The scene cannot be read.
    #[error(transparent)]
    Facts(#[from] FactsError),
    /// The scene's blob is not a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The result cannot be written.
    #[error(transparent)]
    Pvs(#[from] PvsError),
    /// A tile's output cannot be decoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The answers of a job of ambient occlusion cannot be put together.
    #[error(transparent)]
    SceneQueries(AnswerError),
    /// Compression failed.
    #[error("a stand-in could not be compressed: {0}")]
    Compress(#[from] std::io::Error),
}

impl From<AnswerError> for AssembleError {
    fn from(e: AnswerError) -> Self {
        match e {
            AnswerError::Blob(e) => Self::Blob(e),
            e => Self::SceneQueries(e),
        }
    }
}

impl AssembleError {
    /// Whether the same may succeed later.
    pub(crate) fn passes(&self) -> bool {
        self.of_blob().is_some_and(BlobError::passes)
    }

    /// Whether something that the result is made from must be sent or computed again.
    pub(crate) fn is_lost(&self) -> bool {
        self.of_blob().is_some_and(BlobError::is_lost)
    }

    fn of_blob(&self) -> Option<&BlobError> {
        match self {
            Self::Blob(e) | Self::Facts(FactsError::Blob(e)) => Some(e),
            Self::SceneQueries(AnswerError::Receivers(Fault::Blob(e))) => Some(e),
            _ => None,
        }
    }
}

/// An error of writing a result. A full disk is told apart, because it is waited for.
fn of_disk(blobs: &dyn Blobs, e: PvsError) -> AssembleError {
    match e {
        PvsError::Write(e) => AssembleError::Blob(blobs.io_error(e)),
        e => AssembleError::Pvs(e),
    }
}

/// Bytes of a result that are hashed and written at a time.
const WRITTEN_AT_ONCE: usize = 1 << 20;

/// A job whose result is written.
pub(crate) struct AssemblyInput {
    pub(crate) work: Arc<PlannedJob>,
    pub(crate) profile: String,
    /// What there is of each tile.
    pub(crate) outputs: Vec<Output>,
    /// Samples of done tiles.
    pub(crate) samples: u64,
}

impl AssemblyInput {
    fn leaf(&self, number: u32) -> Leaf {
        let tile = TileIndex(number);
        Leaf {
            tile,
            output: self.outputs[tile.at()],
            cells: self.work.plan().tiles[tile.at()].cells,
        }
    }

    /// The cells of a leaf tile, whose sets name at most `items` items. Those of a tile that is not done are
    /// empty, like those of one that was set aside.
    fn read(
        &self,
        task: &Visibility,
        number: u32,
        blobs: &dyn Blobs,
        items: u32,
    ) -> Result<CellSets, AssembleError> {
        let leaf = self.leaf(number);
        if leaf.output != Output::Open {
            return leaf.read(blobs, items);
        }
        let mut sets = CellSets::default();
        empty_cells(task, &self.work.plan().tiles[leaf.tile.at()], &mut sets);
        Ok(sets)
    }
}

/// A leaf tile of the plan.
#[derive(Clone, Copy)]
struct Leaf {
    tile: TileIndex,
    output: Output,
    /// Its cells by the plan; 1 for a tile of an adaptive division.
    cells: u64,
}

impl Leaf {
    /// Reads the tile's cells, whose sets name at most `items` items.
    fn read(self, blobs: &dyn Blobs, items: u32) -> Result<CellSets, AssembleError> {
        let wrong = |reason| AssembleError::Tile {
            tile: self.tile,
            reason,
        };
        let Some(digest) = self.output.digest() else {
            return Err(wrong("it is not done"));
        };
        let TileOutput::Cells(sets) = codec::decode(&blobs.read(&digest)?, items)? else {
            return Err(wrong("it holds samples and not cells"));
        };
        // An adaptive tile counts as one cell in the plan, however many it has.
        if self.cells > 1 && sets.cells.len() as u64 != self.cells {
            return Err(wrong("it has another number of cells than its grid"));
        }
        Ok(sets)
    }
}

/// Builds the result of a complete job and stores it; returns its digest and length.
pub(crate) fn assemble(
    c: &Coordinator,
    parts: &AssemblyInput,
) -> Result<(Digest, u64), AssembleError> {
    let mut file = c.blobs.put_stream()?;
    let bytes = write(
        c,
        parts,
        &mut BufWriter::with_capacity(WRITTEN_AT_ONCE, &mut file),
    )?;
    Ok((file.finish(None)?, bytes))
}

/// Writes the `.pvs` file of a job and returns its length. Cells of tiles that are not done or were set aside
/// show everything, as undecided. The result of a job of ambient occlusion is no such file.
pub(crate) fn write(
    c: &Coordinator,
    parts: &AssemblyInput,
    out: &mut impl Write,
) -> Result<u64, AssembleError> {
    let task = match &parts.work.spec().task {
        Task::Ambient(ambient) => return Ok(openness::write(c, ambient, &parts.outputs, out)?),
        Task::Visibility(task) => task,
    };
    let digest = &parts.work.spec().scene;
    let (scene, blobs) = (facts(c, digest)?, &*c.blobs);
    let (plan, lattice) = (parts.work.plan(), task.lattice());
    let most = most_items(task, scene.triangles, scene.objects.len() as u32);
    let leaves = || plan.leaves().map(|n| parts.leaf(n));
    // The tree comes before the sets, so every tile is read twice, one at a time. Certificates are most of a
    // tile: keeping all tiles in memory would cost more than the second reading.
    let mut nodes = Vec::new();
    // The cells of a plan's only tile, which is read once.
    let mut kept = None;
    let mut statistics = Statistics::default();
    for part in &plan.outline {
        match *part {
            Outline::Split(s) => nodes.push(pvs_node(sightline_model::Node::Split(s), lattice)),
            Outline::Leaf(number) => {
                let sets = match kept.take() {
                    Some(sets) => sets,
                    None => parts.read(task, number, blobs, most)?,
                };
                nodes.extend(sets.nodes.iter().map(|n| pvs_node(*n, lattice)));
                if plan.outline.len() == 1 {
                    kept = Some(sets);
                }
            }
        }
    }
    let items = items(c, digest, task.items())?;
    // The visible set of every cell of a tile that was set aside; stand-ins do not repeat it for every cell.
    let all: Vec<u32> = match &items {
        None => (0..scene.triangles)
            .filter(|t| scene.kinds.kind(*t).shows())
            .collect(),
        Some(Items::Clusters(all)) => (0..all.len() as u32).collect(),
        Some(Items::Objects { .. }) => (0..scene.objects.len() as u32).collect(),
    };
    let set_aside = leaves()
        .filter(|l| matches!(l.output, Output::SetAside(_)))
        .count();
    let objects = scene
        .objects
        .iter()
        .enumerate()
        .map(|(i, o)| {
            let source = scene.sources.get(i).map(|s| Source {
                node: s.node,
                mesh: s.mesh,
                primitive: s.primitive,
                instance: s.instance,
            });
            Object {
                name: o.name.clone(),
                first: o.first,
                count: o.count,
                source,
            }
        })
        .collect();
    let tree = CellTree::new(task.view_box().corners().map(|c| c.to_array()), nodes)?;
    let cells = tree.cells();
    let mut builder = Builder::new(Header {
        triangles: scene.triangles,
        method: task.method.name().to_string(),
        tree,
        objects,
        info_json: info(parts, task, &scene, set_aside),
    })?;
    if let Some(items) = &items {
        builder.set_items(items)?;
    }
    if let Some(region) = task.viewpoints().region() {
        builder.set_region(region.encode());
    }
    let mut pairs = PairJoin::new(task, cells);
    if task.has_certificates()
        && let Some(file) = blobs.scratch()?
    {
        builder.keep_certificates_in(file);
    }
    for leaf in leaves() {
        let aside = !matches!(leaf.output, Output::Done(_));
        let wrong = |reason| AssembleError::Tile {
            tile: leaf.tile,
            reason,
        };
        let mut sets = match kept.take() {
            Some(sets) => sets,
            None => parts.read(task, leaf.tile.0, blobs, most)?,
        };
        if !sets.portals.is_empty() {
            builder.set_portals(std::mem::take(&mut sets.portals))?;
        }
        let shown = sets.cells.iter().map(|cell| match aside {
            // Triangles of a failed tile were neither seen nor proved hidden.
            true => Cell {
                visible: &all,
                undecided: &all,
                flags: SET_ASIDE,
            },
            false => {
                let undecided = cell.decision.as_ref().map_or(&[][..], |d| &d.undecided);
                let flags = if cell.unreached { NOT_REACHED } else { 0 };
                Cell {
                    visible: &cell.visible,
                    undecided,
                    flags,
                }
            }
        });
        builder.push_cells(&shown.collect::<Vec<_>>())?;
        for cell in &sets.cells {
            if task.has_certificates() {
                let evidence = cell.decision.as_ref().map_or(&[][..], |d| &d.certificate);
                builder
                    .push_certificate(evidence)
                    .map_err(|e| of_disk(blobs, e))?;
            }
            if task.has_contributions() {
                let of = contributions(cell, if aside { all.len() } else { cell.visible.len() });
                builder.push_contributions(&of.ok_or_else(|| wrong("it lacks contributions"))?)?;
            }
            statistics.push(cell);
        }
        if let Some(join) = &mut pairs {
            if let Some(tile) = &sets.pairs
                && !join.add_tile(tile)
            {
                return Err(wrong("its pairs are those of another number of cells"));
            }
            let boxes = boxes(&plan.tiles[leaf.tile.at()].cell, &sets.nodes);
            boxes
                .iter()
                .zip(&sets.cells)
                .for_each(|(at, cell)| join.add_cell(at, !cell.unreached, aside));
        }
    }
    if let Some(pairs) = &pairs {
        builder.set_pairs(&pairs.finish()?)?;
    }
    builder.set_columns(statistics.columns())?;
    let stats = builder.finish(out).map_err(|e| of_disk(blobs, e))?;
    Ok(stats.file_bytes)
}

/// An upper limit on the numbers that the sets of a job's tiles name. There are at most as many clusters as
/// triangles; objects may have none.
pub(crate) fn most_items(task: &Visibility, triangles: u32, objects: u32) -> u32 {
    match task.items() {
        Granularity::Triangles | Granularity::Clusters => triangles,
        Granularity::Objects => objects,
    }
}

/// What the sets of a job name; `None` for triangles.
fn items(
    c: &Coordinator,
    digest: &Digest,
    items: Granularity,
) -> Result<Option<Items>, AssembleError> {
    let scene = || -> Result<Scene, AssembleError> {
        Ok(Scene::from_blob("stored scene", &c.blobs.read(digest)?)?)
    };
    Ok(match items {
        Granularity::Triangles => None,
        Granularity::Clusters => Some(Items::Clusters(clusters(&scene()?))),
        Granularity::Objects => {
            let scene = scene()?;
            Some(Items::Objects {
                never: (0..scene.len()).filter(|t| !scene.shows(*t)).collect(),
            })
        }
    })
}

/// How much of the view each of `items` visible items takes; `None` when the tile counted another number.
fn contributions(cell: &CellSet, items: usize) -> Option<Vec<Contribution>> {
    let Some(hits) = &cell.hits else {
        // Nothing was measured in a tile that was set aside.
        return Some(vec![Contribution::new(0.0, 0.0); items]);
    };
    let all = f64::from(hits.viewpoints) * f64::from(hits.lines);
    let of = |[hit, most]: &[u32; 2]| {
        Contribution::new(
            f64::from(*hit) / all,
            f64::from(*most) / f64::from(hits.lines),
        )
    };
    (hits.counts.len() == items).then(|| hits.counts.iter().map(of).collect())
}

/// The boxes of a subtree's cells, in preorder.
fn boxes(root: &CellBox, nodes: &[sightline_model::Node]) -> Vec<CellBox> {
    let (mut boxes, mut open) = (Vec::new(), vec![*root]);
    for node in nodes {
        let Some(at) = open.pop() else { break };
        match node {
            sightline_model::Node::Split(split) => {
                let [below, above] = at.children(*split);
                open.extend([above, below]);
            }
            sightline_model::Node::Cell => boxes.push(at),
        }
    }
    boxes
}

/// Stores the stand-in of a tile that is set aside: the tree of its cells with empty sets, because every cell
/// will show every triangle, including those without area. For a tile of samples: no samples.
pub(crate) fn stand_in(
    c: &Coordinator,
    job: &PlannedJob,
    tile: TileIndex,
) -> Result<(Digest, u64), AssembleError> {
    let tile = &job.plan().tiles[tile.at()];
    let task = match &job.spec().task {
        Task::Ambient(ambient) => {
            let bytes = openness::stand_in(ambient)?;
            return Ok((c.blobs.put(&bytes)?, bytes.len() as u64));
        }
        Task::Visibility(task) => task,
    };
    let output = if tile.kind == TileKind::Leaf {
        let mut sets = CellSets::default();
        empty_cells(task, tile, &mut sets);
        TileOutput::Cells(sets)
    } else {
        TileOutput::Pack(sightline_model::Pack::default())
    };
    let bytes = codec::encode(&output)?;
    Ok((c.blobs.put(&bytes)?, bytes.len() as u64))
}

/// The subtree below a leaf tile's cell; `None` for an adaptive division, whose subtree depends on the
/// samples.
pub(crate) fn expected_nodes(task: &Visibility, tile: &Tile) -> Option<Vec<sightline_model::Node>> {
    (!matches!(task.division(), Division::Adaptive { .. })).then(|| {
        let mut sets = CellSets::default();
        empty_cells(task, tile, &mut sets);
        sets.nodes
    })
}

/// Adds the tree of a tile's cells, with empty sets.
fn empty_cells(task: &Visibility, tile: &Tile, out: &mut CellSets) {
    add_empty_cells(
        (task.division(), task.lattice()),
        &tile.cell,
        tile.depth,
        out,
    );
}

fn add_empty_cells(of: (&Division, &Lattice), cell: &CellBox, depth: u32, out: &mut CellSets) {
    let (division, lattice) = of;
    let is_known = !matches!(division, Division::Adaptive { .. });
    match division.split(lattice, cell, depth).filter(|_| is_known) {
        Some(split) => {
            out.nodes.push(sightline_model::Node::Split(split));
            for child in cell.children(split) {
                add_empty_cells(of, &child, depth + 1, out);
            }
        }
        None => {
            out.nodes.push(sightline_model::Node::Cell);
            out.cells.push(CellSet::default());
        }
    }
}

fn pvs_node(node: sightline_model::Node, lattice: &Lattice) -> Node {
    match node {
        sightline_model::Node::Split(s) => Node::Split {
            axis: s.axis as u8,
            at: lattice.coordinate(s.axis, s.at),
        },
        sightline_model::Node::Cell => Node::Leaf,
    }
}

/// Describes the bake: everything that the result depends on, and nothing that differs between two runs.
fn info(parts: &AssemblyInput, task: &Visibility, scene: &SceneFacts, set_aside: usize) -> String {
    let kinds = &scene.kinds;
    let mut info = serde_json::json!({
        "program": concat!("sightline ", env!("CARGO_PKG_VERSION")),
        "algorithm": ALGORITHM_VERSION,
        "profile": parts.profile,
        "spec": parts.work.spec().to_json(),
        "samples": parts.samples,
        "tiles_set_aside": set_aside,
    });
    let open = parts
        .work
        .plan()
        .leaves()
        .filter(|n| parts.outputs[*n as usize] == Output::Open)
        .count();
    if open > 0 {
        info["tiles_open"] = open.into();
    }
    if let Some(marks) = task.viewpoints().mask() {
        info["viewpoints"] = serde_json::json!({
            "cells_reached": marks.reached(), "cells": marks.count(), "parts": marks.marked(),
        });
    }
    if scene.culled {
        info["cull_back_faces"] = true.into();
    }
    // Absent for opaque scenes.
    if *kinds != Kinds::opaque() {
        let count = |c: KindCount| {
            let kind = c.kind.name();
            serde_json::json!({"kind": kind, "reason": c.reason, "triangles": c.triangles})
        };
        let counts: Vec<_> = kinds.counts().into_iter().map(count).collect();
        let rules = kinds.rules().iter();
        let rules: Vec<_> = rules
            .map(|r| serde_json::json!({"kind": r.kind.name(), "glob": r.glob}))
            .collect();
        info["kinds"] = serde_json::json!({"counts": counts, "rules": rules});
        if kinds.alpha_textures() {
            info["kinds"]["alpha_textures"] = true.into();
        }
    }
    info.to_string()
}
