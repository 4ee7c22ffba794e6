//! Reader of results at run time: opens and checks a file, and returns its contents other than the sets.
//!
//! [`Pvs::open`] checks the whole file once. Functions that decode sets check their input again. So a file
//! that was tampered with (wrong contents under right checksums) gives an error and never a panic.

mod cells;
mod sets;

use std::fs::File;
use std::io::Read as _;
use std::path::Path;
use std::sync::{Arc, OnceLock};

use crate::builder::check_tiling;
use crate::error::PvsError;
use crate::items::ItemTable;
use crate::layout::{LEAST_SECTIONS, Layout, Section, Written, header, u32_at, u64_at};
use crate::parse::{check_offsets, read_objects, read_sources, read_tree};
use crate::portals::Portals;
use crate::scene_parts::SceneParts;
use crate::tree::CellTree;
use crate::{CellPairs, Column, Contribution, Granularity, NOT_REACHED, Object, SET_ASIDE};
use crate::{columns, contributions};

pub use sets::NodeBytes;

/// An opened result. Threads can share a `Pvs`, and look-ups acquire no lock.
pub struct Pvs {
    bytes: Bytes,
    layout: Layout,
    tree: CellTree,
    objects: Vec<Object>,
    items: ItemTable,
    /// The relations, which are decoded at their first use.
    pairs: OnceLock<Option<CellPairs>>,
    portals: OnceLock<Option<Portals>>,
}

/// The size in bytes from which [`Pvs::open`] maps a file instead of reading it: 256 MiB.
pub const MAPPED_FROM: u64 = 256 << 20;

/// Reads a file that had `length` bytes when it was opened. If the file is truncated during the read, the
/// result has fewer bytes, and the later check against the header's length fails.
fn read(file: File, length: u64) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let room = usize::try_from(length).map_err(|_| std::io::ErrorKind::OutOfMemory)?;
    bytes
        .try_reserve_exact(room)
        .map_err(|_| std::io::ErrorKind::OutOfMemory)?;
    file.take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

enum Bytes {
    Mapped(memmap2::Mmap),
    Read(Vec<u8>),
    Owned(Arc<[u8]>),
}

impl Bytes {
    fn get(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Read(bytes) => bytes,
            Self::Owned(bytes) => bytes,
        }
    }
}

impl std::fmt::Debug for Pvs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pvs")
            .field("layout", &self.layout)
            .finish_non_exhaustive()
    }
}

impl Pvs {
    /// Opens a file and checks all of it. A file below [`MAPPED_FROM`] bytes is read into memory, and later
    /// changes of the file have no effect.
    ///
    /// A larger file is mapped: the operating system loads its pages as they are used, and can drop them. A
    /// mapped file must not be changed in place while it is open. If another program truncates the file, the
    /// operating system ends this process with SIGBUS (Windows does not let the other program truncate the
    /// file). To replace a result, write another file and rename it, as all commands of Sightline do.
    ///
    /// # Errors
    /// [`PvsError::Open`] if the file cannot be read, and the errors of [`Self::from_bytes`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, PvsError> {
        Self::open_mapping_from(path.as_ref(), MAPPED_FROM)
    }

    /// Opens a file like [`Self::open`], but maps files from `mapped_from` bytes on.
    fn open_mapping_from(path: &Path, mapped_from: u64) -> Result<Self, PvsError> {
        let failed = |source| PvsError::Open {
            path: path.to_owned(),
            source,
        };
        let file = File::open(path).map_err(failed)?;
        let metadata = file.metadata().map_err(failed)?;
        if metadata.is_dir() {
            return Err(failed(std::io::ErrorKind::IsADirectory.into()));
        }
        if metadata.len() < mapped_from {
            return Self::check(Bytes::Read(read(file, metadata.len()).map_err(failed)?));
        }
        #[allow(unsafe_code, reason = "mapping a file is unsafe")]
        // SAFETY: the map is read-only and used as bytes, for which any contents are valid. Another process
        // must not change or truncate the file while it is open, which the documentation of `open` forbids.
        // Decoded numbers are checked before they are used as lengths or indices.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(failed)?;
        Self::check(Bytes::Mapped(map))
    }

    /// Checks a whole file that is in memory.
    ///
    /// # Errors
    /// [`PvsError::NotPvs`], [`PvsError::Version`], [`PvsError::Length`] and [`PvsError::Checksum`] if the
    /// bytes are not a whole, unaltered file of a known version. [`PvsError::Malformed`], [`PvsError::Tree`]
    /// and [`PvsError::Objects`] if the contents contradict each other.
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
            return Err(Section::Tree.malformed("the number of cells differs from the header's"));
        }
        let mut objects = read_objects(part(Section::Objects))?;
        check_tiling(layout.triangles, objects.iter().map(|o| (o.first, o.count)))?;
        if layout.has(Section::Sources) {
            read_sources(part(Section::Sources), &mut objects)?;
        }
        let items = match layout.has(Section::Items) {
            true => ItemTable::decode(part(Section::Items), layout.triangles, &objects)?,
            false => ItemTable::Triangles,
        };
        if part(Section::Flags).len() as u64 != u64::from(layout.cells) * 4 {
            return Err(
                Section::Flags.malformed("the number of flags differs from the number of cells")
            );
        }
        check_offsets(Section::Visible, part(Section::Visible), layout.nodes)?;
        if !part(Section::Undecided).is_empty() {
            check_offsets(Section::Undecided, part(Section::Undecided), layout.nodes)?;
        }
        if layout.has(Section::Certificates) {
            check_offsets(
                Section::Certificates,
                part(Section::Certificates),
                layout.cells,
            )?;
        }
        // The section of columns is empty only if certificates follow.
        if layout.has(Section::Columns)
            && !(part(Section::Columns).is_empty() && layout.has(Section::Certificates))
        {
            columns::check(part(Section::Columns), layout.cells)?;
        }
        if layout.has(Section::Contributions) {
            check_offsets(
                Section::Contributions,
                part(Section::Contributions),
                layout.cells,
            )?;
        }
        Ok(Self {
            layout,
            tree,
            objects,
            items,
            bytes,
            pairs: OnceLock::new(),
            portals: OnceLock::new(),
        })
    }

    /// Returns the region that contains all viewpoints, as bytes that this crate does not parse. Returns
    /// `None` if viewpoints are not restricted to a region.
    pub fn region(&self) -> Option<&[u8]> {
        self.layout
            .has(Section::Region)
            .then(|| self.part(Section::Region))
    }

    /// Returns the scene divided along its walls, or `None` if the result has no portals.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the portals are malformed although the checksums match.
    pub fn portals(&self) -> Result<Option<&Portals>, PvsError> {
        if self.portals.get().is_none() {
            let is_there = self.layout.has(Section::Portals);
            let decoded = is_there
                .then(|| Portals::decode(self.part(Section::Portals), self.layout.triangles));
            // Another thread may have set the same value first.
            let _ = self.portals.set(decoded.transpose()?);
        }
        Ok(self.portals.get().and_then(Option::as_ref))
    }

    /// Returns the bytes of the whole file.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get()
    }

    fn part(&self, section: Section) -> &[u8] {
        &self.bytes.get()[self.layout.range(section)]
    }

    /// Returns the items, the region and the portals, for another result of the same scene.
    pub fn scene_parts(&self) -> SceneParts {
        SceneParts {
            triangles: self.triangle_count(),
            objects: self.objects.len(),
            items: self.part(Section::Items).to_vec(),
            item_count: self.item_count(),
            region: self.part(Section::Region).to_vec(),
            portals: self.part(Section::Portals).to_vec(),
        }
    }

    /// Returns the bytes of a file with some sections of this file. These are the sections that every file
    /// has, and the optional sections of this file that are in `wanted`.
    pub fn with_sections(&self, wanted: &[Section]) -> Vec<u8> {
        let is_kept = |section: &Section| {
            (*section as usize) < LEAST_SECTIONS
                || wanted.contains(section) && self.layout.has(*section)
        };
        let kept: Vec<Section> = Section::ALL.into_iter().filter(is_kept).collect();
        let written: Vec<Written> = kept
            .iter()
            .map(|s| Written::new(*s, self.part(*s)))
            .collect();
        let mut out = header(
            self.layout.triangles,
            self.layout.cells,
            self.layout.nodes,
            &written,
        );
        kept.iter()
            .for_each(|section| out.extend(self.part(*section)));
        out
    }

    fn text(&self, section: Section) -> &str {
        // Opening has checked the text. If the file was changed since then, the text reads as empty.
        std::str::from_utf8(self.part(section)).unwrap_or_default()
    }

    /// Returns the number of triangles of the scene, N.
    pub fn triangle_count(&self) -> u32 {
        self.layout.triangles
    }

    /// Returns the number of view cells, M.
    pub fn cells(&self) -> u32 {
        self.layout.cells
    }

    /// Returns the tree of the view cells.
    pub fn tree(&self) -> &CellTree {
        &self.tree
    }

    /// Returns the JSON text that the builder received: parameters and counters of the bake.
    pub fn info_json(&self) -> &str {
        self.text(Section::Info)
    }

    /// Returns the name of the method that computed the sets: "aggressive", "exact", "verified" or "portals".
    pub fn method(&self) -> &str {
        self.text(Section::Method)
    }

    /// Returns the objects of the scene, which tile its triangles.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Returns the index of the cell that contains a point in world space, or `None` outside the view box.
    /// [`CellTree::find_cell`] documents the treatment of points on planes and borders.
    pub fn find_cell(&self, point: [f32; 3]) -> Option<u32> {
        self.tree.find_cell(point)
    }

    /// Returns the cell of a point like [`Self::find_cell`], for coordinates in doubles.
    pub fn find_cell_precisely(&self, point: [f64; 3]) -> Option<u32> {
        self.tree.find_cell_precisely(point)
    }

    /// Returns the box of a cell in world space (min, max), or `None` if the cell does not exist.
    pub fn cell_bounds(&self, cell: u32) -> Option<[[f32; 3]; 2]> {
        self.tree.cell_bounds(cell)
    }

    /// Returns the flags of a cell: [`SET_ASIDE`] and [`NOT_REACHED`].
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if the cell does not exist.
    pub fn flags(&self, cell: u32) -> Result<u32, PvsError> {
        self.leaf(cell)?;
        Ok(u32_at(self.part(Section::Flags), cell as usize * 4))
    }

    /// Returns true if the cell's tile was set aside or has no output, so that the cell's set was not
    /// computed ([`SET_ASIDE`]).
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if the cell does not exist.
    pub fn is_set_aside(&self, cell: u32) -> Result<bool, PvsError> {
        Ok(self.flags(cell)? & SET_ASIDE != 0)
    }

    /// Returns true if viewpoints can be in the cell. A cell without viewpoints was not sampled, and its sets
    /// are empty.
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if the cell does not exist.
    pub fn is_reached(&self, cell: u32) -> Result<bool, PvsError> {
        Ok(self.flags(cell)? & NOT_REACHED == 0)
    }

    /// Returns the type of items that the sets of the result name.
    pub fn granularity(&self) -> Granularity {
        self.items.granularity()
    }

    /// Returns the number of items that the sets name, K.
    pub fn item_count(&self) -> u32 {
        self.items.count(self.layout.triangles, &self.objects)
    }

    /// Returns true if the file contains the contribution of each item to the view.
    pub fn has_contributions(&self) -> bool {
        self.layout.has(Section::Contributions)
    }

    /// Returns the contribution of each item visible from a cell, in the order of [`Self::visible_items`].
    /// Returns `None` if the file has no contributions.
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if the cell does not exist. [`PvsError::Malformed`] if the numbers of
    /// contributions and of visible items of the cell differ.
    pub fn contributions(&self, cell: u32) -> Result<Option<Vec<Contribution>>, PvsError> {
        self.leaf(cell)?;
        if !self.has_contributions() {
            return Ok(None);
        }
        let bytes =
            contributions::of_cell(self.part(Section::Contributions), cell, self.layout.cells)?;
        if self.visible_item_count(cell)? != bytes.len() {
            return Err(Section::Contributions
                .malformed("the numbers of a cell's values and of its visible items differ"));
        }
        Ok(Some(
            bytes.iter().map(|b| Contribution::from_byte(*b)).collect(),
        ))
    }

    /// Returns the statistics of the bake, one value per cell, in the order in which the builder received
    /// them. Returns no columns if the file has none. Every call decodes the columns, because only tools read
    /// them, and an engine does not need them in memory.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the file was changed after opening.
    pub fn columns(&self) -> Result<Vec<Column>, PvsError> {
        if self.part(Section::Columns).is_empty() {
            return Ok(Vec::new());
        }
        columns::decode(self.part(Section::Columns), self.layout.cells)
    }

    /// Returns the bytes of a cell's certificate, or `None` if the file has no certificates. This crate does
    /// not parse the bytes.
    ///
    /// # Errors
    /// [`PvsError::NoCell`] if the cell does not exist. [`PvsError::Malformed`] if the file was changed after
    /// opening.
    pub fn certificate(&self, cell: u32) -> Result<Option<&[u8]>, PvsError> {
        self.leaf(cell)?;
        if !self.layout.has(Section::Certificates) {
            return Ok(None);
        }
        let section = self.part(Section::Certificates);
        let head = (self.layout.cells as usize + 1) * 8;
        let [from, to] = [0, 1].map(|k| u64_at(section, (cell as usize + k) * 8) as usize);
        let bytes = head
            .checked_add(from)
            .zip(head.checked_add(to))
            .and_then(|(a, b)| section.get(a..b));
        bytes.map(Some).ok_or_else(|| {
            Section::Certificates
                .malformed("the certificate of a cell reaches beyond the end of the section")
        })
    }

    fn leaf(&self, cell: u32) -> Result<u32, PvsError> {
        self.tree.leaf(cell).ok_or(PvsError::NoCell {
            cell,
            cells: self.layout.cells,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builder, Header, Node};

    #[test]
    fn mapped_file_gives_same_sets_as_read_file() {
        let tree = CellTree::new([[0.0; 3], [1.0; 3]], vec![Node::Leaf]).unwrap();
        let object = Object {
            name: "all".into(),
            first: 0,
            count: 9,
            source: None,
        };
        let (method, info_json) = ("aggressive".into(), "{}".into());
        let header = Header {
            triangles: 9,
            method,
            tree,
            objects: vec![object],
            info_json,
        };
        let mut builder = Builder::new(header).unwrap();
        builder.push_cell(&[1, 2, 8], &[], 0).unwrap();
        let mut file = Vec::new();
        builder.finish(&mut file).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pvs");
        std::fs::write(&path, &file).unwrap();
        for (mapped_from, is_mapped) in [(file.len() as u64, true), (file.len() as u64 + 1, false)]
        {
            let pvs = Pvs::open_mapping_from(&path, mapped_from).unwrap();
            assert_eq!(matches!(pvs.bytes, Bytes::Mapped(_)), is_mapped);
            assert_eq!(pvs.bytes(), file);
            let mut ids = Vec::new();
            pvs.visible(0, &mut ids).unwrap();
            assert_eq!(ids, [1, 2, 8]);
        }
    }
}
