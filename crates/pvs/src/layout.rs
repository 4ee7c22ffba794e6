//! The bytes of the file around the contents of the sections: header, section table and checksums.
//!
//! | offset | bytes | contents |
//! |---|---|---|
//! | 0 | 8 | `89 50 56 53 0d 0a 1a 0a`, which transfers that change line ends or clear the eighth bit alter |
//! | 8 | 4 | version: 1, or 2 in a file with a section from [`Section::CellPairs`] on |
//! | 12 | 4 | number of sections S |
//! | 16 | 8 | length of the file |
//! | 24 | 4 | triangles N |
//! | 28 | 4 | cells M |
//! | 32 | 4 | tree nodes, 2M − 1 |
//! | 36 | 4 | CRC-32C of bytes 0…35 and of the section table |
//! | 40 | S × 24 | for each [`Section`] in order: its number (4), CRC-32C (4), offset (8), length (8) |
//! | 40 + 24 S | | the sections, one after another, without gaps |
//!
//! Exactly one checksum covers each byte. The header's checksum covers the offsets of the sections.
//!
//! Every file has the sections up to [`Section::Undecided`]. A file of version 1 has the sections 0 to S − 1:
//! seven, eight with columns, or nine with certificates. A file of version 2 has any of the optional
//! sections, in the order of their numbers.

use crate::error::PvsError;

/// The newest version that this crate reads. The crate writes the oldest version that has the sections of a
/// file.
pub const VERSION: u32 = 2;

const MAGIC: [u8; 8] = *b"\x89PVS\r\n\x1a\n";
/// The number of different sections.
const SECTIONS: usize = 15;
/// The number of sections that every file has: the sections before the columns.
pub(crate) const LEAST_SECTIONS: usize = Section::Columns as usize;
/// The maximum number of sections of a file of version 1.
const SECTIONS_OF_1: usize = Section::CellPairs as usize;
const CRC_AT: usize = 36;
const TABLE_AT: usize = 40;

/// The sections in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// The JSON text of the bake, in UTF-8, which this crate does not parse.
    Info,
    /// The name of the method that computed the sets, in UTF-8.
    Method,
    /// The view box as six f32 (min, max), then 8 bytes per node: axis (3 for a leaf) as u32, plane as f32 (0
    /// for a leaf).
    Tree,
    /// The objects: count as u32, then for each object its first triangle, count and length of its name as
    /// u32, then the names in UTF-8.
    Objects,
    /// The flags of the cells: one u32 per cell.
    Flags,
    /// The visible sets: nodes + 1 offsets as u64, then the coded sets of the nodes.
    Visible,
    /// The undecided sets, in the form of [`Section::Visible`]. The length is 0 if no cell has undecided
    /// items.
    Undecided,
    /// The statistics of the bake per cell, optional. Count as u32; for each column the length of its name as
    /// u32, the name in UTF-8, the length of its data as u32, and the data: one LEB128 number per cell.
    Columns,
    /// The certificates of the cells, which this crate does not parse, optional. Cells + 1 offsets as u64,
    /// then the bytes of the cells. A file with this section also has the section of columns, which may be
    /// empty.
    Certificates,
    /// The cell-to-cell relations, optional. See the module `pairs`.
    CellPairs,
    /// The items that the sets name instead of triangles, optional. See the module `items`.
    Items,
    /// The contribution of each visible item to the view, optional. See the module `contributions`.
    Contributions,
    /// The sources of the objects in their glTF file, optional. For each object the indices of node, mesh,
    /// primitive and instance as four u32; `u32::MAX` for a missing index.
    Sources,
    /// The region that contains all viewpoints, which this crate does not parse, optional.
    Region,
    /// The scene divided along its walls, optional. See the module `portals`.
    Portals,
}

impl Section {
    /// All sections in order. The sections from the columns on are optional.
    pub const ALL: [Self; SECTIONS] = [
        Self::Info,
        Self::Method,
        Self::Tree,
        Self::Objects,
        Self::Flags,
        Self::Visible,
        Self::Undecided,
        Self::Columns,
        Self::Certificates,
        Self::CellPairs,
        Self::Items,
        Self::Contributions,
        Self::Sources,
        Self::Region,
        Self::Portals,
    ];

    /// Returns the name of the section in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Method => "method",
            Self::Tree => "tree",
            Self::Objects => "object table",
            Self::Flags => "cell flags",
            Self::Visible => "visible sets",
            Self::Undecided => "undecided sets",
            Self::Columns => "columns",
            Self::Certificates => "certificates",
            Self::CellPairs => "pairs of cells",
            Self::Items => "items",
            Self::Contributions => "contributions",
            Self::Sources => "sources of objects",
            Self::Region => "region of viewpoints",
            Self::Portals => "portals",
        }
    }

    pub(crate) fn malformed(self, reason: impl Into<String>) -> PvsError {
        PvsError::Malformed {
            section: self.name(),
            reason: reason.into(),
        }
    }
}

/// The sizes in the header and the range of each section, after all checks of this module.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub triangles: u32,
    pub cells: u32,
    pub nodes: u32,
    /// The sections that the file has: bit i for section i.
    present: u32,
    ranges: [std::ops::Range<usize>; SECTIONS],
}

impl Layout {
    /// Returns true if the file has a section.
    pub fn has(&self, section: Section) -> bool {
        self.present >> section as u32 & 1 == 1
    }

    /// Returns the range of a section in the file, which is empty if the file does not have the section.
    pub fn range(&self, section: Section) -> std::ops::Range<usize> {
        self.ranges[section as usize].clone()
    }

    /// Parses the header and verifies the file's length, the positions of the sections and all checksums.
    pub fn parse(file: &[u8]) -> Result<Self, PvsError> {
        let actual = file.len() as u64;
        if !file.starts_with(&MAGIC[..MAGIC.len().min(file.len())]) || file.is_empty() {
            return Err(PvsError::NotPvs);
        }
        let first = |length: usize| {
            file.get(..length).ok_or(PvsError::Length {
                expected: length as u64,
                actual,
            })
        };
        let header = first(header_len(LEAST_SECTIONS))?;
        let found = u32_at(header, 8);
        if !(1..=VERSION).contains(&found) {
            return Err(PvsError::Version {
                found,
                known: VERSION,
            });
        }
        let sections = u32_at(header, 12) as usize;
        let known = (LEAST_SECTIONS..=if found == 1 { SECTIONS_OF_1 } else { SECTIONS })
            .contains(&sections);
        // An impossible number is most likely an altered byte, so let the checksum report it.
        let header = first(header_len(if known { sections } else { LEAST_SECTIONS }))?;
        if crc32c::crc32c_append(crc32c::crc32c(&header[..CRC_AT]), &header[TABLE_AT..])
            != u32_at(header, CRC_AT)
        {
            return Err(PvsError::Checksum { section: "header" });
        }
        let malformed = |reason: &str| PvsError::Malformed {
            section: "header",
            reason: reason.to_owned(),
        };
        if !known {
            return Err(malformed(
                "the number of sections does not fit the format version",
            ));
        }
        let expected = u64_at(header, 16);
        if expected != actual {
            return Err(PvsError::Length { expected, actual });
        }
        let (triangles, cells, nodes) =
            (u32_at(header, 24), u32_at(header, 28), u32_at(header, 32));
        if cells == 0 || u64::from(nodes) != 2 * u64::from(cells) - 1 {
            return Err(malformed(
                "the numbers of cells M and tree nodes do not fit: M ≥ 1 cells have 2M − 1 nodes",
            ));
        }
        let mut at = header.len();
        let mut ranges = [const { 0..0 }; SECTIONS];
        let (mut present, mut least) = (0u32, 0);
        for i in 0..sections {
            let entry = TABLE_AT + i * 24;
            let number = u32_at(header, entry) as usize;
            let section = Section::ALL
                .get(number)
                .filter(|_| number >= least && (number == i || (found > 1 && i >= LEAST_SECTIONS)));
            let section = section.ok_or_else(|| {
                malformed("the sections in the table do not fit the format version")
            })?;
            if u64_at(header, entry + 8) != at as u64 {
                return Err(malformed(
                    "a section does not start at the end of the previous section",
                ));
            }
            let bytes = usize::try_from(u64_at(header, entry + 16))
                .ok()
                .and_then(|length| file.get(at..at.checked_add(length)?))
                .ok_or_else(|| malformed("a section reaches beyond the end of the file"))?;
            if crc32c::crc32c(bytes) != u32_at(header, entry + 4) {
                return Err(PvsError::Checksum {
                    section: section.name(),
                });
            }
            ranges[number] = at..at + bytes.len();
            present |= 1 << number;
            least = number + 1;
            at += bytes.len();
        }
        if at != file.len() {
            return Err(malformed("bytes follow the last section"));
        }
        Ok(Self {
            triangles,
            cells,
            nodes,
            present,
            ranges,
        })
    }
}

/// Returns the size of the header with a table of `sections` sections, in bytes.
const fn header_len(sections: usize) -> usize {
    TABLE_AT + sections * 24
}

/// The number, length and checksum of a section, in the form in which the header stores them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Written {
    pub section: Section,
    pub length: u64,
    pub crc: u32,
}

impl Written {
    /// Computes the length and checksum of the bytes of a section.
    pub fn new(section: Section, bytes: &[u8]) -> Self {
        Self {
            section,
            length: bytes.len() as u64,
            crc: crc32c::crc32c(bytes),
        }
    }
}

/// Returns the header of a file with these sections, which must be in the order of [`Section::ALL`].
pub(crate) fn header(triangles: u32, cells: u32, nodes: u32, sections: &[Written]) -> Vec<u8> {
    let file_len =
        header_len(sections.len()) as u64 + sections.iter().map(|s| s.length).sum::<u64>();
    let mut table = Vec::with_capacity(sections.len() * 24);
    let mut at = header_len(sections.len()) as u64;
    let newest = sections.last().map_or(0, |s| s.section as usize);
    let version: u32 = if newest < SECTIONS_OF_1 { 1 } else { 2 };
    for section in sections {
        table.extend((section.section as u32).to_le_bytes());
        table.extend(section.crc.to_le_bytes());
        table.extend(at.to_le_bytes());
        table.extend(section.length.to_le_bytes());
        at += section.length;
    }
    let mut header = MAGIC.to_vec();
    header.extend(version.to_le_bytes());
    header.extend((sections.len() as u32).to_le_bytes());
    header.extend(file_len.to_le_bytes());
    for n in [triangles, cells, nodes] {
        header.extend(n.to_le_bytes());
    }
    let crc = crc32c::crc32c_append(crc32c::crc32c(&header), &table);
    header.extend(crc.to_le_bytes());
    header.extend(table);
    header
}

/// Returns the little-endian number at offset `at`. The caller has checked that the four bytes exist.
pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}

/// Returns the little-endian number at offset `at`. The caller has checked that the eight bytes exist.
pub(crate) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}
