//! Material libraries of OBJ files (.mtl), which determine the see-through materials.
//!
//! `d` below 1, `Tr` above 0 (without a `d`), a `map_d`, or one of the illumination models with transparency
//! (4, 6, 7 and 9) makes a material see-through. All other statements are skipped.

use std::collections::BTreeMap;
use std::path::{Component, Path};

use super::limits::read_file;
use super::marks::{Mark, Marks};
use crate::kinds::SurfaceKind;

/// Maximum size of a library in bytes.
const MOST_BYTES: u64 = 64 << 20;

/// The materials of the libraries read so far, by name.
#[derive(Default)]
pub(super) struct Materials {
    marks: BTreeMap<Vec<u8>, Mark>,
    /// True if any library was read.
    pub(super) any: bool,
}

impl Materials {
    /// Returns the kind of a material and the reason for it, or `None` if no library contains the material.
    pub(super) fn get(&self, name: &[u8]) -> Option<&Mark> {
        self.marks.get(name)
    }

    /// Reads the libraries that a `mtllib` statement names. For a missing library, adds a warning with the
    /// name of the library to `marks`.
    pub(super) fn read(&mut self, base_dir: Option<&Path>, names: &[u8], marks: &mut Marks) {
        let text = String::from_utf8_lossy(names);
        // A name may contain spaces, although the format separates several names by spaces.
        let whole = base_dir.is_some_and(|dir| below(&text).is_some_and(|n| dir.join(n).is_file()));
        let each: Vec<&str> = if whole {
            vec![&text]
        } else {
            text.split_ascii_whitespace().collect()
        };
        for name in each {
            let shown: String = name.chars().take(200).collect();
            let missing = |marks: &mut Marks, why: &str| {
                marks.warn(format!(
                    "the material library {shown:?} {why}; its materials count as opaque"
                ));
            };
            let Some(dir) = base_dir else {
                missing(marks, "is not read, because the scene is not a file");
                continue;
            };
            let Some(relative) = below(name) else {
                missing(
                    marks,
                    "is not read, because its path leads outside of the scene's folder",
                );
                continue;
            };
            match read_file(&dir.join(relative), MOST_BYTES + 1) {
                Ok(bytes) if bytes.len() as u64 > MOST_BYTES => {
                    missing(marks, "is larger than 64 MiB")
                }
                Ok(bytes) => {
                    self.any = true;
                    self.parse(&bytes);
                }
                Err(_) => missing(marks, "is missing or cannot be read"),
            }
        }
    }

    fn parse(&mut self, bytes: &[u8]) {
        let mut current: Option<MtlMaterial> = None;
        for line in bytes.split(|b| matches!(b, b'\n' | b'\r')) {
            let line = line
                .split(|b| *b == b'#')
                .next()
                .unwrap_or_default()
                .trim_ascii();
            let at = line
                .iter()
                .position(u8::is_ascii_whitespace)
                .unwrap_or(line.len());
            let (word, rest) = (&line[..at], line[at..].trim_ascii());
            if word == b"newmtl" {
                self.keep(current.replace(MtlMaterial {
                    name: rest.to_vec(),
                    ..MtlMaterial::default()
                }));
                continue;
            }
            let Some(material) = &mut current else {
                continue;
            };
            let last = rest
                .rsplit(u8::is_ascii_whitespace)
                .next()
                .unwrap_or_default();
            let number = || std::str::from_utf8(last).ok()?.parse::<f64>().ok();
            match word {
                b"d" => material.dissolve = number(),
                b"Tr" => material.transparency = number(),
                b"map_d" => material.map = true,
                b"illum" => material.model = number(),
                _ => {}
            }
        }
        self.keep(current);
    }

    fn keep(&mut self, material: Option<MtlMaterial>) {
        if let Some(m) = material {
            let mark = m.mark();
            self.marks.insert(m.name, mark);
        }
    }
}

/// The statements of a material that determine its kind.
#[derive(Default)]
struct MtlMaterial {
    name: Vec<u8>,
    dissolve: Option<f64>,
    transparency: Option<f64>,
    map: bool,
    model: Option<f64>,
}

impl MtlMaterial {
    fn mark(&self) -> Mark {
        let reason = match (self.dissolve, self.transparency) {
            (Some(d), _) if d < 1.0 => Some("d"),
            // Exporters disagree on the meaning of Tr 1. An exporter that also writes d is unambiguous.
            (None, Some(t)) if t > 0.0 => Some("Tr"),
            _ if self.map => Some("map_d"),
            _ if self
                .model
                .is_some_and(|m| [4.0, 6.0, 7.0, 9.0].contains(&m)) =>
            {
                Some("illum")
            }
            _ => None,
        };
        reason.map_or(Mark::DEFAULT, |r| Mark::new(SurfaceKind::SeeThrough, r))
    }
}

/// Returns `name` as a path relative to the scene's folder, or `None` if the path leads outside of the
/// folder.
fn below(name: &str) -> Option<&Path> {
    let path = Path::new(name);
    let inside = path
        .components()
        .all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    (inside && !name.is_empty()).then_some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_of_material_determine_kind() {
        let text = "newmtl a\nKd 1 1 1\nd 0.5\nnewmtl b\nTr 0.3\nnewmtl c\nd 1.0\nTr 1.0\nillum 2\n\
                    newmtl d d\nmap_d -clamp on leaf.png\r\nnewmtl e\nillum 4 # glass\nnewmtl f\n\
                    d -halo 0.2\nnewmtl g\nd wrong\n";
        let mut m = Materials::default();
        m.parse(text.as_bytes());
        let reason = |name: &str| {
            m.get(name.as_bytes())
                .map(|k| (k.kind, k.reason.to_string()))
        };
        let glass = |why: &str| Some((SurfaceKind::SeeThrough, why.to_owned()));
        assert_eq!(reason("a"), glass("d"));
        assert_eq!(reason("b"), glass("Tr"));
        assert_eq!(reason("c").unwrap().0, SurfaceKind::Opaque);
        assert_eq!(reason("d d"), glass("map_d"));
        assert_eq!(reason("e"), glass("illum"));
        assert_eq!(reason("f"), glass("d"));
        assert_eq!(reason("g").unwrap().0, SurfaceKind::Opaque);
        assert_eq!(reason("h"), None);
    }
}
