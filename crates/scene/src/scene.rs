//! The scene: triangles in id order, their objects, bounds and canonical bytes.
//!
//! A scene is a triangle soup: each triangle has three separate vertices, and there is no index buffer. So
//! ids, digests and samples do not depend on shared vertices in a file, and triangles are read without an
//! indirection.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};
use sightline_numbers::ids::TriangleId;
use sightline_numbers::{Aabb, MAX_COORDINATE};

use crate::SceneError;
use crate::kinds::{self, Kinds};
use crate::masks::{self, Masks};
use crate::sides::{self, Side, Sides};
use crate::sources::{self, GltfLocation};

/// A triangle: three vertices in world space, in the order of the file. 36 bytes without padding.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Triangle {
    /// The vertices in world space.
    pub v: [Vec3; 3],
}

impl Triangle {
    /// Returns true if the triangle has no area: two vertices are equal, or all three are on one line. The
    /// result is exact.
    ///
    /// Differences of `f32` coordinates are exact in `f64` only if their exponents are close. So
    /// [`sightline_geometry::predicates`] uses expansion arithmetic if its filter cannot decide.
    pub fn is_degenerate(&self) -> bool {
        sightline_geometry::predicates::collinear(self.v[0], self.v[1], self.v[2])
    }

    /// Returns the box around the three vertices.
    pub fn bounds(&self) -> Aabb {
        Aabb::around(self.v)
    }
}

/// A run of triangles that an engine draws together: a primitive of a glTF node, an OBJ group, or a whole PLY
/// file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// The name of the object in the file, made unique by the loader. The loader creates a name if the file
    /// contains none.
    pub name: String,
    /// The id of the object's first triangle.
    pub first: u32,
    /// The number of the object's triangles, which may be 0.
    pub count: u32,
}

/// The BLAKE3 digest of a scene's canonical bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneDigest(pub [u8; 32]);

impl std::fmt::Display for SceneDigest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

/// A checked static scene. Every vertex is finite, there is at least one triangle, and the objects cover the
/// ids 0…N−1 in order without gaps.
#[derive(Clone, Debug)]
pub struct Scene {
    triangles: Vec<Triangle>,
    objects: Vec<Object>,
    bounds: Aabb,
    kinds: Kinds,
    masks: Masks,
    /// The locations in a glTF file: one for each object, or none.
    sources: Vec<GltfLocation>,
    sides: Sides,
}

/// The first bytes of a canonical scene of opaque triangles: the name and version of the encoding.
const BLOB_MAGIC: &[u8; 8] = b"SLSCENE1";
/// The first bytes of a canonical scene with kinds.
const BLOB_MAGIC_KINDS: &[u8; 8] = b"SLSCENE2";
/// The first bytes of a canonical scene with kinds whose alpha textures were read.
const BLOB_MAGIC_MASKS: &[u8; 8] = b"SLSCENE4";
/// The first bytes of a canonical scene with sides, or with the locations of its objects in a glTF file. A
/// u32 of flags follows.
const BLOB_MAGIC_FLAGS: &[u8; 8] = b"SLSCENE5";
/// The flag of a [`BLOB_MAGIC_FLAGS`] scene with kinds. The following flags are set for scenes with alpha
/// textures, with sides, and with locations in a glTF file.
const HAS_KINDS: u32 = 1;
const HAS_MASKS: u32 = 2;
const HAS_SIDES: u32 = 4;
const HAS_SOURCES: u32 = 8;
/// Maximum length of an object name in bytes. [`Scene::new`] rejects longer names.
pub const MAX_NAME_BYTES: usize = 4096;

impl Scene {
    /// Creates a scene of `triangles` in id order, and of `objects`, which cover the ids in order without
    /// gaps.
    ///
    /// `file` is the name of the source in errors.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if there is no triangle, more than `u32::MAX - 1` triangles, a vertex that is not
    /// finite, or objects that do not cover the ids.
    pub fn new(
        file: &str,
        triangles: Vec<Triangle>,
        objects: Vec<Object>,
    ) -> Result<Self, SceneError> {
        if triangles.is_empty() {
            return Err(SceneError::bad(
                file,
                "scene",
                "the scene has no triangles",
                "export the meshes as triangles (lines and points are not visible surfaces)",
            ));
        }
        if triangles.len() >= u32::MAX as usize {
            return Err(SceneError::bad(
                file,
                "scene",
                format!(
                    "{} triangles are more than 32-bit ids can number",
                    triangles.len()
                ),
                "split the scene into parts of fewer than 4 294 967 295 triangles",
            ));
        }
        let mut bounds = Aabb::EMPTY;
        for (i, t) in triangles.iter().enumerate() {
            for (corner, v) in t.v.iter().enumerate() {
                if !v.is_finite() {
                    return Err(SceneError::bad(
                        file,
                        format!("triangle {i}, vertex {corner}"),
                        format!("the position ({}, {}, {}) is not finite", v.x, v.y, v.z),
                        "remove or repair the vertex and export again",
                    ));
                }
            }
            bounds = bounds.union(t.bounds());
        }
        let mut next = 0u64;
        for (i, o) in objects.iter().enumerate() {
            if u64::from(o.first) != next {
                return Err(SceneError::bad(
                    file,
                    format!("object {i}"),
                    format!(
                        "the object starts at triangle {} instead of {next}",
                        o.first
                    ),
                    "give the objects in id order, without gaps",
                ));
            }
            if o.name.len() > MAX_NAME_BYTES {
                return Err(SceneError::bad(
                    file,
                    format!("object {i}"),
                    format!("the name is {} bytes long", o.name.len()),
                    format!("shorten the name to at most {MAX_NAME_BYTES} bytes"),
                ));
            }
            next += u64::from(o.count);
        }
        if next != triangles.len() as u64 {
            return Err(SceneError::bad(
                file,
                "objects",
                format!(
                    "the objects contain {next} triangles, but the scene has {}",
                    triangles.len()
                ),
                "assign every triangle to one object",
            ));
        }
        Ok(Self {
            triangles,
            objects,
            bounds,
            kinds: Kinds::opaque(),
            masks: Masks::none(),
            sources: Vec::new(),
            sides: Sides::both(),
        })
    }

    /// Checks that all coordinates are within ±[`MAX_COORDINATE`]. Loaders and tracers call this function;
    /// exact queries accept any finite scene.
    ///
    /// # Errors
    /// [`SceneError::Bad`] with the first triangle that exceeds the range.
    pub fn check_reach(&self, file: &str) -> Result<(), SceneError> {
        let corner = |v: &Vec3| v.abs().max_element() > MAX_COORDINATE;
        let far = self
            .triangles
            .iter()
            .enumerate()
            .find_map(|(i, t)| Some((i, t.v.iter().position(corner)?)));
        let Some((i, corner)) = far else {
            return Ok(());
        };
        let v = self.triangles[i].v[corner];
        Err(SceneError::bad(
            file,
            format!("triangle {i}, vertex {corner}"),
            format!(
                "the position ({}, {}, {}) is beyond ±{MAX_COORDINATE:e}",
                v.x, v.y, v.z
            ),
            "remove a misplaced vertex, or move or scale the scene, and export again",
        ))
    }

    /// Returns the scene with the locations of its objects in a glTF file: one for each object, or none.
    ///
    /// `file` is the name of the source in errors.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the number of locations is neither 0 nor the number of objects.
    pub fn with_sources(self, file: &str, sources: Vec<GltfLocation>) -> Result<Self, SceneError> {
        sources::check(file, &sources, self.objects.len())?;
        Ok(Self { sources, ..self })
    }

    /// Returns the locations of the objects in their glTF file, in the order of the objects. The slice is
    /// empty for other files.
    pub fn sources(&self) -> &[GltfLocation] {
        &self.sources
    }

    /// Returns the scene with `kinds` in place of its kinds and masks.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the kinds cover another number of triangles, or if triangles are masked.
    pub fn with_kinds(self, file: &str, kinds: Kinds) -> Result<Self, SceneError> {
        self.with_masks(file, kinds, Masks::none())
    }

    /// Returns the scene with `kinds` in place of its kinds, and with the masks of the masked triangles.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the kinds cover another number of triangles, or the masks do not cover exactly
    /// the masked triangles.
    pub fn with_masks(self, file: &str, kinds: Kinds, masks: Masks) -> Result<Self, SceneError> {
        kinds.check(file, self.len())?;
        masks.check(file, &kinds)?;
        Ok(Self {
            kinds,
            masks,
            ..self
        })
    }

    /// Returns the kinds of the triangles.
    pub fn kinds(&self) -> &Kinds {
        &self.kinds
    }

    /// Returns the masks of the masked triangles.
    pub fn masks(&self) -> &Masks {
        &self.masks
    }

    /// Returns true if masked triangle `id` blocks the line from `origin` along `direction` at their
    /// intersection.
    pub fn mask_blocks(&self, id: TriangleId, origin: [f32; 3], direction: [f32; 3]) -> bool {
        self.masks
            .block(id, self.triangles[id.at()].v, origin, direction)
    }

    /// Returns the scene with `sides` in place of its sides.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the sides cover another number of triangles.
    pub fn with_sides(self, file: &str, sides: Sides) -> Result<Self, SceneError> {
        sides.check(file, self.len())?;
        Ok(Self { sides, ..self })
    }

    /// Returns the sides from which lines meet the triangles.
    pub fn sides(&self) -> &Sides {
        &self.sides
    }

    /// Returns the normal of triangle `id` towards the front of the triangle, not normalised. The result is
    /// zero if lines meet the triangle from both sides.
    ///
    /// Lines whose direction has a positive dot product with the normal meet the triangle from behind. The
    /// cross product of the edges e and f is rounded in `f64`, with an error of less than 2⁻⁵⁰ |e| |f|. So
    /// the sign can be wrong only for lines within an angle of 2⁻⁵⁰ |e| |f| / |e × f| of the plane, which
    /// meet the triangle edge-on. There are far fewer such lines than lines that single precision cannot
    /// distinguish from the triangle's border.
    pub fn front(&self, id: TriangleId) -> DVec3 {
        let side = self.sides.side(id);
        if side == Side::Both {
            return DVec3::ZERO;
        }
        let [a, b, c] = self.triangles[id.at()].v.map(|v| v.as_dvec3());
        let normal = (b - a).cross(c - a);
        if side == Side::Clockwise {
            -normal
        } else {
            normal
        }
    }

    /// Returns true if triangle `id` ends all sight lines: it has an area, and its kind blocks.
    pub fn blocks(&self, id: TriangleId) -> bool {
        self.kinds.kind(id).blocks() && !self.triangles[id.at()].is_degenerate()
    }

    /// Returns true if triangle `id` can be in a visibility set: it has an area, and its kind shows.
    pub fn shows(&self, id: TriangleId) -> bool {
        self.kinds.kind(id).shows() && !self.triangles[id.at()].is_degenerate()
    }

    /// Returns the triangles. The index of a triangle is its id.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// Returns the objects, in id order.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Returns the number of triangles, N.
    pub fn len(&self) -> u32 {
        // `new` rejects scenes whose count does not fit.
        self.triangles.len() as u32
    }

    /// Returns false, because a scene has at least one triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Returns the smallest box around all vertices.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Encodes the scene to its canonical bytes, which are uploaded and digested. All numbers are
    /// little-endian.
    ///
    /// - The bytes are `SLSCENE1`, u32 N (triangles), u32 M (objects), N × 9 f32 (vertices), then M × (u32
    ///   number of triangles, u32 name length in bytes, name UTF-8).
    /// - A scene with kinds begins with `SLSCENE2`, and its kinds follow the objects: u32 R (rules), R × (u8
    ///   kind, glob), u32 S (reasons), S × reason, u32 K (runs), K × (u32 count, u8 kind, u32 index of the
    ///   reason). A glob or reason is a u32 length in bytes and UTF-8.
    /// - A scene whose alpha textures were read begins with `SLSCENE4`, and its masks follow the kinds. First
    ///   are u32 Q (masks) and Q × (u32 width, u32 height, 2 × u8 wrap mode, one bit per texel). Then follow
    ///   u32 P (runs), P × (u32 first triangle, u32 count, u32 index of the mask), and six f32 (texture
    ///   coordinates) per masked triangle.
    /// - A scene with sides, or with the locations of its objects in a glTF file (sources), begins with
    ///   `SLSCENE5` and u32 flags (1: with kinds, 2: with masks, 4: with sides, 8: with sources). Its sides
    ///   follow the objects: u32 R (runs) and R × (u32 count, u8 side). Its sources are at the end: M × (u32
    ///   node, u32 mesh, u32 primitive, u32 instance or 2³² − 1).
    pub fn to_blob(&self) -> Vec<u8> {
        let names: usize = self.objects.iter().map(|o| o.name.len() + 8).sum();
        let mut out = Vec::with_capacity(20 + self.triangles.len() * 36 + names);
        self.each_part(true, |part| out.extend_from_slice(part));
        out
    }

    /// Passes the canonical bytes to `take`, in pieces. If `with_sources` is false, the bytes do not contain
    /// the locations of objects in a glTF file.
    fn each_part(&self, with_sources: bool, mut take: impl FnMut(&[u8])) {
        let with_kinds = self.kinds != Kinds::opaque();
        let with_sources = with_sources && !self.sources.is_empty();
        let with_sides = !self.sides.are_both();
        let flagged = with_sources || with_sides;
        take(match with_kinds {
            _ if flagged => BLOB_MAGIC_FLAGS,
            true if self.kinds.alpha_textures => BLOB_MAGIC_MASKS,
            true => BLOB_MAGIC_KINDS,
            false => BLOB_MAGIC,
        });
        if flagged {
            let flags = [
                (with_kinds, HAS_KINDS),
                (with_kinds && self.kinds.alpha_textures, HAS_MASKS),
                (with_sides, HAS_SIDES),
                (with_sources, HAS_SOURCES),
            ];
            let flags = flags
                .iter()
                .filter(|(has, _)| *has)
                .fold(0, |all, (_, flag)| all | flag);
            take(&flags.to_le_bytes());
        }
        take(&self.len().to_le_bytes());
        take(&(self.objects.len() as u32).to_le_bytes());
        if cfg!(target_endian = "big") {
            let mut triangles = self.triangles.clone();
            swap_bytes(&mut triangles);
            take(bytemuck::cast_slice(&triangles));
        } else {
            take(bytemuck::cast_slice(&self.triangles));
        }
        for o in &self.objects {
            take(&o.count.to_le_bytes());
            take(&(o.name.len() as u32).to_le_bytes());
            take(o.name.as_bytes());
        }
        if !self.sides.are_both() {
            let mut bytes = Vec::new();
            sides::write(&self.sides, &mut bytes);
            take(&bytes);
        }
        if with_kinds {
            let mut bytes = Vec::new();
            kinds::write(&self.kinds, &mut bytes);
            take(&bytes);
        }
        if self.kinds.alpha_textures {
            masks::write(&self.masks, &mut take);
        }
        if with_sources {
            take(&sources::write(&self.sources));
        }
    }

    /// Reads a scene from canonical bytes. The function checks all counts before it allocates memory.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the bytes are not a canonical scene. `source` is the file name in the error.
    pub fn from_blob(source: &str, bytes: &[u8]) -> Result<Self, SceneError> {
        let bad = |element: &str, reason: &str| {
            SceneError::bad(
                source,
                element,
                reason,
                "upload the scene again with this version of the program",
            )
        };
        let u32_at = |at: usize| -> Option<u32> {
            let b = bytes.get(at..at.checked_add(4)?)?;
            Some(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        };
        let (flagged, flags) = match (bytes.first_chunk::<8>(), u32_at(8)) {
            (Some(BLOB_MAGIC), _) => (false, 0),
            (Some(BLOB_MAGIC_KINDS), _) => (false, HAS_KINDS),
            (Some(BLOB_MAGIC_MASKS), _) => (false, HAS_KINDS | HAS_MASKS),
            // The scene must have sides or sources, and masks require kinds.
            (Some(BLOB_MAGIC_FLAGS), Some(flags @ 4..16)) if flags & 3 != HAS_MASKS => {
                (true, flags)
            }
            _ => {
                return Err(bad(
                    "header",
                    "the bytes do not start with the header of a canonical scene",
                ));
            }
        };
        let head = if flagged { 12 } else { 8 };
        let (Some(n), Some(m)) = (u32_at(head), u32_at(head + 4)) else {
            return Err(bad("header", "the bytes end within the header"));
        };
        let head = head + 8;
        let body = (n as usize)
            .checked_mul(36)
            .and_then(|len| bytes.get(head..head.checked_add(len)?))
            .ok_or_else(|| {
                bad(
                    "triangles",
                    "the header counts more triangles than the bytes contain",
                )
            })?;
        let mut triangles = vec![Triangle::zeroed(); n as usize];
        bytemuck::cast_slice_mut(&mut triangles).copy_from_slice(body);
        if cfg!(target_endian = "big") {
            swap_bytes(&mut triangles);
        }
        let mut at = head + body.len();
        // Each object needs at least eight bytes, so the count is checked against the remaining bytes.
        if (m as usize) > (bytes.len() - at) / 8 {
            return Err(bad(
                "objects",
                "the header counts more objects than the bytes contain",
            ));
        }
        let mut objects = Vec::with_capacity(m as usize);
        let mut first = 0u32;
        for i in 0..m {
            let element = format!("object {i}");
            let (Some(count), Some(len)) = (u32_at(at), u32_at(at + 4)) else {
                return Err(bad(&element, "the bytes end within the object"));
            };
            at += 8;
            let name = bytes
                .get(at..at.saturating_add(len as usize))
                .and_then(|b| std::str::from_utf8(b).ok())
                .ok_or_else(|| bad(&element, "the name is cut short or not UTF-8"))?;
            at += len as usize;
            objects.push(Object {
                name: name.to_owned(),
                first,
                count,
            });
            first = first
                .checked_add(count)
                .filter(|f| *f <= n)
                .ok_or_else(|| {
                    bad(
                        &element,
                        "the objects together have more triangles than the scene",
                    )
                })?;
        }
        let has = |flag: u32| flags & flag != 0;
        let count = objects.len();
        let scene = Self::new(source, triangles, objects)?;
        let end = match has(HAS_SOURCES) {
            true => (bytes.len() - at)
                .checked_sub(sources::length(count))
                .map(|length| at + length),
            false => Some(bytes.len()),
        };
        let end = end.ok_or_else(|| {
            bad(
                "sources",
                "the number of glTF locations differs from the number of objects",
            )
        })?;
        let places = sources::read(&bytes[end..], if has(HAS_SOURCES) { count } else { 0 })
            .map_err(|why| bad("sources", why))?;
        let (sides, rest) = match has(HAS_SIDES) {
            true => sides::read(&bytes[at..end], n).map_err(|why| bad("sides", why))?,
            false => (Sides::both(), &bytes[at..end]),
        };
        let (kinds, rest) = match has(HAS_KINDS) {
            true => kinds::read(rest, n, has(HAS_MASKS)).map_err(|why| bad("kinds", why))?,
            false => (Kinds::opaque(), rest),
        };
        let (masks, rest) = match has(HAS_MASKS) {
            true => (masks::read(rest).map_err(|why| bad("masks", why))?, &[][..]),
            false => (Masks::none(), rest),
        };
        if !rest.is_empty() {
            return Err(bad("end", "further bytes follow the scene"));
        }
        let scene = scene
            .with_sources(source, places)?
            .with_sides(source, sides)?;
        scene.with_masks(source, kinds, masks)
    }

    /// Returns the BLAKE3 digest of [`Scene::to_blob`].
    pub fn digest(&self) -> SceneDigest {
        self.digest_of(true)
    }

    /// Returns the digest without the locations of objects in a glTF file. Results of program versions that
    /// did not store these locations contain this digest.
    pub fn digest_without_sources(&self) -> SceneDigest {
        self.digest_of(false)
    }

    fn digest_of(&self, with_sources: bool) -> SceneDigest {
        let mut hasher = blake3::Hasher::new();
        self.each_part(with_sources, |part| {
            hasher.update(part);
        });
        SceneDigest(*hasher.finalize().as_bytes())
    }
}

/// Reverses the bytes of each coordinate, for machines whose byte order is not little-endian.
fn swap_bytes(triangles: &mut [Triangle]) {
    for bits in bytemuck::cast_slice_mut::<_, u32>(triangles) {
        *bits = bits.swap_bytes();
    }
}
