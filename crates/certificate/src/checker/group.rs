//! Whether a group of triangles is hidden from a cell: by closed surfaces, or by a proof for each pair of
//! faces.

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

/// Most corners of a target polygon. No search makes more, and the check of convexity is quadratic.
const MAX_CORNERS: usize = 64;

/// The parity of a cell by surface, computed on first use; see [`super::surfaces`].
pub(super) type Parities = [OnceLock<Option<bool>>];

/// Accepts that a closed surface hides a triangle from the whole cell: no point of the cell is on the other
/// side of its plane than the hidden one.
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
        return Err("a part of the cell is not on its hidden side");
    }
    Ok(())
}

/// Accepts that a group of triangles is hidden from a cell, or says why that is not shown.
pub(super) fn check_group(
    scene: &Triangles<'_>,
    cell: Aabb,
    parity: &Parities,
    group: &HiddenGroup,
) -> Result<(), String> {
    let all = scene.all();
    if group.triangles.iter().any(|id| *id as usize >= all.len()) {
        return Err("there is no such triangle in the scene".to_owned());
    }
    let targets: Vec<Corners> = match &group.target {
        Target::Surfaces => {
            if !group.proofs.is_empty() {
                return Err("it is hidden by surfaces and must have no proofs".to_owned());
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
                return Err("it must have exactly one triangle".to_owned());
            };
            if meets_box(&all[id as usize], cell) {
                return Err("it meets the cell".to_owned());
            }
            if has_area(&all[id as usize]) {
                vec![exact(&all[id as usize]).into()]
            } else {
                Vec::new()
            }
        }
        Target::Polygon(corners) => {
            if corners.len() > MAX_CORNERS {
                return Err(format!("its polygon has more than {MAX_CORNERS} corners"));
            }
            let corners: Corners = corners
                .iter()
                .map(|c| point(c.as_dvec3().to_array()))
                .collect();
            let target = [corners];
            // The containment test below holds for convex flat polygons only.
            check_polygons(&target).map_err(|e| e.to_string())?;
            for id in &group.triangles {
                if meets_box(&all[*id as usize], cell) {
                    return Err(format!("triangle {id} meets the cell"));
                }
                if !exact(&all[*id as usize])
                    .iter()
                    .all(|p| within(&target[0], p))
                {
                    return Err(format!("triangle {id} is not in its polygon"));
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
                return Err(format!("triangle {id} is not in its box"));
            }
            if of.touches(&cell) {
                return Err("its box touches the cell".to_owned());
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
    check_proofs(scene, cell, (&targets, half), &group.proofs)
}

/// Accepts that a box is hidden from a cell, or says why that is not shown. A segment from the cell to the
/// box leaves the cell through a face and enters the box through a face. Where both share an edge or a
/// corner, the segments through it form no open set; where they share a part of a face, segments pass it
/// without being between the faces, so that is refused.
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
        (&faces_towards(bounds, cell), None),
        &apart.proofs,
    )
}

fn check_box(Aabb { min, max }: Aabb) -> Result<(), String> {
    match min.is_finite() && max.is_finite() && min.cmple(max).all() {
        true => Ok(()),
        false => Err("its box is not finite or its corners are not in order".to_owned()),
    }
}

/// The faces with area of a box through which segments from a cell can enter it.
fn faces_towards(of: Aabb, cell: Aabb) -> Vec<Corners> {
    let Aabb { min, max } = of;
    faces()
        .filter(|(axis, up)| {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let area = min[u] < max[u] && min[v] < max[v];
            // Whether a point of the cell is on the outer side of the face.
            let towards = if *up {
                cell.max[*axis] > max[*axis]
            } else {
                cell.min[*axis] < min[*axis]
            };
            area && towards
        })
        .map(|(axis, up)| face(of, axis, up))
        .collect()
}

/// Accepts that target polygons are hidden from a cell: there is a proof for each pair of a face of the cell
/// and a target that has a part beyond the face. With `half`, only the part of the cell on the other side of
/// the target's plane needs one.
fn check_proofs(
    scene: &Triangles<'_>,
    cell: Aabb,
    (targets, half): (&[Corners], Option<Ordering>),
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
                .ok_or("a proof is missing for a pair of faces")?;
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
        return Err("it has more proofs than pairs of faces".to_owned());
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
        Some(e @ Refusal::Polygon) => Err(format!("a face is not a valid polygon: {e}")),
        Some(e) => Err(e.to_string()),
    }
}
