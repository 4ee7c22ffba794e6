//! The answers of a job of ambient occlusion as bytes: of a tile, as its worker sends them, and of the whole
//! job, as the coordinator puts them together. `docs/formats/ambient.md` has the layout of the result.

use std::io::{Read as _, Write};

use sightline_numbers::varint;

/// The first byte of a tile's output; outputs of tiles with cells begin with others.
const KIND: u8 = b'A';
/// The first bytes of a result: its name and the version of the layout.
const MAGIC: &[u8; 8] = b"SLOPEN01";
/// Compression level of a tile's output. Floats hold no long matches.
const LEVEL: i32 = 1;
/// Most numbers of a receiver: its openness and the form factors of 64 lights.
const MOST_NUMBERS: u32 = 65;
/// Bytes of a result before its numbers, and after them.
const AROUND: usize = 16 + 16;

/// Answers that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the openness of receivers cannot be read: {0}; it was damaged or written by another version"
)]
pub struct OpennessError(&'static str);

/// The answers of some receivers.
#[derive(Clone, Debug, PartialEq)]
pub struct Openness {
    /// Numbers of each receiver: its openness, then the form factor of each light. At least 1.
    pub numbers: u32,
    /// The numbers of all receivers, 0 to 1. In a result not a number where a tile was given up.
    pub values: Vec<f32>,
    /// The largest bound on what rounding can have changed, before the values were rounded to single
    /// precision.
    pub bound: f64,
}

impl Openness {
    /// Number of receivers.
    pub fn points(&self) -> usize {
        self.values.len() / self.numbers.max(1) as usize
    }

    /// A tile's output.
    ///
    /// # Errors
    /// When compression fails.
    pub fn encode(&self) -> Result<Vec<u8>, std::io::Error> {
        let mut raw = vec![KIND];
        varint::write(&mut raw, self.numbers.into());
        varint::write(&mut raw, self.points() as u64);
        raw.extend_from_slice(&self.bound.to_le_bytes());
        self.values
            .iter()
            .for_each(|value| raw.extend_from_slice(&value.to_le_bytes()));
        zstd::stream::encode_all(raw.as_slice(), LEVEL)
    }

    /// Reads a tile's output, which must be of so many receivers with so many numbers each.
    ///
    /// # Errors
    /// [`OpennessError`] saying what is wrong.
    pub fn decode(bytes: &[u8], points: u32, numbers: u32) -> Result<Self, OpennessError> {
        let head = 1 + 2 * varint::MOST_BYTES as usize + 8;
        let values = (points as usize).saturating_mul(numbers as usize);
        let most = values.saturating_mul(4).saturating_add(head) as u64;
        let bad = |_| OpennessError("it is not zstd data");
        let unpacked = zstd::stream::Decoder::new(bytes).map_err(bad)?;
        let mut raw = Vec::new();
        // What unpacks to more is not unpacked further.
        unpacked.take(most + 1).read_to_end(&mut raw).map_err(bad)?;
        let cut = |_| OpennessError("it is cut short");
        let Some((&KIND, mut rest)) = raw.split_first() else {
            return Err(OpennessError("it is not the openness of receivers"));
        };
        let has = varint::read(&mut rest, varint::MOST_BYTES).map_err(cut)?;
        let stored_points = varint::read(&mut rest, varint::MOST_BYTES).map_err(cut)?;
        if (has, stored_points) != (numbers.into(), points.into()) {
            return Err(OpennessError(
                "it is of other receivers than the tile's, or of other lights",
            ));
        }
        let (bound, rest) = rest
            .split_first_chunk()
            .ok_or(OpennessError("it is cut short"))?;
        let bound = f64::from_le_bytes(*bound);
        if !(bound >= 0.0 && bound.is_finite()) {
            return Err(OpennessError("its bound is none"));
        }
        let values = floats(rest, values)?;
        if !values.iter().all(|value| (0.0..=1.0).contains(value)) {
            return Err(OpennessError("a number of it is not between 0 and 1"));
        }
        Ok(Self {
            numbers,
            values,
            bound,
        })
    }

    /// Reads the result of a job.
    ///
    /// # Errors
    /// [`OpennessError`] saying what is wrong.
    pub fn of_result(bytes: &[u8]) -> Result<Self, OpennessError> {
        let cut = OpennessError("it is cut short");
        let rest = bytes
            .strip_prefix(MAGIC)
            .ok_or(OpennessError("it does not begin as a result does"))?;
        let ([a, b, c, d, e, f, g, h], rest) = rest.split_first_chunk().ok_or(cut.clone())?;
        let (numbers, points) = (
            u32::from_le_bytes([*a, *b, *c, *d]),
            u32::from_le_bytes([*e, *f, *g, *h]),
        );
        if !(1..=MOST_NUMBERS).contains(&numbers) {
            return Err(OpennessError("it has another number of lights than can be"));
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
        let is_right = |value: &f32| value.is_nan() || (0.0..=1.0).contains(value);
        if !(openness.values.iter().all(is_right) && bound >= 0.0 && bound.is_finite()) {
            return Err(OpennessError("a number of it is not between 0 and 1"));
        }
        if openness.missing() != missing {
            return Err(OpennessError("other receivers have no answer than it says"));
        }
        Ok(openness)
    }

    /// Receivers without an answer, because their tile was given up or is not done.
    pub fn missing(&self) -> u64 {
        self.values
            .chunks(self.numbers.max(1) as usize)
            .filter(|v| v.iter().any(|x| x.is_nan()))
            .count() as u64
    }
}

/// As many little-endian floats as are expected, and nothing else.
fn floats(bytes: &[u8], count: usize) -> Result<Vec<f32>, OpennessError> {
    if Some(bytes.len()) != count.checked_mul(4) {
        return Err(OpennessError(
            "it has another number of numbers than it announces",
        ));
    }
    Ok(bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect())
}

/// Writes the result of a job, tile by tile.
pub struct ResultWriter<'a, W: Write> {
    out: &'a mut W,
    numbers: u32,
    written: u64,
    missing: u64,
    bound: f64,
}

impl<'a, W: Write> ResultWriter<'a, W> {
    /// Begins the result of so many receivers with so many numbers each.
    ///
    /// # Errors
    /// Those of the writer.
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

    /// Writes the answers of the next tile.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn push(&mut self, tile: &Openness) -> Result<(), std::io::Error> {
        self.bound = self.bound.max(tile.bound);
        self.put(&tile.values)
    }

    /// Writes that the next tile, of so many receivers, has no answers.
    ///
    /// # Errors
    /// Those of the writer.
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

    /// Ends the result; gives its length in bytes.
    ///
    /// # Errors
    /// Those of the writer.
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
    fn a_tile_comes_back_and_another_one_is_refused() {
        for (points, numbers) in [(0, 1), (1, 1), (5, 3)] {
            let tile = openness(points, numbers);
            let bytes = tile.encode().unwrap();
            assert_eq!(Openness::decode(&bytes, points, numbers).unwrap(), tile);
            assert!(Openness::decode(&bytes, points + 1, numbers).is_err());
            assert!(Openness::decode(&bytes, points, numbers + 1).is_err());
            // Cells are not taken for it, nor it for cells.
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
        assert!(wrong(&|tile| tile.values.push(0.5)).contains("announces"));
        let bomb = zstd::stream::encode_all(&vec![KIND; 1 << 20][..], LEVEL).unwrap();
        assert!(Openness::decode(&bomb, 4, 2).is_err());
    }

    #[test]
    fn a_result_is_its_tiles_one_after_the_other() {
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
        // A tile is missing, or one too many is there.
        assert!(Openness::of_result(&bytes[..bytes.len() - 1]).is_err());
        assert!(Openness::of_result(&[&bytes[..16], &bytes[24..]].concat()).is_err());
        let miscounted = [&bytes[..bytes.len() - 8], &1u64.to_le_bytes()].concat();
        assert!(
            Openness::of_result(&miscounted)
                .unwrap_err()
                .to_string()
                .contains("no answer")
        );
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(
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
