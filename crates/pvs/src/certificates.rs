//! The section of certificates while it is built: in memory, or in a scratch file until the result is
//! written.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, Write};

use crate::layout::{Section, Written};

/// Bytes read back at a time.
const AT_ONCE: usize = 1 << 20;

/// The certificates pushed so far, one for each cell.
#[derive(Debug, Default)]
pub(crate) struct Certificates {
    /// Where the certificate of each cell ends, in bytes from the first.
    pub ends: Vec<u64>,
    pub kept: Kept,
}

/// Where the bytes are.
#[derive(Debug)]
pub(crate) enum Kept {
    Memory(Vec<u8>),
    File(File),
}

impl Default for Kept {
    fn default() -> Self {
        Self::Memory(Vec::new())
    }
}

impl Certificates {
    pub fn push(&mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self.kept {
            Kept::Memory(all) => all.extend_from_slice(bytes),
            Kept::File(file) => file.write_all(bytes)?,
        }
        self.ends.push(self.length() + bytes.len() as u64);
        Ok(())
    }

    fn length(&self) -> u64 {
        self.ends.last().copied().unwrap_or(0)
    }

    /// Length and checksum of the section; `None` without certificates.
    pub fn section(&mut self, cells: u32) -> io::Result<Option<Written>> {
        if self.ends.is_empty() {
            return Ok(None);
        }
        let mut section = Written::of(Section::Certificates, &[]);
        self.each(cells, &mut |bytes| {
            section.length += bytes.len() as u64;
            section.crc = crc32c::crc32c_append(section.crc, bytes);
            Ok(())
        })?;
        Ok(Some(section))
    }

    pub fn write(&mut self, cells: u32, out: &mut impl Write) -> io::Result<()> {
        self.each(cells, &mut |bytes| out.write_all(bytes))
    }

    /// Calls `take` with the offsets and then with the bytes, in pieces.
    fn each(
        &mut self,
        cells: u32,
        take: &mut dyn FnMut(&[u8]) -> io::Result<()>,
    ) -> io::Result<()> {
        let length = self.length();
        let ends = (0..cells as usize).map(|cell| self.ends.get(cell).copied().unwrap_or(length));
        let offsets: Vec<u8> = std::iter::once(0)
            .chain(ends)
            .flat_map(u64::to_le_bytes)
            .collect();
        take(&offsets)?;
        match &mut self.kept {
            Kept::Memory(all) => take(all),
            Kept::File(file) => {
                file.rewind()?;
                let mut piece = vec![0; AT_ONCE.min(usize::try_from(length).unwrap_or(AT_ONCE))];
                let mut left = length;
                while left > 0 {
                    let some =
                        usize::try_from(left).map_or(piece.len(), |left| left.min(piece.len()));
                    file.read_exact(&mut piece[..some])?;
                    take(&piece[..some])?;
                    left -= some as u64;
                }
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_gives_the_same_bytes_as_memory() {
        // Pieces that end before, at and after the number of bytes read back at a time.
        let pieces: Vec<Vec<u8>> = [AT_ONCE - 1, 1, 0, AT_ONCE, 3]
            .iter()
            .map(|n| (0..*n).map(|i| (i * 31 + n) as u8).collect())
            .collect();
        let written = |kept: Kept| {
            let mut certificates = Certificates {
                ends: Vec::new(),
                kept,
            };
            assert!(certificates.section(7).unwrap().is_none());
            pieces.iter().for_each(|p| certificates.push(p).unwrap());
            let section = certificates.section(7).unwrap().unwrap();
            let mut out = Vec::new();
            certificates.write(7, &mut out).unwrap();
            assert_eq!(
                (section.length, section.crc),
                (out.len() as u64, crc32c::crc32c(&out))
            );
            out
        };
        let memory = written(Kept::default());
        assert_eq!(memory.len(), 8 * 8 + 2 * AT_ONCE + 3);
        assert_eq!(memory[8 * 5..8 * 6], (2 * AT_ONCE as u64 + 3).to_le_bytes());
        assert!(written(Kept::File(tempfile::tempfile().unwrap())) == memory);
    }
}
