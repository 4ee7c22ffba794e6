//! Puts the result of a job together from its leaf tiles: one tree, one set a cell, one `.pvs` file.
//!
//! The bytes depend on the tiles' outputs and the job alone. Tiles are read one at a time.

use std::io::BufWriter;

use sightline_model::codec::{self, CodecError};
use sightline_model::{ALGORITHM_VERSION, JobSpec};
use sightline_model::{CellSet, CellSets, TileOutput};
use sightline_pvs::{Builder, Cell, CellTree, Header, Node, Object, PvsError, SET_ASIDE};
use sightline_viewcells::{CellBox, Division, Lattice, Outline, Plan, TileKind};

use crate::core::Coordinator;
use crate::scene_facts::FactsError;
use crate::scheduler::Slot;
use crate::statistics::Statistics;
use crate::store::{BlobError, Blobs, Digest, StoreError, TileState};

/// Why a result could not be put together.
#[derive(Debug, thiserror::Error)]
pub enum AssembleError {
    /// A blob could not be read or written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// A tile's output is not what the plan asks for.
    #[error("tile {tile}: {reason}")]
    Tile {
        /// The tile.
        tile: u32,
        /// What is wrong.
        reason: String,
    },
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] FactsError),
    /// The result cannot be written.
    #[error(transparent)]
    Pvs(#[from] PvsError),
    /// The store cannot be asked.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The codec.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// Compression failed.
    #[error("a stand-in could not be compressed: {0}")]
    Compress(#[from] std::io::Error),
}

/// What the disk had against a result: a full one is waited for.
fn of_disk(blobs: &Blobs, e: PvsError) -> AssembleError {
    match e {
        PvsError::Write(e) => AssembleError::Blob(blobs.refused(e)),
        e => AssembleError::Pvs(e),
    }
}

/// Bytes of a result that are hashed and written at a time.
const WRITTEN_AT_ONCE: usize = 1 << 20;

/// What [`Coordinator::assemble`] works from, copied out of the scheduler.
pub(crate) struct Parts {
    pub(crate) spec: JobSpec,
    pub(crate) lattice: Lattice,
    pub(crate) plan: Plan,
    pub(crate) profile: String,
    pub(crate) slots: Vec<Slot>,
}

impl Coordinator {
    /// Builds the `.pvs` file of a complete job and stores it; gives its digest and length.
    pub(crate) fn assemble(&self, parts: &Parts) -> Result<(Digest, u64), AssembleError> {
        let scene = self.facts(&parts.spec.scene)?;
        let leaves = || parts.plan.leaves().map(|n| (n, &parts.slots[n as usize].state));
        // The tree comes before the sets, so the tiles are read twice, one at a time; with certificates, which are most of a
        // tile, that is their price for not all being in memory twice.
        let mut nodes = Vec::new();
        let mut samples = 0u64;
        // But for a result of one tile.
        let mut kept = None;
        let mut statistics = Statistics::default();
        for part in &parts.plan.outline {
            match *part {
                Outline::Split(s) => nodes.push(pvs_node(sightline_model::Node::Split(s), &parts.lattice)),
                Outline::Leaf(number) => {
                    let slot = &parts.slots[number as usize];
                    let cells = parts.plan.tiles[number as usize].cells;
                    let sets = match kept.take() {
                        Some(sets) => sets,
                        None => self.leaf(number, &slot.state, cells, scene.triangles)?,
                    };
                    nodes.extend(sets.nodes.iter().map(|n| pvs_node(*n, &parts.lattice)));
                    if parts.plan.outline.len() == 1 {
                        kept = Some(sets);
                    }
                }
            }
        }
        for slot in &parts.slots {
            if let TileState::Done { stats, .. } = &slot.state {
                samples = samples.saturating_add(stats.samples);
            }
        }
        // What a cell that was set aside shows; stand-ins do not repeat it for every cell.
        let all: Vec<u32> = (0..scene.triangles).collect();
        let set_aside = leaves().filter(|(_, s)| matches!(s, TileState::SetAside { .. })).count();
        let objects = scene
            .objects
            .iter()
            .map(|o| Object { name: o.name.clone(), first: o.first, count: o.count })
            .collect();
        let mut builder = Builder::new(Header {
            triangles: scene.triangles,
            method: parts.spec.method.to_string(),
            tree: CellTree::new(parts.spec.view_box.map(|c| c.to_array()), nodes)?,
            objects,
            info_json: info(parts, samples, set_aside),
        })?;
        if parts.spec.certificates {
            builder.keep_certificates_in(self.blobs.scratch()?);
        }
        for (number, state) in leaves() {
            let cells = parts.plan.tiles[number as usize].cells;
            let aside = matches!(state, TileState::SetAside { .. });
            let sets = match kept.take() {
                Some(sets) => sets,
                None => self.leaf(number, state, cells, scene.triangles)?,
            };
            let shown = sets.cells.iter().map(|cell| match aside {
                // What is shown because its tile failed was neither seen nor proved hidden.
                true => Cell { visible: &all, undecided: &all, flags: SET_ASIDE },
                false => {
                    let undecided = cell.decision.as_ref().map_or(&[][..], |d| &d.undecided);
                    Cell { visible: &cell.visible, undecided, flags: 0 }
                }
            });
            builder.push_cells(&shown.collect::<Vec<_>>())?;
            for cell in &sets.cells {
                if parts.spec.certificates {
                    let certificate = cell.decision.as_ref().map_or(&[][..], |d| &d.certificate);
                    builder.push_certificate(certificate).map_err(|e| of_disk(&self.blobs, e))?;
                }
                statistics.push(cell);
            }
        }
        builder.set_columns(statistics.columns())?;
        let mut file = self.blobs.put_stream()?;
        let stats = builder
            .finish(&mut BufWriter::with_capacity(WRITTEN_AT_ONCE, &mut file))
            .map_err(|e| of_disk(&self.blobs, e))?;
        Ok((file.finish(None)?, stats.file_bytes))
    }

    fn leaf(
        &self,
        tile: u32,
        state: &TileState,
        cells: u64,
        triangles: u32,
    ) -> Result<CellSets, AssembleError> {
        let wrong = |reason: &str| AssembleError::Tile { tile, reason: reason.to_owned() };
        let (TileState::Done { digest, .. } | TileState::SetAside { digest, .. }) = state else {
            return Err(wrong("it is not done"));
        };
        let TileOutput::Cells(sets) = codec::decode(&self.blobs.read(digest)?, triangles)? else {
            return Err(wrong("it holds samples and not cells"));
        };
        // An adaptive tile counts as one cell in the plan, whatever it found.
        if cells > 1 && sets.cells.len() as u64 != cells {
            return Err(wrong("it has another number of cells than its grid"));
        }
        Ok(sets)
    }

    /// Stores what stands for a tile that was given up: its cells, without their sets, as every cell will show every triangle,
    /// those without area too. For a tile that should
    /// have given samples, none.
    pub(crate) fn stand_in(
        &self,
        spec: &JobSpec,
        lattice: &Lattice,
        tile: &sightline_viewcells::Tile,
    ) -> Result<(Digest, u64), AssembleError> {
        let output = if tile.kind == TileKind::Leaf {
            let mut sets = CellSets::default();
            everything(&spec.division, lattice, &tile.cell, tile.depth, &mut sets);
            TileOutput::Cells(sets)
        } else {
            TileOutput::Pack(sightline_model::Pack::default())
        };
        let bytes = codec::encode(&output)?;
        Ok((self.blobs.put(&bytes)?, bytes.len() as u64))
    }
}

/// The subtree a grid has below a leaf tile's cell; `None` when an adaptive tree decides by itself.
pub(crate) fn expected_nodes(
    d: &Division,
    l: &Lattice,
    cell: &CellBox,
    depth: u32,
) -> Option<Vec<sightline_model::Node>> {
    matches!(d, Division::Grid(_)).then(|| {
        let mut sets = CellSets::default();
        everything(d, l, cell, depth, &mut sets);
        sets.nodes
    })
}

/// The tree of a tile's cells, with empty sets.
fn everything(d: &Division, l: &Lattice, cell: &CellBox, depth: u32, out: &mut CellSets) {
    let grid = matches!(d, Division::Grid(_));
    match d.split(l, cell, depth).filter(|_| grid) {
        Some(split) => {
            out.nodes.push(sightline_model::Node::Split(split));
            for child in cell.children(split) {
                everything(d, l, &child, depth + 1, out);
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
        sightline_model::Node::Split(s) => {
            Node::Split { axis: s.axis as u8, at: lattice.coordinate(s.axis, s.at) }
        }
        sightline_model::Node::Cell => Node::Leaf,
    }
}

/// The baker's account: everything the result depends on, and nothing that differs between two runs.
fn info(parts: &Parts, samples: u64, set_aside: usize) -> String {
    serde_json::json!({
        "program": concat!("sightline ", env!("CARGO_PKG_VERSION")),
        "algorithm": ALGORITHM_VERSION,
        "scene": blake3::Hash::from_bytes(parts.spec.scene).to_hex().as_str(),
        "profile": parts.profile,
        "division": parts.spec.division,
        "sampling": parts.spec.sampling,
        "method": parts.spec.method.to_string(),
        "certificates": parts.spec.certificates,
        "seed": parts.spec.seed,
        "time_budget_ms": parts.spec.time_budget_ms,
        "block_cells": parts.spec.block_cells,
        "samples": samples,
        "tiles_set_aside": set_aside,
    })
    .to_string()
}
