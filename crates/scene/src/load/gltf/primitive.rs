//! The triangles of one primitive: lists, strips and fans, with or without indices.

use glam::Vec3;
use rayon::prelude::*;

use super::accessor::{Accessors, CheckedAccessor};
use super::alpha::Alpha;
use super::nodes::Draw;
use super::source::GltfContext;
use super::uses::{Mode, Role, mode, surface};
use super::{json, transform};
use crate::load::limits::{EXPORT_AGAIN, REPAIR_VERTEX};
use crate::masks::Coordinates;
use crate::{SceneError, Triangle};

/// Triangles that a thread reads at a time.
const AT_ONCE: usize = 8192;

/// The name of a primitive in errors.
pub(super) fn label(draw: &Draw, p: usize) -> String {
    format!("mesh {}, primitive {p} (at node {})", draw.mesh, draw.node)
}

/// The number of triangles of primitive `p` of the mesh.
pub(super) fn count(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    draw: &Draw,
    p: usize,
) -> Result<u64, SceneError> {
    let primitive = &root.meshes[draw.mesh].primitives[p];
    let bad = |why: String| source.bad(label(draw, p), why);
    let Some(position) = surface(primitive).map_err(bad)? else {
        return Ok(0);
    };
    let corners = match primitive.indices {
        Some(i) => accessors.get(Role::Indices, i).count(),
        None => accessors.get(Role::Positions, position).count(),
    };
    match mode(primitive).map_err(bad)? {
        Mode::NoSurface => Ok(0),
        Mode::Triangles if corners % 3 == 0 => Ok(corners / 3),
        Mode::Triangles => Err(bad(format!(
            "its {corners} corners are not a multiple of three"
        ))),
        Mode::Strip | Mode::Fan if corners >= 3 => Ok(corners - 2),
        Mode::Strip | Mode::Fan => Err(bad(format!(
            "a strip or fan needs three corners and it has {corners}"
        ))),
    }
}

/// Reads the triangles of primitive `p` of the mesh, in world space, into `out`, whose length is that of
/// [`count`].
pub(super) fn read(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    draw: &Draw,
    p: usize,
    out: &mut [Triangle],
) -> Result<(), SceneError> {
    let primitive = &root.meshes[draw.mesh].primitives[p];
    let (Some(position), false) = (primitive.attributes.position, out.is_empty()) else {
        return Ok(());
    };
    let corners = Corners {
        source,
        draw,
        p,
        position,
        positions: accessors.get(Role::Positions, position),
        indices: primitive
            .indices
            .map(|i| (i, accessors.get(Role::Indices, i))),
    };
    let mode = mode(primitive).map_err(|why| source.bad(label(draw, p), why))?;
    let triangle = |i: u64| -> Result<Triangle, SceneError> {
        let [a, b, c] = corners_of(mode, i);
        Ok(Triangle {
            v: [corners.at(a)?, corners.at(b)?, corners.at(c)?],
        })
    };
    // Of several faults, the first in the file is reported.
    let wrong = out
        .par_chunks_mut(AT_ONCE)
        .enumerate()
        .find_map_first(|(k, chunk)| {
            let mut numbered = chunk.iter_mut().zip((k * AT_ONCE) as u64..);
            numbered.find_map(|(t, i)| triangle(i).map(|read| *t = read).err())
        });
    wrong.map_or(Ok(()), Err)
}

/// The corners of a triangle.
fn corners_of(mode: Mode, i: u64) -> [u64; 3] {
    match mode {
        // Every second triangle of a strip is turned, so that all wind the same way.
        Mode::Strip => [i, i + 1 + i % 2, i + 2 - i % 2],
        Mode::Fan => [i + 1, i + 2, 0],
        // Without a surface there are none.
        Mode::Triangles | Mode::NoSurface => [3 * i, 3 * i + 1, 3 * i + 2],
    }
}

/// Adds the texture coordinates of the `count` triangles of primitive `p`, as `alpha` places its texture, to
/// `out`; zeros without a texture.
pub(super) fn coordinates(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    (draw, p, count): (&Draw, usize, u32),
    alpha: &Alpha,
    out: &mut Vec<Coordinates>,
) -> Result<(), SceneError> {
    let primitive = &root.meshes[draw.mesh].primitives[p];
    let set = alpha
        .texture
        .and_then(|_| primitive.attributes.coordinates(alpha.set));
    let Some(set) = set else {
        out.resize(out.len() + count as usize, Coordinates::default());
        return Ok(());
    };
    let bad = |why: String| source.bad(format!("{}, accessor {set}", label(draw, p)), why);
    let given = accessors.get(Role::Coordinates, set);
    let indices = primitive.indices.map(|i| accessors.get(Role::Indices, i));
    let mode = mode(primitive).map_err(|why| source.bad(label(draw, p), why))?;
    for i in 0..u64::from(count) {
        let mut uvs = Coordinates::default();
        for (corner, uv) in corners_of(mode, i).into_iter().zip(&mut uvs) {
            let vertex = indices.map_or(corner, |indices| indices.index(corner));
            if vertex >= given.count() {
                let n = given.count();
                return Err(bad(format!(
                    "vertex {vertex} has no texture coordinates, there are {n}"
                )));
            }
            let placed = alpha.placed(given.coordinates(vertex));
            *uv = placed
                .ok_or_else(|| bad(format!("the coordinates of vertex {vertex} are not finite")))?;
        }
        out.push(uvs);
    }
    Ok(())
}

/// The corners of a primitive in the order of the indices.
struct Corners<'a> {
    source: &'a GltfContext<'a>,
    draw: &'a Draw,
    p: usize,
    position: usize,
    positions: &'a CheckedAccessor<'a>,
    indices: Option<(usize, &'a CheckedAccessor<'a>)>,
}

impl Corners<'_> {
    fn at(&self, corner: u64) -> Result<Vec3, SceneError> {
        let vertex = match self.indices {
            None => corner,
            Some((number, indices)) => {
                let v = indices.index(corner);
                if v >= self.positions.count() || v == indices.restart() {
                    return Err(self.bad_index(number, corner, v, indices));
                }
                v
            }
        };
        let local = self.positions.position(vertex);
        let world = transform::apply(&self.draw.world, local);
        if world.is_finite() {
            Ok(world)
        } else {
            Err(self.bad_vertex(vertex, local))
        }
    }

    fn bad_index(
        &self,
        accessor: usize,
        corner: u64,
        v: u64,
        indices: &CheckedAccessor<'_>,
    ) -> SceneError {
        let element = format!(
            "{}, accessor {accessor}, index {corner}",
            label(self.draw, self.p)
        );
        let mut reason = format!("it names vertex {v} of {}", self.positions.count());
        if v == indices.restart() {
            reason.push_str(" (primitive restart is not allowed in glTF)");
        }
        SceneError::bad(self.source.file, element, reason, EXPORT_AGAIN)
    }

    fn bad_vertex(&self, vertex: u64, [x, y, z]: [f64; 3]) -> SceneError {
        let element = format!(
            "{}, accessor {}, vertex {vertex}",
            label(self.draw, self.p),
            self.position
        );
        let reason = if x.is_finite() && y.is_finite() && z.is_finite() {
            format!(
                "its position ({x}, {y}, {z}) is out of range once the node's transform is applied"
            )
        } else {
            format!("its position ({x}, {y}, {z}) is not finite")
        };
        SceneError::bad(self.source.file, element, reason, REPAIR_VERTEX)
    }
}
