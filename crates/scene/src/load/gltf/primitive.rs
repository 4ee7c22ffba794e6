//! The triangles of one primitive: lists, strips and fans, with or without indices.

use glam::Vec3;
use rayon::prelude::*;

use super::accessor::{Accessors, CheckedAccessor};
use super::alpha::Alpha;
use super::nodes::PlacedMesh;
use super::source::GltfContext;
use super::uses::{AccessorRole, PrimitiveMode, mode, surface};
use super::{json, transform};
use crate::load::limits::{EXPORT_AGAIN, REPAIR_VERTEX};
use crate::masks::Coordinates;
use crate::{SceneError, Triangle};

/// The number of triangles that a thread reads in one step.
const AT_ONCE: usize = 8192;

/// Returns the name in errors of primitive `p` of the mesh.
pub(super) fn label(draw: &PlacedMesh, p: usize) -> String {
    format!("mesh {}, primitive {p} (at node {})", draw.mesh, draw.node)
}

/// Returns the number of triangles of primitive `p` of the mesh.
pub(super) fn count(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    draw: &PlacedMesh,
    p: usize,
) -> Result<u64, SceneError> {
    let primitive = &root.meshes[draw.mesh].primitives[p];
    let bad = |why: String| source.bad(label(draw, p), why);
    let Some(position) = surface(primitive).map_err(bad)? else {
        return Ok(0);
    };
    let corners = match primitive.indices {
        Some(i) => accessors.get(AccessorRole::Indices, i).count(),
        None => accessors.get(AccessorRole::Positions, position).count(),
    };
    match mode(primitive).map_err(bad)? {
        PrimitiveMode::NoSurface => Ok(0),
        PrimitiveMode::Triangles if corners % 3 == 0 => Ok(corners / 3),
        PrimitiveMode::Triangles => Err(bad(format!(
            "the number of corners, {corners}, is not a multiple of three"
        ))),
        PrimitiveMode::Strip | PrimitiveMode::Fan if corners >= 3 => Ok(corners - 2),
        PrimitiveMode::Strip | PrimitiveMode::Fan => Err(bad(format!(
            "a strip or fan needs three corners, but the primitive has {corners}"
        ))),
    }
}

/// Reads the triangles of primitive `p` of the mesh, in world space, into `out`. The length of `out` is the
/// result of [`count`].
pub(super) fn read(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    draw: &PlacedMesh,
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
        positions: accessors.get(AccessorRole::Positions, position),
        indices: primitive
            .indices
            .map(|i| (i, accessors.get(AccessorRole::Indices, i))),
    };
    let mode = mode(primitive).map_err(|why| source.bad(label(draw, p), why))?;
    let triangle = |i: u64| -> Result<Triangle, SceneError> {
        let [a, b, c] = corners_of(mode, i);
        Ok(Triangle {
            v: [corners.at(a)?, corners.at(b)?, corners.at(c)?],
        })
    };
    // If there are several faults, the first fault in the file is reported.
    let wrong = out
        .par_chunks_mut(AT_ONCE)
        .enumerate()
        .find_map_first(|(k, chunk)| {
            let mut numbered = chunk.iter_mut().zip((k * AT_ONCE) as u64..);
            numbered.find_map(|(t, i)| triangle(i).map(|read| *t = read).err())
        });
    wrong.map_or(Ok(()), Err)
}

/// Returns the three corners of triangle `i`, as positions in the primitive's sequence of corners.
fn corners_of(mode: PrimitiveMode, i: u64) -> [u64; 3] {
    match mode {
        // Every second triangle of a strip is reversed, so that all have the same winding.
        PrimitiveMode::Strip => [i, i + 1 + i % 2, i + 2 - i % 2],
        PrimitiveMode::Fan => [i + 1, i + 2, 0],
        // Primitives without a surface have no triangles.
        PrimitiveMode::Triangles | PrimitiveMode::NoSurface => [3 * i, 3 * i + 1, 3 * i + 2],
    }
}

/// Adds the texture coordinates of the `count` triangles of primitive `p` to `out`, transformed as `alpha`
/// specifies. Adds zeros if there is no texture.
pub(super) fn coordinates(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    draw: &PlacedMesh,
    p: usize,
    count: u32,
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
    let given = accessors.get(AccessorRole::Coordinates, set);
    let indices = primitive
        .indices
        .map(|i| accessors.get(AccessorRole::Indices, i));
    let mode = mode(primitive).map_err(|why| source.bad(label(draw, p), why))?;
    for i in 0..u64::from(count) {
        let mut uvs = Coordinates::default();
        for (corner, uv) in corners_of(mode, i).into_iter().zip(&mut uvs) {
            let vertex = indices.map_or(corner, |indices| indices.index(corner));
            if vertex >= given.count() {
                let n = given.count();
                return Err(bad(format!(
                    "vertex {vertex} has no texture coordinates: the accessor has {n} elements"
                )));
            }
            let placed = alpha.placed(given.coordinates(vertex));
            *uv = placed.ok_or_else(|| {
                bad(format!(
                    "the texture coordinates of vertex {vertex} are not finite"
                ))
            })?;
        }
        out.push(uvs);
    }
    Ok(())
}

/// The corners of a primitive, in the order of its indices or, without indices, of its vertices.
struct Corners<'a> {
    source: &'a GltfContext<'a>,
    draw: &'a PlacedMesh,
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
        let mut reason = format!(
            "the index refers to vertex {v}, but the primitive has {} vertices",
            self.positions.count()
        );
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
            format!("the position ({x}, {y}, {z}) is out of range after the transform of the node")
        } else {
            format!("the position ({x}, {y}, {z}) is not finite")
        };
        SceneError::bad(self.source.file, element, reason, REPAIR_VERTEX)
    }
}
