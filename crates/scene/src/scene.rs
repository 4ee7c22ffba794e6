//! The scene itself: triangles in id order, the objects they form, their bounds, and their canonical bytes.
//!
//! A scene is a triangle soup: each triangle has three vertices of its own, and there is no index buffer. So
//! ids, digests and samples do not depend on how a file shares its vertices, and no indirection is needed to
//! read triangles.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use sightline_numbers::Aabb;

use crate::SceneError;
use crate::kinds::{self, Kinds};

/// A triangle: three vertices in world space, in the winding of the file. 36 bytes without padding.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Triangle {
    /// The vertices.
    pub v: [Vec3; 3],
}

impl Triangle {
    /// Whether the triangle has no area: two vertices equal, or all three on one line, decided exactly.
    ///
    /// Differences of `f32` coordinates are exact in `f64` only when their exponents are close, so
    /// [`crate::exact`] decides with expansion arithmetic when its filter cannot.
    pub fn is_degenerate(&self) -> bool {
        crate::exact::collinear(self.v[0], self.v[1], self.v[2])
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
}

/// First bytes of a canonical scene of opaque triangles: name and version of the encoding.
const BLOB_MAGIC: &[u8; 8] = b"SLSCENE1";
/// The same for a scene with kinds.
const BLOB_MAGIC_KINDS: &[u8; 8] = b"SLSCENE2";
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
    pub fn new(file: &str, triangles: Vec<Triangle>, objects: Vec<Object>) -> Result<Self, SceneError> {
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
        Ok(Self { triangles, objects, bounds, kinds: Kinds::opaque() })
    }

    /// The scene with other kinds of triangles.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when the kinds are those of another number of triangles.
    pub fn with_kinds(self, file: &str, kinds: Kinds) -> Result<Self, SceneError> {
        kinds.check(file, self.len())?;
        Ok(Self { kinds, ..self })
    }

    /// The kinds of the triangles.
    pub fn kinds(&self) -> &Kinds {
        &self.kinds
    }

    /// Whether triangle `id` ends sight lines: it has an area, and its kind blocks.
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

    /// The canonical bytes, which are uploaded and digested. Little-endian:
    /// `SLSCENE1`, u32 N, u32 M, N × 9 f32, then M × (u32 count, u32 name length, name UTF-8). A scene with
    /// kinds begins with `SLSCENE2`, and its kinds follow the objects: u32 R, R × (u8 kind, glob), u32 S,
    /// S × reason, u32 K, K × (u32 count, u8 kind, u32 reason), a glob or reason as u32 length and UTF-8.
    pub fn to_blob(&self) -> Vec<u8> {
        let names: usize = self.objects.iter().map(|o| o.name.len() + 8).sum();
        let mut out = Vec::with_capacity(16 + self.triangles.len() * 36 + names);
        self.each_part(|part| out.extend_from_slice(part));
        out
    }

    /// The canonical bytes, in parts.
    fn each_part(&self, mut take: impl FnMut(&[u8])) {
        let with_kinds = self.kinds != Kinds::opaque();
        take(if with_kinds { BLOB_MAGIC_KINDS } else { BLOB_MAGIC });
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
        if with_kinds {
            let mut bytes = Vec::new();
            kinds::write(&self.kinds, &mut bytes);
            take(&bytes);
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
        let with_kinds = match bytes.first_chunk::<8>() {
            Some(BLOB_MAGIC) => false,
            Some(BLOB_MAGIC_KINDS) => true,
            _ => return Err(bad("header", "it is not a canonical scene")),
        };
        let (Some(n), Some(m)) = (u32_at(8), u32_at(12)) else {
            return Err(bad("header", "it is cut short"));
        };
        let body = (n as usize)
            .checked_mul(36)
            .and_then(|len| bytes.get(16..16usize.checked_add(len)?))
            .ok_or_else(|| bad("triangles", "the header counts more than there are"))?;
        let mut triangles = vec![Triangle::zeroed(); n as usize];
        bytemuck::cast_slice_mut(&mut triangles).copy_from_slice(body);
        if cfg!(target_endian = "big") {
            swap_bytes(&mut triangles);
        }
        let mut at = 16 + body.len();
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
            objects.push(Object { name: name.to_owned(), first, count });
            first = first
                .checked_add(count)
                .filter(|f| *f <= n)
                .ok_or_else(|| bad(&element, "it names more triangles than there are"))?;
        }
        let rest = &bytes[at..];
        if with_kinds {
            let kinds = kinds::read(rest, n).map_err(|why| bad("kinds", why))?;
            return Self::new(source, triangles, objects)?.with_kinds(source, kinds);
        }
        if !rest.is_empty() {
            return Err(bad("end", "there are bytes after the last object"));
        }
        Self::new(source, triangles, objects)
    }

    /// BLAKE3 of [`Scene::to_blob`].
    pub fn digest(&self) -> SceneDigest {
        let mut hasher = blake3::Hasher::new();
        self.each_part(|part| {
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
