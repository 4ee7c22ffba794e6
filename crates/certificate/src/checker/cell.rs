//! The check that the certificate of a view cell proves the claims of the cell's set.
//!
//! A cell makes the following claims, which the checker verifies:
//!
//! 1. *Every triangle is accounted for.* Each triangle with area is in the set with a reason, in the set and
//!    undecided, or hidden. The reason for a visible triangle is that it meets the cell, or a witness. A
//!    hidden triangle is in exactly one group, either of the cell or of a cell group's box that contains the
//!    cell.
//! 2. *Seen.* A witness starts in the cell and ends inside the triangle. No other triangle has a point on the
//!    witness, except triangles in the plane of the shown triangle. If the witness starts on a face of the
//!    cell and leaves the cell there, a triangle in that face's plane may touch the start of the witness.
//! 3. *Hidden.* A group's triangles lie in its box or polygon (or are its only triangle), and neither the box
//!    nor the triangles touch the cell. A segment from the cell to the box leaves the cell through a face of
//!    the cell and enters the box through a face of the box. For every pair of such faces there is a proof
//!    ([`super::check_hidden`]) about the part of the box's face that is outside the cell's face. Faces
//!    without area pass no open set of lines. A triangle hidden by its closed surface needs no proof;
//!    `surfaces.rs` contains the argument.
//!
//! A triangle that is hidden from a box is hidden from every cell in the box. The checker tests the groups of
//! a cell group like the groups of a cell, with the box in place of the cell.

use std::sync::OnceLock;

use rayon::prelude::*;
use sightline_numbers::Aabb;

use super::boxes::meets_box;
use super::geometry::has_area;
use super::group::{Parities, check_apart, check_group};
use super::triangles::Triangles;
use super::witness::check_cell_witness;
use crate::certificate::{CellCertificate, GroupCertificate, HiddenGroup, Target};

/// The claims of a result about one cell.
#[derive(Clone, Copy, Debug)]
pub struct CellClaims<'a> {
    /// The lowest and the highest corner of the cell, in scene coordinates.
    pub cell: Aabb,
    /// The visibility set including the undecided triangles, ascending.
    pub visible: &'a [u32],
    /// The undecided triangles of the set, ascending.
    pub undecided: &'a [u32],
    /// The certificate with the reasons for the set.
    pub certificate: &'a CellCertificate,
    /// The certificate of the box around the cell that [`CellCertificate::above`] refers to.
    pub above: Option<&'a GroupCertificate>,
}

/// One claim about a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Claim {
    /// The triangle with this id meets the cell.
    Meets(u32),
    /// The witness at this index of [`CellCertificate::seen`] holds.
    Seen(usize),
    /// The group at this index of [`CellCertificate::hidden`] is hidden.
    Hidden(usize),
    /// The group at this index of [`CellCertificate::shared`] is hidden. The check needs no other cell.
    Shared(usize),
    /// The group at this index of [`CellClaims::above`] is hidden. A caller that checks every cell of a
    /// result checks the same group as [`Claim::Shared`] of the cell that stores it.
    Above(usize),
    /// The box at this index of [`CellCertificate::apart`] is hidden.
    Apart(usize),
}

/// The reason why the checker rejects the claims about a cell.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CellRefusal {
    /// The cell is not a box with a volume.
    #[error("the cell is not a box with a volume")]
    Cell,
    /// The set is not ascending, or the certificate does not account for a triangle.
    #[error("triangle {0}: {1}")]
    Account(u32, &'static str),
    /// A visible triangle neither meets the cell nor has a witness.
    #[error("triangle {0} is in the set, but it does not meet the cell and has no witness")]
    NoWitness(u32),
    /// The cell relies on the certificate of a box that does not contain it, or that is missing.
    #[error("the certificate of the cell's group is missing, or its box does not contain the cell")]
    Above,
    /// A witness does not show its triangle.
    #[error("the witness for triangle {0}: {1}")]
    Witness(u32, String),
    /// A group of triangles is not shown to be hidden.
    #[error("the certificate for {}: {reason}", group(triangles))]
    Hidden {
        /// The triangles of the group.
        triangles: Vec<u32>,
        /// The reason why the group is not shown to be hidden.
        reason: String,
    },
    /// A box is not shown to be hidden.
    #[error("the certificate for the hidden box {} to {}: {reason}", bounds.min, bounds.max)]
    Apart {
        /// The bounds of the box.
        bounds: Aabb,
        /// The reason why the box is not shown to be hidden.
        reason: String,
    },
    /// The caller of [`check_cell_until`] cancelled the check.
    #[error("the check was cancelled")]
    Cancelled,
}

impl CellRefusal {
    /// Returns the triangles that the rejected claim is about, or no triangles if it is about the whole cell.
    pub fn triangles(&self) -> Vec<u32> {
        match self {
            Self::Account(id, _) | Self::NoWitness(id) | Self::Witness(id, _) => vec![*id],
            Self::Hidden { triangles, .. } => triangles.clone(),
            Self::Cell | Self::Above | Self::Apart { .. } | Self::Cancelled => Vec::new(),
        }
    }
}

fn group(triangles: &[u32]) -> String {
    match triangles {
        [one] => format!("triangle {one}"),
        [first, _] => format!("triangle {first} and 1 other"),
        [first, ..] => format!("triangle {first} and {} others", triangles.len() - 1),
        [] => "an empty group".to_owned(),
    }
}

/// Checks that every triangle is accounted for, and then each claim for which `pick` returns true. Returns
/// the number of checked claims. Calls `pick` once for every claim.
///
/// # Errors
/// [`CellRefusal`] for the first claim, in the order of the claims, that does not hold.
pub fn check_cell(
    scene: &Triangles<'_>,
    claims: &CellClaims<'_>,
    pick: &(dyn Fn(Claim) -> bool + Sync),
) -> Result<u64, CellRefusal> {
    check_cell_until(scene, claims, pick, &|| false)
}

/// Checks claims like [`check_cell`], but stops soon after `cancelled` returns true.
///
/// # Errors
/// The errors of [`check_cell`], and [`CellRefusal::Cancelled`] if `cancelled` returned true.
pub fn check_cell_until(
    scene: &Triangles<'_>,
    claims: &CellClaims<'_>,
    pick: &(dyn Fn(Claim) -> bool + Sync),
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<u64, CellRefusal> {
    let Aabb { min, max } = claims.cell;
    if !(min.cmplt(max).all() && min.is_finite() && max.is_finite()) {
        return Err(CellRefusal::Cell);
    }
    let mut picked = account(scene, claims)?;
    picked.retain(|claim| pick(*claim));
    // Computing the surfaces of a scene costs time. Only groups that refer to surfaces need them.
    let by_surface = |h: &HiddenGroup| matches!(h.target, Target::Surfaces | Target::Half);
    let surfaces = if claims.certificate.hidden.iter().any(by_surface) {
        scene.surfaces().len()
    } else {
        0
    };
    let parity = vec![OnceLock::new(); surfaces];
    let refuse = |claim: &Claim| {
        if cancelled() {
            Some(CellRefusal::Cancelled)
        } else {
            check(scene, claims, &parity, *claim).err()
        }
    };
    // The first rejected claim is deterministic. Each task checks one claim, because one box can cost as much
    // time as a thousand triangles.
    let refusal = picked.par_iter().with_max_len(1).find_map_first(refuse);
    refusal.map_or(Ok(picked.len() as u64), Err)
}

fn check(
    scene: &Triangles<'_>,
    claims: &CellClaims<'_>,
    parity: &Parities,
    claim: Claim,
) -> Result<(), CellRefusal> {
    match claim {
        Claim::Meets(id) => {
            if !meets_box(&scene.all()[id as usize], claims.cell) {
                return Err(CellRefusal::NoWitness(id));
            }
        }
        Claim::Seen(at) => {
            let (id, witness) = &claims.certificate.seen[at];
            check_cell_witness(scene, claims.cell, *id, witness)
                .map_err(|e| CellRefusal::Witness(*id, e))?;
        }
        Claim::Hidden(at) => {
            let group = &claims.certificate.hidden[at];
            check_group(scene, claims.cell, parity, group).map_err(|reason| {
                CellRefusal::Hidden {
                    triangles: group.triangles.clone(),
                    reason,
                }
            })?;
        }
        Claim::Shared(at) => check_shared(scene, claims.certificate.shared.as_ref(), at)?,
        Claim::Above(at) => check_shared(scene, claims.above, at)?,
        Claim::Apart(at) => check_box_claim(scene, claims, at)?,
    }
    Ok(())
}

/// Checks the claim that the box at an index of [`CellCertificate::apart`] is hidden from the cell.
///
/// # Errors
/// [`CellRefusal::Apart`] if the claim is not proved. [`CellRefusal::Cell`] if the cell has no volume.
pub fn check_box_claim(
    scene: &Triangles<'_>,
    claims: &CellClaims<'_>,
    at: usize,
) -> Result<(), CellRefusal> {
    let Aabb { min, max } = claims.cell;
    if !(min.cmplt(max).all() && min.is_finite() && max.is_finite()) {
        return Err(CellRefusal::Cell);
    }
    let apart = &claims.certificate.apart[at];
    check_apart(scene, claims.cell, apart).map_err(|reason| CellRefusal::Apart {
        bounds: apart.bounds,
        reason,
    })
}

/// Checks the claim that a group of triangles is hidden from the box of a cell group.
fn check_shared(
    scene: &Triangles<'_>,
    shared: Option<&GroupCertificate>,
    at: usize,
) -> Result<(), CellRefusal> {
    let Some((shared, group)) = shared.and_then(|s| Some((s, s.hidden.get(at)?))) else {
        return Err(CellRefusal::Above);
    };
    let Aabb { min, max } = shared.bounds;
    let checked = if !(min.cmplt(max).all() && min.is_finite() && max.is_finite()) {
        Err("the box of the cell group has no volume".to_owned())
    } else if matches!(group.target, Target::Surfaces | Target::Half) {
        Err(
            "closed surfaces are not allowed as a reason in the certificate of a cell group"
                .to_owned(),
        )
    } else {
        check_group(scene, shared.bounds, &[], group)
    };
    checked.map_err(|reason| CellRefusal::Hidden {
        triangles: group.triangles.clone(),
        reason,
    })
}

/// Checks that every triangle with area has exactly one claim, and returns all claims.
fn account(scene: &Triangles<'_>, claims: &CellClaims<'_>) -> Result<Vec<Claim>, CellRefusal> {
    let refuse = |id: u32, what| Err(CellRefusal::Account(id, what));
    let n = scene.all().len();
    for set in [claims.visible, claims.undecided] {
        if let Some(w) = set.windows(2).find(|w| w[0] >= w[1]) {
            return refuse(
                w[1],
                "the triangle ids of the set are not in ascending order",
            );
        }
        if let Some(id) = set.last().filter(|id| **id as usize >= n) {
            return refuse(*id, "the scene does not contain this triangle");
        }
    }
    /// The claim that the certificate has made so far about one triangle.
    #[derive(Clone, Copy, PartialEq)]
    enum ClaimState {
        /// No claim.
        Nothing,
        /// The set contains the triangle, and no witness for the triangle was read.
        Visible,
        /// The set contains the triangle as undecided, so no reason is needed.
        Undecided,
        /// One witness or one hidden group is the reason of the claim. The checker rejects a second reason.
        Accounted,
    }
    if let Some(id) = claims.visible.iter().find(|id| !scene.shows(**id)) {
        return refuse(
            *id,
            "the set contains the triangle, but its kind is never visible",
        );
    }
    let mut known = vec![ClaimState::Nothing; n];
    claims
        .visible
        .iter()
        .for_each(|id| known[*id as usize] = ClaimState::Visible);
    for id in claims.undecided {
        if known[*id as usize] != ClaimState::Visible {
            return refuse(*id, "the triangle is undecided but not in the set");
        }
        known[*id as usize] = ClaimState::Undecided;
    }
    let mut all = Vec::new();
    for (at, (id, _)) in claims.certificate.seen.iter().enumerate() {
        match known.get_mut(*id as usize) {
            Some(k @ ClaimState::Visible) => *k = ClaimState::Accounted,
            _ => {
                return refuse(
                    *id,
                    "the triangle has a witness but is not in the set, or is undecided, or has two \
                     witnesses",
                );
            }
        }
        all.push(Claim::Seen(at));
    }
    for (at, group) in claims.certificate.hidden.iter().enumerate() {
        for id in &group.triangles {
            match known.get_mut(*id as usize) {
                Some(k @ ClaimState::Nothing) => *k = ClaimState::Accounted,
                _ => {
                    return refuse(
                        *id,
                        "the triangle is in a hidden group and also in the set or in another group",
                    );
                }
            }
        }
        all.push(Claim::Hidden(at));
    }
    if claims.above.is_some() != claims.certificate.above.is_some() {
        return Err(CellRefusal::Above);
    }
    if let Some(shared) = claims.above {
        let Aabb { min, max } = shared.bounds;
        if !(min.cmple(claims.cell.min).all() && max.cmpge(claims.cell.max).all()) {
            return Err(CellRefusal::Above);
        }
        for (at, group) in shared.hidden.iter().enumerate() {
            for id in &group.triangles {
                match known.get_mut(*id as usize) {
                    Some(k @ ClaimState::Nothing) => *k = ClaimState::Accounted,
                    _ => {
                        return refuse(
                            *id,
                            "the triangle is hidden from the cell group and also in the set or in another \
                             group",
                        );
                    }
                }
            }
            all.push(Claim::Above(at));
        }
    }
    all.extend((0..claims.certificate.apart.len()).map(Claim::Apart));
    all.extend(
        (0..claims
            .certificate
            .shared
            .as_ref()
            .map_or(0, |s| s.hidden.len()))
            .map(Claim::Shared),
    );
    for (id, (k, t)) in known.iter().zip(scene.all()).enumerate() {
        match k {
            ClaimState::Visible => all.push(Claim::Meets(id as u32)),
            ClaimState::Nothing if has_area(t) && scene.shows(id as u32) => {
                return refuse(
                    id as u32,
                    "the triangle is not in the set, and no proof shows that it is hidden",
                );
            }
            _ => {}
        }
    }
    Ok(all)
}
