//! The scene itself: triangles in id order, the objects they form, their bounds, and their canonical bytes.
//!
//! A scene is a triangle soup: each triangle has three vertices of its own, and there is no index buffer. So
//! ids, digests and samples do not depend on how a file shares its vertices, and no indirection is needed to
//! read triangles.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};
use sightline_numbers::{Aabb, MAX_COORDINATE};

use crate::SceneError;
use crate::kinds::{self, Kinds};
use crate::masks::{self, Masks};
use crate::sides::{self, Side, Sides};
use crate::sources::{self, Source};

/// A triangle: three vertices in world space, in the winding of the file. 36 bytes without padding.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Triangle {
    /// The vertices.
    pub v: [Vec3; 3],
}

impl Triangle {
    /// Returns true if the triangle has no area: two vertices equal, or all three on one line. Exact.
    ///
    /// Differences of `f32` coordinates are exact in `f64` only when their exponents are close, so
    /// [`sightline_geometry::predicates`] decides with expansion arithmetic when its filter cannot.
    pub fn is_degenerate(&self) -> bool {
        sightline_geometry::predicates::collinear(self.v[0], self.v[1], self.v[2])
    }

    /// The box around the three vertices.
    pub fn bounds(&self) -> Aabb {
        Aabb::around(self.v)
    }
}

/// A run of triangles that an engine draws together: a primitive of a glTF node, an OBJ group, or a whole PLY
/// file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// Its name in the file, made unique by the loader; invented where the file gives none.
    pub name: String,
    /// Id of its first triangle.
    pub first: u32,
    /// Number of its triangles; may be 0.
    pub count: u32,
}

/// BLAKE3 of a scene's canonical bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneDigest(pub [u8; 32]);

impl std::fmt::Display for SceneDigest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

/// A checked static scene. Every vertex is finite, there is at least one triangle, and the objects tile the
/// ids 0…N−1 in order without gaps.
#[derive(Clone, Debug)]
pub struct Scene {
    triangles: Vec<Triangle>,
    objects: Vec<Object>,
    bounds: Aabb,
    kinds: Kinds,
    masks: Masks,
    /// One for each object, or none.
    sources: Vec<Source>,
    sides: Sides,
}

/// First bytes of a canonical scene of opaque triangles: name and version of the encoding.
const BLOB_MAGIC: &[u8; 8] = b"SLSCENE1";
/// The same for a scene with kinds.
const BLOB_MAGIC_KINDS: &[u8; 8] = b"SLSCENE2";
/// The same for a scene with kinds whose alpha textures were read.
const BLOB_MAGIC_MASKS: &[u8; 8] = b"SLSCENE4";
/// The same for a scene with sides, or that says where its objects are in a glTF file. A u32 of flags
/// follows.
const BLOB_MAGIC_FLAGS: &[u8; 8] = b"SLSCENE5";
/// Flags of such a scene: it has kinds, its alpha textures were read, it has sides, it has sources.
const HAS_KINDS: u32 = 1;
const HAS_MASKS: u32 = 2;
const HAS_SIDES: u32 = 4;
const HAS_SOURCES: u32 = 8;
/// Longest object name kept in a scene, in bytes; longer names are refused by [`Scene::new`].
pub const MAX_NAME_BYTES: usize = 4096;

impl Scene {
    /// A scene of `triangles` (in id order) and `objects` (in order, tiling the ids).
    ///
    /// `file` names the source in errors.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when there is no triangle, more than `u32::MAX - 1` of them, a vertex that is not
    /// finite, or objects that do not tile the ids.
    pub fn new(
        file: &str,
        triangles: Vec<Triangle>,
        objects: Vec<Object>,
    ) -> Result<Self, SceneError> {
        if triangles.is_empty() {
            return Err(SceneError::bad(
                file,
                "scene",
                "it has no triangles",
                "export the meshes as triangles (lines and points are not visible surfaces)",
            ));
        }
        if triangles.len() >= u32::MAX as usize {
            return Err(SceneError::bad(
                file,
                "scene",
                format!("{} triangles are more than ids can number", triangles.len()),
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
                        format!("its position ({}, {}, {}) is not finite", v.x, v.y, v.z),
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
                    format!("it starts at triangle {} and not at {next}", o.first),
                    "objects must follow one another in id order",
                ));
            }
            if o.name.len() > MAX_NAME_BYTES {
                return Err(SceneError::bad(
                    file,
                    format!("object {i}"),
                    format!("its name is {} bytes long", o.name.len()),
                    format!("shorten it to at most {MAX_NAME_BYTES} bytes"),
                ));
            }
            next += u64::from(o.count);
        }
        if next != triangles.len() as u64 {
            return Err(SceneError::bad(
                file,
                "objects",
                format!("they name {next} triangles of {}", triangles.len()),
                "every triangle must belong to one object",
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

    /// Checks that all coordinates are within ±[`MAX_COORDINATE`]. Loaders and tracers call it; exact queries
    /// accept any finite scene.
    ///
    /// # Errors
    /// [`SceneError::Bad`] with the first triangle that reaches farther.
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
                "its position ({}, {}, {}) is beyond ±{MAX_COORDINATE:e}",
                v.x, v.y, v.z
            ),
            "remove the vertex if it is astray, or move or scale the scene, and export again",
        ))
    }

    /// The scene with the places of its objects in a glTF file, one for each, or none.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when there is another number of them.
    pub fn with_sources(self, file: &str, sources: Vec<Source>) -> Result<Self, SceneError> {
        sources::check(file, &sources, self.objects.len())?;
        Ok(Self { sources, ..self })
    }

    /// The places of the objects in their glTF file, in the order of the objects; empty for other files.
    pub fn sources(&self) -> &[Source] {
        &self.sources
    }

    /// The scene with other kinds of triangles.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when the kinds are those of another number of triangles, or when some are masked.
    pub fn with_kinds(self, file: &str, kinds: Kinds) -> Result<Self, SceneError> {
        self.with_masks(file, kinds, Masks::none())
    }

    /// The scene with other kinds of triangles, and the masks of the masked ones.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when the kinds are those of another number of triangles, or the masks are not
    /// those of the masked triangles.
    pub fn with_masks(self, file: &str, kinds: Kinds, masks: Masks) -> Result<Self, SceneError> {
        kinds.check(file, self.len())?;
        masks.check(file, &kinds)?;
        Ok(Self {
            kinds,
            masks,
            ..self
        })
    }

    /// The kinds of the triangles.
    pub fn kinds(&self) -> &Kinds {
        &self.kinds
    }

    /// The masks of the masked triangles.
    pub fn masks(&self) -> &Masks {
        &self.masks
    }

    /// Whether masked triangle `id` blocks the line from `origin` along `direction` where the line meets it.
    pub fn mask_blocks(&self, id: u32, origin: [f32; 3], direction: [f32; 3]) -> bool {
        self.masks
            .block(id, self.triangles[id as usize].v, origin, direction)
    }

    /// The scene with other sides of triangles.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when the sides are those of another number of triangles.
    pub fn with_sides(self, file: &str, sides: Sides) -> Result<Self, SceneError> {
        sides.check(file, self.len())?;
        Ok(Self { sides, ..self })
    }

    /// From which side each triangle is met.
    pub fn sides(&self) -> &Sides {
        &self.sides
    }

    /// The normal of triangle `id` towards its front, of any length; zero when it is met from both sides.
    ///
    /// Lines whose direction has a positive product with it meet the triangle from behind. The cross product
    /// of the edges e and f is rounded in `f64`, with an error of less than 2⁻⁵⁰ |e| |f|. So the sign can be
    /// wrong only for lines within an angle of 2⁻⁵⁰ |e| |f| / |e × f| of the plane, which meet the triangle
    /// edge-on: they are far fewer than those that single precision cannot tell from its border.
    pub fn front(&self, id: u32) -> DVec3 {
        let side = self.sides.side(id);
        if side == Side::Both {
            return DVec3::ZERO;
        }
        let [a, b, c] = self.triangles[id as usize].v.map(|v| v.as_dvec3());
        let normal = (b - a).cross(c - a);
        if side == Side::Clockwise {
            -normal
        } else {
            normal
        }
    }

    /// Whether triangle `id` ends all sight lines: it has an area, and its kind blocks.
    pub fn blocks(&self, id: u32) -> bool {
        self.kinds.kind(id).blocks() && !self.triangles[id as usize].is_degenerate()
    }

    /// Whether triangle `id` can be in a visibility set: it has an area, and its kind shows.
    pub fn shows(&self, id: u32) -> bool {
        self.kinds.kind(id).shows() && !self.triangles[id as usize].is_degenerate()
    }

    /// The triangles; index = id.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// The objects, in id order.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Number of triangles, N.
    pub fn len(&self) -> u32 {
        // `new` refuses scenes whose count does not fit.
        self.triangles.len() as u32
    }

    /// Always false: a scene has at least one triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The least box around all vertices.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// The canonical bytes, which are uploaded and digested. Little-endian: `SLSCENE1`, u32 N, u32 M, N × 9
    /// f32, then M × (u32 count, u32 name length, name UTF-8). A scene with kinds begins with `SLSCENE2`,
    /// and its kinds follow the objects: u32 R, R × (u8 kind, glob), u32 S, S × reason, u32 K, K × (u32
    /// count, u8 kind, u32 reason), a glob or reason as u32 length and UTF-8. A scene whose alpha textures
    /// were read begins with `SLSCENE4`, and its masks follow the kinds: u32 M, M × (u32 width, u32 height,
    /// 2 × u8 wrap, one bit a texel), u32 P, P × (u32 first, u32 count, u32 mask), then six f32 a masked
    /// triangle. A scene with sides, or that says where its objects are in a glTF file, begins with
    /// `SLSCENE5` and u32 flags (1: with kinds, 2: with masks, 4: with sides, 8: with sources). Its sides
    /// follow the objects: u32 R and R × (u32 count, u8 side). Its sources end it: M × (u32 node, u32 mesh,
    /// u32 primitive, u32 instance or 2³² − 1).
    pub fn to_blob(&self) -> Vec<u8> {
        let names: usize = self.objects.iter().map(|o| o.name.len() + 8).sum();
        let mut out = Vec::with_capacity(20 + self.triangles.len() * 36 + names);
        self.each_part(true, |part| out.extend_from_slice(part));
        out
    }

    /// The canonical bytes, in parts.
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

    /// Reads canonical bytes. Counts are checked before memory is allocated for them.
    ///
    /// # Errors
    /// [`SceneError::Bad`] naming `source` when the bytes are not a canonical scene.
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
            // Sides or sources are there, and masks only with kinds.
            (Some(BLOB_MAGIC_FLAGS), Some(flags @ 4..16)) if flags & 3 != HAS_MASKS => {
                (true, flags)
            }
            _ => return Err(bad("header", "it is not a canonical scene")),
        };
        let head = if flagged { 12 } else { 8 };
        let (Some(n), Some(m)) = (u32_at(head), u32_at(head + 4)) else {
            return Err(bad("header", "it is cut short"));
        };
        let head = head + 8;
        let body = (n as usize)
            .checked_mul(36)
            .and_then(|len| bytes.get(head..head.checked_add(len)?))
            .ok_or_else(|| bad("triangles", "the header counts more than there are"))?;
        let mut triangles = vec![Triangle::zeroed(); n as usize];
        bytemuck::cast_slice_mut(&mut triangles).copy_from_slice(body);
        if cfg!(target_endian = "big") {
            swap_bytes(&mut triangles);
        }
        let mut at = head + body.len();
        // Each object takes at least eight bytes, so the count is checked against what is left.
        if (m as usize) > (bytes.len() - at) / 8 {
            return Err(bad("objects", "the header counts more than there are"));
        }
        let mut objects = Vec::with_capacity(m as usize);
        let mut first = 0u32;
        for i in 0..m {
            let element = format!("object {i}");
            let (Some(count), Some(len)) = (u32_at(at), u32_at(at + 4)) else {
                return Err(bad(&element, "it is cut short"));
            };
            at += 8;
            let name = bytes
                .get(at..at.saturating_add(len as usize))
                .and_then(|b| std::str::from_utf8(b).ok())
                .ok_or_else(|| bad(&element, "its name is cut short or not UTF-8"))?;
            at += len as usize;
            objects.push(Object {
                name: name.to_owned(),
                first,
                count,
            });
            first = first
                .checked_add(count)
                .filter(|f| *f <= n)
                .ok_or_else(|| bad(&element, "it names more triangles than there are"))?;
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
        let end = end.ok_or_else(|| bad("sources", "there is not one source for each object"))?;
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
            return Err(bad("end", "there are bytes after the scene"));
        }
        let scene = scene
            .with_sources(source, places)?
            .with_sides(source, sides)?;
        scene.with_masks(source, kinds, masks)
    }

    /// BLAKE3 of [`Scene::to_blob`].
    pub fn digest(&self) -> SceneDigest {
        self.digest_of(true)
    }

    /// The digest that versions of the program had which did not keep where objects are in a glTF file.
    /// Results of these versions name it.
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

/// Turns coordinates from this machine's byte order into the file's, or back, where the two differ.
fn swap_bytes(triangles: &mut [Triangle]) {
    for bits in bytemuck::cast_slice_mut::<_, u32>(triangles) {
        *bits = bits.swap_bytes();
    }
}
