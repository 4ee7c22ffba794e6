//! The bytes of a `.tets` file around the contents of its sections. All numbers are little-endian.
//!
//! | offset | bytes | contents |
//! |---|---|---|
//! | 0 | 8 | `89 54 45 54 0d 0a 1a 0a`, which transfers that change line ends or clear the eighth bit alter |
//! | 8 | 4 | version: 2 |
//! | 12 | 4 | number of sections S: 15 |
//! | 16 | 8 | length of the file |
//! | 24 | 32 | digest of the scene |
//! | 56 | 4 | CRC-32C of bytes 0…55 and of the section table |
//! | 60 | 4 | 0 |
//! | 64 | S × 24 | for each [`Section`] in order: its number (4), CRC-32C (4), offset (8), length (8) |
//! | 64 + 24 S | | the sections in order, each from the next multiple of 8 on, zeros between them |
//!
//! Since sections start at multiples of 8, a file that is mapped into memory can be read in place.

use std::ops::Range;

use super::error::TetsError;

/// The version that this crate reads and writes.
pub const VERSION: u32 = 2;

const MAGIC: [u8; 8] = *b"\x89TET\r\n\x1a\n";
const CRC_AT: usize = 56;
const TABLE_AT: usize = 64;
const SECTIONS: usize = 15;
const HEADER: usize = TABLE_AT + SECTIONS * 24;

/// The sections in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// Three f32 a point: the points of the surfaces, then the corners of the box.
    Points,
    /// Three u32 a triangle: its corners.
    Triangles,
    /// A byte a triangle: its flags.
    Flags,
    /// Three u32 a plane.
    Planes,
    /// Three u32 a vertex that is a meet: its planes.
    Meets,
    /// Three f64 a vertex that is a meet: its rounded place.
    Rounded,
    /// Five u32 a face and one more: plane, starts of loop and triangles, cells in front and behind.
    Faces,
    /// A u32 for each vertex of each loop.
    Loops,
    /// A u32 for each triangle of each face.
    Covers,
    /// Two u32 a cell and one more: tetrahedron, start of its faces.
    Cells,
    /// A u32 for each face of each cell.
    CellFaces,
    /// An i32 a cell: how many closed solids hold it.
    Windings,
    /// 32 bytes a box: least corner (three f32), first child or triangle (u32), greatest corner (three f32),
    /// number of triangles (u32).
    Boxes,
    /// A u32 for each triangle that blocks or shows: those of a box together.
    Order,
    /// Three u32 a triangle: what is across the edge from each corner to the next, or 2³² − 1.
    Neighbours,
}

impl Section {
    /// All sections in order.
    pub const ALL: [Self; SECTIONS] = [
        Self::Points,
        Self::Triangles,
        Self::Flags,
        Self::Planes,
        Self::Meets,
        Self::Rounded,
        Self::Faces,
        Self::Loops,
        Self::Covers,
        Self::Cells,
        Self::CellFaces,
        Self::Windings,
        Self::Boxes,
        Self::Order,
        Self::Neighbours,
    ];

    /// Its name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::Triangles => "triangles",
            Self::Flags => "flags of triangles",
            Self::Planes => "planes",
            Self::Meets => "vertices",
            Self::Rounded => "rounded vertices",
            Self::Faces => "faces",
            Self::Loops => "loops of faces",
            Self::Covers => "triangles of faces",
            Self::Cells => "cells",
            Self::CellFaces => "faces of cells",
            Self::Windings => "solids around cells",
            Self::Boxes => "boxes",
            Self::Order => "triangles of boxes",
            Self::Neighbours => "neighbours of triangles",
        }
    }

    /// Bytes of one entry.
    fn entry(self) -> usize {
        match self {
            Self::Points | Self::Triangles | Self::Planes | Self::Meets | Self::Neighbours => 12,
            Self::Rounded => 24,
            Self::Faces => 20,
            Self::Cells => 8,
            Self::Loops | Self::Covers | Self::CellFaces | Self::Windings | Self::Order => 4,
            Self::Boxes => 32,
            Self::Flags => 1,
        }
    }

    pub(super) fn malformed(self, reason: impl Into<String>) -> TetsError {
        TetsError::Malformed {
            section: self.name(),
            reason: reason.into(),
        }
    }
}

/// Digest and sections of a file whose lengths and checksums are right.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The digest of the scene.
    pub digest: [u8; 32],
    ranges: [Range<usize>; SECTIONS],
}

impl Layout {
    /// Where a section is in the file. Its length is a multiple of its entries'.
    pub fn range(&self, section: Section) -> Range<usize> {
        self.ranges[section as usize].clone()
    }

    /// Reads the header and verifies lengths and all checksums.
    ///
    /// # Errors
    /// [`TetsError`], for every file that was cut short or altered.
    pub fn parse(file: &[u8]) -> Result<Self, TetsError> {
        let actual = file.len() as u64;
        if file.is_empty() || !file.starts_with(&MAGIC[..MAGIC.len().min(file.len())]) {
            return Err(TetsError::NotTets);
        }
        let short = |expected: u64| TetsError::CutShort { expected, actual };
        let start = file.get(..TABLE_AT).ok_or_else(|| short(HEADER as u64))?;
        let found = u32_at(start, 8);
        if found != VERSION {
            return Err(TetsError::Version {
                found,
                known: VERSION,
            });
        }
        let header = file.get(..HEADER).ok_or_else(|| short(HEADER as u64))?;
        if crc(&header[..CRC_AT], &header[TABLE_AT..]) != u32_at(header, CRC_AT) {
            return Err(TetsError::Altered { section: "header" });
        }
        let malformed = |reason: &str| TetsError::Malformed {
            section: "header",
            reason: reason.to_owned(),
        };
        let expected = u64_at(header, 16);
        if actual < expected {
            return Err(short(expected));
        }
        if actual > expected || u32_at(header, 12) as usize != SECTIONS || u32_at(header, 60) != 0 {
            return Err(malformed(
                "it is not the header of a file of this length and version",
            ));
        }
        let mut ranges = [const { 0..0 }; SECTIONS];
        let mut at = HEADER;
        for (i, section) in Section::ALL.into_iter().enumerate() {
            let entry = TABLE_AT + i * 24;
            let offset = at.next_multiple_of(8);
            if u32_at(header, entry) as usize != i || u64_at(header, entry + 8) != offset as u64 {
                return Err(malformed("its sections do not follow one another"));
            }
            let gap = file.get(at..offset);
            let bytes = usize::try_from(u64_at(header, entry + 16))
                .ok()
                .and_then(|length| file.get(offset..offset.checked_add(length)?));
            let (Some(gap), Some(bytes)) = (gap, bytes) else {
                return Err(malformed("a section reaches beyond the end of the file"));
            };
            if crc32c::crc32c(bytes) != u32_at(header, entry + 4) || gap.iter().any(|b| *b != 0) {
                return Err(TetsError::Altered {
                    section: section.name(),
                });
            }
            if !bytes.len().is_multiple_of(section.entry()) {
                return Err(section.malformed("its last entry is not whole"));
            }
            ranges[i] = offset..offset + bytes.len();
            at = offset + bytes.len();
        }
        if at != file.len() {
            return Err(malformed("bytes follow its last section"));
        }
        let digest = std::array::from_fn(|i| header[24 + i]);
        Ok(Self { digest, ranges })
    }
}

/// The header of a file with these sections, given as checksum and length.
pub(super) fn header(digest: &[u8; 32], sections: &[(u32, u64); SECTIONS]) -> Vec<u8> {
    let mut table = Vec::with_capacity(SECTIONS * 24);
    let mut at = HEADER as u64;
    for (i, (crc, length)) in (0u32..).zip(sections) {
        at = at.next_multiple_of(8);
        table.extend(i.to_le_bytes());
        table.extend(crc.to_le_bytes());
        table.extend(at.to_le_bytes());
        table.extend(length.to_le_bytes());
        at += length;
    }
    let mut header = MAGIC.to_vec();
    header.extend(VERSION.to_le_bytes());
    header.extend((SECTIONS as u32).to_le_bytes());
    header.extend(at.to_le_bytes());
    header.extend(digest);
    header.extend(crc(&header, &table).to_le_bytes());
    header.extend([0; 4]);
    header.extend(table);
    header
}

/// Makes all checksums of a file right, if its header and sections are where they should be: for tests of
/// what is behind them.
pub(crate) fn seal(file: &mut [u8]) {
    if file.len() < HEADER {
        return;
    }
    for entry in (TABLE_AT..HEADER).step_by(24) {
        let number = |at: usize| usize::try_from(u64_at(file, at)).unwrap_or(usize::MAX);
        let (from, length) = (number(entry + 8), number(entry + 16));
        let Some(crc) = from
            .checked_add(length)
            .and_then(|to| file.get(from..to))
            .map(crc32c::crc32c)
        else {
            return;
        };
        file[entry..][4..8].copy_from_slice(&crc.to_le_bytes());
    }
    let crc = crc(&file[..CRC_AT], &file[TABLE_AT..HEADER]);
    file[CRC_AT..][..4].copy_from_slice(&crc.to_le_bytes());
}

fn crc(start: &[u8], table: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(start), table)
}

/// The caller has checked that the four bytes are there.
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}

/// The caller has checked that the eight bytes are there.
pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}
