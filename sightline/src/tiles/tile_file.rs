//! The file of a tile: a header with the bake, the tile and the samples, then the output, under one digest.

/// The first bytes of such a file, with its version.
const MAGIC: &[u8; 8] = b"SLTILE\0\x01";
/// Bytes before the output: the first ones, the bake, the tile, the samples, and the digest of all that and
/// of the output.
const HEADER: usize = 8 + 32 + 4 + 8 + 32;

/// A tile's output with its bake and its samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileFile {
    /// The digest of the job's key and the numerics profile.
    pub bake: [u8; 32],
    /// The tile's number.
    pub tile: u32,
    /// The number of its samples.
    pub samples: u64,
    /// The output.
    pub output: Vec<u8>,
}

/// Bytes that are not the file of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TileFileError {
    /// The file does not begin like one.
    #[error("it is not the file of a tile, or of another version")]
    Foreign,
    /// The content does not have the digest.
    #[error("it is damaged")]
    Damaged,
    /// The tile belongs to another job, or was computed with another backend.
    #[error("it is of another job, or of another backend")]
    OtherBake,
    /// The tile is another one of the job.
    #[error("it is tile {0}")]
    OtherTile(u32),
}

impl TileFile {
    /// Encodes the file.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + self.output.len());
        bytes.extend(MAGIC);
        bytes.extend(self.bake);
        bytes.extend(self.tile.to_le_bytes());
        bytes.extend(self.samples.to_le_bytes());
        let digest = digest(&bytes, &self.output);
        bytes.extend(digest.as_bytes());
        bytes.extend(&self.output);
        bytes
    }

    /// Decodes the file of a tile of a bake.
    ///
    /// # Errors
    /// [`TileFileError`] for other bytes.
    pub fn decode(bytes: &[u8], bake: &[u8; 32], tile: u32) -> Result<Self, TileFileError> {
        if !bytes.starts_with(MAGIC) {
            return Err(TileFileError::Foreign);
        }
        let (header, output) = bytes
            .split_at_checked(HEADER)
            .ok_or(TileFileError::Damaged)?;
        let (fields, stored) = header.split_at(HEADER - 32);
        if digest(fields, output).as_bytes() != stored {
            return Err(TileFileError::Damaged);
        }
        let field = |at: usize| &fields[at..];
        let (Some(own), Some(number), Some(samples)) = (
            field(8).first_chunk::<32>(),
            field(40).first_chunk::<4>(),
            field(44).first_chunk::<8>(),
        ) else {
            return Err(TileFileError::Damaged);
        };
        let found = Self {
            bake: *own,
            tile: u32::from_le_bytes(*number),
            samples: u64::from_le_bytes(*samples),
            output: output.to_vec(),
        };
        match found {
            found if found.bake != *bake => Err(TileFileError::OtherBake),
            found if found.tile != tile => Err(TileFileError::OtherTile(found.tile)),
            found => Ok(found),
        }
    }
}

fn digest(fields: &[u8], output: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(fields);
    hasher.update(output);
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> TileFile {
        TileFile {
            bake: [7; 32],
            tile: 3,
            samples: 99,
            output: b"output".to_vec(),
        }
    }

    #[test]
    fn files_come_back_and_belong_to_one_tile_of_one_bake() {
        let bytes = file().encode();
        assert_eq!(TileFile::decode(&bytes, &[7; 32], 3), Ok(file()));
        assert_eq!(
            TileFile::decode(&bytes, &[8; 32], 3),
            Err(TileFileError::OtherBake)
        );
        assert_eq!(
            TileFile::decode(&bytes, &[7; 32], 4),
            Err(TileFileError::OtherTile(3))
        );
    }

    #[test]
    fn every_flipped_bit_and_every_cut_is_found() {
        let bytes = file().encode();
        for at in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1;
            assert!(
                TileFile::decode(&flipped, &[7; 32], 3).is_err(),
                "byte {at}"
            );
            assert!(
                TileFile::decode(&bytes[..at], &[7; 32], 3).is_err(),
                "{at} bytes"
            );
        }
    }
}
