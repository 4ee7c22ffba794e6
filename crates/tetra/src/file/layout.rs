//! The byte layout of a `.tets` file: header, section table and sections. All numbers are little-endian.
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

/// The format version that this crate reads and writes.
pub const VERSION: u32 = 2;

const MAGIC: [u8; 8] = *b"\x89TET\r\n\x1a\n";
/// The offset of the header's checksum, in bytes.
const CRC_AT: usize = 56;
/// The offset of the section table, in bytes.
const TABLE_AT: usize = 64;
/// The number of sections.
const SECTIONS: usize = 15;
/// The length of the header with the section table, in bytes.
const HEADER: usize = TABLE_AT + SECTIONS * 24;

/// A section of the file. The variants are in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// The points of the surfaces, then the corners of the box: three f32 per point.
    Points,
    /// The corners of the triangles: three u32 per triangle.
    Triangles,
    /// The flags of the triangles: one byte per triangle.
    Flags,
    /// The planes, each as three point numbers, or as two point numbers and an axis: three u32 per plane.
    Planes,
    /// The vertices that are intersections of three planes, as plane numbers: three u32 per vertex.
    Meets,
    /// The rounded position of each vertex that is an intersection of three planes: three f64 per vertex.
    Rounded,
    /// The faces, and one more entry: five u32 per entry.
    ///
    /// An entry contains the number of the plane, the start of the face's vertices in `Loops`, the start of
    /// its triangles in `Covers`, and the numbers of the cells in front and behind.
    Faces,
    /// The vertex numbers of each face's loop: one u32 per vertex.
    Loops,
    /// The ids of the triangles that cover each face: one u32 per triangle.
    Covers,
    /// The cells, and one more entry: two u32 per entry.
    ///
    /// An entry contains the number of the tetrahedron, and the start of the cell's faces in `CellFaces`.
    Cells,
    /// The faces of each cell: one u32 per face, which is twice the face number, plus 1 if the cell is behind
    /// the face.
    CellFaces,
    /// The number of closed solids around each cell: one i32 per cell.
    Windings,
    /// The boxes: 32 bytes per box.
    ///
    /// An entry contains the lower corner (three f32), the index of the first child box or of the first entry
    /// in `Order` (u32), the upper corner (three f32), and the number of triangles (u32).
    Boxes,
    /// The ids of the triangles that block or show, grouped by box: one u32 per triangle.
    Order,
    /// The neighbours of the triangles: three u32 per triangle.
    ///
    /// Each number is the id of the triangle across the edge from a corner to the next corner, or 2³² − 1
    /// without such a triangle.
    Neighbours,
}

impl Section {
    /// All sections, in the order of the file.
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

    /// Returns the name of the section in messages.
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

    /// Returns the size of an entry, in bytes.
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

/// The scene digest and the section ranges of a file whose lengths and checksums are right.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The digest of the scene.
    pub digest: [u8; 32],
    ranges: [Range<usize>; SECTIONS],
}

impl Layout {
    /// Returns the byte range of a section in the file. The length of the range is a multiple of the
    /// section's entry size.
    pub fn range(&self, section: Section) -> Range<usize> {
        self.ranges[section as usize].clone()
    }

    /// Reads the header and verifies all lengths and checksums.
    ///
    /// # Errors
    /// [`TetsError`] if the file was cut short or altered, is not a `.tets` file, has another version, or has
    /// a malformed header or section table.
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
                "the stated length of the file, number of sections or last field is wrong",
            ));
        }
        let mut ranges = [const { 0..0 }; SECTIONS];
        let mut at = HEADER;
        for (i, section) in Section::ALL.into_iter().enumerate() {
            let entry = TABLE_AT + i * 24;
            let offset = at.next_multiple_of(8);
            if u32_at(header, entry) as usize != i || u64_at(header, entry + 8) != offset as u64 {
                return Err(malformed(
                    "an entry of the section table has a wrong number or offset",
                ));
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
                return Err(section.malformed("the last entry is incomplete"));
            }
            ranges[i] = offset..offset + bytes.len();
            at = offset + bytes.len();
        }
        if at != file.len() {
            return Err(malformed("bytes follow the last section"));
        }
        let digest = std::array::from_fn(|i| header[24 + i]);
        Ok(Self { digest, ranges })
    }
}

/// Builds the header of a file with these sections, in the order of the file. Each section is given as its
/// checksum and its length in bytes.
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

/// Writes correct checksums to a file. Stops at the first section that exceeds the file.
///
/// Tests use this function to reach the code after the checksum tests.
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

/// Reads a little-endian u32 at offset `at`. The caller has checked that the slice contains the four bytes.
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}

/// Reads a little-endian u64 at offset `at`. The caller has checked that the slice contains the eight bytes.
pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}
