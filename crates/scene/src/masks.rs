//! Alpha masks: the points at which a masked triangle blocks, as one bit for each texel of its texture.
//!
//! Loaders create the masks ([`mod@crate::load`]), and a scene stores them with the kinds. The texel at a
//! point of a triangle is computed only with + − × ÷ and floor in `f64`, so every machine and every backend
//! computes the same texel.

use glam::Vec3;
use sightline_geometry::vector::{cross, dot};
use sightline_numbers::ids::TriangleId;

use crate::{Kinds, SceneError};

/// The rule that maps a texture coordinate outside 0…1 to a texel (glTF 2.0, sampler).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum WrapMode {
    /// Repetition of the texture.
    Repeat = 0,
    /// Repetition of the texture, mirrored every second time.
    Mirror = 1,
    /// Continuation of the texels at the border.
    Clamp = 2,
}

impl WrapMode {
    const ALL: [Self; 3] = [Self::Repeat, Self::Mirror, Self::Clamp];

    /// Maps a texture coordinate to 0…1.
    fn apply(self, t: f64) -> f64 {
        match self {
            Self::Repeat => t - t.floor(),
            Self::Mirror => {
                let twice = t - 2.0 * (t / 2.0).floor();
                if twice > 1.0 { 2.0 - twice } else { twice }
            }
            Self::Clamp => t.clamp(0.0, 1.0),
        }
    }
}

/// A texture of one bit per texel. The bit is set if the texel's alpha reaches the cutoff, so that the texel
/// blocks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    size: [u32; 2],
    wrap: [WrapMode; 2],
    /// The bits, row by row from the first row of the image, the lowest bit of a byte first.
    bits: Vec<u8>,
}

impl Mask {
    /// Returns the number of texels of a mask with a width and a height.
    fn texels(size: [u32; 2]) -> u64 {
        u64::from(size[0]) * u64::from(size[1])
    }

    /// Creates a mask of width and height `size` in which no texel blocks. The caller must check that the
    /// mask fits in memory.
    pub(crate) fn open(size: [u32; 2], wrap: [WrapMode; 2]) -> Self {
        Self {
            size,
            wrap,
            bits: vec![0; Self::texels(size).div_ceil(8) as usize],
        }
    }

    /// Marks a texel as blocking. The texels are counted row by row from 0, and the mask must contain
    /// `texel`.
    pub(crate) fn close(&mut self, texel: usize) {
        self.bits[texel / 8] |= 1 << (texel % 8);
    }

    /// Returns true if all texels block.
    pub(crate) fn all_closed(&self) -> bool {
        let set: u64 = self.bits.iter().map(|b| u64::from(b.count_ones())).sum();
        set == Self::texels(self.size)
    }

    /// Returns the width and height in texels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Returns true if the texel at the texture coordinates `uv` blocks. Textures are not filtered.
    pub fn blocks(&self, uv: [f64; 2]) -> bool {
        let [x, y] = [0, 1].map(|a| {
            // A coordinate of 1 is the far border of the last texel. The cast saturates.
            let at = self.wrap[a].apply(uv[a]) * f64::from(self.size[a]);
            (at as u64).min(u64::from(self.size[a]) - 1)
        });
        let texel = y * u64::from(self.size[0]) + x;
        self.bits
            .get((texel / 8) as usize)
            .is_some_and(|byte| byte >> (texel % 8) & 1 == 1)
    }
}

/// The texture coordinates of a triangle's vertices.
pub type Coordinates = [[f32; 2]; 3];

/// A run of consecutive masked triangles with one mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MaskRun {
    pub(crate) first: u32,
    pub(crate) count: u32,
    /// The index of the mask in the list of masks.
    pub(crate) mask: u32,
}

/// The masks of a scene and the texture coordinates of its masked triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Masks {
    masks: Vec<Mask>,
    parts: Vec<MaskRun>,
    /// For each run of `parts`, the index in `coordinates` of its first triangle.
    starts: Vec<usize>,
    /// The texture coordinates of each masked triangle, in id order.
    coordinates: Vec<Coordinates>,
}

impl Masks {
    /// Returns the masks of a scene without masked triangles.
    pub fn none() -> Self {
        Self::default()
    }

    /// Creates masks in their canonical form: adjacent runs with the same mask are joined, and the masks are
    /// in the order in which runs use them first. The runs `parts` must ascend and refer to existing masks.
    pub(crate) fn new(
        masks: Vec<Mask>,
        parts: Vec<MaskRun>,
        coordinates: Vec<Coordinates>,
    ) -> Self {
        let mut this = Self {
            coordinates,
            ..Self::default()
        };
        let mut place = vec![u32::MAX; masks.len()];
        let mut waiting: Vec<Option<Mask>> = masks.into_iter().map(Some).collect();
        let mut start = 0;
        for part in parts.into_iter().filter(|p| p.count > 0) {
            let mask_index = part.mask as usize;
            if let Some(mask) = waiting[mask_index].take() {
                place[mask_index] = this.masks.len() as u32;
                this.masks.push(mask);
            }
            let mask = place[mask_index];
            match this.parts.last_mut() {
                Some(last) if last.mask == mask && last.first + last.count == part.first => {
                    last.count += part.count;
                }
                _ => {
                    this.parts.push(MaskRun { mask, ..part });
                    this.starts.push(start);
                }
            }
            start += part.count as usize;
        }
        this
    }

    /// Returns true if no triangle is masked.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Returns the mask of a triangle and its texture coordinates, if the triangle is masked.
    pub fn find_mask(&self, triangle: TriangleId) -> Option<(&Mask, &Coordinates)> {
        let after = self.parts.partition_point(|p| p.first <= triangle.0);
        let at = after.checked_sub(1)?;
        let (part, offset) = (&self.parts[at], triangle.0 - self.parts[at].first);
        let within = offset < part.count;
        within.then(|| {
            (
                &self.masks[part.mask as usize],
                &self.coordinates[self.starts[at] + offset as usize],
            )
        })
    }

    /// Returns true if the masked triangle with vertices `v` blocks the line from `origin` along `direction`
    /// at their intersection. A line in the plane of the triangle is not blocked.
    pub(crate) fn block(
        &self,
        triangle: TriangleId,
        v: [Vec3; 3],
        origin: [f32; 3],
        direction: [f32; 3],
    ) -> bool {
        let Some((mask, coordinates)) = self.find_mask(triangle) else {
            return false;
        };
        // Möller and Trumbore 1997, in f64 with a fixed order of operations.
        let v = v.map(|v| v.as_dvec3());
        let (origin, direction) = (Vec3::from(origin).as_dvec3(), direction.map(f64::from));
        let [b, c, to] = [v[1] - v[0], v[2] - v[0], origin - v[0]].map(|v| v.to_array());
        let across = cross(direction, c);
        let scale = dot(b, across);
        if scale == 0.0 {
            return false;
        }
        // The tracer computes with lower precision, so its intersection may be slightly outside the triangle.
        let beside = cross(to, b);
        let second = (dot(to, across) / scale).clamp(0.0, 1.0);
        let third = (dot(direction, beside) / scale).clamp(0.0, 1.0);
        let first = 1.0 - second - third;
        let uv = [0, 1].map(|a| {
            first * f64::from(coordinates[0][a])
                + second * f64::from(coordinates[1][a])
                + third * f64::from(coordinates[2][a])
        });
        mask.blocks(uv)
    }

    /// Checks that the runs cover exactly the masked triangles of `kinds`.
    pub(crate) fn check(&self, file: &str, kinds: &Kinds) -> Result<(), SceneError> {
        let mut parts = self
            .parts
            .iter()
            .map(|p| (u64::from(p.first), u64::from(p.count)))
            .peekable();
        let mut fits = true;
        for (first, count) in kinds.masked() {
            // A run of kinds may have several consecutive masks.
            let (mut at, end) = (first, first + count);
            while at < end && fits {
                let part = parts.next();
                fits = part.is_some_and(|(from, n)| from == at && n > 0 && at + n <= end);
                at += part.map_or(0, |p| p.1);
            }
        }
        if fits && parts.next().is_none() {
            return Ok(());
        }
        Err(SceneError::bad(
            file,
            "masks",
            "the masks do not cover exactly the masked triangles",
            "upload the scene again with this version of the program",
        ))
    }
}

/// Passes the section of a scene's canonical bytes that contains the masks to `take`, in pieces. All numbers
/// are little-endian.
///
/// - The section begins with u32 M, then M masks of (u32 width, u32 height, u8 wrap along each axis, one bit
///   per texel in ⌈width · height / 8⌉ bytes).
/// - The masks are followed by u32 P, then P runs of (u32 first triangle, u32 count, u32 index of the mask).
/// - The section ends with six f32 for each masked triangle: the texture coordinates of its vertices.
pub(crate) fn write(masks: &Masks, take: &mut impl FnMut(&[u8])) {
    take(&(masks.masks.len() as u32).to_le_bytes());
    for mask in &masks.masks {
        mask.size.iter().for_each(|n| take(&n.to_le_bytes()));
        take(&mask.wrap.map(|w| w as u8));
        take(&mask.bits);
    }
    take(&(masks.parts.len() as u32).to_le_bytes());
    for part in &masks.parts {
        [part.first, part.count, part.mask]
            .iter()
            .for_each(|n| take(&n.to_le_bytes()));
    }
    // Pass the coordinates of 4096 triangles at a time, because a digest processes large pieces faster.
    for some in masks.coordinates.chunks(4096) {
        let bytes: Vec<u8> = some
            .iter()
            .flatten()
            .flatten()
            .flat_map(|c| c.to_le_bytes())
            .collect();
        take(&bytes);
    }
}

/// Reads the section that [`write`] writes, which must be all of `bytes`. Every count is checked against the
/// remaining bytes.
pub(crate) fn read(bytes: &[u8]) -> Result<Masks, &'static str> {
    let mut rest = bytes;
    let mut masks = Vec::new();
    for _ in 0..count(&mut rest, 11)? {
        let size = [number(&mut rest)?, number(&mut rest)?];
        let wrap = |w: u8| {
            WrapMode::ALL
                .get(usize::from(w))
                .copied()
                .ok_or("the number of the wrap mode of a mask is above 2")
        };
        let [s, t] = take(&mut rest, 2)? else {
            return Err(SHORT);
        };
        let wrap = [wrap(*s)?, wrap(*t)?];
        let texels = Mask::texels(size);
        if texels == 0 {
            return Err("a mask has no texels");
        }
        let length = usize::try_from(texels.div_ceil(8)).map_err(|_| SHORT)?;
        let bits = take(&mut rest, length)?.to_vec();
        if !texels.is_multiple_of(8) && bits.last().is_some_and(|last| last >> (texels % 8) != 0) {
            return Err("a mask has bits after its last texel");
        }
        masks.push(Mask { size, wrap, bits });
    }
    let mut parts: Vec<MaskRun> = Vec::new();
    let (mut end, mut triangles) = (0u32, 0usize);
    for _ in 0..count(&mut rest, 12)? {
        let part = MaskRun {
            first: number(&mut rest)?,
            count: number(&mut rest)?,
            mask: number(&mut rest)?,
        };
        if part.first < end || part.count == 0 || part.mask as usize >= masks.len() {
            return Err("a run of masked triangles is empty, out of order or refers to no mask");
        }
        end = part
            .first
            .checked_add(part.count)
            .ok_or("a run of masked triangles is too long")?;
        triangles += part.count as usize;
        parts.push(part);
    }
    if triangles.checked_mul(24) != Some(rest.len()) {
        return Err(
            "the number of texture coordinates differs from the number of masked triangles",
        );
    }
    let corner = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let read_coordinates = |b: &[u8]| [0, 8, 16].map(|at| [corner(&b[at..]), corner(&b[at + 4..])]);
    let coordinates: Vec<Coordinates> = rest.chunks_exact(24).map(read_coordinates).collect();
    if coordinates
        .iter()
        .flatten()
        .flatten()
        .any(|c| !c.is_finite())
    {
        return Err("a texture coordinate is not finite");
    }
    let (given, used) = (parts.clone(), masks.len());
    let masks = Masks::new(masks, parts, coordinates);
    // Each scene has one encoding.
    if masks.parts != given || masks.masks.len() != used {
        return Err("the masks are not in their canonical form");
    }
    Ok(masks)
}

const SHORT: &str = "the masks are cut short";

fn take<'a>(rest: &mut &'a [u8], n: usize) -> Result<&'a [u8], &'static str> {
    let (head, tail) = rest.split_at_checked(n).ok_or(SHORT)?;
    *rest = tail;
    Ok(head)
}

fn number(rest: &mut &[u8]) -> Result<u32, &'static str> {
    let (head, tail) = rest.split_first_chunk::<4>().ok_or(SHORT)?;
    *rest = tail;
    Ok(u32::from_le_bytes(*head))
}

/// Reads the number of the following elements, which have at least `least` bytes each.
fn count(rest: &mut &[u8], least: usize) -> Result<usize, &'static str> {
    let n = number(rest)? as usize;
    if n > rest.len() / least {
        Err("the masks announce more elements than the remaining bytes can contain")
    } else {
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a mask of four by two texels. The first row is open, closed, open, closed; the second row is
    /// closed.
    fn mask(wrap: WrapMode) -> Mask {
        let mut mask = Mask::open([4, 2], [wrap; 2]);
        [1, 3, 4, 5, 6, 7].into_iter().for_each(|t| mask.close(t));
        mask
    }

    fn row(wrap: WrapMode, from: i32) -> String {
        let at = |i: i32| f64::from(i) / 4.0 + 0.125;
        (from..from + 4)
            .map(|i| {
                if mask(wrap).blocks([at(i), 0.25]) {
                    'x'
                } else {
                    '.'
                }
            })
            .collect()
    }

    #[test]
    fn coordinates_outside_texture_are_wrapped() {
        assert_eq!(
            [-4, 0, 4].map(|i| row(WrapMode::Repeat, i)),
            [".x.x", ".x.x", ".x.x"]
        );
        assert_eq!(
            [-4, 0, 4].map(|i| row(WrapMode::Mirror, i)),
            ["x.x.", ".x.x", "x.x."]
        );
        assert_eq!(
            [-4, 0, 4].map(|i| row(WrapMode::Clamp, i)),
            ["....", ".x.x", "xxxx"]
        );
        assert!(
            mask(WrapMode::Repeat).blocks([0.1, 0.75])
                && !mask(WrapMode::Repeat).blocks([0.1, 1.25])
        );
        assert!(
            mask(WrapMode::Clamp).blocks([1.0, 0.0]),
            "the far border is the last texel"
        );
        for wrap in WrapMode::ALL {
            // Coordinates that are too large to have a fraction also have a texel.
            let _ = [1e30, -1e30, f64::from(f32::MAX)].map(|t| mask(wrap).blocks([t, -t]));
        }
        assert!(
            !mask(WrapMode::Clamp).all_closed()
                && !Mask::open([3, 3], [WrapMode::Clamp; 2]).all_closed()
        );
    }

    #[test]
    fn line_finds_texel_at_intersection() {
        let part = MaskRun {
            first: 5,
            count: 1,
            mask: 0,
        };
        let masks = Masks::new(
            vec![mask(WrapMode::Repeat)],
            vec![part],
            vec![[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]],
        );
        let v = [Vec3::ZERO, Vec3::X * 8.0, Vec3::Y * 8.0];
        let met = |x: f32, y: f32| {
            masks.block(TriangleId(5), v, [x - 1.0, y - 2.0, -3.0], [1.0, 2.0, 3.0])
        };
        assert_eq!(
            [0.5, 2.5, 4.5, 6.5].map(|x| met(x, 0.5)),
            [false, true, false, true]
        );
        assert!(met(0.5, 5.0));
        assert!(
            !masks.block(TriangleId(5), v, [0.0, 5.0, 0.0], [1.0, 0.0, 0.0]),
            "a line in the plane"
        );
        assert!(
            !masks.block(TriangleId(4), v, [0.5, 5.0, 1.0], [0.0, 0.0, -1.0]),
            "a triangle without a mask"
        );
    }

    #[test]
    fn parts_are_joined_and_masks_numbered_by_use() {
        let parts = [(2, 1, 1), (3, 2, 1), (5, 0, 0), (7, 1, 2)];
        let parts = parts
            .map(|(first, count, mask)| MaskRun { first, count, mask })
            .to_vec();
        let three = [WrapMode::Repeat, WrapMode::Mirror, WrapMode::Clamp]
            .map(mask)
            .to_vec();
        let coordinates: Vec<Coordinates> = (0..4).map(|i| [[i as f32, 0.5]; 3]).collect();
        let masks = Masks::new(three, parts, coordinates);
        assert_eq!(masks.masks.len(), 2);
        let found = |t: u32| {
            masks
                .find_mask(TriangleId(t))
                .map(|(m, c)| (m.wrap[0], c[0][0]))
        };
        assert_eq!(
            (0..9).filter_map(found).map(|f| f.1).collect::<Vec<_>>(),
            [0.0, 1.0, 2.0, 3.0]
        );
        assert_eq!(
            (found(4), found(7)),
            (Some((WrapMode::Mirror, 2.0)), Some((WrapMode::Clamp, 3.0)))
        );
        assert_eq!((found(1), found(5), found(8)), (None, None, None));
    }

    #[test]
    fn rejects_damaged_bytes() {
        let part = MaskRun {
            first: 5,
            count: 2,
            mask: 0,
        };
        let masks = Masks::new(
            vec![mask(WrapMode::Repeat)],
            vec![part],
            vec![[[0.25; 2]; 3]; 2],
        );
        let mut bytes = Vec::new();
        write(&masks, &mut |part| bytes.extend_from_slice(part));
        assert_eq!(read(&bytes).as_ref(), Ok(&masks));
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "{length}");
        }
        let with = |at: usize, value: &[u8]| {
            let mut changed = bytes.clone();
            changed[at..at + value.len()].copy_from_slice(value);
            read(&changed)
        };
        // More masks than exist; a mask of 10¹⁸ texels or none; an unknown wrap mode; too many triangles.
        let [many, none] = [[255; 4], [0; 4]];
        for (at, value) in [
            (0, &many[..]),
            (4, &many[..]),
            (8, &none[..]),
            (12, &[3][..]),
            (23, &many[..]),
            (27, &many[..]),
        ] {
            assert!(with(at, value).is_err(), "{at}");
        }
        assert!(with(31, &f32::NAN.to_le_bytes()).is_err());
        assert!(read(&[&bytes[..], &[0]].concat()).is_err());
    }
}
