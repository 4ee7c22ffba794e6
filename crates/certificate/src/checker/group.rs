//! The check that a group of triangles is hidden from a cell: closed surfaces hide the triangles, or a proof
//! exists for each pair of a cell face and a target polygon.

use std::cmp::Ordering;
use std::sync::OnceLock;

use rayon::prelude::*;
use sightline_numbers::Aabb;

use super::boxes::{face, face_plane, meets_box};
use super::geometry::{exact, has_area, height, plane, point, sign};
use super::polygon::{check_polygons, clip, within};
use super::triangles::Triangles;
use super::{Corners, Refusal, check_hidden};
use crate::certificate::{HiddenBox, HiddenGroup, Target, faces};
use crate::proof::Proof;

/// The maximum number of corners of a target polygon. The search makes no larger polygons, and the time of
/// the convexity check grows with the square of this number.
const MAX_CORNERS: usize = 64;

/// The parities of a cell by surface, each computed on first use. See [`super::surfaces`].
pub(super) type Parities = [OnceLock<Option<bool>>];

/// Checks that a closed surface hides a triangle from the whole cell. This is the case if all points of the
/// cell are on the hidden side of the triangle's plane, or on the plane.
fn hidden_by_surface(
    scene: &Triangles<'_>,
    cell: Aabb,
    parity: &Parities,
    id: u32,
) -> Result<(), &'static str> {
    let side = scene
        .surfaces()
        .hidden_side(scene.tree(), cell, parity, id)?;
    let t = exact(&scene.all()[id as usize]);
    let flat = plane([&t[0], &t[1], &t[2]]);
    let corners = [face(cell, 0, false), face(cell, 0, true)].concat();
    if corners
        .iter()
        .any(|p| sign(&height(&flat, p)) == side.reverse())
    {
        return Err("a part of the cell is not on the hidden side of the triangle");
    }
    Ok(())
}

/// Checks that a group of triangles is hidden from a cell. Returns the reason if this is not shown.
pub(super) fn check_group(
    scene: &Triangles<'_>,
    cell: Aabb,
    parity: &Parities,
    group: &HiddenGroup,
) -> Result<(), String> {
    let all = scene.all();
    if group.triangles.iter().any(|id| *id as usize >= all.len()) {
        return Err("the scene does not contain a triangle of the group".to_owned());
    }
    let targets: Vec<Corners> = match &group.target {
        Target::Surfaces => {
            if !group.proofs.is_empty() {
                return Err("a group that closed surfaces hide must not contain proofs".to_owned());
            }
            let refusal = group.triangles.par_iter().find_map_first(|id| {
                hidden_by_surface(scene, cell, parity, *id)
                    .err()
                    .map(|e| format!("triangle {id}: {e}"))
            });
            return refusal.map_or(Ok(()), Err);
        }
        Target::Triangle | Target::Half => {
            let [id] = group.triangles[..] else {
                return Err(
                    "a group with the target Triangle or Half must contain exactly one triangle"
                        .to_owned(),
                );
            };
            if meets_box(&all[id as usize], cell) {
                return Err("the triangle meets the cell".to_owned());
            }
            if has_area(&all[id as usize]) {
                vec![exact(&all[id as usize]).into()]
            } else {
                Vec::new()
            }
        }
        Target::Polygon(corners) => {
            if corners.len() > MAX_CORNERS {
                return Err(format!(
                    "the target polygon has {} corners; at most {MAX_CORNERS} are allowed",
                    corners.len()
                ));
            }
            let corners: Corners = corners
                .iter()
                .map(|c| point(c.as_dvec3().to_array()))
                .collect();
            let target = [corners];
            // The containment test below is correct only for convex flat polygons.
            check_polygons(&target).map_err(|e| e.to_string())?;
            for id in &group.triangles {
                if meets_box(&all[*id as usize], cell) {
                    return Err(format!("triangle {id} meets the cell"));
                }
                if !exact(&all[*id as usize])
                    .iter()
                    .all(|p| within(&target[0], p))
                {
                    return Err(format!("triangle {id} is not in the target polygon"));
                }
            }
            target.into()
        }
        Target::Box(of) => {
            let Aabb { min, max } = *of;
            check_box(*of)?;
            let outside = |id: &&u32| {
                all[**id as usize]
                    .iter()
                    .any(|v| v.cmplt(min).any() || v.cmpgt(max).any())
            };
            if let Some(id) = group.triangles.iter().find(outside) {
                return Err(format!("triangle {id} is not in the target box"));
            }
            if of.touches(&cell) {
                return Err("the target box touches the cell".to_owned());
            }
            faces_towards(*of, cell)
        }
    };
    // If the triangle is hidden from one side of its plane, only the other side needs a proof.
    let half = match (&group.target, &group.triangles[..]) {
        (Target::Half, [id]) => Some(
            scene
                .surfaces()
                .hidden_side(scene.tree(), cell, parity, *id)
                .map_err(str::to_owned)?,
        ),
        _ => None,
    };
    check_proofs(scene, cell, &targets, half, &group.proofs)
}

/// Checks that a box is hidden from a cell. Returns the reason if this is not shown. A segment from the cell
/// to the box leaves the cell through a face and enters the box through a face. If box and cell share only an
/// edge or a corner, the segments through it form no open set. If they share a part of a face, segments can
/// pass through that part and meet no other face, so the function rejects such boxes.
pub(super) fn check_apart(
    scene: &Triangles<'_>,
    cell: Aabb,
    apart: &HiddenBox,
) -> Result<(), String> {
    let bounds = apart.bounds;
    check_box(bounds)?;
    let common: Vec<f32> = (0..3)
        .map(|a| bounds.max[a].min(cell.max[a]) - bounds.min[a].max(cell.min[a]))
        .collect();
    let apart_or_touching = common.iter().filter(|length| **length <= 0.0).count();
    if common.iter().all(|length| *length >= 0.0) && apart_or_touching < 2 {
        return Err("the box and the cell share a volume or a part of a face".to_owned());
    }
    check_proofs(
        scene,
        cell,
        &faces_towards(bounds, cell),
        None,
        &apart.proofs,
    )
}

fn check_box(Aabb { min, max }: Aabb) -> Result<(), String> {
    match min.is_finite() && max.is_finite() && min.cmple(max).all() {
        true => Ok(()),
        false => Err("the box is not finite, or a minimum is above its maximum".to_owned()),
    }
}

/// Returns the faces with area of a box through which segments from a cell can enter it.
fn faces_towards(bounds: Aabb, cell: Aabb) -> Vec<Corners> {
    let Aabb { min, max } = bounds;
    faces()
        .filter(|(axis, up)| {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let area = min[u] < max[u] && min[v] < max[v];
            // True if a point of the cell is on the outer side of the face.
            let towards = if *up {
                cell.max[*axis] > max[*axis]
            } else {
                cell.min[*axis] < min[*axis]
            };
            area && towards
        })
        .map(|(axis, up)| face(bounds, axis, up))
        .collect()
}

/// Checks that target polygons are hidden from a cell. There must be a proof for each pair of a face of the
/// cell and a target with a part beyond the face. With `half`, only the part of the cell on the other side of
/// the target's plane needs a proof.
fn check_proofs(
    scene: &Triangles<'_>,
    cell: Aabb,
    targets: &[Corners],
    half: Option<Ordering>,
    proofs: &[Proof],
) -> Result<(), String> {
    let mut shown = Vec::with_capacity(proofs.len());
    let mut proofs = proofs.iter();
    for (axis, up) in faces() {
        let flat = face_plane(cell, axis, up);
        let from = face(cell, axis, up);
        for target in targets {
            let Some(beyond) = clip(target, &flat, Ordering::Greater) else {
                continue;
            };
            let proof = proofs
                .next()
                .ok_or("a proof is missing for a face of the cell and a target polygon")?;
            let part = match half {
                None => Some(from.clone()),
                Some(side) => clip(
                    &from,
                    &plane([&target[0], &target[1], &target[2]]),
                    side.reverse(),
                ),
            };
            shown.push((part, beyond, proof));
        }
    }
    if proofs.next().is_some() {
        return Err(
            "the certificate has more proofs than pairs of a cell face and a target polygon"
                .to_owned(),
        );
    }
    let refusal = shown
        .par_iter()
        .with_max_len(1)
        .find_map_first(|(part, beyond, proof)| {
            check_hidden(
                scene.blocking(),
                part.as_slice(),
                std::slice::from_ref(beyond),
                proof,
            )
            .err()
        });
    match refusal {
        None => Ok(()),
        Some(e @ Refusal::Polygon) => Err(format!(
            "a face of the cell or a target polygon is invalid: {e}"
        )),
        Some(e) => Err(e.to_string()),
    }
}
