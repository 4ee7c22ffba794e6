//! The container of binary glTF: a header, then chunks of JSON, binary data and others.
//!
//! Layout: Khronos, "glTF 2.0 Specification", section 4. All numbers are little-endian. The header contains
//! "glTF", the version 2 and the length of the file. Each chunk consists of its length, its type and its
//! data, which fill a multiple of four bytes.

use std::io::{self, Write};

/// The first bytes of a GLB.
pub const MAGIC: [u8; 4] = *b"glTF";
/// The type of the first chunk.
pub const JSON: [u8; 4] = *b"JSON";
/// The type of the chunk that contains buffer 0.
pub const BINARY: [u8; 4] = *b"BIN\0";
/// The length of the header of a GLB, in bytes.
const HEADER: usize = 12;
/// The length of the header of a chunk, in bytes.
const CHUNK_HEADER: usize = 8;

/// A chunk, given by its type and its data.
pub type Chunk<'a> = ([u8; 4], &'a [u8]);

/// The fault of bytes that are not a GLB, or of data that do not fit into one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GlbFault {
    /// The file ends within its header.
    #[error("the file ends within the header")]
    NoHeader,
    /// The file has another version.
    #[error("the GLB version is {0}, but must be 2")]
    Version(u32),
    /// The file is shorter than its header announces.
    #[error("the header announces {announced} bytes, but the file has {present}")]
    CutOff {
        /// The length of the file that the header announces, in bytes.
        announced: u32,
        /// The length of the file, in bytes.
        present: usize,
    },
    /// A chunk is longer than the rest of the file.
    #[error("the chunk announces {announced} bytes of data, but only {left} bytes follow")]
    ChunkCutOff {
        /// The index of the chunk in the file, from 0.
        chunk: usize,
        /// The length of its data that the chunk announces, in bytes.
        announced: u32,
        /// The number of bytes of the file after the chunk's type.
        left: usize,
    },
    /// The first chunk is absent or is not the JSON chunk.
    #[error("the first chunk of the file is not the JSON chunk")]
    NoJson,
    /// The length of the file does not fit in the header.
    #[error("the file would have {0} bytes, but a GLB has at most 4 294 967 295")]
    TooLong(u64),
}

impl GlbFault {
    /// Returns the name of the faulty header or chunk, such as `GLB chunk 1`.
    pub fn element(&self) -> String {
        match self {
            Self::ChunkCutOff { chunk, .. } => format!("GLB chunk {chunk}"),
            Self::NoJson => "GLB chunk 0".to_owned(),
            _ => "GLB header".to_owned(),
        }
    }
}

/// Returns true if `bytes` begin with the magic number of a GLB.
pub fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC)
}

/// Returns the chunks of a GLB. Ignores bytes beyond the length that the header announces, and a rest of
/// fewer than eight bytes after the last chunk.
///
/// # Errors
/// [`GlbFault`] if the header or a chunk is cut off, or if the first chunk is not JSON.
pub fn chunks(bytes: &[u8]) -> Result<Vec<Chunk<'_>>, GlbFault> {
    let chunks: Vec<Chunk<'_>> = walk(bytes)?.collect::<Result<_, _>>()?;
    match chunks.first() {
        Some((JSON, _)) => Ok(chunks),
        _ => Err(GlbFault::NoJson),
    }
}

/// Returns the JSON of a GLB, and its second chunk if this chunk is the binary chunk. Checks the lengths of
/// further chunks without allocating memory.
///
/// # Errors
/// The errors of [`chunks`].
pub fn document(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), GlbFault> {
    let mut walk = walk(bytes)?;
    let (first, second) = (walk.next().transpose()?, walk.next().transpose()?);
    walk.try_for_each(|chunk| chunk.map(drop))?;
    match (first, second) {
        (Some((JSON, json)), Some((BINARY, binary))) => Ok((json, Some(binary))),
        (Some((JSON, json)), _) => Ok((json, None)),
        _ => Err(GlbFault::NoJson),
    }
}

/// Checks the header of a GLB, and returns an iterator of its chunks that ends after the first fault.
fn walk(bytes: &[u8]) -> Result<impl Iterator<Item = Result<Chunk<'_>, GlbFault>>, GlbFault> {
    let word = |at: usize| {
        let word = bytes.get(at..)?.first_chunk::<4>()?;
        Some(u32::from_le_bytes(*word))
    };
    let (Some(version), Some(announced)) = (word(4), word(8)) else {
        return Err(GlbFault::NoHeader);
    };
    if version != 2 {
        return Err(GlbFault::Version(version));
    }
    let present = bytes.len();
    let Some(bytes) = bytes.get(..announced as usize) else {
        return Err(GlbFault::CutOff { announced, present });
    };
    let (mut at, mut chunk) = (HEADER, 0);
    Ok(std::iter::from_fn(move || {
        let head = bytes.get(at..)?.first_chunk::<CHUNK_HEADER>()?;
        let [l0, l1, l2, l3, kind @ ..] = *head;
        let announced = u32::from_le_bytes([l0, l1, l2, l3]);
        let start = at + CHUNK_HEADER;
        let end = start.checked_add(announced as usize);
        let data = end.and_then(|end| bytes.get(start..end));
        let fault = GlbFault::ChunkCutOff {
            chunk,
            announced,
            left: bytes.len() - start,
        };
        // A fault ends the iteration.
        at = data.and(end).unwrap_or(bytes.len());
        chunk += 1;
        Some(data.map(|data| (kind, data)).ok_or(fault))
    }))
}

/// Joins chunks into a GLB. Pads each chunk to a multiple of four bytes, JSON with spaces and other chunks
/// with zeros.
///
/// # Errors
/// [`GlbFault::TooLong`] if the length does not fit in the header.
pub fn join(chunks: &[Chunk<'_>]) -> Result<Vec<u8>, GlbFault> {
    let length = length(chunks.iter().map(|(_, data)| data.len() as u64))?;
    let mut out = Vec::with_capacity(length as usize);
    out.extend(header(length));
    for (kind, data) in chunks {
        out.extend(chunk_header(*kind, data.len() as u64));
        out.extend_from_slice(data);
        let fill = if *kind == JSON { b' ' } else { 0 };
        out.resize(out.len().next_multiple_of(4), fill);
    }
    Ok(out)
}

/// Computes the length of a GLB whose chunks have these data lengths, in bytes.
///
/// # Errors
/// [`GlbFault::TooLong`] if the length does not fit in the header.
pub fn length(chunks: impl IntoIterator<Item = u64>) -> Result<u32, GlbFault> {
    let padded = |bytes: u64| bytes.saturating_add(3) / 4 * 4;
    let length = chunks.into_iter().fold(HEADER as u64, |sum, bytes| {
        sum.saturating_add(padded(bytes))
            .saturating_add(CHUNK_HEADER as u64)
    });
    u32::try_from(length).map_err(|_| GlbFault::TooLong(length))
}

/// Writes the beginning of a GLB with two chunks: all bytes before the data of its binary chunk.
///
/// The caller must then write `binary` bytes, a multiple of four. `length` must be the result of [`length`]
/// for both chunks.
///
/// # Errors
/// The errors of `out`.
pub fn begin(out: &mut dyn Write, length: u32, json: &[u8], binary: u64) -> io::Result<()> {
    out.write_all(&header(length))?;
    out.write_all(&chunk_header(JSON, json.len() as u64))?;
    out.write_all(json)?;
    out.write_all(&b"   "[..json.len().next_multiple_of(4) - json.len()])?;
    out.write_all(&chunk_header(BINARY, binary))
}

fn header(length: u32) -> [u8; HEADER] {
    let mut header = [0; HEADER];
    header[..4].copy_from_slice(&MAGIC);
    header[4..8].copy_from_slice(&2u32.to_le_bytes());
    header[8..].copy_from_slice(&length.to_le_bytes());
    header
}

fn chunk_header(kind: [u8; 4], bytes: u64) -> [u8; CHUNK_HEADER] {
    let mut header = [0; CHUNK_HEADER];
    // Chunks are shorter than the file, whose length was checked.
    header[..4].copy_from_slice(&(bytes.next_multiple_of(4) as u32).to_le_bytes());
    header[4..].copy_from_slice(&kind);
    header
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_chunks_round_trip() {
        let file = join(&[(JSON, b"{}"), (BINARY, &[1, 2, 3, 4, 5]), (*b"MORE", &[])]).unwrap();
        let expected: [Chunk<'_>; 3] = [
            (JSON, b"{}  "),
            (BINARY, &[1, 2, 3, 4, 5, 0, 0, 0]),
            (*b"MORE", &[]),
        ];
        assert_eq!(chunks(&file).unwrap(), expected);
        assert_eq!(length([2, 5, 0]), Ok(file.len() as u32));
        // Bytes beyond the announced length are not part of the file.
        let longer = [&file[..], b"rest"].concat();
        assert_eq!(chunks(&longer).unwrap(), expected);
        assert_eq!(
            document(&longer).unwrap(),
            (expected[0].1, Some(expected[1].1))
        );
    }

    #[test]
    fn file_that_is_begun_equals_joined_one() {
        let binary = [7; 8];
        let mut out = Vec::new();
        begin(&mut out, length([3, 8]).unwrap(), b"{ }", 8).unwrap();
        out.extend(binary);
        assert_eq!(out, join(&[(JSON, b"{ }"), (BINARY, &binary)]).unwrap());
    }

    #[test]
    fn cut_file_is_refused() {
        let file = join(&[(JSON, b"{}  "), (BINARY, &[0; 4])]).unwrap();
        for end in 0..file.len() {
            let fault = chunks(&file[..end]).unwrap_err();
            assert_eq!(document(&file[..end]).unwrap_err(), fault);
            assert_eq!(fault == GlbFault::NoHeader, end < HEADER, "{end}: {fault}");
        }
        let mut long = file.clone();
        long[12] = 200;
        assert!(matches!(
            chunks(&long),
            Err(GlbFault::ChunkCutOff {
                chunk: 0,
                announced: 200,
                left: 16
            })
        ));
        let mut other = file.clone();
        other[16] = b'X';
        assert_eq!(chunks(&other), Err(GlbFault::NoJson));
        other[4] = 1;
        assert_eq!(chunks(&other), Err(GlbFault::Version(1)));
        assert!(matches!(length([u64::MAX, 1]), Err(GlbFault::TooLong(_))));
    }
}
