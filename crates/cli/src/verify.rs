//! `sightline verify`: every witness and every certificate of a result checked again, by the checker alone.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;
use serde_json::json;
use sightline_exact::checker::{CellClaims, Claim, Triangles, check_cell};
use sightline_exact::evidence::{Hidden, Target};
use sightline_pvs::{Pvs, SET_ASIDE};

use crate::args::VerifyArgs;
use crate::certificates::Reader;
use crate::error::CliError;
use crate::inspect;
use crate::progress::{Progress, human, say};
use crate::serve::{self, print, threads};

/// Bytes of evidence that are decoded at the same time, but for a cell that has more.
const AT_ONCE: usize = 16 << 20;

/// Checks a result against its scene.
pub fn run(args: &VerifyArgs, json: bool) -> Result<(), CliError> {
    serve::use_threads(threads(args.threads.map(usize::from)))?;
    let scene = sightline_scene::load(&args.scene)?;
    let pvs = inspect::open(&args.result)?;
    inspect::check_scene(&scene, &pvs, &args.scene, &args.result)?;
    if pvs.cells() > 0 && pvs.certificate(0)?.is_none() {
        return Err(CliError::Input(format!(
            "{} has no certificates (method {}), so there is nothing to verify; bake it with {}--certificates",
            args.result.display(),
            pvs.method(),
            if pvs.method() == "aggressive" { "--method exact " } else { "" }
        )));
    }
    if let Err(why) = consistent(&pvs) {
        if json {
            print(&json!({"accepted": false, "reason": why}).to_string())?;
        }
        return Err(CliError::Input(format!(
            "REFUSED: {}: {why}; the result is damaged or was altered, bake it again",
            args.result.display()
        )));
    }
    let raw: Vec<[Vec3; 3]> = scene.triangles().iter().map(|t| t.v).collect();
    let triangles = Triangles::new(&raw);
    let sample = args.sample.map(|n| draw(n, args.seed, pvs.cells(), scene.len()));
    let reader = Reader::default();
    let progress = Progress::new();
    let start = Instant::now();
    let mut totals = Totals::default();
    let mut next = 0;
    while next < pvs.cells() {
        let some = few(&pvs, next);
        next += some.len() as u32;
        let check = |cell: &u32| {
            let wanted = sample.as_ref().map(|s| s.get(cell).cloned().unwrap_or_default());
            check_one((&pvs, &reader), &triangles, *cell, wanted.as_ref())
        };
        let checked: Vec<Result<Totals, String>> = some.par_iter().with_max_len(1).map(check).collect();
        for (cell, checked) in some.iter().zip(checked) {
            match checked {
                Ok(of_cell) => totals += of_cell,
                Err(why) => {
                    progress.end();
                    if json {
                        print(&json!({"accepted": false, "cell": cell, "reason": why}).to_string())?;
                    }
                    return Err(CliError::Input(format!(
                        "REFUSED: {}, cell {cell}: {why}; the result is damaged or was altered, bake it again",
                        args.result.display()
                    )));
                }
            }
        }
        progress.count(u64::from(next), u64::from(pvs.cells()), "cells");
    }
    progress.end();
    say(&format!("verified in {}", human(start.elapsed())));
    totals.checked[1] += totals.rested.len() as u64;
    let [witnesses, certificates, meeting] = totals.checked;
    let [by_surface, in_boxes, alone] = totals.hidden;
    let pairs = u64::from(pvs.cells()) * u64::from(scene.len());
    let known = totals.all[0] + totals.all[2] + by_surface + in_boxes + alone + totals.undecided;
    if json {
        return print(
            &json!({
                "accepted": true,
                "method": pvs.method(),
                "cells": pvs.cells(),
                "pairs": pairs,
                "witnesses": totals.all[0],
                "certificates": totals.all[1],
                "meeting": totals.all[2],
                "witnesses_checked": witnesses,
                "certificates_checked": certificates,
                "meeting_checked": meeting,
                "hidden_by_surfaces": by_surface,
                "hidden_in_boxes": in_boxes,
                "hidden_alone": alone,
                "undecided": totals.undecided,
                "without_area": pairs - known,
                "evidence_bytes": totals.bytes,
                "sampled": args.sample.is_some(),
                "sample": args.sample,
                "seed": args.sample.map(|_| args.seed),
            })
            .to_string(),
        );
    }
    print(&format!(
        "accepted{}: {pairs} pairs of cell and triangle in {} cells\n\
         seen: {} with a witness ({witnesses} checked), {} meet their cell ({meeting} checked)\n\
         hidden: {by_surface} by the closed surface they are part of, {in_boxes} in hidden boxes, {alone} alone or with their polygon; \
         {} certificates ({certificates} checked), {} bytes with the witnesses\n\
         neither: {} undecided, {} without area",
        args.sample.map_or(String::new(), |n| format!(" by a sample of {n} pairs")),
        pvs.cells(),
        totals.all[0],
        totals.all[2],
        totals.all[1],
        totals.bytes,
        totals.undecided,
        pairs - known,
    ))
}

/// Whether what a result says of itself, and of which there is no other evidence, agrees with what is in it.
fn consistent(pvs: &Pvs) -> Result<(), String> {
    let info: serde_json::Value =
        serde_json::from_str(pvs.info_json()).map_err(|e| format!("its parameters are no JSON: {e}"))?;
    let method = pvs.method();
    if !["exact", "verified"].contains(&method) {
        return Err(format!("{method:?} is no method that has certificates"));
    }
    // A result of another program need not say.
    if info["method"].as_str().is_some_and(|m| m != method) {
        return Err(format!("its method is {method}, and {} in its parameters", info["method"]));
    }
    if let Some(grid) = info["division"]["grid"].as_array() {
        let cells = grid.iter().try_fold(1u64, |n, side| n.checked_mul(side.as_u64()?));
        if cells != Some(u64::from(pvs.cells())) {
            return Err(format!(
                "its parameters say {} cells, and it has {}",
                info["division"]["grid"],
                pvs.cells()
            ));
        }
    }
    for cell in 0..pvs.cells() {
        let flags = pvs.flags(cell).map_err(|e| e.to_string())?;
        if flags & !SET_ASIDE != 0 {
            return Err(format!("cell {cell} has flags {flags:#x}, which mean nothing"));
        }
    }
    Ok(())
}

/// The cells from `first` on that are checked at the same time. Of a sample there is little to check in each, and of any one cell a long
/// proof may be the last; but all their evidence is in memory then.
fn few(pvs: &Pvs, first: u32) -> Vec<u32> {
    let mut bytes = 0;
    let most = pvs.cells().min(first.saturating_add(2 * rayon::current_num_threads() as u32));
    let fits = |cell: &u32| {
        // What cannot be read is refused when it is its turn.
        bytes += pvs.certificate(*cell).ok().flatten().map_or(0, <[u8]>::len);
        *cell == first || bytes <= AT_ONCE
    };
    (first..most).take_while(fits).collect()
}

/// What was gone through: witnesses, certificates, triangles that meet their cell.
#[derive(Default)]
struct Totals {
    all: [u64; 3],
    checked: [u64; 3],
    /// Pairs hidden by surfaces, in boxes, and alone or with their polygon.
    hidden: [u64; 3],
    undecided: u64,
    bytes: u64,
    /// Certificates kept with another cell, and which, that pairs of a sample rest on: counted once.
    rested: BTreeSet<(u32, usize)>,
}

impl std::ops::AddAssign for Totals {
    fn add_assign(&mut self, o: Self) {
        for kind in 0..3 {
            self.all[kind] += o.all[kind];
            self.checked[kind] += o.checked[kind];
            self.hidden[kind] += o.hidden[kind];
        }
        self.undecided += o.undecided;
        self.bytes += o.bytes;
        self.rested.extend(o.rested);
    }
}

/// Checks one cell, or of it only what is about the triangles `wanted`.
fn check_one(
    (pvs, reader): (&Pvs, &Reader),
    scene: &Triangles<'_>,
    cell: u32,
    wanted: Option<&BTreeSet<u32>>,
) -> Result<Totals, String> {
    let error = |e: sightline_pvs::PvsError| e.to_string();
    let mut totals = Totals::default();
    let (mut visible, mut undecided) = (Vec::new(), Vec::new());
    pvs.visible(cell, &mut visible).map_err(error)?;
    pvs.undecided(cell, &mut undecided).map_err(error)?;
    let bounds = pvs.cell_bounds(cell).ok_or("there is no such cell")?.map(Vec3::from);
    let certificates = reader.read(pvs, cell)?.ok_or("it has no evidence")?;
    let (evidence, above) = (&certificates.own, certificates.above());
    totals.undecided += undecided.len() as u64;
    totals.bytes += pvs.certificate(cell).map_err(error)?.map_or(0, |e| e.len() as u64);
    let claims = CellClaims { cell: bounds, visible: &visible, undecided: &undecided, evidence, above };
    let [all, picked] = [0, 1].map(|_| [0, 1, 2].map(|_| AtomicU64::new(0)));
    let rested = Mutex::new(Vec::new());
    let pick = |claim: Claim| {
        let about =
            |group: &Hidden, wanted: &BTreeSet<u32>| group.triangles.iter().any(|t| wanted.contains(t));
        let (kind, take) = match claim {
            Claim::Seen(at) => (0, wanted.is_none_or(|w| w.contains(&evidence.seen[at].0))),
            Claim::Hidden(at) => (1, wanted.is_none_or(|w| about(&evidence.hidden[at], w))),
            // Kept with this cell for others, too, and checked once: here, or where a sample has a pair that rests on it.
            Claim::Shared(_) => (1, wanted.is_none()),
            Claim::Above(at) => {
                let of = above.and_then(|shared| shared.hidden.get(at));
                let take = wanted.is_some_and(|w| of.is_some_and(|group| about(group, w)));
                if take {
                    rested.lock().unwrap_or_else(PoisonError::into_inner).push(at);
                }
                return take;
            }
            Claim::Meets(id) => (2, wanted.is_none_or(|w| w.contains(&id))),
        };
        all[kind].fetch_add(1, Ordering::Relaxed);
        picked[kind].fetch_add(u64::from(take), Ordering::Relaxed);
        take
    };
    check_cell(scene, &claims, &pick).map_err(|e| e.to_string())?;
    let rested = rested.into_inner().unwrap_or_else(PoisonError::into_inner);
    totals.rested.extend(rested.into_iter().filter_map(|at| Some((certificates.keeper()?, at))));
    // Now that no triangle is known to be in two groups.
    for group in certificates.hidden() {
        let kind = match &group.target {
            Target::Surfaces => 0,
            Target::Box(_) => 1,
            Target::Triangle | Target::Half | Target::Polygon(_) => 2,
        };
        totals.hidden[kind] += group.triangles.len() as u64;
    }
    for kind in 0..3 {
        totals.all[kind] += all[kind].load(Ordering::Relaxed);
        totals.checked[kind] += picked[kind].load(Ordering::Relaxed);
    }
    Ok(totals)
}

/// So many pairs of cell and triangle, evenly from all: the triangles by cell.
fn draw(count: u64, seed: u64, cells: u32, triangles: u32) -> BTreeMap<u32, BTreeSet<u32>> {
    let mut state = seed;
    let mut next = |below: u32| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        // The upper half of the product of 32 random bits and the number.
        ((u64::from((state >> 32) as u32) * u64::from(below)) >> 32) as u32
    };
    let mut out: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for _ in 0..count {
        let cell = next(cells);
        out.entry(cell).or_default().insert(next(triangles));
    }
    out
}
