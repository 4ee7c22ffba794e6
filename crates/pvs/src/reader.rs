//! Reading a result at run time: opening, checking, finding a point's cell, decoding its sets.
//!
//! Everything is checked once, on opening. What decodes sets still checks what it reads, so that a file made to
//! deceive (right checksums around wrong contents) gives an error, never a wrong id or a panic.

use std::fs::File;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use crate::builder::check_tiling;
use crate::error::PvsError;
use crate::layout::{Layout, Section, u32_at, u64_at};
use crate::parse::{check_offsets, read_objects, read_tree};
use crate::tree::CellTree;
use crate::{Column, Object, SET_ASIDE, codec, columns};

/// An opened result. Cheap to share between threads; looking up needs no lock.
pub struct Pvs {
    bytes: Bytes,
    layout: Layout,
    tree: CellTree,
    objects: Vec<Object>,
}

enum Bytes {
    Mapped(memmap2::Mmap),
    Owned(Arc<[u8]>),
}

impl Bytes {
    fn get(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Owned(bytes) => bytes,
        }
    }
}

/// How many bytes the nodes on one cell's root path take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeBytes {
    /// The leaf's own set.
    pub own: u64,
    /// All that is read to decode the cell, the leaf's set included.
    pub path: u64,
}

impl std::fmt::Debug for Pvs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pvs").field("layout", &self.layout).finish_non_exhaustive()
    }
}

impl Pvs {
    /// Maps and checks a file. It reads the file once; pages not used afterwards can be dropped by the system.
    ///
    /// The file must not be changed in place while it is open: a result is replaced by writing another file and
    /// renaming it.
    ///
    /// # Errors
    /// [`PvsError::Open`] when it cannot be read, otherwise as [`Self::from_bytes`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, PvsError> {
        let path = path.as_ref();
        let failed = |source| PvsError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        if file.metadata().map_err(failed)?.len() == 0 {
            // An empty file cannot be mapped on every system.
            return Err(PvsError::NotPvs);
        }
        #[allow(unsafe_code, reason = "mapping a file is unsafe")]
        // SAFETY: the map is read-only and used as bytes only, for which any contents are valid. What remains is
        // that another process changes or truncates the file meanwhile; this is documented as forbidden above,
        // and nothing decoded is ever trusted as a length or an index without a check.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(failed)?;
        Self::check(Bytes::Mapped(map))
    }

    /// Takes a whole file from memory and checks it.
    ///
    /// # Errors
    /// [`PvsError::NotPvs`], [`PvsError::Version`], [`PvsError::Length`], [`PvsError::Checksum`] for what is not a
    /// whole, unaltered file; [`PvsError::Malformed`], [`PvsError::Tree`], [`PvsError::Objects`] for one whose
    /// contents contradict themselves.
    pub fn from_bytes(bytes: impl Into<Arc<[u8]>>) -> Result<Self, PvsError> {
        Self::check(Bytes::Owned(bytes.into()))
    }

    fn check(bytes: Bytes) -> Result<Self, PvsError> {
        let file = bytes.get();
        let layout = Layout::parse(file)?;
        let part = |section: Section| &file[layout.range(section)];
        for section in [Section::Info, Section::Method] {
            std::str::from_utf8(part(section)).map_err(|e| section.malformed(e.to_string()))?;
        }
        let tree = read_tree(part(Section::Tree), layout.nodes)?;
        if tree.cells() != layout.cells {
            return Err(Section::Tree.malformed("it does not have as many cells as the header says"));
        }
        let objects = read_objects(part(Section::Objects))?;
        check_tiling(layout.triangles, objects.iter().map(|o| (o.first, o.count)))?;
        if part(Section::Flags).len() as u64 != u64::from(layout.cells) * 4 {
            return Err(Section::Flags.malformed("it does not have one word a cell"));
        }
        check_offsets(Section::Visible, part(Section::Visible), layout.nodes)?;
        if !part(Section::Undecided).is_empty() {
            check_offsets(Section::Undecided, part(Section::Undecided), layout.nodes)?;
        }
        if layout.has(Section::Evidence) {
            check_offsets(Section::Evidence, part(Section::Evidence), layout.cells)?;
        }
        // Empty only where evidence follows.
        if layout.has(Section::Columns)
            && !(part(Section::Columns).is_empty() && layout.has(Section::Evidence))
        {
            columns::check(part(Section::Columns), layout.cells)?;
        }
        Ok(Self { layout, tree, objects, bytes })
    }

    fn part(&self, section: Section) -> &[u8] {
        &self.bytes.get()[self.layout.range(section)]
    }

    fn text(&self, section: Section) -> &str {
        // Checked on opening; if the file was changed since, against the rules, it is shown as empty.
        std::str::from_utf8(self.part(section)).unwrap_or_default()
    }

    /// N, the number of triangles of the scene.
    pub fn triangle_count(&self) -> u32 {
        self.layout.triangles
    }

    /// M, the number of view cells.
    pub fn cells(&self) -> u32 {
        self.layout.cells
    }

    /// The tree of the view cells.
    pub fn tree(&self) -> &CellTree {
        &self.tree
    }

    /// The baker's account, JSON as it was given to the builder.
    pub fn info_json(&self) -> &str {
        self.text(Section::Info)
    }

    /// How the sets were made: "aggressive", "exact" or "verified".
    pub fn method(&self) -> &str {
        self.text(Section::Method)
    }

    /// The objects of the scene, tiling its triangles.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The cell of a point (world space). See [`CellTree::find_cell`] for planes and borders.
    pub fn find_cell(&self, point: [f32; 3]) -> Option<u32> {
        self.tree.find_cell(point)
    }

    /// The box of a cell, min and max (world space); `None` when there is no such cell.
    pub fn cell_bounds(&self, cell: u32) -> Option<[[f32; 3]; 2]> {
        self.tree.cell_bounds(cell)
    }

    /// A cell's flags.
    ///
    /// # Errors
    /// [`PvsError::NoCell`].
    pub fn flags(&self, cell: u32) -> Result<u32, PvsError> {
        self.leaf(cell)?;
        Ok(u32_at(self.part(Section::Flags), cell as usize * 4))
    }

    /// Whether the cell's job was set aside, so that everything is shipped as visible.
    ///
    /// # Errors
    /// [`PvsError::NoCell`].
    pub fn is_set_aside(&self, cell: u32) -> Result<bool, PvsError> {
        Ok(self.flags(cell)? & SET_ASIDE != 0)
    }

    /// What the baker counted in each cell, in the order it was given to the builder; empty for a file
    /// without. Decoded anew each time: it is for who looks at a bake, and an engine need not keep it in
    /// memory.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] for a file that was changed after opening.
    pub fn columns(&self) -> Result<Vec<Column>, PvsError> {
        if self.part(Section::Columns).is_empty() {
            return Ok(Vec::new());
        }
        columns::decode(self.part(Section::Columns), self.layout.cells)
    }

    /// The reasons for a cell's set as the baker wrote them, opaque here; `None` when the file has none.
    ///
    /// # Errors
    /// [`PvsError::NoCell`], and [`PvsError::Malformed`] for a file that was changed after opening.
    pub fn evidence(&self, cell: u32) -> Result<Option<&[u8]>, PvsError> {
        self.leaf(cell)?;
        if !self.layout.has(Section::Evidence) {
            return Ok(None);
        }
        let section = self.part(Section::Evidence);
        let head = (self.layout.cells as usize + 1) * 8;
        let [from, to] = [0, 1].map(|k| u64_at(section, (cell as usize + k) * 8) as usize);
        let bytes = head.checked_add(from).zip(head.checked_add(to)).and_then(|(a, b)| section.get(a..b));
        bytes.map(Some).ok_or_else(|| Section::Evidence.malformed("a cell's part is beyond its end"))
    }

    /// What to draw from a cell: `ids` becomes the ascending triangle ids.
    ///
    /// # Errors
    /// [`PvsError::NoCell`], [`PvsError::Memory`], and [`PvsError::Malformed`] for a file made to deceive.
    pub fn visible(&self, cell: u32, ids: &mut Vec<u32>) -> Result<(), PvsError> {
        self.ids(Section::Visible, cell, ids)
    }

    /// The part of the visible set that was neither seen nor proved hidden: `ids` becomes the ascending ids.
    ///
    /// # Errors
    /// As [`Self::visible`].
    pub fn undecided(&self, cell: u32, ids: &mut Vec<u32>) -> Result<(), PvsError> {
        self.ids(Section::Undecided, cell, ids)
    }

    /// What to draw from a cell as maximal runs of consecutive ids, ascending: what a draw call wants.
    ///
    /// # Errors
    /// As [`Self::visible`].
    pub fn visible_runs(&self, cell: u32, runs: &mut Vec<Range<u32>>) -> Result<(), PvsError> {
        runs.clear();
        self.each_run(Section::Visible, cell, |run| runs.push(run))
    }

    /// What to draw from a cell as a bit set, the cheapest to keep: bit `id % 64` of word `id / 64`.
    /// `bits` must have ⌈N / 64⌉ words; all are written.
    ///
    /// # Errors
    /// As [`Self::visible`], and [`PvsError::BitsLength`].
    pub fn visible_bits(&self, cell: u32, bits: &mut [u64]) -> Result<(), PvsError> {
        let needed = self.words();
        if bits.len() != needed {
            return Err(PvsError::BitsLength { given: bits.len(), needed });
        }
        bits.fill(0);
        self.boundaries(Section::Visible, cell, bits)?;
        let mut inside = 0;
        for word in bits {
            *word = members(*word, &mut inside);
        }
        Ok(())
    }

    /// The objects of which at least one triangle is visible: `objects` becomes their ascending indices.
    ///
    /// # Errors
    /// As [`Self::visible`].
    pub fn visible_objects(&self, cell: u32, objects: &mut Vec<u32>) -> Result<(), PvsError> {
        self.objects_of(Section::Visible, cell, objects)
    }

    /// The objects of which at least one triangle is undecided: `objects` becomes their ascending indices.
    ///
    /// # Errors
    /// As [`Self::visible`].
    pub fn undecided_objects(&self, cell: u32, objects: &mut Vec<u32>) -> Result<(), PvsError> {
        self.objects_of(Section::Undecided, cell, objects)
    }

    /// What a cell's visible set takes in the file.
    ///
    /// # Errors
    /// [`PvsError::NoCell`], and [`PvsError::Malformed`] for a file that was changed after opening.
    pub fn visible_bytes(&self, cell: u32) -> Result<NodeBytes, PvsError> {
        let leaf = self.leaf(cell)?;
        let own = self.set(Section::Visible, leaf)?.len() as u64;
        let mut path = 0;
        for node in self.tree.path(leaf) {
            let set = self.set(Section::Visible, node)?;
            path += set.len() as u64;
            if codec::is_absolute(set) {
                break;
            }
        }
        Ok(NodeBytes { own, path })
    }

    /// Bytes of the whole file, and of its visible and its undecided sets (with their offsets).
    pub fn file_bytes(&self) -> [u64; 3] {
        let part = |s| self.part(s).len() as u64;
        [self.bytes.get().len() as u64, part(Section::Visible), part(Section::Undecided)]
    }

    /// The bytes of the visible sets as they are in the file, for comparing ways to code them.
    pub fn visible_section(&self) -> &[u8] {
        self.part(Section::Visible)
    }

    fn leaf(&self, cell: u32) -> Result<u32, PvsError> {
        self.tree.leaf(cell).ok_or(PvsError::NoCell { cell, cells: self.layout.cells })
    }

    /// Words of a bit set over all triangles.
    fn words(&self) -> usize {
        (self.layout.triangles as usize).div_ceil(64)
    }

    fn ids(&self, section: Section, cell: u32, ids: &mut Vec<u32>) -> Result<(), PvsError> {
        ids.clear();
        let words = self.marked(section, cell)?;
        let mut inside = 0;
        let mut part = [0u32; 64];
        for (i, &word) in words.iter().enumerate() {
            if word == 0 && inside == 0 {
                continue;
            }
            let mut rest = members(word, &mut inside);
            let mut count = 0;
            while rest != 0 {
                part[count] = i as u32 * 64 + rest.trailing_zeros();
                count += 1;
                rest &= rest - 1;
            }
            if ids.try_reserve(count).is_err() {
                return Err(self.no_memory());
            }
            ids.extend_from_slice(&part[..count]);
        }
        Ok(())
    }

    fn no_memory(&self) -> PvsError {
        PvsError::Memory { triangles: self.layout.triangles }
    }

    fn objects_of(&self, section: Section, cell: u32, objects: &mut Vec<u32>) -> Result<(), PvsError> {
        objects.clear();
        let mut next = 0;
        self.each_run(section, cell, |run| {
            // Objects tile the triangles in order: skip those that end before the run, take those it touches.
            next += self.objects[next..].partition_point(|o| o.first + o.count <= run.start);
            while let Some(o) = self.objects.get(next).filter(|o| o.first < run.end) {
                if o.count > 0 {
                    objects.push(next as u32);
                }
                next += 1;
            }
        })
    }

    /// The coded set of a node.
    fn set(&self, section: Section, node: u32) -> Result<&[u8], PvsError> {
        let bytes = self.part(section);
        let table = (self.layout.nodes as usize + 1) * 8;
        let at = |i: usize| usize::try_from(u64_at(bytes, i * 8)).ok();
        // Checked on opening. Asked again because it is cheap and keeps a file changed since from panicking.
        match (at(node as usize), at(node as usize + 1)) {
            (Some(start), Some(end)) => bytes[table..].get(start..end),
            _ => None,
        }
        .ok_or_else(|| section.malformed("an offset is out of range"))
    }

    /// Marks where runs of the cell's set start and end, in zeroed words: the exclusive or of sets is that of
    /// their boundaries, so each set on the root path flips its own. Only an end at the very last bit finds no place,
    /// and needs none: no bit beyond the last triangle is ever a member.
    fn boundaries(&self, section: Section, cell: u32, words: &mut [u64]) -> Result<(), PvsError> {
        let leaf = self.leaf(cell)?;
        if self.part(section).is_empty() {
            return Ok(());
        }
        for node in self.tree.path(leaf) {
            let set = self.set(section, node)?;
            codec::decode(set, self.layout.triangles, |start, end| {
                let (first, last) = ((start >> 6) as usize, (end >> 6) as usize);
                let (mark_start, mark_end) = (1u64 << (start & 63), 1u64 << (end & 63));
                if first == last {
                    // Most runs are short; one access instead of two to the same word, the second waiting for the first.
                    if let Some(word) = words.get_mut(first) {
                        *word ^= mark_start ^ mark_end;
                    }
                } else {
                    if let Some(word) = words.get_mut(first) {
                        *word ^= mark_start;
                    }
                    if let Some(word) = words.get_mut(last) {
                        *word ^= mark_end;
                    }
                }
            })
            .map_err(|e| section.malformed(format!("the set of node {node}: {}", e.0)))?;
            if codec::is_absolute(set) {
                break;
            }
        }
        Ok(())
    }

    /// The marks of [`Self::boundaries`] in words of their own.
    fn marked(&self, section: Section, cell: u32) -> Result<Vec<u64>, PvsError> {
        let mut words = Vec::new();
        words.try_reserve_exact(self.words()).map_err(|_| self.no_memory())?;
        words.resize(self.words(), 0u64);
        self.boundaries(section, cell, &mut words)?;
        Ok(words)
    }

    /// Gives the maximal runs of a cell's set, ascending.
    fn each_run(
        &self,
        section: Section,
        cell: u32,
        mut each: impl FnMut(Range<u32>),
    ) -> Result<(), PvsError> {
        let words = self.marked(section, cell)?;
        let mut start = None;
        for (i, &word) in words.iter().enumerate() {
            let mut rest = word;
            while rest != 0 {
                let at = i as u32 * 64 + rest.trailing_zeros();
                rest &= rest - 1;
                start = match start {
                    None => Some(at),
                    Some(from) => {
                        each(from..at);
                        None
                    }
                };
            }
        }
        if let Some(from) = start {
            each(from..self.layout.triangles);
        }
        Ok(())
    }
}

/// From marked boundaries to members: each bit becomes the parity of the marks at or before it. `inside` is all ones
/// when the word before ended within a run.
fn members(marks: u64, inside: &mut u64) -> u64 {
    let mut x = marks;
    if x != 0 {
        for shift in [1, 2, 4, 8, 16, 32] {
            x ^= x << shift;
        }
    }
    x ^= *inside;
    *inside = (x >> 63).wrapping_neg();
    x
}
