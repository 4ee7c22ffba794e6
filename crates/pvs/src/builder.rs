//! Writing a result: the builder checks its input and writes the sections. The module `hierarchy` chooses the
//! sets of the inner tree nodes.

use std::fs::File;
use std::io::Write;

use crate::certificates::{Certificates, Kept};
use crate::columns::{self, Column};
use crate::error::PvsError;
use crate::hierarchy::{CodedSet, Hierarchy};
use crate::layout::{self, Section, Written};
use crate::portals::Portals;
use crate::tree::{CellTree, Node};
use crate::{CellPairs, Contribution, Items, NOT_REACHED, Object, SET_ASIDE, parse, runs};

/// The parts of a result that are known before the first cell.
#[derive(Clone, Debug)]
pub struct Header {
    /// N, the number of triangles.
    pub triangles: u32,
    /// How the sets are made: "aggressive", "exact", "verified" or "portals".
    pub method: String,
    /// The view cells.
    pub tree: CellTree,
    /// The scene's objects, tiling triangles 0…N−1 in order.
    pub objects: Vec<Object>,
    /// Parameters, numerics profile and counters of the bake as JSON; this crate does not read it.
    pub info_json: String,
}

/// Sizes of a finished file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stats {
    /// Length of the file.
    pub file_bytes: u64,
    /// Bytes of the visible sets with their offsets.
    pub visible_bytes: u64,
    /// Bytes of the undecided sets with their offsets; 0 when nothing is undecided.
    pub undecided_bytes: u64,
    /// Bytes of the columns; 0 when there are none.
    pub column_bytes: u64,
    /// Bytes of the certificates with their offsets; 0 when there are none.
    pub certificate_bytes: u64,
    /// Bytes of the relations between cells; 0 when there are none.
    pub pair_bytes: u64,
    /// Bytes of the contributions with their offsets; 0 when there are none.
    pub contribution_bytes: u64,
    /// Sum of the sizes of the visible sets.
    pub visible_ids: u64,
    /// Sum of the sizes of the undecided sets.
    pub undecided_ids: u64,
}

/// The sets of a cell, which name the items of the result: triangles, unless [`Builder::set_items`] was
/// called.
#[derive(Clone, Copy, Debug)]
pub struct Cell<'a> {
    /// The items to draw from it, ascending.
    pub visible: &'a [u32],
    /// Those of `visible` that were neither seen nor proved hidden, ascending.
    pub undecided: &'a [u32],
    /// [`SET_ASIDE`] and [`NOT_REACHED`]; other bits are stored as they are.
    pub flags: u32,
}

/// Collects the cells' sets in cell order and writes the file. The same input gives the same bytes.
pub struct Builder {
    header: Header,
    flags: Vec<u32>,
    visible: Hierarchy,
    undecided: Hierarchy,
    /// The coded section; empty when there are no columns.
    columns: Vec<u8>,
    certificates: Certificates,
    /// The coded section of items; empty when the sets name triangles.
    items: Vec<u8>,
    /// How many items there are.
    item_count: u32,
    /// The coded section; empty when the result does not say which cells see which.
    pairs: Vec<u8>,
    contributions: Contributions,
    /// Empty when viewpoints are not restricted to a region.
    region: Vec<u8>,
    /// The coded section; empty without portals.
    portals: Vec<u8>,
}

/// The contributions pushed so far.
#[derive(Default)]
struct Contributions {
    /// Where those of each cell end.
    ends: Vec<u64>,
    bytes: Vec<u8>,
}

impl Builder {
    /// Starts a result.
    ///
    /// # Errors
    /// [`PvsError::Objects`] when the objects do not tile the triangles, [`PvsError::TooLarge`] for names or
    /// counts beyond 32 bits.
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

    /// Sets the region that holds all viewpoints, in bytes that this crate does not read.
    pub fn set_region(&mut self, bytes: Vec<u8>) {
        self.region = bytes;
    }

    /// Sets the portals, as [`crate::Portals::encode`] gives them.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] when they are not of the result's triangles.
    pub fn set_portals(&mut self, bytes: Vec<u8>) -> Result<(), PvsError> {
        Portals::decode(&bytes, self.header.triangles)?;
        self.portals = bytes;
        Ok(())
    }

    /// Sets what the sets name, before the first cell.
    ///
    /// # Errors
    /// [`PvsError::Malformed`] when the triangles of an item do not ascend or reach N, and after a cell.
    pub fn set_items(&mut self, items: &Items) -> Result<(), PvsError> {
        if !self.flags.is_empty() {
            return Err(Section::Items.malformed("the items come before the first cell"));
        }
        let Header {
            triangles, objects, ..
        } = &self.header;
        self.items = items.encode(*triangles, objects.len())?;
        // `encode` has checked that the count fits.
        self.item_count = match items {
            Items::Clusters(clusters) => clusters.len() as u32,
            Items::Objects { .. } => objects.len() as u32,
        };
        Ok(())
    }

    /// Sets which cells see which, at any time before [`Self::finish`].
    ///
    /// # Errors
    /// [`PvsError::Malformed`] when the relations are over another number of cells, or a pair is undecided
    /// and not visible.
    pub fn set_pairs(&mut self, pairs: &CellPairs) -> Result<(), PvsError> {
        pairs.check(self.header.tree.cells())?;
        self.pairs = pairs.encode();
        Ok(())
    }

    /// Adds the contributions of the items visible from the next cell, in the order of its visible set. Call
    /// it for every cell or for none.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] after the last cell.
    pub fn push_contributions(&mut self, of: &[Contribution]) -> Result<(), PvsError> {
        let all = &mut self.contributions;
        let (expected, pushed) = (self.header.tree.cells(), all.ends.len() as u64 + 1);
        if pushed > u64::from(expected) {
            return Err(PvsError::CellCount { expected, pushed });
        }
        all.bytes.extend(of.iter().map(|c| c.byte()));
        all.ends.push(all.bytes.len() as u64);
        Ok(())
    }

    /// Adds the next cell: the ids of the triangles to draw from it, those of them that were neither seen nor
    /// proved hidden, and its flags; see [`Cell`].
    ///
    /// # Errors
    /// As [`Self::push_cells`].
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

    /// Adds the next cells. With the feature `parallel` all cores code them.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] when the tree has fewer cells; [`PvsError::Ids`] when ids do not ascend
    /// strictly or reach N, when `undecided` is not a subset of `visible`, or when a cell that was set aside
    /// does not have all triangles visible. No cell is added then.
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

    /// A cell's visible and undecided sets, checked and coded.
    fn coded(&self, cell: u32, of: &Cell<'_>) -> Result<[CodedSet; 2], PvsError> {
        let bad = |set, reason: String| PvsError::Ids { cell, set, reason };
        let count = self.item_count;
        let what = if self.items.is_empty() {
            "triangle"
        } else {
            "item"
        };
        for (set, ids) in [("visible", of.visible), ("undecided", of.undecided)] {
            if let Some(pair) = ids.windows(2).find(|p| p[0] >= p[1]) {
                return Err(bad(
                    set,
                    format!("{} comes before {}; ids must ascend", pair[0], pair[1]),
                ));
            }
            if let Some(&last) = ids.last().filter(|&&last| last >= count) {
                return Err(bad(set, format!("there is no {what} {last} among {count}")));
            }
        }
        let (seen, open) = (runs::from_ids(of.visible), runs::from_ids(of.undecided));
        if !open.is_empty() {
            let [beyond] = runs::sweep([&seen, &open], |m| u32::from(m == 2));
            if let Some(id) = beyond.first() {
                return Err(bad(
                    "undecided",
                    format!("{what} {id} is not in the visible set"),
                ));
            }
        }
        if of.flags & SET_ASIDE != 0
            && of.visible != of.undecided
            && of.visible.len() as u64 != u64::from(count)
        {
            return Err(bad(
                "visible",
                format!("the cell is set aside, but not all {what}s are visible"),
            ));
        }
        if of.flags & NOT_REACHED != 0 && !of.visible.is_empty() {
            return Err(bad(
                "visible",
                "no viewpoint is in the cell, but its set is not empty".to_owned(),
            ));
        }
        Ok([
            CodedSet::new(&seen, of.visible.len()),
            CodedSet::new(&open, of.undecided.len()),
        ])
    }

    /// Sets the statistics of the bake, at any time before [`Self::finish`]. The file has the columns in this
    /// order. They replace those of an earlier call; a file without columns has no section for them.
    ///
    /// # Errors
    /// [`PvsError::Column`] when a name is empty, longer than 64 bytes or not unique, or when a column does
    /// not have one value for each cell of the tree; [`PvsError::TooLarge`] when the length of its data does
    /// not fit 32 bits. The columns of an earlier call remain then.
    pub fn set_columns(&mut self, columns: Vec<Column>) -> Result<(), PvsError> {
        self.columns = columns::encode(&columns, self.header.tree.cells())?;
        Ok(())
    }

    /// Keeps certificates in `file`, which is empty and open for reading and writing, until [`Self::finish`]:
    /// they may not fit in memory. Call it before the first [`Self::push_certificate`].
    pub fn keep_certificates_in(&mut self, file: File) {
        self.certificates.kept = Kept::File(file);
    }

    /// Adds the certificate of the next cell, as bytes that are opaque to this crate. Cells after the last
    /// call have an empty one; without any call the file has no section for them.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] after the last cell; [`PvsError::Write`] when the scratch file cannot be
    /// written, after which the builder cannot be used.
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

    /// Writes the file.
    ///
    /// # Errors
    /// [`PvsError::CellCount`] when cells are missing, [`PvsError::Write`] when writing fails.
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
        // Files have no sections that they do not need. A file of version 1 has no certificates without
        // columns, so it has an empty section of columns then.
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
        let written = |(section, bytes): (Section, &[u8])| Written::of(section, bytes);
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
    /// Offsets and bytes; empty without contributions.
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

/// Checks that ranges, each (first, count), tile 0 … `triangles` − 1 in order.
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

/// The results of `f` for each index and cell; with the feature `parallel` on all cores.
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
