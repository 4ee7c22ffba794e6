//! The device memory of rounds: the facts of a scene, the tables of a block, and lists that blocks lend.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;
use sightline_scene::TriangleId;

use super::kernels::Kernels;
use crate::gpu::line_scene::filled;
use crate::lines::device::DECADES;
use crate::lines::device::{DeviceBlock, DeviceCell};
use crate::lines::grid::CellGrid;

/// The number of bytes between two parts in their buffer: the largest alignment that a device may require.
pub(super) const PART_STRIDE: u64 = 256;
/// The number of parts that fit in their buffer. Later parts overwrite the oldest parts.
pub(super) const PARTS: u32 = 256;
/// The size of the counters in bytes, as `block.wgsl` numbers them.
pub(super) const COUNTER_BYTES: u64 = 4 * (8 + 5 * DECADES as u64);
/// The number of triangles of a stripe of candidates, as in `candidates.wgsl`.
pub(super) const STRIPE: usize = 4096;
/// The substitute for an infinite distance, as in `traverse.wgsl`.
const FAR: f32 = 3e38;

/// The uniform `Grid` in `block.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct GridUniform {
    low: Vec3,
    margin: f32,
    per_unit: Vec3,
    first_cell: u32,
    cells: [u32; 3],
    words: u32,
    side: [u32; 3],
    first_word: u32,
    bricks: [u32; 3],
    unused: u32,
    first: [[u32; 4]; 3],
}

impl GridUniform {
    /// Creates a grid whose first cell and first word have these places in their buffers.
    fn new(grid: &CellGrid, first_cell: usize, first_word: usize) -> Self {
        let shape = grid.shape();
        Self {
            low: grid.bounds().0,
            margin: grid.margin(),
            per_unit: shape.per_unit.into(),
            first_cell: first_cell as u32,
            cells: grid.cells(),
            words: 2 * grid.words() as u32,
            side: shape.side,
            first_word: first_word as u32,
            bricks: shape.bricks,
            unused: 0,
            first: shape.first.map(|m| [m as u32, (m >> 32) as u32, 0, 0]),
        }
    }
}

/// The uniform `Block` in `block.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct BlockUniform {
    grids: [GridUniform; 2],
    extent: f32,
    step: f32,
    far: f32,
    zero: u32,
    seed: [u32; 2],
    triangles: u32,
    ordered: u32,
    capacity: u32,
    has_rows: u32,
    unused: [u32; 2],
}

/// The uniform `Part` in `block.wgsl`.
#[derive(Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Part {
    pub(super) count: u32,
    pub(super) first: u32,
    pub(super) items: u32,
    pub(super) round: u32,
    pub(super) mask: u32,
    pub(super) time: u32,
    pub(super) way: u32,
    pub(super) joins: u32,
    pub(super) times: [f32; DECADES],
    pub(super) so_far: [f32; DECADES],
}

impl Part {
    /// Returns the size of the part's hash table of claims, in bytes.
    pub(super) fn bytes_of_claims(&self) -> u64 {
        4 * (u64::from(self.mask) + 1)
    }
}

/// The record `Cell` in `block.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct CellRecord {
    low: Vec3,
    key_low: u32,
    size: Vec3,
    key_high: u32,
    at: [u32; 3],
    slot: u32,
    parts: [u32; 2],
    unused: [u32; 2],
}

fn halves(number: u64) -> [u32; 2] {
    [number as u32, (number >> 32) as u32]
}

/// The facts about a scene that the kernels need in addition to its hierarchy.
pub(super) struct Facts {
    vertices: wgpu::Buffer,
    around: wgpu::Buffer,
    triangles: u32,
    ordered: u32,
}

impl Facts {
    pub(super) fn new(device: &wgpu::Device, block: &DeviceBlock<'_>) -> Result<Self, String> {
        let scene = block.scene;
        let ids: Vec<u32> = (0..scene.len()).collect();
        let corners = |id: &u32| -> [[u32; 4]; 3] {
            let side = scene.sides().side(TriangleId(*id)) as u32;
            scene.triangles()[*id as usize].v.map(|v| {
                let [x, y, z] = v.to_array().map(f32::to_bits);
                [x, y, z, side]
            })
        };
        let around: Vec<u32> = block
            .surface
            .neighbours
            .iter()
            .flatten()
            .chain(&block.surface.morton)
            .copied()
            .collect();
        let storage = wgpu::BufferUsages::STORAGE;
        Ok(Self {
            vertices: filled(device, "vertices", storage, &ids, corners)?,
            around: filled(device, "around", storage, &around, |x| *x)?,
            triangles: scene.len(),
            ordered: block.surface.morton.len() as u32,
        })
    }

    /// Returns the size of the largest buffer for a scene, in bytes.
    pub(super) fn most_bytes(block: &DeviceBlock<'_>) -> u64 {
        u64::from(block.scene.len()) * 48
    }
}

/// The table of a block, and the cells of the block.
pub(super) struct Tables {
    pub(super) seen: wgpu::Buffer,
    pub(super) now: wgpu::Buffer,
    pub(super) met: wgpu::Buffer,
    pub(super) pairs: wgpu::Buffer,
    pub(super) joined: wgpu::Buffer,
    pub(super) group: wgpu::BindGroup,
    /// The number of 64-bit words of the table.
    pub(super) places: u32,
    /// The number of 64-bit words of the table of pairs; 0 without pairs.
    pub(super) pair_places: u32,
    /// The number of 64-bit words of a row.
    pub(super) words: u32,
    /// The number of triangles in Morton order.
    pub(super) ordered: u32,
}

impl Tables {
    /// Returns the size of a table in bytes.
    pub(super) fn bytes(block: &DeviceBlock<'_>) -> u64 {
        block.row_count as u64 * block.grid.words() as u64 * 8
    }

    pub(super) fn new(
        device: &wgpu::Device,
        kernels: &Kernels,
        facts: &Facts,
        block: &DeviceBlock<'_>,
        capacity: u32,
    ) -> Result<Self, String> {
        let grid = block.grid;
        let none = CellGrid::new(Vec3::ZERO, Vec3::ONE, [1; 3]);
        let division = block.pairs.as_ref().map_or(&none, |pairs| pairs.grid);
        let (low, high) = grid.bounds();
        let uniform = BlockUniform {
            grids: [
                GridUniform::new(grid, 0, 0),
                GridUniform::new(division, block.cells.len(), 2 * grid.words()),
            ],
            extent: (high - low).length(),
            step: block.step,
            far: block.far.min(FAR),
            zero: 0,
            seed: halves(block.key),
            triangles: facts.triangles,
            ordered: facts.ordered,
            capacity,
            has_rows: u32::from(!block.rows.is_empty()),
            unused: [0; 2],
        };
        let record = |c: &DeviceCell| {
            let [key_low, key_high] = halves(c.key);
            let slot = c.slot.index() as u32;
            // From a cell without viewpoints only segments are cast, from any point of the cell.
            let parts = halves(if c.parts == 0 { u64::MAX } else { c.parts });
            CellRecord {
                low: c.low,
                key_low,
                size: c.size,
                key_high,
                at: c.at,
                slot,
                parts,
                unused: [0; 2],
            }
        };
        let all = |words: &[u64], grid: &CellGrid| match words {
            [] => vec![u64::MAX; grid.words()],
            some => some.to_vec(),
        };
        let (mut cells, mut reached) = (block.cells.to_vec(), all(block.reached, grid));
        if let Some(pairs) = &block.pairs {
            cells.extend_from_slice(pairs.cells);
            reached.extend(all(pairs.reached, pairs.grid));
        }
        use wgpu::BufferUsages as Use;
        let table = |label, size| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: Use::STORAGE | Use::COPY_SRC | Use::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let [seen, now, met] = ["seen", "now", "met"].map(|label| table(label, Self::bytes(block)));
        let [pairs, joined] =
            ["pairs", "joined"].map(|label| table(label, Self::pair_bytes(block).max(8)));
        let uniform = filled(device, "block", Use::UNIFORM, &[uniform], |u| *u)?;
        let cells = filled(device, "cells", Use::STORAGE, &cells, record)?;
        let reached = filled(device, "reached", Use::STORAGE, &reached, |w| halves(*w))?;
        // A binding needs a buffer.
        let rows = if block.rows.is_empty() {
            &[0][..]
        } else {
            block.rows
        };
        let rows = filled(device, "rows", Use::STORAGE, rows, |row| *row)?;
        let Facts {
            vertices, around, ..
        } = facts;
        let bound = [
            &uniform, &seen, &now, &met, &cells, &reached, vertices, around, &pairs, &joined, &rows,
        ];
        let bound = bound.map(wgpu::Buffer::as_entire_binding);
        let group = bind(device, "tables", &kernels.tables_layout, &bound);
        let words = grid.words() as u32;
        Ok(Self {
            seen,
            now,
            met,
            pairs,
            joined,
            group,
            places: (Self::bytes(block) / 8) as u32,
            pair_places: (Self::pair_bytes(block) / 8) as u32,
            words,
            ordered: facts.ordered,
        })
    }

    /// Returns the size of the table of pairs in bytes; 0 without pairs.
    pub(super) fn pair_bytes(block: &DeviceBlock<'_>) -> u64 {
        let words = block
            .pairs
            .as_ref()
            .map_or(0, |pairs| pairs.grid.words() as u64);
        64 * words * words * 8
    }
}

/// The lists whose size does not depend on a block.
pub(super) struct Lists {
    pub(super) counters: wgpu::Buffer,
    pub(super) claims: wgpu::Buffer,
    pub(super) finds: wgpu::Buffer,
    pub(super) from: wgpu::Buffer,
    pub(super) to: wgpu::Buffer,
    pub(super) about: wgpu::Buffer,
    pub(super) reaches: wgpu::Buffer,
    pub(super) ends: wgpu::Buffer,
    pub(super) candidates: wgpu::Buffer,
    pub(super) words: wgpu::Buffer,
    pub(super) pair_words: wgpu::Buffer,
    pub(super) parts: wgpu::Buffer,
    pub(super) read_back: wgpu::Buffer,
}

impl Lists {
    /// Creates lists for `capacity` newly found triangles, three times as many lines, candidates and words,
    /// and claims of eight times as many.
    pub(super) fn new(device: &wgpu::Device, capacity: u32) -> Self {
        use wgpu::BufferUsages as Use;
        let make = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let n = u64::from(capacity);
        let both = Use::STORAGE | Use::COPY_SRC | Use::COPY_DST;
        Self {
            counters: make("counters", COUNTER_BYTES, both),
            claims: make("claims", 8 * n * 4, both),
            finds: make("finds", n * 16, both),
            from: make("line origins", 3 * n * 16, both),
            to: make("line directions", 3 * n * 16, both),
            about: make("line numbers", 3 * n * 8, both),
            reaches: make("line reaches", 3 * n * 8, both),
            ends: make("line ends", 3 * n * 8, both),
            candidates: make("candidates", 3 * n * 16, both),
            words: make("words", 3 * n * 12, both),
            pair_words: make("pair words", 3 * n * 12, both),
            parts: make(
                "parts",
                u64::from(PARTS) * PART_STRIDE,
                Use::UNIFORM | Use::COPY_DST,
            ),
            read_back: make(
                "read-back",
                3 * n * 12 + (1 << 20),
                Use::MAP_READ | Use::COPY_DST,
            ),
        }
    }

    /// Returns the size of the largest list in bytes.
    pub(super) fn most_bytes(capacity: u32) -> u64 {
        48 * u64::from(capacity)
    }
}

/// The lists of a block: the lent lists, and the lists whose size depends on the block.
pub(super) struct BlockLists {
    pub(super) lists: Lists,
    pub(super) items: wgpu::Buffer,
    pub(super) stats: wgpu::Buffer,
    pub(super) places: wgpu::Buffer,
    pub(super) group: wgpu::BindGroup,
}

impl BlockLists {
    pub(super) fn new(
        device: &wgpu::Device,
        kernels: &Kernels,
        lists: Lists,
        tables: &Tables,
        cells: usize,
    ) -> Self {
        use wgpu::BufferUsages as Use;
        let make = |label, words: usize| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: 4 * words as u64,
                usage: Use::STORAGE | Use::COPY_SRC | Use::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let items = make("items", 4 * cells);
        let stats = make("stats", 4 * cells);
        let stripes = (tables.ordered as usize).div_ceil(STRIPE);
        let places = make("places", 64 * tables.words as usize + stripes);
        let part = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: &lists.parts,
            offset: 0,
            size: wgpu::BufferSize::new(size_of::<Part>() as u64),
        });
        let all = [
            &items,
            &stats,
            &lists.counters,
            &lists.claims,
            &lists.finds,
            &lists.from,
            &lists.to,
            &lists.about,
            &lists.ends,
            &lists.candidates,
            &places,
            &lists.words,
            &lists.pair_words,
            &lists.reaches,
        ];
        let bound: Vec<_> = std::iter::once(part)
            .chain(all.map(wgpu::Buffer::as_entire_binding))
            .collect();
        let group = bind(device, "lists", &kernels.lists_layout, &bound);
        Self {
            lists,
            items,
            stats,
            places,
            group,
        }
    }
}

impl std::ops::Deref for BlockLists {
    type Target = Lists;

    fn deref(&self) -> &Lists {
        &self.lists
    }
}

fn bind(
    device: &wgpu::Device,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    bound: &[wgpu::BindingResource<'_>],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(bound)
        .map(|(binding, resource)| wgpu::BindGroupEntry {
            binding,
            resource: resource.clone(),
        })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(label),
        layout,
        entries: &entries,
    })
}

/// Returns the words of a table that have bits: place, low half, high half.
pub(super) fn filled_words(words: &[u64]) -> Vec<[u32; 3]> {
    let some = words.par_iter().enumerate().filter(|(_, word)| **word != 0);
    some.map(|(at, word)| [at as u32, *word as u32, (*word >> 32) as u32])
        .collect()
}
