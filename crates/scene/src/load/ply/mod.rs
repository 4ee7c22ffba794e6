//! Stanford PLY, ascii and binary of either byte order: the elements `vertex` (x, y, z) and `face`
//! (`vertex_indices`).
//!
//! An n-gon becomes the fan (v0, vi, vi+1), and the whole file is one object. Other elements and properties
//! are skipped. Triangle strips (`tristrips`) are not read. This parser converts the bytes to triangles
//! directly, so its memory is proportional to the mesh regardless of the counts in the header. Its errors
//! name the element and the property.

use glam::Vec3;
use sightline_formats::ply::{Ascii, Binary, Element, Format, Header, Property, Values, read};

use super::limits::{EXPORT_AGAIN, LoadLimits, REPAIR_VERTEX, too_many_triangles};
use super::marks::{Mark, Marks};
use crate::{Object, Scene, SceneError, Triangle};

/// Returns true if bytes begin as a PLY file does.
pub(super) fn has_signature(bytes: &[u8]) -> bool {
    bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") || bytes == b"ply"
}

/// Reads a PLY file.
pub(super) fn parse(
    file: &str,
    bytes: &[u8],
    limits: &LoadLimits,
    marks: &mut Marks,
) -> Result<Scene, SceneError> {
    let header = read(bytes).map_err(|fault| {
        let element = format!("header line {}", fault.line);
        SceneError::bad(file, element, fault.reason, EXPORT_AGAIN)
    })?;
    let body = &bytes[header.body..];
    let mut r = PlyReader {
        file,
        limits,
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    match header.format {
        Format::Ascii => r.elements(&header, Ascii::new(body, header.lines))?,
        Format::BinaryLittle => r.elements(&header, Binary::new(body, false))?,
        Format::BinaryBig => r.elements(&header, Binary::new(body, true))?,
    }
    // The number of triangles is at most `limits.triangles`, a u32.
    let whole = Object {
        name: "mesh".to_owned(),
        first: 0,
        count: r.triangles.len() as u32,
    };
    marks.push(whole.count, &[whole.name.as_str()], &Mark::DEFAULT);
    Scene::new(file, r.triangles, vec![whole])
}

/// The state of the PLY reader.
struct PlyReader<'a> {
    file: &'a str,
    limits: &'a LoadLimits,
    vertices: Vec<Vec3>,
    triangles: Vec<Triangle>,
}

impl PlyReader<'_> {
    fn bad(&self, at: &str, reason: impl Into<String>, remedy: &str) -> SceneError {
        SceneError::bad(self.file, at, reason, remedy)
    }

    fn elements<V: Values>(&mut self, header: &Header, mut values: V) -> Result<(), SceneError> {
        let mut have_vertices = false;
        for e in &header.elements {
            if e.properties.is_empty() {
                continue;
            }
            // Each record of an element has a known minimum number of bytes, so check the count before
            // reading the records.
            let least: u64 = e.properties.iter().map(|p| values.least_bytes(p)).sum();
            if e.count
                .checked_mul(least)
                .is_none_or(|n| n > values.left() as u64 + 1)
            {
                let reason = format!(
                    "the header announces {} records, more than the remaining {} bytes can contain",
                    e.count,
                    values.left()
                );
                return Err(self.bad(&format!("element {}", e.name), reason, EXPORT_AGAIN));
            }
            match e.name.as_str() {
                "vertex" => {
                    self.read_vertices(e, &mut values)?;
                    have_vertices = true;
                }
                "face" if !have_vertices => {
                    return Err(self.bad(
                        "header",
                        "the element face precedes the element vertex",
                        "export the file with its vertices first",
                    ));
                }
                "face" => self.read_faces(e, &mut values)?,
                _ => {
                    for i in 0..e.count {
                        for p in &e.properties {
                            self.skip(e, i, p, &mut values)?;
                        }
                    }
                }
            }
        }
        if !header.elements.iter().any(|e| e.name == "face") {
            return Err(self.bad(
                "header",
                "the header has no face element, so the file has no triangles",
                "export a mesh with faces, not a point cloud or strips",
            ));
        }
        if values.has_rest() {
            let reason = format!(
                "{} bytes follow the last element of the header",
                values.left()
            );
            return Err(self.bad("end", reason, EXPORT_AGAIN));
        }
        Ok(())
    }

    /// Creates the error for property `p` of record `i` whose value is missing or not a number.
    fn unreadable<V: Values>(&self, e: &Element, i: u64, p: &Property, values: &V) -> SceneError {
        let at = format!("{} {i}, property {}", e.name, p.name);
        self.bad(&at, values.why(), EXPORT_AGAIN)
    }

    /// Reads the length of the next list, and checks that the rest of the file can contain the list. Returns
    /// 1 for a property that is a single number.
    fn list_len<V: Values>(
        &self,
        e: &Element,
        i: u64,
        p: &Property,
        values: &mut V,
    ) -> Result<usize, SceneError> {
        let Some(count) = p.list else { return Ok(1) };
        let n = values
            .integer(count)
            .ok_or_else(|| self.unreadable(e, i, p, values))?;
        let fits = u64::try_from(n).ok().filter(|n| {
            n.checked_mul(values.least_value_bytes(p.kind))
                .is_some_and(|b| b <= values.left() as u64 + 1)
        });
        match fits {
            // The number is at most the number of remaining bytes, so it fits a usize.
            Some(n) => Ok(n as usize),
            None => {
                let at = format!("{} {i}, property {}", e.name, p.name);
                let reason = format!(
                    "the list has {n} values, but only {} bytes follow",
                    values.left()
                );
                Err(self.bad(&at, reason, EXPORT_AGAIN))
            }
        }
    }

    fn skip<V: Values>(
        &self,
        e: &Element,
        i: u64,
        p: &Property,
        values: &mut V,
    ) -> Result<(), SceneError> {
        let n = self.list_len(e, i, p, values)?;
        values
            .skip(p.kind, n)
            .ok_or_else(|| self.unreadable(e, i, p, values))
    }

    fn read_vertices<V: Values>(&mut self, e: &Element, values: &mut V) -> Result<(), SceneError> {
        for axis in ["x", "y", "z"] {
            if e.properties
                .iter()
                .filter(|p| p.name == axis && p.list.is_none())
                .count()
                != 1
            {
                let reason = format!("a vertex must have one property {axis} that is a number");
                return Err(self.bad("element vertex", reason, EXPORT_AGAIN));
            }
        }
        for i in 0..e.count {
            let mut position = [0.0f32; 3];
            for p in &e.properties {
                let axis = match (p.name.as_str(), p.list) {
                    ("x", None) => 0,
                    ("y", None) => 1,
                    ("z", None) => 2,
                    _ => {
                        self.skip(e, i, p, values)?;
                        continue;
                    }
                };
                position[axis] = values
                    .float(p.kind)
                    .ok_or_else(|| self.unreadable(e, i, p, values))?;
            }
            let v = Vec3::from_array(position);
            if !v.is_finite() {
                let reason = format!("the position ({}, {}, {}) is not finite", v.x, v.y, v.z);
                return Err(self.bad(&format!("vertex {i}"), reason, REPAIR_VERTEX));
            }
            self.vertices.push(v);
        }
        Ok(())
    }

    fn read_faces<V: Values>(&mut self, e: &Element, values: &mut V) -> Result<(), SceneError> {
        let is_indices = |p: &Property| {
            p.list.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index")
        };
        match e.properties.iter().filter(|p| is_indices(p)).count() {
            1 => {}
            n => {
                let reason =
                    format!("the element has {n} lists named vertex_indices, but must have one");
                return Err(self.bad("element face", reason, EXPORT_AGAIN));
            }
        }
        for i in 0..e.count {
            for p in &e.properties {
                if is_indices(p) {
                    self.read_face(e, i, p, values)?
                } else {
                    self.skip(e, i, p, values)?
                }
            }
        }
        Ok(())
    }

    fn read_face<V: Values>(
        &mut self,
        e: &Element,
        i: u64,
        p: &Property,
        values: &mut V,
    ) -> Result<(), SceneError> {
        let n = self.list_len(e, i, p, values)?;
        if n < 3 {
            let reason = format!("the face has {n} corners");
            let remedy = "remove faces of fewer than three corners and export again";
            return Err(self.bad(&format!("face {i}"), reason, remedy));
        }
        if n - 2 > self.limits.triangles as usize - self.triangles.len() {
            return Err(too_many_triangles(
                self.file,
                format!("face {i}"),
                self.limits,
            ));
        }
        let first = self.corner(e, i, p, values)?;
        let mut last = self.corner(e, i, p, values)?;
        for _ in 2..n {
            let next = self.corner(e, i, p, values)?;
            self.triangles.push(Triangle {
                v: [first, last, next],
            });
            last = next;
        }
        Ok(())
    }

    fn corner<V: Values>(
        &self,
        e: &Element,
        i: u64,
        p: &Property,
        values: &mut V,
    ) -> Result<Vec3, SceneError> {
        let index = values
            .integer(p.kind)
            .ok_or_else(|| self.unreadable(e, i, p, values))?;
        let vertex = usize::try_from(index)
            .ok()
            .and_then(|i| self.vertices.get(i));
        vertex.copied().ok_or_else(|| {
            let reason = format!(
                "the face refers to vertex {index}, but the file has {} vertices",
                self.vertices.len()
            );
            self.bad(&format!("face {i}"), reason, EXPORT_AGAIN)
        })
    }
}
