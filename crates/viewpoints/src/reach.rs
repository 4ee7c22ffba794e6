//! Viewpoints that are reachable from given points along free segments: within a distance of a given point,
//! or along any number of segments.
//!
//! Rays are cast from a point in all directions. While the rays cross unmarked parts, more rays follow. If
//! any number of segments is allowed, every newly marked part has a reached point, and rays are cast from
//! that point in turn. Parts are marked in the order of the points and their rays, so the result does not
//! depend on threads. If walls enclose the points, the enclosed region is more precise (`sightline-portals`).

use rayon::prelude::*;
use sightline_scene::{Aabb, Scene};
use sightline_trace::cube::{SKY, face_basis};
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_viewcells::PartMask;

use crate::mesh::winding;
use crate::{PartPlanes, ViewpointsError, walk};

/// The number of tiles of 4×4 directions along a side of a cube face, in the first and in the last round of
/// rays from a point.
const FIRST_TILES: u32 = 1;
const MOST_TILES: u32 = 32;
/// Maximum number of rays per newly marked part. If a round needs more rays, no further round starts from the
/// point.
const RAYS_PER_FIND: usize = 200;
/// The number of points from which rays are cast before their crossings are marked.
const BATCH: usize = 256;
/// The last integer in the names of this module's random streams, so that they differ from other streams.
const REACH: u64 = 9;

/// The position of a cell part that a ray crosses, in the grid of parts, and a point of the ray in this part.
type PartCrossing = ([u32; 3], [f32; 3]);

/// The scene and the parts in which rays are traced.
pub struct ReachScene<'a> {
    /// The scene whose triangles stop rays.
    pub scene: &'a Scene,
    /// The tracer of the scene's triangles.
    pub sight: &'a SightLineTracer<'a>,
    /// The planes of the parts that the functions of this module mark.
    pub parts: &'a PartPlanes,
    /// The number of cells of the parts' grid along each axis.
    pub cells: [u32; 3],
    /// The minimum distance from a see-through triangle to the start of the next search, in world units.
    pub step: f32,
}

/// Marks the parts that rays of length `reach` (world units) from one of the points cross before they meet a
/// blocking triangle. With a `reach` of 0, marks only the parts that contain the points.
///
/// Points outside the view box are ignored. Also returns the number of ignored points.
///
/// # Errors
/// [`ViewpointsError::None`] if all points are outside, or [`ViewpointsError::Backend`] if the tracer fails.
pub fn mark_around(
    t: &ReachScene<'_>,
    points: &[[f32; 3]],
    reach: f32,
) -> Result<(PartMask, usize), ViewpointsError> {
    let mut marks = PartMask::empty(t.cells);
    let inside: Vec<[f32; 3]> = points
        .iter()
        .copied()
        .filter(|p| t.parts.of_point(*p).is_some())
        .collect();
    if inside.is_empty() {
        return Err(ViewpointsError::None(
            "no viewpoint is in the view box; check that the viewpoints have the scene's units and axes"
                .to_owned(),
        ));
    }
    for point in &inside {
        if let Some(part) = t.parts.of_point(*point) {
            marks.mark(part);
        }
    }
    if reach > 0.0 {
        cast_from_all(
            t,
            inside.clone(),
            f64::from(reach),
            &mut marks,
            &mut |_, _| {},
        )?;
    }
    Ok((marks, points.len() - inside.len()))
}

/// Marks all parts that are reachable from the starting points `seeds` along any number of free segments.
/// Calls `progress` with the number of marked parts after each round.
///
/// # Errors
/// The errors of [`check`].
pub fn mark_reachable(
    t: &ReachScene<'_>,
    seeds: &[[f32; 3]],
    progress: &mut dyn FnMut(u64),
) -> Result<PartMask, ViewpointsError> {
    let mut marks = PartMask::empty(t.cells);
    for part in check(t, seeds)? {
        marks.mark(part);
    }
    let mut open = seeds.to_vec();
    while !open.is_empty() {
        let mut next = Vec::new();
        cast_from_all(
            t,
            std::mem::take(&mut open),
            f64::INFINITY,
            &mut marks,
            &mut |_, point| {
                next.push(point);
            },
        )?;
        progress(marks.marked());
        open = next;
    }
    Ok(marks)
}

/// Checks the starting points `seeds`, and returns the coordinates of the parts that contain them.
///
/// # Errors
/// [`ViewpointsError::Outside`] or [`ViewpointsError::Solid`] for a point, or [`ViewpointsError::Backend`] if
/// the tracer fails.
pub fn check(t: &ReachScene<'_>, seeds: &[[f32; 3]]) -> Result<Vec<[u32; 3]>, ViewpointsError> {
    let mut parts = Vec::new();
    for seed in seeds {
        let Some(part) = t.parts.of_point(*seed) else {
            let whole = t.parts.whole();
            let (min, max) = (whole.min.to_array(), whole.max.to_array());
            return Err(ViewpointsError::Outside {
                point: *seed,
                min,
                max,
            });
        };
        check_free(t, *seed)?;
        parts.push(part);
    }
    Ok(parts)
}

/// Casts rays of length `reach` (world units) from all points, and marks the parts that the rays cross. Calls
/// `found` with every newly marked part and a point in this part.
fn cast_from_all(
    t: &ReachScene<'_>,
    points: Vec<[f32; 3]>,
    reach: f64,
    marks: &mut PartMask,
    found: &mut dyn FnMut([u32; 3], [f32; 3]),
) -> Result<(), ViewpointsError> {
    for batch in points.chunks(BATCH) {
        let mut open: Vec<[f32; 3]> = batch.to_vec();
        let mut tiles = FIRST_TILES;
        while !open.is_empty() && tiles <= MOST_TILES {
            let known = &*marks;
            let crossed: Vec<Vec<PartCrossing>> = open
                .par_iter()
                .with_max_len(1)
                .map(|point| cast(t, *point, tiles, reach, known))
                .collect::<Result<_, ViewpointsError>>()?;
            let rays = (6 * tiles * tiles) as usize * LANES;
            let mut keep = Vec::new();
            for (point, parts) in open.iter().zip(crossed) {
                let mut new = 0;
                for (part, at) in parts {
                    if !marks.has(part) {
                        marks.mark(part);
                        found(part, at);
                        new += 1;
                    }
                }
                if new * RAYS_PER_FIND >= rays {
                    keep.push(*point);
                }
            }
            open = keep;
            tiles *= 2;
        }
    }
    Ok(())
}

/// Returns the unmarked parts that rays from a point cross, with a point in each part.
fn cast(
    t: &ReachScene<'_>,
    origin: [f32; 3],
    tiles: u32,
    reach: f64,
    known: &PartMask,
) -> Result<Vec<PartCrossing>, ViewpointsError> {
    let mut out = Vec::new();
    each_ray(t, origin, tiles, &mut |packet, lane| {
        let (origin, direction) = packet.ray(lane);
        let end = f64::from(packet.distance[lane]).min(reach / f64::from(packet.length(lane)));
        walk::walk(t.parts, origin, direction, end, |part, at| {
            if !known.has(part) {
                out.push((part, at));
            }
        });
    })?;
    Ok(out)
}

/// Traces 6·`tiles`²·16 rays, evenly distributed over all directions, and calls `f` with the packet and the
/// lane of each ray.
fn each_ray(
    t: &ReachScene<'_>,
    origin: [f32; 3],
    tiles: u32,
    f: &mut dyn FnMut(&Packet, usize),
) -> Result<(), ViewpointsError> {
    let name = origin.map(|x| u64::from(x.to_bits()));
    let mut random = Hashed::new(&[name[0], name[1], name[2], u64::from(tiles), REACH]);
    let pixel = 2.0 / (4 * tiles) as f32;
    let (mut packets, mut passed) = (Vec::new(), Passed::default());
    for face in 0..6 {
        packets.clear();
        let [forward, right, up] = face_basis(face);
        for tile in 0..tiles * tiles {
            let mut packet = Packet::default();
            for lane in 0..LANES as u32 {
                let x = ((tile % tiles * 4 + lane % 4) as f32 + random.unit()) * pixel - 1.0;
                let y = ((tile / tiles * 4 + lane / 4) as f32 + random.unit()) * pixel - 1.0;
                packet.push(origin, (forward + right * x + up * y).to_array());
            }
            packets.push(packet);
        }
        t.sight.trace(&mut packets, &mut passed, t.step)?;
        for packet in &packets {
            (0..packet.count).for_each(|lane| f(packet, lane));
        }
    }
    Ok(())
}

/// Checks that a point is not inside a solid.
///
/// A point is inside a solid if most rays from it meet the back of a triangle, as the file winds its
/// triangles, and an object that does not enclose the whole scene winds around the point. A closed room is
/// not a solid: its triangles face inwards, or the room encloses the whole scene.
fn check_free(t: &ReachScene<'_>, point: [f32; 3]) -> Result<(), ViewpointsError> {
    let (mut backs, mut others) = (0u32, 0u32);
    each_ray(t, point, FIRST_TILES, &mut |packet, lane| {
        let triangle = packet.triangle[lane];
        let back = triangle != SKY && {
            let (_, direction) = packet.ray(lane);
            let v = t.scene.triangles()[triangle as usize].v;
            (v[1] - v[0]).cross(v[2] - v[0]).dot(direction.into()) > 0.0
        };
        if back { backs += 1 } else { others += 1 }
    })?;
    if backs <= others {
        return Ok(());
    }
    for object in t.scene.objects() {
        let own =
            &t.scene.triangles()[object.first as usize..(object.first + object.count) as usize];
        let bounds = own.iter().fold(Aabb::EMPTY, |all, t| all.union(t.bounds()));
        let around = winding(own, glam::Vec3::from(point).as_dvec3());
        if around > 0.5 && bounds != t.scene.bounds() {
            return Err(ViewpointsError::Solid {
                point,
                object: object.name.clone(),
            });
        }
    }
    Ok(())
}
