//! The section of certificates while it is built: in memory, or in a scratch file until the result is
//! written.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, Write};

use crate::layout::{Section, Written};

/// The number of bytes that are read back from the scratch file at once.
const AT_ONCE: usize = 1 << 20;

/// The certificates pushed so far, one per cell.
#[derive(Debug, Default)]
pub(crate) struct Certificates {
    /// The end offset of the certificate of each cell, in bytes from the start of the first certificate.
    pub ends: Vec<u64>,
    pub kept: CertificateBytes,
}

/// The storage of the certificates' bytes.
#[derive(Debug)]
pub(crate) enum CertificateBytes {
    Memory(Vec<u8>),
    File(File),
}

impl Default for CertificateBytes {
    fn default() -> Self {
        Self::Memory(Vec::new())
    }
}

impl Certificates {
    pub fn push(&mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self.kept {
            CertificateBytes::Memory(all) => all.extend_from_slice(bytes),
            CertificateBytes::File(file) => file.write_all(bytes)?,
        }
        self.ends.push(self.length() + bytes.len() as u64);
        Ok(())
    }

    fn length(&self) -> u64 {
        self.ends.last().copied().unwrap_or(0)
    }

    /// Computes the length and the checksum of the section, or returns `None` without certificates.
    pub fn section(&mut self, cells: u32) -> io::Result<Option<Written>> {
        if self.ends.is_empty() {
            return Ok(None);
        }
        let mut section = Written::new(Section::Certificates, &[]);
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

    /// Calls `take` with the offsets and then with the certificates' bytes, in pieces.
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
            CertificateBytes::Memory(all) => take(all),
            CertificateBytes::File(file) => {
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
    fn file_and_memory_give_same_bytes() {
        // The pieces end before, at and after the number of bytes that are read back at once.
        let pieces: Vec<Vec<u8>> = [AT_ONCE - 1, 1, 0, AT_ONCE, 3]
            .iter()
            .map(|n| (0..*n).map(|i| (i * 31 + n) as u8).collect())
            .collect();
        let written = |kept: CertificateBytes| {
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
        let memory = written(CertificateBytes::default());
        assert_eq!(memory.len(), 8 * 8 + 2 * AT_ONCE + 3);
        assert_eq!(memory[8 * 5..8 * 6], (2 * AT_ONCE as u64 + 3).to_le_bytes());
        assert!(written(CertificateBytes::File(tempfile::tempfile().unwrap())) == memory);
    }
}
