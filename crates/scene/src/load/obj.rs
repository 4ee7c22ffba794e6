//! Wavefront OBJ: `v`, `f`, `o`, `g`, `mtllib` and `usemtl`; all other statements are skipped.
//!
//! Faces keep the order of the file, an n-gon becomes the fan (v0, vi, vi+1), and each non-empty run of faces
//! between two `o` or `g` statements is an object. A file with free-form surfaces (`surf`) is rejected,
//! because skipped surfaces would be missing.
//!
//! This parser replaces the crate `tobj`, which returns errors without line numbers, splits objects where the
//! material changes, and builds index arrays that the loader does not need.

use std::path::Path;

use glam::Vec3;

use super::format::text_head;
use super::limits::{
    EXPORT_AGAIN, LoadLimits, REPAIR_VERTEX, too_many_objects, too_many_triangles,
};
use super::marks::{Mark, Marks};
use super::mtl::Materials;
use super::names::UniqueNames;
use crate::{Object, Scene, SceneError, Triangle};

/// A corner of a face that refers to a vertex further down the file. The reader sets the position of the
/// corner at the end of the file.
struct Forward {
    /// The id of the triangle.
    triangle: usize,
    /// The corner of the triangle, 0 to 2.
    corner: usize,
    /// The index of the vertex in the file, from 0.
    vertex: usize,
    /// The number of the line with the face, from 1.
    line: usize,
}

/// The state of the OBJ reader.
struct ObjReader<'a> {
    file: &'a str,
    limits: &'a LoadLimits,
    vertices: Vec<Vec3>,
    triangles: Vec<Triangle>,
    objects: Vec<Object>,
    forward: Vec<Forward>,
    names: UniqueNames,
    object: String,
    group: String,
    /// True if the next face opens a new object.
    opens: bool,
    /// The corners of the current face as vertex indices, from 0.
    face: Vec<usize>,
    base_dir: Option<&'a Path>,
    materials: Materials,
    marks: &'a mut Marks,
    material: Vec<u8>,
    /// The kind of the current material and the reason for it.
    mark: Mark,
    /// The number of triangles since the object or the material last changed.
    run: u32,
}

/// The first words of OBJ statements. A text counts as OBJ if a line near its start begins with such a word.
const WORDS: &[&[u8]] = &[
    b"v", b"vt", b"vn", b"vp", b"f", b"o", b"g", b"s", b"l", b"p", b"mtllib", b"usemtl",
];

/// Returns true if bytes are a text with an OBJ statement near its start.
pub(super) fn has_signature(bytes: &[u8]) -> bool {
    let is_statement = |line: &[u8]| {
        let word = line.split(u8::is_ascii_whitespace).find(|w| !w.is_empty());
        word.is_some_and(|w| WORDS.contains(&w))
    };
    text_head(bytes)
        .is_some_and(|head| head.split(|b| *b == b'\n' || *b == b'\r').any(is_statement))
}

/// Reads an OBJ file.
pub(super) fn parse(
    file: &str,
    bytes: &[u8],
    base_dir: Option<&Path>,
    limits: &LoadLimits,
    marks: &mut Marks,
) -> Result<Scene, SceneError> {
    let mut r = ObjReader {
        file,
        limits,
        vertices: Vec::new(),
        triangles: Vec::new(),
        objects: Vec::new(),
        forward: Vec::new(),
        names: UniqueNames::default(),
        object: String::new(),
        group: String::new(),
        opens: true,
        face: Vec::new(),
        base_dir,
        materials: Materials::default(),
        marks,
        material: Vec::new(),
        mark: Mark::DEFAULT,
        run: 0,
    };
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    // Very old exporters end lines with only a carriage return.
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let mut lines = bytes.split(|b| *b == end).enumerate();
    let mut joined = Vec::new();
    while let Some((at, line)) = lines.next() {
        let Some(mut open) = continued(line) else {
            r.statement(at + 1, line)?;
            continue;
        };
        // A backslash at the end of a line joins the next line to this line.
        joined.clear();
        loop {
            joined.extend_from_slice(open);
            joined.push(b' ');
            let Some((_, next)) = lines.next() else { break };
            match continued(next) {
                Some(more) => open = more,
                None => {
                    joined.extend_from_slice(next);
                    break;
                }
            }
        }
        r.statement(at + 1, &joined)?;
    }
    r.finish()
}

/// Returns the line without the backslash at its end, or `None` if no backslash continues the line.
fn continued(line: &[u8]) -> Option<&[u8]> {
    line.trim_ascii_end()
        .strip_suffix(b"\\")
        .filter(|l| !l.contains(&b'#'))
}

/// The words of a statement, separated by white space.
struct Words<'a>(&'a [u8]);

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let text = self.0.trim_ascii_start();
        let len = text
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(text.len());
        let (word, rest) = text.split_at(len);
        self.0 = rest;
        (len > 0).then_some(word)
    }
}

/// Formats a token of any bytes for a message, shortened to 40 bytes.
fn show(token: &[u8]) -> String {
    String::from_utf8_lossy(&token[..token.len().min(40)]).into_owned()
}

impl ObjReader<'_> {
    fn bad(&self, line: usize, reason: impl Into<String>, remedy: &str) -> SceneError {
        SceneError::bad(self.file, format!("line {line}"), reason, remedy)
    }

    fn statement(&mut self, line: usize, text: &[u8]) -> Result<(), SceneError> {
        let text = text.split(|b| *b == b'#').next().unwrap_or_default();
        let mut words = Words(text);
        match words.next() {
            Some(b"v") => self.vertex(line, words),
            Some(b"f") => self.face(line, words),
            Some(word @ (b"o" | b"g")) => {
                let name = text
                    .trim_ascii()
                    .strip_prefix(word)
                    .unwrap_or_default()
                    .trim_ascii();
                let name = String::from_utf8_lossy(name).into_owned();
                self.end_run();
                *(if word == b"o" {
                    &mut self.object
                } else {
                    &mut self.group
                }) = name;
                self.opens = true;
                Ok(())
            }
            Some(b"mtllib") => {
                let names = text
                    .trim_ascii()
                    .strip_prefix(b"mtllib")
                    .unwrap_or_default()
                    .trim_ascii();
                self.materials.read(self.base_dir, names, self.marks);
                Ok(())
            }
            Some(b"usemtl") => {
                self.end_run();
                let name = text
                    .trim_ascii()
                    .strip_prefix(b"usemtl")
                    .unwrap_or_default()
                    .trim_ascii();
                self.material = name.to_vec();
                self.mark = self.materials.get(name).cloned().unwrap_or_else(|| {
                    self.marks.warn(match self.materials.any {
                        true => format!(
                            "the material {:?} is in no library that was read; the material counts as opaque",
                            show(name)
                        ),
                        false => {
                            "the scene uses materials, but no material library was read; all materials \
                             count as opaque"
                                .to_owned()
                        }
                    });
                    Mark::DEFAULT
                });
                Ok(())
            }
            Some(b"surf") => Err(self.bad(
                line,
                "free-form surfaces (surf) are not supported",
                "tessellate the surfaces and export again",
            )),
            _ => Ok(()),
        }
    }

    fn vertex(&mut self, line: usize, mut words: Words<'_>) -> Result<(), SceneError> {
        let mut p = [0.0f32; 3];
        for (axis, c) in ["x", "y", "z"].iter().zip(&mut p) {
            let Some(word) = words.next() else {
                return Err(self.bad(
                    line,
                    format!("the vertex has no {axis} coordinate"),
                    EXPORT_AGAIN,
                ));
            };
            *c = std::str::from_utf8(word)
                .ok()
                .and_then(|w| w.parse().ok())
                .ok_or_else(|| {
                    self.bad(
                        line,
                        format!("the {axis} coordinate \"{}\" is not a number", show(word)),
                        EXPORT_AGAIN,
                    )
                })?;
            if !c.is_finite() {
                let what = format!(
                    "vertex {} (counted from 0): the {axis} coordinate {} is not finite",
                    self.vertices.len(),
                    show(word)
                );
                return Err(self.bad(line, what, REPAIR_VERTEX));
            }
        }
        self.vertices.push(Vec3::from_array(p));
        Ok(())
    }

    fn face(&mut self, line: usize, words: Words<'_>) -> Result<(), SceneError> {
        self.face.clear();
        for word in words {
            let corner = self.corner(line, word)?;
            self.face.push(corner);
        }
        if self.face.len() < 3 {
            let reason = format!("the face has {} corners", self.face.len());
            return Err(self.bad(
                line,
                reason,
                "remove faces of fewer than three corners and export again",
            ));
        }
        if self.triangles.len() + self.face.len() - 2 > self.limits.triangles as usize {
            return Err(too_many_triangles(
                self.file,
                format!("line {line}"),
                self.limits,
            ));
        }
        if self.opens {
            self.open_object(line)?;
        }
        for i in 1..self.face.len() - 1 {
            let mut v = [Vec3::ZERO; 3];
            for (corner, &vertex) in [self.face[0], self.face[i], self.face[i + 1]]
                .iter()
                .enumerate()
            {
                match self.vertices.get(vertex) {
                    Some(p) => v[corner] = *p,
                    None => {
                        self.forward.push(Forward {
                            triangle: self.triangles.len(),
                            corner,
                            vertex,
                            line,
                        });
                    }
                }
            }
            self.triangles.push(Triangle { v });
            self.run += 1;
        }
        Ok(())
    }

    /// Returns the index, from 0, of the vertex to which a corner such as `7`, `7/1`, `7//2`, `7/1/2` or `-1`
    /// refers. The vertex may be further down the file.
    fn corner(&self, line: usize, word: &[u8]) -> Result<usize, SceneError> {
        let mut parts = word.split(|b| *b == b'/');
        let number = parts
            .next()
            .and_then(|w| std::str::from_utf8(w).ok())
            .and_then(|w| w.parse::<i64>().ok());
        let rest_ok = parts.clone().count() <= 2
            && parts
                .flatten()
                .all(|&b| b.is_ascii_digit() || matches!(b, b'-' | b'+'));
        let (Some(number), true) = (number, rest_ok) else {
            let reason = format!("\"{}\" is not a valid corner of a face", show(word));
            return Err(self.bad(line, reason, EXPORT_AGAIN));
        };
        let known = self.vertices.len();
        let index = match number {
            1.. => usize::try_from(number - 1).ok(),
            0 => None,
            // Negative numbers count back from the last vertex read.
            _ => usize::try_from(number.unsigned_abs())
                .ok()
                .and_then(|back| known.checked_sub(back)),
        };
        index.ok_or_else(|| {
            let reason = format!(
                "the face refers to vertex {number}, but {known} vertices precede the face"
            );
            self.bad(line, reason, EXPORT_AGAIN)
        })
    }

    fn open_object(&mut self, line: usize) -> Result<(), SceneError> {
        if self.objects.len() >= self.limits.objects as usize {
            return Err(too_many_objects(
                self.file,
                format!("line {line}"),
                self.limits,
            ));
        }
        self.close_object();
        let name = match (self.object.is_empty(), self.group.is_empty()) {
            (true, true) => "default".to_owned(),
            (false, true) => self.object.clone(),
            (true, false) => self.group.clone(),
            (false, false) => format!("{}/{}", self.object, self.group),
        };
        let name = self.names.unique(name);
        // The number of triangles is below `limits.triangles`, a u32.
        self.objects.push(Object {
            name,
            first: self.triangles.len() as u32,
            count: 0,
        });
        self.opens = false;
        Ok(())
    }

    /// Records the kind of the triangles since the object or the material last changed.
    fn end_run(&mut self) {
        if let (Some(object), 1..) = (self.objects.last(), self.run) {
            let material = String::from_utf8_lossy(&self.material);
            let names = [object.name.as_str(), &self.object, &self.group, &material];
            self.marks.push(self.run, &names, &self.mark);
        }
        self.run = 0;
    }

    /// Sets the number of triangles of the last object, which ends at the last triangle read.
    fn close_object(&mut self) {
        self.end_run();
        if let Some(last) = self.objects.last_mut() {
            last.count = self.triangles.len() as u32 - last.first;
        }
    }

    fn finish(mut self) -> Result<Scene, SceneError> {
        self.close_object();
        for f in &self.forward {
            let Some(p) = self.vertices.get(f.vertex) else {
                let reason = format!(
                    "the face refers to vertex {}, but the file has {} vertices",
                    f.vertex as u64 + 1,
                    self.vertices.len()
                );
                return Err(self.bad(f.line, reason, EXPORT_AGAIN));
            };
            self.triangles[f.triangle].v[f.corner] = *p;
        }
        drop(self.vertices);
        Scene::new(self.file, self.triangles, self.objects)
    }
}
