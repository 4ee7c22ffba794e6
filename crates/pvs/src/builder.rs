//! Builder of result files: checks the input and writes the sections. The module `hierarchy` chooses the sets
//! of the inner tree nodes.

use std::fs::File;
use std::io::Write;

use crate::certificates::{CertificateBytes, Certificates};
use crate::columns::{self, Column};
use crate::error::PvsError;
use crate::hierarchy::{CodedSet, Hierarchy};
use crate::layout::{self, Section, Written};
use crate::portals::Portals;
use crate::scene_parts::SceneParts;
use crate::tree::{CellTree, Node};
use crate::{CellPairs, Contribution, Items, NOT_REACHED, Object, SET_ASIDE, parse, runs};

/// The parts of a result that are known before the first cell.
#[derive(Clone, Debug)]
pub struct Header {
    /// The number of triangles, N.
    pub triangles: u32,
    /// The name of the method that computed the sets: "aggressive", "exact", "verified" or "portals".
    pub method: String,
    /// The view cells.
    pub tree: CellTree,
    /// The objects of the scene, which tile the triangles 0…N−1 in order.
    pub objects: Vec<Object>,
    /// The parameters, numerics profile and counters of the bake as JSON. This crate does not parse the text.
    pub info_json: String,
}

/// The sizes of the parts of a finished file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stats {
    /// The length of the file, in bytes.
    pub file_bytes: u64,
    /// The size of the visible sets with their offsets, in bytes.
    pub visible_bytes: u64,
    /// The size of the undecided sets with their offsets, in bytes; 0 if no item is undecided.
    pub undecided_bytes: u64,
    /// The size of the columns, in bytes; 0 if the file has no columns.
    pub column_bytes: u64,
    /// The size of the certificates with their offsets, in bytes; 0 if the file has no certificates.
    pub certificate_bytes: u64,
    /// The size of the relations between cells, in bytes; 0 if the file has no such relations.
    pub pair_bytes: u64,
    /// The size of the contributions with their offsets, in bytes; 0 if the file has no contributions.
    pub contribution_bytes: u64,
    /// The sum of the numbers of ids in the visible sets.
    pub visible_ids: u64,
    /// The sum of the numbers of ids in the undecided sets.
    pub undecided_ids: u64,
}

/// The sets of a cell. The ids name the items of the result: triangles, unless [`Builder::set_items`] was
/// called.
#[derive(Clone, Copy, Debug)]
pub struct Cell<'a> {
    /// The items to draw from the cell, ascending.
    pub visible: &'a [u32],
    /// The items of `visible` that were neither seen nor proved hidden, ascending.
    pub undecided: &'a [u32],
    /// The bits [`SET_ASIDE`] and [`NOT_REACHED`]. The builder stores other bits unchanged.
    pub flags: u32,
}

/// A builder that collects the sets of the cells in cell order and writes the file. Equal input gives equal
/// bytes.
pub struct Builder {
    header: Header,
    flags: Vec<u32>,
    visible: Hierarchy,
    undecided: Hierarchy,
    /// The coded section of columns; empty without columns.
    columns: Vec<u8>,
    certificates: Certificates,
    /// The coded section of items; empty if the sets name triangles.
    items: Vec<u8>,
    /// The number of items.
    item_count: u32,
    /// The coded section of cell-to-cell relations; empty without them.
    pairs: Vec<u8>,
    contributions: Contributions,
    /// The coded region of the viewpoints; empty if viewpoints are not restricted to a region.
    region: Vec<u8>,
    /// The coded section of portals; empty without portals.
    portals: Vec<u8>,
}

/// The contributions pushed so far.
#[derive(Default)]
struct Contributions {
    /// The end offset of the contributions of each cell, in bytes.
    ends: Vec<u64>,
    bytes: Vec<u8>,
}

impl Builder {
    /// Creates a builder for a result with this header.
    ///
    /// # Errors
    /// [`PvsError::Objects`] if the objects do not tile the triangles. [`PvsError::TooLarge`] if a name or a
    /// count does not fit in 32 bits.
    pub fn new(header: Header) -> Result<Self, PvsError> {
        check_tiling(
            header.triangles,
            header.objects.iter().map(|o| (o.first, o.count)),
        )?;
        let limit = u64::from(u32::MAX);
        let longest = header
            .objects
            .iter()
            .map(|o| o.name.len())
            .max()
            .unwrap_or(0) as u64;
        for (what, value) in [
            ("the number of objects", header.objects.len() as u64),
            ("an object's name", longest),
        ] {
            if value > limit {
                return Err(PvsError::TooLarge { what, value, limit });
            }
        }
        Ok(Self {
            flags: Vec::new(),
            visible: Hierarchy::default(),
            undecided: Hierarchy::default(),
            columns: Vec::new(),
            certificates: Certificates::default(),
            items: Vec::new(),
            item_count: header.triangles,
            pairs: Vec::new(),
            contributions: Contributions::default(),
            region: Vec::new(),
            portals: Vec::new(),
            header,
        })
    }

    /// Sets the region that contains all viewpoints, as bytes that this crate does not parse.
    pub fn set_region(&mut self, bytes: Vec<u8>) {
        self.region = bytes;
    }

    /// Sets the portals, as bytes that [`crate::Portals::encode`] returned.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the portals do not belong to the result's triangles.
    pub fn set_portals(&mut self, bytes: Vec<u8>) -> Result<(), PvsError> {
        Portals::decode(&bytes, self.header.triangles)?;
        self.portals = bytes;
        Ok(())
    }

    /// Sets the items that the ids of the sets name. Call this function before the first cell.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the triangle ids of an item do not ascend strictly or are not below N, or
    /// if a cell was already pushed.
    pub fn set_items(&mut self, items: &Items) -> Result<(), PvsError> {
        if !self.flags.is_empty() {
            return Err(
                Section::Items.malformed("a cell was pushed before the items; set the items first")
            );
        }
        let Header {
            triangles, objects, ..
        } = &self.header;
        self.items = items.encode(*triangles, objects.len())?;
        // `encode` has checked that the count fits in 32 bits.
        self.item_count = match items {
            Items::Clusters(clusters) => clusters.len() as u32,
            Items::Objects { .. } => objects.len() as u32,
        };
        Ok(())
    }

    /// Sets the items, the region and the portals to those parts of a result of the same scene
    /// ([`crate::Pvs::scene_parts`]). Call this function before the first cell.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the result has another number of triangles or objects, or if a cell was
    /// already pushed.
    pub fn set_scene_parts(&mut self, parts: SceneParts) -> Result<(), PvsError> {
        let own = (self.header.triangles, self.header.objects.len());
        if own != (parts.triangles, parts.objects) {
            return Err(
                Section::Items.malformed("the results have other numbers of triangles or objects")
            );
        }
        if !self.flags.is_empty() {
            return Err(
                Section::Items.malformed("a cell was pushed before the items; set the items first")
            );
        }
        self.items = parts.items;
        self.item_count = parts.item_count;
        self.region = parts.region;
        self.portals = parts.portals;
        Ok(())
    }

    /// Sets the cell-to-cell relations, at any time before [`Self::finish`].
    ///
    /// # Errors
    /// [`PvsError::Malformed`] if the relations have another number of cells than the tree, or if a pair is
    /// undecided and not visible.
    pub fn set_pairs(&mut self, pairs: &CellPairs) -> Result<(), PvsError> {
        pairs.check(self.header.tree.cells())?;
        self.pairs = pairs.encode();
        Ok(())
    }

    /// Adds the contributions of the items visible from the next cell, in the order of its visible set. Call
    /// this function for every cell or for no cell.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] if all cells already have contributions.
    pub fn push_contributions(&mut self, contributions: &[Contribution]) -> Result<(), PvsError> {
        let all = &mut self.contributions;
        let (expected, pushed) = (self.header.tree.cells(), all.ends.len() as u64 + 1);
        if pushed > u64::from(expected) {
            return Err(PvsError::CellCount { expected, pushed });
        }
        all.bytes.extend(contributions.iter().map(|c| c.byte()));
        all.ends.push(all.bytes.len() as u64);
        Ok(())
    }

    /// Adds the next cell with its sets and flags. `undecided` contains the ids of `visible` that were
    /// neither seen nor proved hidden. See [`Cell`].
    ///
    /// # Errors
    /// The errors of [`Self::push_cells`].
    pub fn push_cell(
        &mut self,
        visible: &[u32],
        undecided: &[u32],
        flags: u32,
    ) -> Result<(), PvsError> {
        self.push_cells(&[Cell {
            visible,
            undecided,
            flags,
        }])
    }

    /// Adds the next cells. With the feature `parallel`, all cores code them.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] if the tree has fewer cells than were pushed. [`PvsError::Ids`] if ids do not
    /// ascend strictly or are not below the number of items, or if `undecided` is not a subset of `visible`.
    /// Also if the visible set of a cell that was set aside neither contains all items nor equals
    /// `undecided`, or if the visible set of a cell without viewpoints is not empty. On an error, no cell is
    /// added.
    pub fn push_cells(&mut self, cells: &[Cell<'_>]) -> Result<(), PvsError> {
        let (first, expected) = (self.flags.len() as u64, self.header.tree.cells());
        let after = first + cells.len() as u64;
        if after > u64::from(expected) {
            return Err(PvsError::CellCount {
                expected,
                pushed: after,
            });
        }
        let coded = each(cells, |i, cell| self.coded((first + i as u64) as u32, cell));
        let coded: Vec<[CodedSet; 2]> = coded.into_iter().collect::<Result<_, _>>()?;
        for (cell, [visible, undecided]) in cells.iter().zip(coded) {
            self.visible.push(visible);
            self.undecided.push(undecided);
            self.flags.push(cell.flags);
        }
        Ok(())
    }

    /// Checks and codes the visible and the undecided set of a cell.
    fn coded(&self, cell: u32, sets: &Cell<'_>) -> Result<[CodedSet; 2], PvsError> {
        let bad = |set, reason: String| PvsError::Ids { cell, set, reason };
        let count = self.item_count;
        let what = if self.items.is_empty() {
            "triangle"
        } else {
            "item"
        };
        for (set, ids) in [("visible", sets.visible), ("undecided", sets.undecided)] {
            if let Some(pair) = ids.windows(2).find(|p| p[0] >= p[1]) {
                return Err(bad(
                    set,
                    format!(
                        "id {} comes before id {}; ids must ascend strictly",
                        pair[0], pair[1]
                    ),
                ));
            }
            if let Some(&last) = ids.last().filter(|&&last| last >= count) {
                return Err(bad(
                    set,
                    format!("there is no {what} {last}; the result has {count}, numbered from 0"),
                ));
            }
        }
        let (seen, open) = (runs::from_ids(sets.visible), runs::from_ids(sets.undecided));
        if !open.is_empty() {
            let [beyond] = runs::sweep([&seen, &open], |m| u32::from(m == 2));
            if let Some(id) = beyond.first() {
                return Err(bad(
                    "undecided",
                    format!("{what} {id} is not in the visible set"),
                ));
            }
        }
        if sets.flags & SET_ASIDE != 0
            && sets.visible != sets.undecided
            && sets.visible.len() as u64 != u64::from(count)
        {
            return Err(bad(
                "visible",
                format!(
                    "the cell is set aside, so the set must contain all {what}s or equal the undecided set"
                ),
            ));
        }
        if sets.flags & NOT_REACHED != 0 && !sets.visible.is_empty() {
            return Err(bad(
                "visible",
                "the cell contains no viewpoint, so the set must be empty".to_owned(),
            ));
        }
        Ok([
            CodedSet::new(&seen, sets.visible.len()),
            CodedSet::new(&open, sets.undecided.len()),
        ])
    }

    /// Sets the statistics of the bake, at any time before [`Self::finish`]. The file stores the columns in
    /// this order. A later call replaces the columns of an earlier call. A file without columns has no
    /// section for them.
    ///
    /// # Errors
    /// [`PvsError::Column`] if a name is empty, longer than 64 bytes or not unique, or if a column does not
    /// have one value per cell of the tree. [`PvsError::TooLarge`] if the length of a column's data does not
    /// fit in 32 bits. On an error, the columns of an earlier call remain.
    pub fn set_columns(&mut self, columns: Vec<Column>) -> Result<(), PvsError> {
        self.columns = columns::encode(&columns, self.header.tree.cells())?;
        Ok(())
    }

    /// Stores certificates in `file` until [`Self::finish`], because they may not fit in memory.
    ///
    /// The file must be empty and open for reading and writing. Call this function before the first
    /// [`Self::push_certificate`].
    pub fn keep_certificates_in(&mut self, file: File) {
        self.certificates.kept = CertificateBytes::File(file);
    }

    /// Adds the certificate of the next cell, as bytes that this crate does not parse. Cells after the last
    /// call have an empty certificate. Without any call, the file has no section for certificates.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] if all cells already have a certificate. [`PvsError::Write`] if the scratch
    /// file cannot be written; the builder cannot be used afterwards.
    pub fn push_certificate(&mut self, bytes: &[u8]) -> Result<(), PvsError> {
        let (expected, pushed) = (
            self.header.tree.cells(),
            self.certificates.ends.len() as u64 + 1,
        );
        if pushed > u64::from(expected) {
            return Err(PvsError::CellCount { expected, pushed });
        }
        self.certificates.push(bytes).map_err(PvsError::Write)
    }

    /// Writes the file to `out` and returns its sizes.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] if cells, or contributions of some cells, are missing. [`PvsError::Write`] if
    /// writing fails.
    pub fn finish(mut self, out: &mut impl Write) -> Result<Stats, PvsError> {
        let Header {
            triangles,
            method,
            tree,
            objects,
            info_json,
        } = self.header;
        if self.flags.len() as u64 != u64::from(tree.cells()) {
            return Err(PvsError::CellCount {
                expected: tree.cells(),
                pushed: self.flags.len() as u64,
            });
        }
        let tree_bytes = tree_section(&tree);
        let object_bytes = object_section(&objects);
        let flag_bytes: Vec<u8> = self.flags.iter().flat_map(|f| f.to_le_bytes()).collect();
        let (visible_ids, undecided_ids) = (self.visible.ids(), self.undecided.ids());
        let visible = self
            .visible
            .section(Section::Visible, &tree, self.item_count)?;
        let undecided = if undecided_ids == 0 {
            Vec::new()
        } else {
            self.undecided
                .section(Section::Undecided, &tree, self.item_count)?
        };
        let contributions = self.contributions.section(tree.cells())?;
        let certificates = self
            .certificates
            .section(tree.cells())
            .map_err(PvsError::Write)?;
        // Optional sections without contents are not written. A file of version 1 with certificates always
        // has a section of columns, so write an empty one if there are no columns.
        let columns = !self.columns.is_empty() || certificates.is_some();
        let sources = parse::source_section(&objects);
        let before: [(Section, &[u8], bool); 8] = [
            (Section::Info, info_json.as_bytes(), true),
            (Section::Method, method.as_bytes(), true),
            (Section::Tree, &tree_bytes, true),
            (Section::Objects, &object_bytes, true),
            (Section::Flags, &flag_bytes, true),
            (Section::Visible, &visible, true),
            (Section::Undecided, &undecided, true),
            (Section::Columns, &self.columns, columns),
        ];
        let after: [(Section, &[u8]); 6] = [
            (Section::CellPairs, &self.pairs),
            (Section::Items, &self.items),
            (Section::Contributions, &contributions),
            (Section::Sources, &sources),
            (Section::Region, &self.region),
            (Section::Portals, &self.portals),
        ];
        let before = || before.iter().filter(|s| s.2).map(|s| (s.0, s.1));
        let after = || after.iter().filter(|s| !s.1.is_empty()).copied();
        let written = |(section, bytes): (Section, &[u8])| Written::new(section, bytes);
        let sections: Vec<Written> = before()
            .map(written)
            .chain(certificates)
            .chain(after().map(written))
            .collect();
        let header = layout::header(
            triangles,
            tree.cells(),
            tree.nodes().len() as u32,
            &sections,
        );
        out.write_all(&header).map_err(PvsError::Write)?;
        before()
            .try_for_each(|(_, bytes)| out.write_all(bytes))
            .map_err(PvsError::Write)?;
        if certificates.is_some() {
            self.certificates
                .write(tree.cells(), out)
                .map_err(PvsError::Write)?;
        }
        after()
            .try_for_each(|(_, bytes)| out.write_all(bytes))
            .map_err(PvsError::Write)?;
        out.flush().map_err(PvsError::Write)?;
        Ok(Stats {
            file_bytes: header.len() as u64 + sections.iter().map(|s| s.length).sum::<u64>(),
            visible_bytes: visible.len() as u64,
            undecided_bytes: undecided.len() as u64,
            column_bytes: self.columns.len() as u64,
            certificate_bytes: certificates.map_or(0, |c| c.length),
            pair_bytes: self.pairs.len() as u64,
            contribution_bytes: contributions.len() as u64,
            visible_ids,
            undecided_ids,
        })
    }
}

impl Contributions {
    /// Returns the offsets and bytes of the section, which is empty without contributions.
    fn section(&self, cells: u32) -> Result<Vec<u8>, PvsError> {
        if self.ends.is_empty() {
            return Ok(Vec::new());
        }
        if self.ends.len() != cells as usize {
            return Err(PvsError::CellCount {
                expected: cells,
                pushed: self.ends.len() as u64,
            });
        }
        let offsets = std::iter::once(0).chain(self.ends.iter().copied());
        let mut bytes: Vec<u8> = offsets.flat_map(u64::to_le_bytes).collect();
        bytes.extend_from_slice(&self.bytes);
        Ok(bytes)
    }
}

/// Checks that ranges, given as (first, count), tile 0 … `triangles` − 1 in order.
pub(crate) fn check_tiling(
    triangles: u32,
    ranges: impl Iterator<Item = (u32, u32)>,
) -> Result<(), PvsError> {
    let (mut expected, mut object) = (0u64, 0);
    for (first, count) in ranges {
        if u64::from(first) != expected {
            return Err(PvsError::Objects {
                object,
                first: u64::from(first),
                expected,
            });
        }
        expected += u64::from(count);
        object += 1;
    }
    if expected != u64::from(triangles) {
        return Err(PvsError::Objects {
            object,
            first: u64::from(triangles),
            expected,
        });
    }
    Ok(())
}

fn tree_section(tree: &CellTree) -> Vec<u8> {
    let mut bytes: Vec<u8> = tree
        .view_box()
        .as_flattened()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    for node in tree.nodes() {
        let (axis, at) = match *node {
            Node::Split { axis, at } => (u32::from(axis), at),
            Node::Leaf => (3, 0.0),
        };
        bytes.extend(axis.to_le_bytes());
        bytes.extend(at.to_le_bytes());
    }
    bytes
}

/// Returns the results of `f` for each index and cell. With the feature `parallel`, all cores compute them.
fn each<T: Send>(cells: &[Cell<'_>], f: impl Fn(usize, &Cell<'_>) -> T + Sync) -> Vec<T> {
    #[cfg(feature = "parallel")]
    {
        use rayon::prelude::*;
        cells
            .par_iter()
            .enumerate()
            .map(|(i, cell)| f(i, cell))
            .collect()
    }
    #[cfg(not(feature = "parallel"))]
    cells
        .iter()
        .enumerate()
        .map(|(i, cell)| f(i, cell))
        .collect()
}

fn object_section(objects: &[Object]) -> Vec<u8> {
    let mut bytes = (objects.len() as u32).to_le_bytes().to_vec();
    for o in objects {
        for n in [o.first, o.count, o.name.len() as u32] {
            bytes.extend(n.to_le_bytes());
        }
    }
    for o in objects {
        bytes.extend(o.name.as_bytes());
    }
    bytes
}
