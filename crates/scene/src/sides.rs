//! The sides from which lines meet triangles: both sides, or only the front if back faces are culled.
//!
//! A triangle with one side neither shows nor blocks along a line that meets the triangle from behind. The
//! front is the side from which the vertices run counter-clockwise. A node whose transform mirrors reverses
//! the front (glTF 2.0, section 3.7.4, "Instantiation"). Vertices keep their order, and the side is stored
//! instead. Loaders determine the sides only if the user requests culling.

use sightline_numbers::ids::TriangleId;

use crate::SceneError;

/// The side from which lines meet a triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Side {
    /// Both sides of the triangle.
    #[default]
    Both = 0,
    /// The side from which the vertices run counter-clockwise.
    CounterClockwise = 1,
    /// The side from which the vertices run clockwise: a mirrored triangle.
    Clockwise = 2,
}

impl Side {
    /// The list of all sides. The index of a side is its number in files.
    pub const ALL: [Self; 3] = [Self::Both, Self::CounterClockwise, Self::Clockwise];

    /// Returns the side from which lines meet a triangle. `mirrored` is true if the transform of the
    /// triangle's node mirrors.
    pub const fn new(double_sided: bool, mirrored: bool) -> Self {
        match (double_sided, mirrored) {
            (true, _) => Self::Both,
            (false, false) => Self::CounterClockwise,
            (false, true) => Self::Clockwise,
        }
    }
}

/// The sides of all triangles of a scene.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// The sides by triangle. Empty if lines meet all triangles from both sides.
    by_triangle: Vec<Side>,
}

impl Sides {
    /// Creates sides with [`Side::Both`] for all triangles.
    pub fn both() -> Self {
        Self::default()
    }

    /// Creates sides from runs of (number of triangles, side) in id order.
    pub fn from_runs(runs: impl IntoIterator<Item = (u32, Side)>) -> Self {
        let mut sides = Vec::new();
        runs.into_iter()
            .for_each(|(count, side)| sides.resize(sides.len() + count as usize, side));
        match sides.iter().all(|s| *s == Side::Both) {
            true => Self::both(),
            false => Self { by_triangle: sides },
        }
    }

    /// Returns the side from which lines meet a triangle. Ids that the sides do not cover have
    /// [`Side::Both`].
    pub fn side(&self, triangle: TriangleId) -> Side {
        self.by_triangle
            .get(triangle.at())
            .copied()
            .unwrap_or_default()
    }

    /// Returns true if every triangle has [`Side::Both`].
    pub fn are_both(&self) -> bool {
        self.by_triangle.is_empty()
    }

    /// Returns the number of triangles that lines meet from one side only.
    pub fn one_sided(&self) -> u64 {
        self.by_triangle
            .iter()
            .filter(|s| **s != Side::Both)
            .count() as u64
    }

    /// Checks that the sides cover `triangles` triangles, or are [`Side::Both`] for all triangles.
    pub(crate) fn check(&self, file: &str, triangles: u32) -> Result<(), SceneError> {
        if self.by_triangle.is_empty() || self.by_triangle.len() == triangles as usize {
            return Ok(());
        }
        Err(SceneError::bad(
            file,
            "sides",
            format!(
                "the sides cover {} triangles, but the scene has {triangles}",
                self.by_triangle.len()
            ),
            "upload the scene again with this version of the program",
        ))
    }
}

/// The number of bytes of an encoded run.
const RUN_BYTES: usize = 5;

/// Appends the section of a scene's canonical bytes that contains the sides. Little-endian: u32 R, then R
/// runs of (u32 count, u8 side).
pub(crate) fn write(sides: &Sides, out: &mut Vec<u8>) {
    let runs = sides.by_triangle.chunk_by(|a, b| a == b);
    out.extend_from_slice(&(runs.clone().count() as u32).to_le_bytes());
    for run in runs {
        out.extend_from_slice(&(run.len() as u32).to_le_bytes());
        out.push(run[0] as u8);
    }
}

/// Reads the section that [`write`] appends from the beginning of `bytes`, and returns the sides and the
/// remaining bytes. `triangles` is the number of triangles that the runs must cover.
pub(crate) fn read(bytes: &[u8], triangles: u32) -> Result<(Sides, &[u8]), &'static str> {
    let short = "the sides are cut short";
    let (head, rest) = bytes.split_first_chunk::<4>().ok_or(short)?;
    let length = (u32::from_le_bytes(*head) as usize)
        .checked_mul(RUN_BYTES)
        .ok_or(short)?;
    let (runs, rest) = rest.split_at_checked(length).ok_or(short)?;
    let mut read: Vec<(u32, Side)> = Vec::with_capacity(runs.len() / RUN_BYTES);
    let mut covered = 0u64;
    for run in runs.chunks_exact(RUN_BYTES) {
        let count = u32::from_le_bytes([run[0], run[1], run[2], run[3]]);
        let side = Side::ALL
            .get(usize::from(run[4]))
            .copied()
            .ok_or("the number of a side is above 2")?;
        covered += u64::from(count);
        if count == 0 || covered > u64::from(triangles) {
            return Err("a run of sides is empty or reaches beyond the triangles");
        }
        // Each scene has one encoding.
        if read.last().is_some_and(|last| last.1 == side) {
            return Err("the sides are not in their canonical form");
        }
        read.push((count, side));
    }
    if covered != u64::from(triangles) {
        return Err("the sides do not cover all triangles");
    }
    let sides = Sides::from_runs(read);
    match sides.are_both() {
        // A scene with these sides has no section.
        true => Err("the sides are not in their canonical form"),
        false => Ok((sides, rest)),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn sides_survive_encoding(
            runs in prop::collection::vec((1u32..50, (0usize..3).prop_map(|s| Side::ALL[s])), 1..20),
            cut in any::<prop::sample::Index>(),
        ) {
            let truth: Vec<Side> = runs.iter().flat_map(|(n, s)| vec![*s; *n as usize]).collect();
            let triangles = truth.len() as u32;
            let sides = Sides::from_runs(runs);
            (0..triangles).for_each(|t| assert_eq!(sides.side(TriangleId(t)), truth[t as usize]));
            prop_assert_eq!(sides.one_sided(), truth.iter().filter(|s| **s != Side::Both).count() as u64);
            let mut bytes = Vec::new();
            write(&sides, &mut bytes);
            let length = bytes.len();
            bytes.extend_from_slice(b"after");
            if sides.are_both() {
                prop_assert!(read(&bytes, triangles).is_err());
            } else {
                prop_assert_eq!(read(&bytes, triangles), Ok((sides, &b"after"[..])));
                prop_assert!(read(&bytes[..cut.index(length)], triangles).is_err());
                prop_assert!(read(&bytes, triangles + 1).is_err());
                prop_assert!(read(&bytes, triangles - 1).is_err());
            }
        }
    }

    #[test]
    fn rejects_non_canonical_sides() {
        let run = |count: u32, side: u8| [&count.to_le_bytes()[..], &[side]].concat();
        let section =
            |runs: &[Vec<u8>]| [&(runs.len() as u32).to_le_bytes()[..], &runs.concat()].concat();
        assert!(read(&section(&[run(2, 1), run(1, 0)]), 3).is_ok());
        for bad in [
            section(&[run(3, 0)]),
            section(&[run(1, 1), run(2, 1)]),
            section(&[run(3, 1), run(0, 0)]),
            section(&[run(2, 3), run(1, 0)]),
            section(&[]),
            u32::MAX.to_le_bytes().to_vec(),
        ] {
            assert!(read(&bad, 3).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn mirrored_triangle_is_clockwise_unless_double_sided() {
        assert_eq!(Side::new(false, false), Side::CounterClockwise);
        assert_eq!(Side::new(false, true), Side::Clockwise);
        assert_eq!(
            [Side::new(true, false), Side::new(true, true)],
            [Side::Both; 2]
        );
    }
}
