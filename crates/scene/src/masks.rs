//! Alpha masks: at which points a masked triangle blocks, one bit for each texel of its texture.
//!
//! Loaders make the masks ([`mod@crate::load`]); a scene keeps them beside the kinds. The texel at a point
//! of a triangle is found with + − × ÷ and floor in `f64` alone, so every machine and every backend finds
//! the same.

use glam::Vec3;
use sightline_geometry::vector::{cross, dot};

use crate::{Kinds, SceneError};

/// How texture coordinates outside of 0…1 are read, for each axis (glTF 2.0, sampler).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Wrap {
    /// The texture is repeated.
    Repeat = 0,
    /// The texture is repeated, every second time mirrored.
    Mirror = 1,
    /// The texels at the border go on.
    Clamp = 2,
}

impl Wrap {
    const ALL: [Self; 3] = [Self::Repeat, Self::Mirror, Self::Clamp];

    /// A coordinate as one in 0…1.
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

/// A texture of one bit a texel: set where its alpha reaches the cutoff, so that the texel blocks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    size: [u32; 2],
    wrap: [Wrap; 2],
    /// Row by row from the first row of the image, the least bit of a byte first.
    bits: Vec<u8>,
}

impl Mask {
    /// Texels for which `bits` has room.
    fn texels(size: [u32; 2]) -> u64 {
        u64::from(size[0]) * u64::from(size[1])
    }

    /// A mask of `size` texels that are all open. The caller has checked the size.
    pub(crate) fn open(size: [u32; 2], wrap: [Wrap; 2]) -> Self {
        Self {
            size,
            wrap,
            bits: vec![0; Self::texels(size).div_ceil(8) as usize],
        }
    }

    /// Makes a texel, counted row by row, block. The mask has that texel.
    pub(crate) fn close(&mut self, texel: usize) {
        self.bits[texel / 8] |= 1 << (texel % 8);
    }

    /// Whether all texels block.
    pub(crate) fn all_closed(&self) -> bool {
        let set: u64 = self.bits.iter().map(|b| u64::from(b.count_ones())).sum();
        set == Self::texels(self.size)
    }

    /// Width and height in texels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Whether the texel at texture coordinates blocks: the nearest one, without filtering.
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

/// Texture coordinates of a triangle's vertices.
pub type Coordinates = [[f32; 2]; 3];

/// Consecutive masked triangles with one mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    pub(crate) first: u32,
    pub(crate) count: u32,
    /// Index of the mask.
    pub(crate) mask: u32,
}

/// The masks of a scene and the texture coordinates of its masked triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Masks {
    masks: Vec<Mask>,
    parts: Vec<Part>,
    /// The place of each part's first triangle in `coordinates`.
    starts: Vec<usize>,
    /// By masked triangle, ascending.
    coordinates: Vec<Coordinates>,
}

impl Masks {
    /// The masks of a scene without masked triangles.
    pub fn none() -> Self {
        Self::default()
    }

    /// Masks in their canonical form: adjacent parts with one mask are joined, and masks are in the order in
    /// which parts use them. `parts` ascend and name masks that are there.
    pub(crate) fn new(masks: Vec<Mask>, parts: Vec<Part>, coordinates: Vec<Coordinates>) -> Self {
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
                    this.parts.push(Part { mask, ..part });
                    this.starts.push(start);
                }
            }
            start += part.count as usize;
        }
        this
    }

    /// Whether no triangle is masked.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// The mask of a triangle and its texture coordinates, if it is masked.
    pub fn of(&self, triangle: u32) -> Option<(&Mask, &Coordinates)> {
        let after = self.parts.partition_point(|p| p.first <= triangle);
        let at = after.checked_sub(1)?;
        let (part, offset) = (&self.parts[at], triangle - self.parts[at].first);
        let within = offset < part.count;
        within.then(|| {
            (
                &self.masks[part.mask as usize],
                &self.coordinates[self.starts[at] + offset as usize],
            )
        })
    }

    /// Whether a triangle with these vertices blocks where a line meets it. A line in the triangle's plane
    /// meets no texel.
    pub(crate) fn block(
        &self,
        triangle: u32,
        v: [Vec3; 3],
        origin: [f32; 3],
        direction: [f32; 3],
    ) -> bool {
        let Some((mask, of)) = self.of(triangle) else {
            return false;
        };
        // Möller and Trumbore 1997, in f64 and a fixed order of operations.
        let v = v.map(|v| v.as_dvec3());
        let (origin, direction) = (Vec3::from(origin).as_dvec3(), direction.map(f64::from));
        let [b, c, to] = [v[1] - v[0], v[2] - v[0], origin - v[0]].map(|v| v.to_array());
        let across = cross(direction, c);
        let scale = dot(b, across);
        if scale == 0.0 {
            return false;
        }
        // The tracer, which rounds more, may find a hit just outside.
        let beside = cross(to, b);
        let second = (dot(to, across) / scale).clamp(0.0, 1.0);
        let third = (dot(direction, beside) / scale).clamp(0.0, 1.0);
        let first = 1.0 - second - third;
        let uv = [0, 1].map(|a| {
            first * f64::from(of[0][a]) + second * f64::from(of[1][a]) + third * f64::from(of[2][a])
        });
        mask.blocks(uv)
    }

    /// Checks that these are masks of exactly the masked triangles.
    pub(crate) fn check(&self, file: &str, kinds: &Kinds) -> Result<(), SceneError> {
        let mut parts = self
            .parts
            .iter()
            .map(|p| (u64::from(p.first), u64::from(p.count)))
            .peekable();
        let mut fits = true;
        for (first, count) in kinds.masked() {
            // A run of kinds may have several masks, one after another.
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
            "they are not those of the masked triangles",
            "upload the scene again with this version of the program",
        ))
    }
}

/// Gives the section of a scene's canonical bytes to `take`, in parts. Little-endian: u32 M, then M masks
/// of (u32 width, u32 height, u8 wrap along each axis, one bit a texel in ⌈width · height / 8⌉ bytes); u32
/// P, then P parts of (u32 first triangle, u32 count, u32 mask); for each masked triangle six f32.
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
    // Many at a time, since a digest takes large pieces faster.
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

/// Reads the section that [`write`] gives, which must be all of `bytes`. Every count is checked against the
/// bytes that are left.
pub(crate) fn read(bytes: &[u8]) -> Result<Masks, &'static str> {
    let mut rest = bytes;
    let mut masks = Vec::new();
    for _ in 0..count(&mut rest, 11)? {
        let size = [number(&mut rest)?, number(&mut rest)?];
        let wrap = |w: u8| {
            Wrap::ALL
                .get(usize::from(w))
                .copied()
                .ok_or("a wrap mode is unknown")
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
    let mut parts: Vec<Part> = Vec::new();
    let (mut end, mut triangles) = (0u32, 0usize);
    for _ in 0..count(&mut rest, 12)? {
        let part = Part {
            first: number(&mut rest)?,
            count: number(&mut rest)?,
            mask: number(&mut rest)?,
        };
        if part.first < end || part.count == 0 || part.mask as usize >= masks.len() {
            return Err("a part of the masked triangles is empty, out of order or names no mask");
        }
        end = part
            .first
            .checked_add(part.count)
            .ok_or("a part of the masked triangles is too long")?;
        triangles += part.count as usize;
        parts.push(part);
    }
    if triangles.checked_mul(24) != Some(rest.len()) {
        return Err("there are more or fewer texture coordinates than masked triangles have");
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
    // One scene has one encoding.
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

/// A count of elements of at least `least` bytes each.
fn count(rest: &mut &[u8], least: usize) -> Result<usize, &'static str> {
    let n = number(rest)? as usize;
    if n > rest.len() / least {
        Err("the masks count more than there is")
    } else {
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four texels by two: the first row open, closed, open, closed; the second row closed.
    fn mask(wrap: Wrap) -> Mask {
        let mut mask = Mask::open([4, 2], [wrap; 2]);
        [1, 3, 4, 5, 6, 7].into_iter().for_each(|t| mask.close(t));
        mask
    }

    fn row(wrap: Wrap, from: i32) -> String {
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
    fn coordinates_outside_of_the_texture_are_wrapped() {
        assert_eq!(
            [-4, 0, 4].map(|i| row(Wrap::Repeat, i)),
            [".x.x", ".x.x", ".x.x"]
        );
        assert_eq!(
            [-4, 0, 4].map(|i| row(Wrap::Mirror, i)),
            ["x.x.", ".x.x", "x.x."]
        );
        assert_eq!(
            [-4, 0, 4].map(|i| row(Wrap::Clamp, i)),
            ["....", ".x.x", "xxxx"]
        );
        assert!(mask(Wrap::Repeat).blocks([0.1, 0.75]) && !mask(Wrap::Repeat).blocks([0.1, 1.25]));
        assert!(
            mask(Wrap::Clamp).blocks([1.0, 0.0]),
            "the far border is the last texel"
        );
        for wrap in Wrap::ALL {
            // Coordinates without a fraction have a texel, too.
            let _ = [1e30, -1e30, f64::from(f32::MAX)].map(|t| mask(wrap).blocks([t, -t]));
        }
        assert!(
            !mask(Wrap::Clamp).all_closed() && !Mask::open([3, 3], [Wrap::Clamp; 2]).all_closed()
        );
    }

    #[test]
    fn a_line_finds_the_texel_where_it_meets_the_triangle() {
        let part = Part {
            first: 5,
            count: 1,
            mask: 0,
        };
        let masks = Masks::new(
            vec![mask(Wrap::Repeat)],
            vec![part],
            vec![[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]],
        );
        let v = [Vec3::ZERO, Vec3::X * 8.0, Vec3::Y * 8.0];
        let met = |x: f32, y: f32| masks.block(5, v, [x - 1.0, y - 2.0, -3.0], [1.0, 2.0, 3.0]);
        assert_eq!(
            [0.5, 2.5, 4.5, 6.5].map(|x| met(x, 0.5)),
            [false, true, false, true]
        );
        assert!(met(0.5, 5.0));
        assert!(
            !masks.block(5, v, [0.0, 5.0, 0.0], [1.0, 0.0, 0.0]),
            "a line in the plane"
        );
        assert!(
            !masks.block(4, v, [0.5, 5.0, 1.0], [0.0, 0.0, -1.0]),
            "a triangle without a mask"
        );
    }

    #[test]
    fn parts_are_joined_and_masks_numbered_by_use() {
        let parts = [(2, 1, 1), (3, 2, 1), (5, 0, 0), (7, 1, 2)];
        let parts = parts
            .map(|(first, count, mask)| Part { first, count, mask })
            .to_vec();
        let three = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp].map(mask).to_vec();
        let coordinates: Vec<Coordinates> = (0..4).map(|i| [[i as f32, 0.5]; 3]).collect();
        let masks = Masks::new(three, parts, coordinates);
        assert_eq!(masks.masks.len(), 2);
        let found = |t: u32| masks.of(t).map(|(m, c)| (m.wrap[0], c[0][0]));
        assert_eq!(
            (0..9).filter_map(found).map(|f| f.1).collect::<Vec<_>>(),
            [0.0, 1.0, 2.0, 3.0]
        );
        assert_eq!(
            (found(4), found(7)),
            (Some((Wrap::Mirror, 2.0)), Some((Wrap::Clamp, 3.0)))
        );
        assert_eq!((found(1), found(5), found(8)), (None, None, None));
    }

    #[test]
    fn damaged_bytes_are_refused() {
        let part = Part {
            first: 5,
            count: 2,
            mask: 0,
        };
        let masks = Masks::new(
            vec![mask(Wrap::Repeat)],
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
        // More masks than there are; a mask of 10¹⁸ texels or none; an unknown wrap mode; too many triangles.
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
