//! Viewpoints that are reached from given points along free segments: at most a distance from one of them, or
//! by any number of segments.
//!
//! From a point rays are cast in all directions, more and more while they find unmarked parts. Where any
//! number of segments is allowed, every newly marked part has a point that was reached, and rays are cast
//! from that point in turn. Parts are marked in the order of the points and their rays, so threads change
//! nothing. Where walls enclose the points, the region that they enclose says more
//! (`sightline-portals`).

use rayon::prelude::*;
use sightline_scene::{Aabb, Scene};
use sightline_trace::cube::{SKY, face_basis};
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sequence::Hashed;
use sightline_trace::sight::{Passed, SightLineTracer};
use sightline_viewcells::PartMask;

use crate::mesh::winding;
use crate::{Parts, ViewpointsError, walk};

/// Tiles of 4×4 directions along a cube face, in the first and in the last round from a point.
const FIRST_TILES: u32 = 1;
const MOST_TILES: u32 = 32;
/// A point goes on while at least one ray in this many has found an unmarked part.
const RAYS_PER_FIND: usize = 200;
/// Points from which rays are cast before their finds are marked.
const BATCH: usize = 256;
/// Name of the stream of random numbers.
const REACH: u64 = 9;

/// A part that a ray crosses, and a point of the ray in it.
type Crossing = ([u32; 3], [f32; 3]);

/// What rays are traced in.
pub struct Tracing<'a> {
    /// The scene's triangles.
    pub scene: &'a Scene,
    /// Their tracer.
    pub sight: &'a SightLineTracer<'a>,
    /// The parts to be marked.
    pub parts: &'a Parts,
    /// Cells of their grid.
    pub cells: [u32; 3],
    /// Least distance from a see-through triangle to the next search, world units.
    pub step: f32,
}

/// Marks where a free segment of at most `reach` from one of the points ends; with a reach of 0, the points
/// alone. Points outside the box mark nothing; returns how many there are.
///
/// # Errors
/// [`ViewpointsError::None`] when all points are outside, [`ViewpointsError::Backend`].
pub fn mark_around(
    t: &Tracing<'_>,
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
            "none of the viewpoints is in the view box; are they in the scene's units and axes?"
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

/// Marks all that viewpoints get to from `seeds` along free segments, and on from there.
///
/// # Errors
/// As [`check`].
pub fn mark_reachable(
    t: &Tracing<'_>,
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

/// The parts of points from which places are reached.
///
/// # Errors
/// [`ViewpointsError::Outside`] and [`ViewpointsError::Solid`] for a point, [`ViewpointsError::Backend`].
pub fn check(t: &Tracing<'_>, seeds: &[[f32; 3]]) -> Result<Vec<[u32; 3]>, ViewpointsError> {
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

/// Casts rays from all points, up to a distance, and marks the parts they cross. `found` gets every newly
/// marked part with a point in it.
fn cast_from_all(
    t: &Tracing<'_>,
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
            let crossed: Vec<Vec<Crossing>> = open
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

/// The unmarked parts that rays from a point cross, with a point in each.
fn cast(
    t: &Tracing<'_>,
    origin: [f32; 3],
    tiles: u32,
    reach: f64,
    known: &PartMask,
) -> Result<Vec<Crossing>, ViewpointsError> {
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

/// Traces rays evenly over all directions and calls `f` with each.
fn each_ray(
    t: &Tracing<'_>,
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

/// Refuses a point inside something solid: most rays from it meet a back, as the file winds its
/// triangles, and an object that does not enclose the whole scene winds around it. A closed room is no
/// solid: it is wound to be seen from inside, or it encloses all there is.
fn check_free(t: &Tracing<'_>, point: [f32; 3]) -> Result<(), ViewpointsError> {
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
