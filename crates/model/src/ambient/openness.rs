//! The encoding of the openness values and form factors that a job of ambient occlusion computes.
//!
//! A worker encodes the values of a tile, and the coordinator joins the values of all tiles to the job's
//! result. `docs/formats/ambient.md` describes the layout of the result.

use std::io::{Read as _, Write};

use sightline_numbers::memory::other_than_exhaustion;
use sightline_numbers::varint;

/// The first byte of a tile's output, before compression. Outputs with view cells begin with other bytes.
const KIND: u8 = b'A';
/// The first bytes of a result: the format's name and the version of the layout.
const MAGIC: &[u8; 8] = b"SLOPEN01";
/// The zstd level of a tile's output. Floats contain no long matches, so higher levels save few bytes.
const LEVEL: i32 = 1;
/// Maximum number of values per receiver: the openness and the form factors of 64 lights.
const MOST_NUMBERS: u32 = 65;
/// The sum of the 16 bytes before the receivers' values and the 16 bytes after them.
const AROUND: usize = 16 + 16;

/// The error of bytes that are not encoded openness values; the text is the reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the openness of receivers cannot be read: {0}; the bytes are damaged, or another version wrote them"
)]
pub struct OpennessError(&'static str);

/// The openness and the form factors of several receivers.
#[derive(Clone, Debug, PartialEq)]
pub struct Openness {
    /// The number of values per receiver: the openness, then the form factor of each light. At least 1.
    pub numbers: u32,
    /// The values of all receivers, 0 to 1. In a result, the values of tiles that were set aside or are not
    /// done are NaN.
    pub values: Vec<f32>,
    /// An upper bound on the error of every value, before its rounding to single precision.
    pub bound: f64,
}

impl Openness {
    /// Returns the number of receivers.
    pub fn points(&self) -> usize {
        self.values.len() / self.numbers.max(1) as usize
    }

    /// Encodes the values as a tile's output.
    ///
    /// # Errors
    /// [`std::io::Error`] if compression fails.
    pub fn encode(&self) -> Result<Vec<u8>, std::io::Error> {
        let mut raw = vec![KIND];
        varint::write(&mut raw, self.numbers.into());
        varint::write(&mut raw, self.points() as u64);
        raw.extend_from_slice(&self.bound.to_le_bytes());
        self.values
            .iter()
            .for_each(|value| raw.extend_from_slice(&value.to_le_bytes()));
        zstd::stream::encode_all(raw.as_slice(), LEVEL).map_err(other_than_exhaustion)
    }

    /// Decodes a tile's output, which must have `points` receivers with `numbers` values each.
    ///
    /// # Errors
    /// [`OpennessError`] with the first difference from such an output.
    pub fn decode(bytes: &[u8], points: u32, numbers: u32) -> Result<Self, OpennessError> {
        let head = 1 + 2 * varint::MOST_BYTES as usize + 8;
        let values = (points as usize).saturating_mul(numbers as usize);
        let most = values.saturating_mul(4).saturating_add(head) as u64;
        let bad = |e| {
            other_than_exhaustion(e);
            OpennessError("the bytes are not zstd data")
        };
        let unpacked = zstd::stream::Decoder::new(bytes).map_err(bad)?;
        let mut raw = Vec::new();
        // Bytes that unpack to more than the tile's output are not unpacked further.
        unpacked.take(most + 1).read_to_end(&mut raw).map_err(bad)?;
        let cut = |_| OpennessError("the bytes are cut short");
        let Some((&KIND, mut rest)) = raw.split_first() else {
            return Err(OpennessError("the first unpacked byte is not the letter A"));
        };
        let has = varint::read(&mut rest, varint::MOST_BYTES).map_err(cut)?;
        let stored_points = varint::read(&mut rest, varint::MOST_BYTES).map_err(cut)?;
        if (has, stored_points) != (numbers.into(), points.into()) {
            return Err(OpennessError(
                "the number of receivers or lights differs from the tile's",
            ));
        }
        let (bound, rest) = rest
            .split_first_chunk()
            .ok_or(OpennessError("the bytes are cut short"))?;
        let bound = f64::from_le_bytes(*bound);
        if !(bound >= 0.0 && bound.is_finite()) {
            return Err(OpennessError("the error bound is negative or not finite"));
        }
        let values = floats(rest, values)?;
        if !values.iter().all(|value| (0.0..=1.0).contains(value)) {
            return Err(OpennessError("a value is not between 0 and 1"));
        }
        Ok(Self {
            numbers,
            values,
            bound,
        })
    }

    /// Decodes the result of a job.
    ///
    /// # Errors
    /// [`OpennessError`] with the first difference from a result.
    pub fn of_result(bytes: &[u8]) -> Result<Self, OpennessError> {
        let cut = OpennessError("the bytes are cut short");
        let rest = bytes
            .strip_prefix(MAGIC)
            .ok_or(OpennessError("the first 8 bytes are not SLOPEN01"))?;
        let ([a, b, c, d, e, f, g, h], rest) = rest.split_first_chunk().ok_or(cut.clone())?;
        let (numbers, points) = (
            u32::from_le_bytes([*a, *b, *c, *d]),
            u32::from_le_bytes([*e, *f, *g, *h]),
        );
        if !(1..=MOST_NUMBERS).contains(&numbers) {
            return Err(OpennessError(
                "the number of values per receiver is not between 1 and 65",
            ));
        }
        let (values, end) = rest.split_last_chunk::<16>().ok_or(cut)?;
        let (bound, missing) = end.split_at(8);
        let eight = |bytes: &[u8]| bytes.try_into().map_or([0; 8], |bytes| bytes);
        let (bound, missing) = (
            f64::from_le_bytes(eight(bound)),
            u64::from_le_bytes(eight(missing)),
        );
        let values = floats(values, (points as usize).saturating_mul(numbers as usize))?;
        let openness = Self {
            numbers,
            values,
            bound,
        };
        if !(bound >= 0.0 && bound.is_finite()) {
            return Err(OpennessError("the error bound is negative or not finite"));
        }
        let is_right = |value: &f32| value.is_nan() || (0.0..=1.0).contains(value);
        if !openness.values.iter().all(is_right) {
            return Err(OpennessError("a value is not between 0 and 1"));
        }
        if openness.missing() != missing {
            return Err(OpennessError(
                "the stated number of receivers without values is wrong",
            ));
        }
        Ok(openness)
    }

    /// Returns the number of receivers without values, because their tile was set aside or is not done.
    pub fn missing(&self) -> u64 {
        self.values
            .chunks(self.numbers.max(1) as usize)
            .filter(|v| v.iter().any(|x| x.is_nan()))
            .count() as u64
    }
}

/// Decodes `count` little-endian floats, which must be all of `bytes`.
fn floats(bytes: &[u8], count: usize) -> Result<Vec<f32>, OpennessError> {
    if Some(bytes.len()) != count.checked_mul(4) {
        return Err(OpennessError(
            "the number of values differs from the stated number",
        ));
    }
    Ok(bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect())
}

/// A writer of the result of a job, tile by tile.
pub struct ResultWriter<'a, W: Write> {
    out: &'a mut W,
    numbers: u32,
    written: u64,
    missing: u64,
    bound: f64,
}

impl<'a, W: Write> ResultWriter<'a, W> {
    /// Starts the result of `points` receivers with `numbers` values each.
    ///
    /// # Errors
    /// [`std::io::Error`] if the writer fails.
    pub fn begin(out: &'a mut W, points: u32, numbers: u32) -> Result<Self, std::io::Error> {
        out.write_all(MAGIC)?;
        out.write_all(&numbers.to_le_bytes())?;
        out.write_all(&points.to_le_bytes())?;
        Ok(Self {
            out,
            numbers,
            written: 0,
            missing: 0,
            bound: 0.0,
        })
    }

    /// Writes the values of the next tile.
    ///
    /// # Errors
    /// [`std::io::Error`] if the writer fails.
    pub fn push(&mut self, tile: &Openness) -> Result<(), std::io::Error> {
        self.bound = self.bound.max(tile.bound);
        self.put(&tile.values)
    }

    /// Writes NaN for all values of the next tile, which has `points` receivers and no output.
    ///
    /// # Errors
    /// [`std::io::Error`] if the writer fails.
    pub fn push_missing(&mut self, points: u32) -> Result<(), std::io::Error> {
        self.missing += u64::from(points);
        self.put(&vec![f32::NAN; points as usize * self.numbers as usize])
    }

    fn put(&mut self, values: &[f32]) -> Result<(), std::io::Error> {
        self.written += values.len() as u64;
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        self.out.write_all(&bytes)
    }

    /// Ends the result and returns its length in bytes.
    ///
    /// # Errors
    /// [`std::io::Error`] if the writer fails.
    pub fn end(self) -> Result<u64, std::io::Error> {
        self.out.write_all(&self.bound.to_le_bytes())?;
        self.out.write_all(&self.missing.to_le_bytes())?;
        self.out.flush()?;
        Ok(AROUND as u64 + 4 * self.written)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn openness(points: u32, numbers: u32) -> Openness {
        let values = (0..points * numbers)
            .map(|i| (i % 17) as f32 / 16.0)
            .collect();
        Openness {
            numbers,
            values,
            bound: 1e-12,
        }
    }

    #[test]
    fn tile_round_trips_and_foreign_tile_is_rejected() {
        for (points, numbers) in [(0, 1), (1, 1), (5, 3)] {
            let tile = openness(points, numbers);
            let bytes = tile.encode().unwrap();
            assert_eq!(Openness::decode(&bytes, points, numbers).unwrap(), tile);
            assert!(Openness::decode(&bytes, points + 1, numbers).is_err());
            assert!(Openness::decode(&bytes, points, numbers + 1).is_err());
            // The decoder of cells rejects openness, and the decoder of openness rejects cells.
            assert!(crate::codec::decode(&bytes, 9).is_err());
        }
        let wrong = |change: &dyn Fn(&mut Openness)| {
            let mut tile = openness(4, 2);
            change(&mut tile);
            Openness::decode(&tile.encode().unwrap(), 4, 2)
                .unwrap_err()
                .to_string()
        };
        for value in [f32::NAN, -0.1, 1.1, f32::INFINITY] {
            assert!(wrong(&|tile| tile.values[3] = value).contains("between 0 and 1"));
        }
        assert!(wrong(&|tile| tile.bound = f64::NAN).contains("bound"));
        assert!(wrong(&|tile| tile.values.push(0.5)).contains("the stated number"));
        let bomb = zstd::stream::encode_all(&vec![KIND; 1 << 20][..], LEVEL).unwrap();
        assert!(Openness::decode(&bomb, 4, 2).is_err());
    }

    #[test]
    fn result_is_concatenation_of_tiles() {
        let (first, last) = (
            openness(3, 2),
            Openness {
                bound: 1e-9,
                ..openness(1, 2)
            },
        );
        let mut bytes = Vec::new();
        let mut writer = ResultWriter::begin(&mut bytes, 6, 2).unwrap();
        writer.push(&first).unwrap();
        writer.push_missing(2).unwrap();
        writer.push(&last).unwrap();
        assert_eq!(writer.end().unwrap(), bytes.len() as u64);
        let whole = Openness::of_result(&bytes).unwrap();
        assert_eq!((whole.points(), whole.missing(), whole.bound), (6, 2, 1e-9));
        assert_eq!(whole.values[..6], first.values);
        assert_eq!(whole.values[10..], last.values);
        // One tile too few, and one tile too many.
        assert!(Openness::of_result(&bytes[..bytes.len() - 1]).is_err());
        assert!(Openness::of_result(&[&bytes[..16], &bytes[24..]].concat()).is_err());
        let miscounted = [&bytes[..bytes.len() - 8], &1u64.to_le_bytes()].concat();
        assert!(
            Openness::of_result(&miscounted)
                .unwrap_err()
                .to_string()
                .contains("without values")
        );
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_do_not_crash_result_decoder(
            bytes in proptest::collection::vec(any::<u8>(), 0..100),
            at in any::<proptest::sample::Index>(),
            bits in 1..=255u8,
        ) {
            let _ = Openness::of_result(&bytes);
            let _ = Openness::of_result(&[MAGIC.as_slice(), &bytes].concat());
            let _ = Openness::decode(&bytes, 3, 2);
            let packed = zstd::stream::encode_all(&[&[KIND], &bytes[..]].concat()[..], LEVEL).unwrap();
            let _ = Openness::decode(&packed, 3, 2);
            let mut bent = openness(3, 2).encode().unwrap();
            let place = at.index(bent.len());
            bent[place] ^= bits;
            let _ = Openness::decode(&bent, 3, 2);
        }
    }
}
