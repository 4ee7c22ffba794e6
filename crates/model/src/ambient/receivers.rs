//! The encoding of the receivers of a job of ambient occlusion.
//!
//! Receivers are the points whose openness a job computes, in blocks, with the settings of the computation.
//! The client writes them, the coordinator checks them, and workers read them.
//!
//! `docs/formats/ambient.md` describes the layout. A decoder checks every count against the remaining bytes
//! before it allocates memory for the counted values.

use sightline_geometry::convex::Convex;
use sightline_numbers::ids::TriangleId;
use sightline_viewcells::TileIndex;

/// The first bytes of receivers: the format's name and the version of the layout.
const MAGIC: &[u8; 8] = b"SLRECV01";
/// Size of a receiver in bytes.
const RECEIVER: usize = 6 * 8 + 4;
/// The stored triangle id of a receiver without a known triangle.
const NO_TRIANGLE: u32 = u32::MAX;

/// Maximum size of the receivers of a job, in bytes: about forty million receivers. The coordinator has all
/// of them in memory while it checks them.
pub const MOST_BYTES: u64 = 2 << 30;
/// The approximate number of receivers of a tile.
pub const TILE: u32 = 4096;
/// Maximum number of receivers of a block. Because of this limit, only the last tile can be empty.
pub const MOST_BLOCK: u32 = TILE;
/// Maximum number of lights of a job. Each light adds a value to each receiver.
pub const MOST_LIGHTS: u32 = 64;
/// Maximum number of corners of a light.
pub const MOST_CORNERS: u32 = 64;

/// The error of receivers that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReceiversError {
    /// The bytes are cut short, or another version wrote them.
    #[error(
        "the receivers cannot be read: {0}; the bytes are damaged, or another version wrote them"
    )]
    Damaged(&'static str),
    /// A receiver cannot be used.
    #[error("receiver {at} of the job cannot be used: {what}")]
    Receiver {
        /// The number of the receiver, starting at 0, in the order of the blocks.
        at: u32,
        /// The fault of the receiver, and the expectation.
        what: &'static str,
    },
    /// A light cannot be used.
    #[error("light {at} of the job cannot be used: {what}")]
    Light {
        /// The number of the light, starting at 0.
        at: u32,
        /// The fault of the light, and the expectation.
        what: String,
    },
    /// The settings, or the receivers as a whole, cannot be used. The text completes “the job's …”.
    #[error("the job's {0}")]
    Job(&'static str),
}

/// The weight, in the openness, of a direction that a triangle blocks within the job's distance D.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Falloff {
    /// A blocked direction has weight 0, whatever the distance to the occluder.
    None,
    /// A direction whose nearest occluder is at distance d < D has weight √(d/D).
    Sqrt,
}

/// A point whose openness the job computes, in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// The point, in world space.
    pub point: [f64; 3],
    /// The normal, of any length except 0.
    pub normal: [f64; 3],
    /// The triangle on which the receiver lies, if it is known.
    pub triangle: Option<TriangleId>,
}

/// The settings that all receivers of a job share.
#[derive(Clone, Debug, PartialEq)]
pub struct ReceiverSettings {
    /// The distance beyond which triangles do not block, in the scene's units. May be infinite.
    pub distance: f64,
    /// The weight of a direction that is blocked within the distance.
    pub falloff: Falloff,
    /// The lights: convex polygons whose form factors the job computes, in world space.
    pub lights: Vec<Vec<[f64; 3]>>,
}

/// The receivers of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Receivers {
    /// The settings of all receivers.
    pub settings: ReceiverSettings,
    /// The number of receivers of each block, 1 to [`MOST_BLOCK`]. The receivers of a block share a ray
    /// partition.
    pub blocks: Vec<u32>,
    /// All receivers, in the order of the blocks.
    pub receivers: Vec<Receiver>,
}

/// The facts about receivers that the coordinator needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Facts {
    /// The number of receivers.
    pub points: u32,
    /// The number of lights.
    pub lights: u32,
    /// The index, in the job, of the first receiver of each tile, followed by the number of all receivers.
    pub starts: Vec<u32>,
    /// The largest triangle number of a receiver; `None` if no receiver has a triangle.
    pub greatest_triangle: Option<u32>,
}

impl Facts {
    /// Returns the number of values per receiver: the openness, then the form factor of each light.
    pub fn numbers(&self) -> u32 {
        1 + self.lights
    }

    /// Returns the number of tiles.
    pub fn tiles(&self) -> u32 {
        self.starts.len().saturating_sub(1) as u32
    }

    /// Returns the number of receivers of a tile, or `None` if the job has no such tile.
    pub fn receivers_of(&self, tile: TileIndex) -> Option<u32> {
        let at = tile.at();
        Some(self.starts.get(at + 1)? - self.starts.get(at)?)
    }
}

/// Returns the number of tiles of a job with `points` receivers.
///
/// Tile t has the blocks whose first receiver is one of t·[`TILE`] to (t + 1)·[`TILE`] − 1. The last tile may
/// be empty.
pub fn tiles(points: u32) -> u32 {
    points.div_ceil(TILE)
}

impl Receivers {
    /// Encodes the receivers.
    ///
    /// # Errors
    /// [`ReceiversError`] if [`Self::decode`] would reject the bytes.
    pub fn encode(&self) -> Result<Vec<u8>, ReceiversError> {
        let ReceiverSettings {
            distance,
            falloff,
            lights,
        } = &self.settings;
        let sum: u64 = self.blocks.iter().map(|n| u64::from(*n)).sum();
        if sum != self.receivers.len() as u64 {
            return Err(ReceiversError::Job(
                "block sizes do not add up to its number of receivers; correct the sizes",
            ));
        }
        if sum.saturating_mul(RECEIVER as u64) > MOST_BYTES {
            return Err(ReceiversError::Job(TOO_MANY));
        }
        let mut out =
            Vec::with_capacity(64 + self.receivers.len() * RECEIVER + self.blocks.len() * 4);
        let put = |out: &mut Vec<u8>, n: usize| out.extend_from_slice(&(n as u32).to_le_bytes());
        let put_point =
            |out: &mut Vec<u8>, p: &[f64; 3]| p.iter().for_each(|x| out.extend(x.to_le_bytes()));
        out.extend_from_slice(MAGIC);
        out.extend_from_slice(&distance.to_le_bytes());
        out.push(match falloff {
            Falloff::None => 0,
            Falloff::Sqrt => 1,
        });
        put(&mut out, lights.len());
        for light in lights {
            put(&mut out, light.len());
            light.iter().for_each(|corner| put_point(&mut out, corner));
        }
        put(&mut out, self.blocks.len());
        self.blocks.iter().for_each(|n| put(&mut out, *n as usize));
        for r in &self.receivers {
            put_point(&mut out, &r.point);
            put_point(&mut out, &r.normal);
            put(&mut out, r.triangle.map_or(NO_TRIANGLE, |t| t.0) as usize);
        }
        check(&out).map(|_| out)
    }

    /// Decodes the receivers of a scene with `triangles` triangles.
    ///
    /// # Errors
    /// [`ReceiversError`] for the first receiver, light or setting that cannot be used.
    pub fn decode(bytes: &[u8], triangles: u32) -> Result<Self, ReceiversError> {
        let mut receivers = Vec::new();
        let (settings, blocks) = read(bytes, &mut |receiver, all| {
            if receivers.capacity() == 0 {
                receivers.reserve_exact(all);
            }
            receivers.push(receiver);
        })?;
        let beyond = |r: &Receiver| r.triangle.is_some_and(|t| t.0 >= triangles);
        if let Some(at) = receivers.iter().position(beyond) {
            let what = "its triangle id is not in the scene; send the scene of these receivers";
            return Err(ReceiversError::Receiver {
                at: at as u32,
                what,
            });
        }
        Ok(Self {
            settings,
            blocks,
            receivers,
        })
    }

    /// Returns the receivers of each block of a tile, or `None` if the job has no such tile.
    pub fn of_tile(&self, tile: TileIndex) -> Option<Vec<&[Receiver]>> {
        if tile.0 >= tiles(self.receivers.len() as u32) {
            return None;
        }
        let (mut tile_blocks, mut start) = (Vec::new(), 0usize);
        for n in &self.blocks {
            let end = start + *n as usize;
            if start as u32 / TILE == tile.0 {
                tile_blocks.push(self.receivers.get(start..end)?);
            }
            start = end;
        }
        Some(tile_blocks)
    }
}

/// Checks receivers without storing them, and returns the facts about them.
///
/// # Errors
/// [`ReceiversError`] for the first receiver, light or setting that cannot be used. Triangle numbers are not
/// checked, because the scene is not known here.
pub fn check(bytes: &[u8]) -> Result<Facts, ReceiversError> {
    let (mut points, mut greatest) = (0u32, None);
    let (settings, blocks) = read(bytes, &mut |receiver, _| {
        points += 1;
        greatest = greatest.max(receiver.triangle.map(|t| t.0));
    })?;
    let (mut starts, mut start) = (vec![0], 0);
    for n in blocks {
        // A block is at most as large as a tile, so each block begins in the tile of the previous block or in
        // the next tile.
        if start / TILE == starts.len() as u32 {
            starts.push(start);
        }
        start += n;
    }
    // The last tile is empty if a block of the previous tile contains its receivers.
    starts.resize(tiles(points) as usize + 1, points);
    Ok(Facts {
        points,
        lights: settings.lights.len() as u32,
        starts,
        greatest_triangle: greatest,
    })
}

const TOO_MANY: &str = "receivers have more than 2 GiB; use larger texels, or several jobs";

/// A reader of receivers from the front of a byte slice.
struct ReceiversReader<'a>(&'a [u8]);

impl ReceiversReader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], ReceiversError> {
        let (taken, rest) = self
            .0
            .split_first_chunk()
            .ok_or(ReceiversError::Damaged("the bytes are cut short"))?;
        self.0 = rest;
        Ok(*taken)
    }

    fn u32(&mut self) -> Result<u32, ReceiversError> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    fn f64(&mut self) -> Result<f64, ReceiversError> {
        Ok(f64::from_le_bytes(self.take()?))
    }

    fn point(&mut self) -> Result<[f64; 3], ReceiversError> {
        Ok([self.f64()?, self.f64()?, self.f64()?])
    }

    /// Reads a count of elements that have this many bytes each.
    fn count(&mut self, bytes: usize) -> Result<usize, ReceiversError> {
        let n = self.u32()? as usize;
        let there = n <= self.0.len() / bytes;
        there.then_some(n).ok_or(ReceiversError::Damaged(
            "a count exceeds the remaining bytes",
        ))
    }
}

fn is_finite(p: &[f64; 3]) -> bool {
    p.iter().all(|x| x.is_finite())
}

/// Decodes receivers. Calls `take` for each receiver, with the number of all receivers. Returns the settings
/// and the number of receivers of each block.
fn read(
    bytes: &[u8],
    take: &mut dyn FnMut(Receiver, usize),
) -> Result<(ReceiverSettings, Vec<u32>), ReceiversError> {
    use ReceiversError::{Damaged, Job};
    if bytes.len() as u64 > MOST_BYTES {
        return Err(Job(TOO_MANY));
    }
    let mut r = ReceiversReader(bytes);
    if &r.take()? != MAGIC {
        return Err(Damaged("the first 8 bytes are not SLRECV01"));
    }
    let distance = r.f64()?;
    // NaN is rejected, too.
    if distance.is_nan() || distance <= 0.0 {
        return Err(Job(
            "distance is not above 0; give a length in the scene's units, or inf",
        ));
    }
    let [falloff] = r.take()?;
    let falloff = match falloff {
        0 => Falloff::None,
        1 => Falloff::Sqrt,
        _ => return Err(Damaged("the byte of the falloff is not 0 or 1")),
    };
    let settings = ReceiverSettings {
        distance,
        falloff,
        lights: lights(&mut r)?,
    };
    check_falloff(&settings)?;
    let count = r.count(4)?;
    let blocks = (0..count).map(|_| r.u32()).collect::<Result<Vec<_>, _>>()?;
    if blocks.iter().any(|n| !(1..=MOST_BLOCK).contains(n)) {
        return Err(Damaged("a block has no receivers, or more than 4096"));
    }
    let all: u64 = blocks.iter().map(|n| u64::from(*n)).sum();
    if all == 0 {
        return Err(Job("receivers are missing; give at least one"));
    }
    if all.checked_mul(RECEIVER as u64) != Some(r.0.len() as u64) {
        return Err(Damaged(
            "the block sizes do not add up to the number of receivers",
        ));
    }
    // The receivers have at most 2 GiB, so their number is far below 2³².
    for at in 0..all as u32 {
        let (point, normal, triangle) = (r.point()?, r.point()?, r.u32()?);
        let wrong = |what| Err(ReceiversError::Receiver { at, what });
        // Scene coordinates are in single precision, so receivers have the same range.
        if !is_finite(&point) || point.iter().any(|x| x.abs() > f64::from(f32::MAX)) {
            return wrong("a coordinate of its point is not finite, or is beyond ±3.4e38");
        }
        if !is_finite(&normal) {
            return wrong("a coordinate of its normal is not finite");
        }
        // The solver computes these squares, which must neither vanish nor overflow.
        let squares: f64 = normal.iter().map(|x| x * x).sum();
        if !(squares.is_normal() && (1.0 / squares).is_normal()) {
            return wrong("its normal is too short or too long; give a normal of length 1");
        }
        let triangle = Some(triangle).filter(|t| *t != NO_TRIANGLE);
        take(
            Receiver {
                point,
                normal,
                triangle: triangle.map(TriangleId),
            },
            all as usize,
        );
    }
    Ok((settings, blocks))
}

fn lights(r: &mut ReceiversReader<'_>) -> Result<Vec<Vec<[f64; 3]>>, ReceiversError> {
    let count = r.count(4)? as u32;
    if count > MOST_LIGHTS {
        return Err(ReceiversError::Job(
            "number of lights exceeds 64; use several jobs",
        ));
    }
    let mut lights = Vec::with_capacity(count as usize);
    for at in 0..count {
        let wrong = |what| ReceiversError::Light { at, what };
        let corners = r.count(3 * 8)? as u32;
        if !(3..=MOST_CORNERS).contains(&corners) {
            return Err(wrong(format!(
                "the light has {corners} corners; give a convex polygon of 3 to {MOST_CORNERS} corners"
            )));
        }
        let light = (0..corners)
            .map(|_| r.point())
            .collect::<Result<Vec<_>, _>>()?;
        // The solver has the same check and would reject each tile of a job with another light.
        Convex::new(&light).map_err(|e| wrong(e.to_string()))?;
        lights.push(light);
    }
    Ok(lights)
}

/// Checks that the falloff can be computed for the distance.
fn check_falloff(settings: &ReceiverSettings) -> Result<(), ReceiversError> {
    if settings.falloff != Falloff::None && settings.distance.is_infinite() {
        return Err(ReceiversError::Job(
            "falloff sqrt requires a finite distance; give a finite distance, or falloff none",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of_blocks(blocks: &[u32]) -> Receivers {
        let all: u32 = blocks.iter().sum();
        let receiver = |i: u32| Receiver {
            point: [f64::from(i), 0.5, -3.0],
            normal: [0.0, 0.0, 2.0],
            triangle: (!i.is_multiple_of(3)).then_some(TriangleId(i % 7)),
        };
        let settings = ReceiverSettings {
            distance: 2.0,
            falloff: Falloff::None,
            lights: Vec::new(),
        };
        Receivers {
            settings,
            blocks: blocks.to_vec(),
            receivers: (0..all).map(receiver).collect(),
        }
    }

    /// Returns the message of the error that a change of valid receivers causes.
    fn refused(change: impl FnOnce(&mut Receivers)) -> String {
        let mut receivers = of_blocks(&[2, 1]);
        change(&mut receivers);
        receivers.encode().unwrap_err().to_string()
    }

    #[test]
    fn receivers_round_trip_and_tiles_partition_blocks() {
        for blocks in [
            &[1][..],
            &[64; 200],
            &[4095, 2, 4096, 4096, 1],
            &[4090, 100],
            &[4096, 4096],
        ] {
            let receivers = of_blocks(blocks);
            let bytes = receivers.encode().unwrap();
            assert_eq!(Receivers::decode(&bytes, 7).unwrap(), receivers);
            let facts = check(&bytes).unwrap();
            let tiles = tiles(facts.points);
            assert_eq!(facts.starts.len() as u32, tiles + 1, "{blocks:?}");
            let mut again = Vec::new();
            for tile in (0..tiles).map(TileIndex) {
                let tile_blocks = receivers.of_tile(tile).unwrap();
                let here: usize = tile_blocks.iter().map(|block| block.len()).sum();
                assert_eq!(
                    facts.receivers_of(tile),
                    Some(here as u32),
                    "{blocks:?}, tile {tile}"
                );
                again.extend(tile_blocks.concat());
            }
            assert_eq!(again, receivers.receivers);
            let past = TileIndex(tiles);
            assert!(receivers.of_tile(past).is_none() && facts.receivers_of(past).is_none());
        }
    }

    #[test]
    fn error_names_receiver_by_number() {
        let bytes = of_blocks(&[5]).encode().unwrap();
        assert_eq!(check(&bytes).unwrap().greatest_triangle, Some(4));
        let unknown = Receivers::decode(&bytes, 4).unwrap_err().to_string();
        assert!(
            unknown.starts_with("receiver 4 of the job") && unknown.contains("triangle"),
            "{unknown}"
        );
        for distance in [0.0, -1.0, f64::NAN] {
            assert!(
                refused(|r| r.settings.distance = distance).contains("distance is not above 0")
            );
        }
        for far in [f64::INFINITY, 1e39] {
            assert!(refused(|r| r.receivers[1].point[2] = far).contains("receiver 1"));
        }
        assert!(refused(|r| r.receivers[2].normal[0] = f64::NAN).contains("receiver 2"));
        for length in [0.0, 1e-200, 1e200] {
            assert!(
                refused(|r| r.receivers[2].normal = [0.0, length, 0.0])
                    .contains("too short or too long")
            );
        }
        let darkens = ReceiverSettings {
            distance: f64::INFINITY,
            falloff: Falloff::Sqrt,
            lights: Vec::new(),
        };
        assert!(refused(|r| r.settings = darkens.clone()).contains("falloff"));
        assert!(refused(|r| r.settings.lights = vec![vec![[0.0; 3]; 3]; 65]).contains("64"));
        assert!(refused(|r| r.blocks = vec![3, 0]).contains("block"));
        assert!(refused(|r| r.blocks = vec![4]).contains("block sizes"));
        assert!(
            refused(|r| (r.blocks, r.receivers) = (Vec::new(), Vec::new())).contains("missing")
        );
        let infinite = ReceiverSettings {
            distance: f64::INFINITY,
            falloff: Falloff::None,
            lights: Vec::new(),
        };
        assert!(
            Receivers {
                settings: infinite,
                ..of_blocks(&[1])
            }
            .encode()
            .is_ok()
        );
    }

    #[test]
    fn error_names_light_that_is_not_convex_polygon() {
        let square = vec![
            [0.0, 0.0, 9.0],
            [4.0, 0.0, 9.0],
            [4.0, 4.0, 9.0],
            [0.0, 4.0, 9.0],
        ];
        let with = |change: &dyn Fn(&mut Vec<[f64; 3]>)| {
            let mut light = square.clone();
            change(&mut light);
            refused(|r| r.settings.lights = vec![square.clone(), light])
        };
        let cases: [(&str, String); 8] = [
            ("the light has 2 corners; give", with(&|l| l.truncate(2))),
            (
                "the light has 65 corners; give",
                with(&|l| l.resize(65, [1.0; 3])),
            ),
            (
                "corner 1 is not finite; give",
                with(&|l| l[1][0] = f64::NAN),
            ),
            ("corner 2 is not finite; give", with(&|l| l[2][2] = 1e39)),
            (
                "the polygon has no area",
                with(&|l| l.iter_mut().for_each(|c| c[1] = 0.0)),
            ),
            (
                "is not in the plane of the other corners; divide",
                with(&|l| l[3][2] = 8.0),
            ),
            (
                "the polygon is not convex at corner 2; divide",
                with(&|l| l[2] = [1.0, 1.0, 9.0]),
            ),
            // A bow tie.
            (
                "the polygon is not convex at corner",
                with(&|l| l[3] = [5.0, 2.0, 9.0]),
            ),
        ];
        for (what, said) in &cases {
            assert!(
                said.starts_with("light 1 of the job") && said.contains(what),
                "{what}: {said}"
            );
        }
        let settings = ReceiverSettings {
            lights: vec![square],
            ..of_blocks(&[1]).settings
        };
        let lit = Receivers {
            settings,
            ..of_blocks(&[1])
        };
        assert_eq!(
            Receivers::decode(&lit.encode().unwrap(), 7).as_ref(),
            Ok(&lit)
        );
    }

    proptest! {
        #[test]
        fn decoder_rejects_or_reads_damaged_receivers(
            blocks in proptest::collection::vec(1u32..9, 1..5),
            at in any::<proptest::sample::Index>(),
            bits in 1..=255u8,
            cut in any::<proptest::sample::Index>(),
        ) {
            let bytes = of_blocks(&blocks).encode().unwrap();
            let mut bent = bytes.clone();
            let place = at.index(bent.len());
            bent[place] ^= bits;
            if let Ok(read) = Receivers::decode(&bent, 7) {
                prop_assert_eq!(read.encode().unwrap(), bent.clone());
            }
            prop_assert!(Receivers::decode(&bytes[..cut.index(bytes.len())], 7).is_err());
            let longer = [&bytes[..], &[0]].concat();
            prop_assert!(Receivers::decode(&longer, 7).is_err() && check(&longer).is_err());
        }

        #[test]
        fn arbitrary_bytes_do_not_crash_decoder(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let named = [MAGIC.as_slice(), &bytes].concat();
            for bytes in [&bytes, &named] {
                let _ = check(bytes);
                let _ = Receivers::decode(bytes, 7);
            }
        }
    }
}
