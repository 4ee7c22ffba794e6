//! Verification of a whole result: checks every witness and every certificate against the scene.

mod consistency;
#[cfg(feature = "pvs")]
mod pvs;
mod reader;
mod result;
mod sample;
mod separate_cells;
mod totals;

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use glam::Vec3;
use rayon::prelude::*;

use crate::certificate::{CellCertificate, HiddenGroup};
use crate::checker::{CellClaims, CellRefusal, Claim, Kinds, Triangles, check_cell_until};
pub use reader::{CertificateReader, Certificates, ReadError};
pub use result::{BakedResult, NOT_REACHED, SET_ASIDE};
pub use sample::Sample;
use sample::SampledTriangles;
use totals::CellTotals;
pub use totals::{Count, Hidden, Totals};

/// The maximum size of the compressed certificates that are checked at the same time, in bytes. A cell with a
/// larger certificate is checked separately.
const BATCH_BYTES: usize = 16 << 20;

/// A callback that receives the number of cells verified so far and the number of all cells of the result.
pub type OnProgress<'a> = dyn Fn(u32, u32) + Sync + 'a;

/// The options of [`verify`]. The default checks every claim.
#[derive(Clone, Copy, Default)]
pub struct VerifyOptions<'a> {
    /// The kinds of the triangles. By default, all triangles block and show.
    pub kinds: Kinds<'a>,
    /// The sample of pairs of cell and triangle whose claims are checked; `None` checks all claims. The check
    /// that every triangle is accounted for is independent of the sample.
    pub sample: Option<Sample>,
    /// The callback that runs after each batch of cells.
    pub progress: Option<&'a OnProgress<'a>>,
    /// The callback that the verification calls between claims. The verification stops soon after the
    /// callback returns true.
    pub cancelled: Option<&'a (dyn Fn() -> bool + Sync)>,
}

/// The counts of an accepted verification.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// The number of cells.
    pub cells: u32,
    /// The number of pairs of cell and triangle.
    pub pairs: u64,
    /// The number of claims found and the number checked, by kind.
    pub totals: Totals,
}

impl Report {
    /// Returns the number of pairs whose triangle has no area. Such triangles are never visible.
    pub fn without_area(&self) -> u64 {
        let t = &self.totals;
        self.pairs
            .saturating_sub(t.witnesses.all + t.meeting.all + t.hidden.sum() + t.undecided)
    }
}

/// The reason why a result is not accepted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VerifyError {
    /// The result has no certificates.
    #[error("the result of method {method} has no certificates; bake it with certificates")]
    NoCertificates {
        /// The method that the result states.
        method: String,
    },
    /// The result was baked from a scene with another number of triangles.
    #[error("the scene of the result has {result} triangles, but the given scene has {scene}")]
    OtherScene {
        /// The number of triangles of the given scene.
        scene: usize,
        /// The number of triangles of the scene from which the result was baked.
        result: u32,
    },
    /// A claim does not hold.
    #[error(transparent)]
    Refused(#[from] Refused),
    /// The caller cancelled the verification. All cells verified before were accepted.
    #[error(
        "the caller cancelled the verification; {verified} of {cells} cells verified so far, all accepted"
    )]
    Cancelled {
        /// The number of cells that were verified and accepted.
        verified: u32,
        /// The number of cells.
        cells: u32,
    },
}

/// A claim of a result that does not hold.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{reason}", .cell.map_or(String::new(), |cell| format!("cell {cell}: ")))]
pub struct Refused {
    /// The cell of the claim; `None` if the claim is about the whole result.
    pub cell: Option<u32>,
    /// The triangles that the claim is about; empty if the claim is about no triangle or about the whole
    /// cell.
    pub triangles: Vec<u32>,
    /// The reason why the claim does not hold.
    pub reason: String,
}

/// Checks the witnesses and certificates of a result against its scene. `triangles` must be in the order of
/// the scene.
///
/// Uses the current rayon pool. The first rejected cell is the same on every run.
///
/// # Errors
/// [`VerifyError`] if the result is rejected, or if the verification did not finish.
pub fn verify(
    triangles: &[[Vec3; 3]],
    result: &dyn BakedResult,
    options: &VerifyOptions<'_>,
) -> Result<Report, VerifyError> {
    let cells = result.cell_count();
    if triangles.len() as u64 != u64::from(result.triangle_count()) {
        return Err(VerifyError::OtherScene {
            scene: triangles.len(),
            result: result.triangle_count(),
        });
    }
    let whole = |reason| Refused {
        cell: None,
        triangles: Vec::new(),
        reason,
    };
    if cells > 0 && result.certificate(0).map_err(whole)?.is_none() {
        return Err(VerifyError::NoCertificates {
            method: result.method().to_owned(),
        });
    }
    consistency::check(result).map_err(whole)?;
    let drawn = options
        .sample
        .map(|s| s.draw(cells, result.triangle_count()));
    let never = || false;
    let verification = Verification {
        result,
        scene: Triangles::with_kinds(triangles, options.kinds),
        reader: CertificateReader::default(),
        drawn: drawn.as_ref(),
        cancelled: options.cancelled.unwrap_or(&never),
    };
    let mut totals = Totals::default();
    let mut group_claims = BTreeSet::new();
    let mut apart = Vec::new();
    let mut next = 0;
    while next < cells {
        let batch = verification.batch(next);
        let check = |cell: &u32| verification.cell(*cell);
        let checked: Vec<Result<CellTotals, Stop>> =
            batch.par_iter().with_max_len(1).map(check).collect();
        let mut verified = next;
        let mut cancelled = false;
        for (cell, checked) in batch.iter().zip(checked) {
            match checked {
                Ok(of_cell) => {
                    verified += 1;
                    totals += of_cell.totals;
                    group_claims.extend(of_cell.group_claims);
                    apart.push(of_cell.apart);
                }
                Err(Stop::Cancelled) => cancelled = true,
                Err(Stop::Refused { triangles, reason }) => {
                    return Err(Refused {
                        cell: Some(*cell),
                        triangles,
                        reason,
                    }
                    .into());
                }
            }
        }
        if cancelled {
            return Err(VerifyError::Cancelled { verified, cells });
        }
        next += batch.len() as u32;
        if let Some(progress) = options.progress {
            progress(next, cells);
        }
    }
    totals.cells_apart =
        separate_cells::check(result, &apart).map_err(|(cell, reason)| Refused {
            cell: Some(cell),
            triangles: Vec::new(),
            reason,
        })?;
    // Several cells of a sample may rely on one certificate of a cell group, which counts once.
    totals.certificates.checked += group_claims.len() as u64;
    Ok(Report {
        cells,
        pairs: u64::from(cells) * triangles.len() as u64,
        totals,
    })
}

/// The reason why the check of a cell ended early.
enum Stop {
    Cancelled,
    Refused { triangles: Vec<u32>, reason: String },
}

impl From<String> for Stop {
    fn from(reason: String) -> Self {
        Self::Refused {
            triangles: Vec::new(),
            reason,
        }
    }
}

impl From<ReadError> for Stop {
    fn from(e: ReadError) -> Self {
        e.to_string().into()
    }
}

impl From<CellRefusal> for Stop {
    fn from(e: CellRefusal) -> Self {
        match e {
            CellRefusal::Cancelled => Self::Cancelled,
            e => Self::Refused {
                triangles: e.triangles(),
                reason: e.to_string(),
            },
        }
    }
}

/// A verification in progress.
struct Verification<'a> {
    result: &'a dyn BakedResult,
    scene: Triangles<'a>,
    reader: CertificateReader,
    drawn: Option<&'a SampledTriangles>,
    cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl Verification<'_> {
    /// Returns the cells from `first` on that are checked at the same time. These cells are enough to occupy
    /// all threads if one cell has a long proof, and few enough that all their certificates fit in memory.
    fn batch(&self, first: u32) -> Vec<u32> {
        let mut bytes = 0;
        let end = first
            .saturating_add(2 * rayon::current_num_threads() as u32)
            .min(self.result.cell_count());
        let fits = |cell: &u32| {
            // A certificate that cannot be read is rejected when its cell is checked.
            bytes += self
                .result
                .certificate(*cell)
                .ok()
                .flatten()
                .map_or(0, <[u8]>::len);
            *cell == first || bytes <= BATCH_BYTES
        };
        (first..end).take_while(fits).collect()
    }

    /// Checks the selected claims of one cell.
    fn cell(&self, cell: u32) -> Result<CellTotals, Stop> {
        if (self.cancelled)() {
            return Err(Stop::Cancelled);
        }
        let nothing = BTreeSet::new();
        // Without a sample, every triangle is selected.
        let wanted = self.drawn.map(|d| d.get(&cell).unwrap_or(&nothing));
        let visible = self.result.visible(cell)?;
        let undecided = self.result.undecided(cell)?;
        let unreached = self.result.flags(cell)? & NOT_REACHED != 0;
        if unreached && !visible.is_empty() {
            return Err("no viewpoint is in the cell, but its set is not empty"
                .to_owned()
                .into());
        }
        let bounds = self
            .result
            .cell_bounds(cell)
            .ok_or_else(|| "the result has no bounds for the cell".to_owned())?;
        let certificates = self
            .reader
            .read(self.result, cell)?
            .ok_or_else(|| "the result has no certificate for the cell".to_owned())?;
        // The certificates of a cell without viewpoints are not checked like the certificates of other cells,
        // so other cells must not rely on them.
        let only_boxes = CellCertificate {
            apart: certificates.own.apart.clone(),
            ..CellCertificate::default()
        };
        if unreached && (certificates.own != only_boxes || !undecided.is_empty()) {
            return Err(
                "no viewpoint is in the cell, but the result makes claims about triangles"
                    .to_owned()
                    .into(),
            );
        }
        let mut out = CellTotals::default();
        out.totals.undecided = undecided.len() as u64;
        out.totals.bytes = self.result.certificate(cell)?.map_or(0, |e| e.len() as u64);
        let (own, above) = (&certificates.own, certificates.above());
        let claims = CellClaims {
            cell: bounds,
            visible: &visible,
            undecided: &undecided,
            certificate: own,
            above,
        };
        let [witnesses, proofs, meeting, boxes] = [const { [const { AtomicU64::new(0) }; 2] }; 4];
        let group_claims = Mutex::new(Vec::new());
        let any =
            |group: &HiddenGroup, w: &BTreeSet<u32>| group.triangles.iter().any(|t| w.contains(t));
        let pick = |claim: Claim| {
            let (counts, take) = match claim {
                Claim::Seen(at) => (
                    &witnesses,
                    wanted.is_none_or(|w| w.contains(&own.seen[at].0)),
                ),
                Claim::Hidden(at) => (&proofs, wanted.is_none_or(|w| any(&own.hidden[at], w))),
                // This cell stores the certificate for other cells, too. The group is checked once: with this
                // cell, or for the cell of a sample that relies on the group.
                Claim::Shared(_) => (&proofs, wanted.is_none()),
                Claim::Above(at) => {
                    let shared_group = above.and_then(|shared| shared.hidden.get(at));
                    let take =
                        wanted.is_some_and(|w| shared_group.is_some_and(|group| any(group, w)));
                    if take {
                        group_claims
                            .lock()
                            .unwrap_or_else(PoisonError::into_inner)
                            .push(at);
                    }
                    return take;
                }
                Claim::Meets(id) => (&meeting, wanted.is_none_or(|w| w.contains(&id))),
                // With a sample, check as many boxes of a cell as pairs were drawn, from an arbitrary start.
                Claim::Apart(at) => (
                    &boxes,
                    wanted.is_none_or(|w| drawn_box(at, own.apart.len(), w)),
                ),
            };
            counts[0].fetch_add(1, Ordering::Relaxed);
            counts[1].fetch_add(u64::from(take), Ordering::Relaxed);
            take
        };
        out.totals.cells_unreached = u64::from(unreached);
        if unreached {
            // The cell makes no claims about triangles, only about other cells.
            separate_cells::check_boxes(&self.scene, &claims, &pick, self.cancelled)?;
        } else {
            check_cell_until(&self.scene, &claims, &pick, self.cancelled)?;
        }
        let group_claims = group_claims
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner);
        out.group_claims = group_claims
            .into_iter()
            .filter_map(|at| Some((certificates.keeper()?, at)))
            .collect();
        // The check has shown that no triangle is in two groups.
        certificates
            .hidden()
            .for_each(|group| out.totals.hidden.add(group));
        let count = |[all, checked]: [AtomicU64; 2]| Count {
            all: all.into_inner(),
            checked: checked.into_inner(),
        };
        out.totals.witnesses = count(witnesses);
        out.totals.certificates = count(proofs);
        out.totals.meeting = count(meeting);
        out.totals.apart = count(boxes);
        out.apart = certificates
            .own
            .apart
            .iter()
            .map(|hidden_box| hidden_box.bounds)
            .collect();
        Ok(out)
    }
}

/// Returns true if a sample contains the box `at` of `count` boxes. The sample has as many boxes as drawn
/// pairs of the cell, in order from a start that depends on these pairs.
fn drawn_box(at: usize, count: usize, wanted: &BTreeSet<u32>) -> bool {
    let from = wanted.iter().fold(0usize, |sum, id| {
        sum.wrapping_mul(31).wrapping_add(*id as usize)
    }) % count;
    (at + count - from) % count < wanted.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sample_draws_one_box_per_pair_and_reaches_all() {
        let mut ever = BTreeSet::new();
        for id in 0..40 {
            let wanted = BTreeSet::from([id, id + 7]);
            let drawn: Vec<usize> = (0..9).filter(|at| drawn_box(*at, 9, &wanted)).collect();
            assert_eq!(drawn.len(), 2, "{drawn:?}");
            ever.extend(drawn);
        }
        assert_eq!(ever.len(), 9);
        assert!((0..9).all(|at| !drawn_box(at, 9, &BTreeSet::new())));
    }
}
