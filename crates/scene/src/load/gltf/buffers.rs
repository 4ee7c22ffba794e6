//! The bytes of the buffers and buffer views that the geometry needs: from the file itself, data URIs or
//! separate files.
//!
//! Only buffers that a drawn primitive uses are read. Images are read only if masks need them, so a missing
//! texture does not prevent other bakes. URIs must stay below the directory of the scene, and the loader
//! never uses a network.

use std::borrow::Cow;
use std::path::{Component, Path, PathBuf};

use base64::Engine;

use super::kinds::Material;
use super::nodes::PlacedMesh;
use super::source::GltfContext;
use super::{json, meshopt, uses};
use crate::SceneError;
use crate::load::limits::{LoadLimits, read_file};

/// The number of bytes to which the compressed views may unpack together, regardless of the size of the file.
const FREE_BYTES: u64 = 64 << 20;
/// The number of additional bytes to which the compressed views may unpack, per byte of the file. Indices
/// unpack to at most twelve times their size. Vertex data unpack to less, unless most vertices are equal.
const MAX_DENSITY: u64 = 32;

/// The buffers and the decoded views that the geometry needs. All other entries are `None`.
pub(super) struct Buffers<'a> {
    data: Vec<Option<Cow<'a, [u8]>>>,
    decoded: Vec<Option<Vec<u8>>>,
    /// The number of bytes of the document and all read buffers, which limits the size of accessors without a
    /// buffer view.
    size: u64,
}

impl<'a> Buffers<'a> {
    /// Reads the buffers that `draws` and the buffer views `images` need. `binary` is the BIN chunk of a GLB,
    /// which is buffer 0 if that buffer has no URI.
    pub(super) fn read(
        source: &GltfContext<'_>,
        root: &json::Root,
        text: &[u8],
        binary: Option<&'a [u8]>,
        draws: &[PlacedMesh],
        materials: &[Material],
        images: &[usize],
    ) -> Result<Self, SceneError> {
        let mut wanted = vec![false; root.buffer_views.len()];
        let used = uses::uses(source, root, draws, materials)?;
        for a in used.iter().map(|u| u.accessor) {
            let accessor = &root.accessors[a];
            let sparse = accessor.sparse.as_ref();
            let views = [
                accessor.buffer_view,
                sparse.map(|s| s.indices.buffer_view),
                sparse.map(|s| s.values.buffer_view),
            ];
            for v in views.into_iter().flatten() {
                match wanted.get_mut(v) {
                    Some(w) => *w = true,
                    None => {
                        let reason = format!(
                            "the accessor refers to buffer view {v}, but the file has {} buffer views",
                            wanted.len()
                        );
                        return Err(source.bad(format!("accessor {a}"), reason));
                    }
                }
            }
        }
        for mesh in used.iter().filter_map(|u| u.by.mesh()) {
            let compressed = root.meshes[mesh].primitives.iter().enumerate();
            for (p, draco) in compressed.filter_map(|(p, primitive)| Some((p, primitive.draco()?)))
            {
                let views = wanted.len();
                *wanted.get_mut(draco.buffer_view).ok_or_else(|| {
                    let by = uses::AccessorUser::Primitive { mesh, primitive: p };
                    let reason = format!(
                        "the extension refers to buffer view {}, but the file has {views} buffer views",
                        draco.buffer_view
                    );
                    source.bad(format!("{by}, KHR_draco_mesh_compression"), reason)
                })? = true;
            }
        }
        // The code that reads an image reports a missing view.
        for view in images {
            if let Some(w) = wanted.get_mut(*view) {
                *w = true;
            }
        }
        let mut this = Self {
            data: root.buffers.iter().map(|_| None).collect(),
            decoded: root.buffer_views.iter().map(|_| None).collect(),
            size: text.len() as u64,
        };
        let mut unpacked: u64 = 0;
        for v in (0..wanted.len()).filter(|v| wanted[*v]) {
            let view = &root.buffer_views[v];
            let packed = view.meshopt();
            let buffer = packed.map_or(view.buffer, |(_, m)| m.buffer);
            let Some(b) = root.buffers.get(buffer) else {
                let reason = format!(
                    "the buffer view refers to buffer {buffer}, but the file has {} buffers",
                    root.buffers.len()
                );
                return Err(source.bad(format!("buffer view {v}"), reason));
            };
            if this.data[buffer].is_none() {
                let bytes = one_buffer(source, buffer, b, binary)?;
                this.size += bytes.len() as u64;
                this.data[buffer] = Some(bytes);
            }
            if let Some((extension, m)) = packed {
                let bad = |why| source.bad(format!("buffer view {v}, {extension}"), why);
                let bytes = this.range(source, v, buffer, m.byte_offset, m.byte_length)?;
                unpacked = unpacked.saturating_add(m.count.saturating_mul(m.byte_stride));
                // Several views may refer to the same bytes, so the size of the file does not limit the
                // total.
                let most = FREE_BYTES + MAX_DENSITY * this.size;
                if unpacked > most {
                    return Err(bad(format!(
                        "the compressed views up to this view unpack to {unpacked} bytes, but the limit for \
                         a file of {} bytes is {most}",
                        this.size
                    )));
                }
                let decoded = meshopt::decode(m, bytes).map_err(bad)?;
                this.decoded[v] = Some(decoded);
            }
        }
        Ok(this)
    }

    /// Returns the bytes of view `v`, which must be one of the needed views.
    pub(super) fn view(
        &self,
        source: &GltfContext<'_>,
        root: &json::Root,
        v: usize,
    ) -> Result<&[u8], SceneError> {
        let Some(view) = root.buffer_views.get(v) else {
            return Err(source.bad(
                format!("buffer view {v}"),
                "the file has no buffer view with this index",
            ));
        };
        match &self.decoded[v] {
            Some(bytes) => Ok(bytes),
            None => self.range(source, v, view.buffer, view.byte_offset, view.byte_length),
        }
    }

    /// Returns the number of bytes of the document and all read buffers.
    pub(super) fn size(&self) -> u64 {
        self.size
    }

    fn range(
        &self,
        source: &GltfContext<'_>,
        v: usize,
        buffer: usize,
        offset: u64,
        length: u64,
    ) -> Result<&[u8], SceneError> {
        let bytes = self
            .data
            .get(buffer)
            .and_then(|b| b.as_deref())
            .unwrap_or_default();
        let end = offset
            .checked_add(length)
            .filter(|e| *e <= bytes.len() as u64);
        match end {
            // Both numbers are at most the length of a slice.
            Some(end) => Ok(&bytes[offset as usize..end as usize]),
            None => Err(source.bad(
                format!("buffer view {v}"),
                format!(
                    "{length} bytes from offset {offset} reach beyond buffer {buffer} of {} bytes",
                    bytes.len()
                ),
            )),
        }
    }
}

/// Returns the bytes of buffer `number`, cut to the length that the buffer announces.
fn one_buffer<'a>(
    source: &GltfContext<'_>,
    number: usize,
    buffer: &json::Buffer,
    binary: Option<&'a [u8]>,
) -> Result<Cow<'a, [u8]>, SceneError> {
    let element = format!("buffer {number}");
    let bytes: Cow<'a, [u8]> = match &buffer.uri {
        None => match binary {
            Some(b) if number == 0 => Cow::Borrowed(b),
            _ => {
                return Err(source.bad(
                    element,
                    "the buffer has no uri and is not the binary chunk of a GLB",
                ));
            }
        },
        Some(uri) => match uri.strip_prefix("data:") {
            Some(data) => {
                Cow::Owned(decode_data(data).map_err(|why| source.bad(element.as_str(), why))?)
            }
            None => Cow::Owned(beside(source, &element, uri, buffer.byte_length)?),
        },
    };
    let have = bytes.len() as u64;
    if have < buffer.byte_length {
        let reason = format!(
            "the buffer announces {} bytes, but only {have} bytes exist (truncated?)",
            buffer.byte_length
        );
        return Err(source.bad(element, reason));
    }
    let wanted = buffer.byte_length as usize;
    Ok(match bytes {
        Cow::Borrowed(b) => Cow::Borrowed(&b[..wanted]),
        Cow::Owned(mut b) => {
            b.truncate(wanted);
            Cow::Owned(b)
        }
    })
}

/// Reads the bytes of a URI of a glTF file: a data URI, or at most `limit` bytes of a file below `base_dir`.
/// `file` and `element` appear in errors.
///
/// # Errors
/// [`SceneError::Bad`] if the URI is neither a data URI nor a path below `base_dir`, or if its data cannot be
/// read.
pub fn uri_bytes(
    file: &str,
    element: &str,
    uri: &str,
    base_dir: Option<&Path>,
    limit: u64,
) -> Result<Vec<u8>, SceneError> {
    let limits = LoadLimits::default();
    let source = GltfContext {
        file,
        base_dir,
        limits: &limits,
        alpha_textures: false,
    };
    match uri.strip_prefix("data:") {
        Some(data) => decode_data(data).map_err(|why| source.bad(element, why)),
        None => beside(&source, element, uri, limit),
    }
}

/// Decodes the bytes of a data URI, after `data:`.
pub(super) fn decode_data(rest: &str) -> Result<Vec<u8>, String> {
    let Some((head, data)) = rest.split_once(',') else {
        return Err("the data URI has no comma".to_owned());
    };
    if !head.ends_with(";base64") {
        return Err("the data URI is not base64".to_owned());
    }
    // Some exporters omit the padding.
    base64::engine::GeneralPurpose::new(
        &base64::alphabet::STANDARD,
        base64::engine::GeneralPurposeConfig::new()
            .with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
    )
    .decode(data)
    .map_err(|e| format!("the base64 of the data URI cannot be decoded: {e}"))
}

/// Reads at most `limit` bytes of the file to which `uri` refers, relative to the folder of the scene.
pub(super) fn beside(
    source: &GltfContext<'_>,
    element: &str,
    uri: &str,
    limit: u64,
) -> Result<Vec<u8>, SceneError> {
    let shown: String = uri.chars().take(80).collect();
    let refuse =
        |reason: String, remedy: &str| SceneError::bad(source.file, element, reason, remedy);
    let Some(path) = relative_path(uri) else {
        return Err(refuse(
            format!("the uri \"{shown}\" is not a plain path below the directory of the scene"),
            "put the file next to the scene, or export as GLB",
        ));
    };
    let Some(base) = source.base_dir else {
        return Err(refuse(
            format!(
                "the uri \"{shown}\" refers to another file, but the scene was not loaded from a \
                 directory"
            ),
            "export as GLB, which contains everything in one file",
        ));
    };
    read_file(&base.join(path), limit).map_err(|e| match e {
        SceneError::Io { path, source: why } => refuse(
            format!("{} cannot be read: {why}", path.display()),
            "put the file next to the scene, or export as GLB",
        ),
        other => other,
    })
}

/// Converts a percent-encoded relative URI to a path below the folder of the scene. Returns `None` for any
/// other URI.
fn relative_path(uri: &str) -> Option<PathBuf> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&b, tail)) = rest.split_first() {
        rest = tail;
        if b == b'%' {
            let hex = std::str::from_utf8(tail.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(hex, 16).ok()?);
            rest = &tail[2..];
        } else {
            bytes.push(b);
        }
    }
    let text = String::from_utf8(bytes).ok()?;
    // A colon marks a scheme or a drive, and a backslash is a separator on some systems only.
    if text.is_empty() || text.contains([':', '\\', '\0']) {
        return None;
    }
    let path = Path::new(&text);
    let plain = path
        .components()
        .all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    plain.then(|| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_below_the_scene() {
        assert_eq!(
            relative_path("a%20b/c.bin"),
            Some(PathBuf::from("a b/c.bin"))
        );
        assert_eq!(relative_path("./c.bin"), Some(PathBuf::from("./c.bin")));
        for bad in [
            "",
            "/etc/passwd",
            "../c.bin",
            "a/../../c",
            "%2e%2e/c",
            "%2Fetc",
            "http://x/c",
            "C:c",
            "a\\c",
            "%zz",
            "%0",
            "a%00",
        ] {
            assert_eq!(relative_path(bad), None, "{bad}");
        }
    }
}
