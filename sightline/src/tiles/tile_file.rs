//! The file of a tile: a header, then the output, all covered by one digest.
//!
//! The header contains the digest of the bake, the number of the tile and the number of samples.

use sightline_viewcells::TileIndex;

/// The first bytes of a tile file, with the version.
const MAGIC: &[u8; 8] = b"SLTILE\0\x01";
/// The number of bytes before the output. These are the magic, the bake, the tile, the samples, and the
/// digest of these and of the output.
const HEADER: usize = 8 + 32 + 4 + 8 + 32;

/// A tile's output with its bake and its samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileFile {
    /// The digest of the job's key and the numerics profile.
    pub bake: [u8; 32],
    /// The number of the tile.
    pub tile: TileIndex,
    /// The number of samples.
    pub samples: u64,
    /// The output.
    pub output: Vec<u8>,
}

/// The reason why bytes are not the file of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TileFileError {
    /// The file does not start with the magic of tile files.
    #[error("the file is not a tile file, or has another version")]
    Foreign,
    /// The content does not match the digest.
    #[error("the file is damaged")]
    Damaged,
    /// The tile belongs to another job, or was computed with another backend.
    #[error("the file belongs to another job or another numerics profile")]
    OtherBake,
    /// The file contains another tile of the job.
    #[error("the file contains tile {0}")]
    OtherTile(TileIndex),
}

impl TileFile {
    /// Encodes the file of a tile.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + self.output.len());
        bytes.extend(MAGIC);
        bytes.extend(self.bake);
        bytes.extend(self.tile.0.to_le_bytes());
        bytes.extend(self.samples.to_le_bytes());
        let digest = digest(&bytes, &self.output);
        bytes.extend(digest.as_bytes());
        bytes.extend(&self.output);
        bytes
    }

    /// Decodes the file of a tile of a bake.
    ///
    /// # Errors
    /// [`TileFileError`] if the bytes are not the file of this tile.
    pub fn decode(bytes: &[u8], bake: &[u8; 32], tile: TileIndex) -> Result<Self, TileFileError> {
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
            tile: TileIndex(u32::from_le_bytes(*number)),
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
            tile: TileIndex(3),
            samples: 99,
            output: b"output".to_vec(),
        }
    }

    #[test]
    fn tile_file_round_trips_for_one_tile_of_one_bake() {
        let bytes = file().encode();
        assert_eq!(TileFile::decode(&bytes, &[7; 32], TileIndex(3)), Ok(file()));
        assert_eq!(
            TileFile::decode(&bytes, &[8; 32], TileIndex(3)),
            Err(TileFileError::OtherBake)
        );
        assert_eq!(
            TileFile::decode(&bytes, &[7; 32], TileIndex(4)),
            Err(TileFileError::OtherTile(TileIndex(3)))
        );
    }

    #[test]
    fn flipped_bits_and_cuts_are_detected() {
        let bytes = file().encode();
        for at in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1;
            assert!(
                TileFile::decode(&flipped, &[7; 32], TileIndex(3)).is_err(),
                "byte {at}"
            );
            assert!(
                TileFile::decode(&bytes[..at], &[7; 32], TileIndex(3)).is_err(),
                "{at} bytes"
            );
        }
    }
}
