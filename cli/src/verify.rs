//! `sightline verify`: checks every witness and every certificate of a result with the independent checker.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::Vec3;
use serde_json::{Value, json};
use sightline_certificate::checker::Kinds;
use sightline_certificate::{Report, Sample, VerifyError, VerifyOptions, verify};
use sightline_model::{MethodName, NamedValue as _};
use sightline_pvs::Pvs;

use crate::args::VerifyArgs;
use crate::error::CliError;
use crate::opening::{self, Source};
use crate::progress::{Progress, human, say};
use crate::serve::{self, print, threads};
use crate::verdict::{Hooks, Verdict};
use crate::verify_hidden;

/// Set by the first Ctrl-C.
static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Checks a result against its scene, and prints what came of it.
pub fn run(args: &VerifyArgs, json: bool) -> Result<(), CliError> {
    let pvs = opening::open(&args.result)?;
    cancel_on_interrupt()?;
    let progress = Progress::new();
    let hooks = Hooks {
        progress: &|done, cells| progress.count(u64::from(done), u64::from(cells), "cells"),
        cancelled: &|| CANCELLED.load(Ordering::Relaxed),
    };
    let start = Instant::now();
    let verdict = verified(args, &pvs, &Source::File(args.scene.clone()), &hooks);
    progress.end();
    match verdict? {
        Verdict::Accepted(value, text) => {
            say(&format!("verified in {}", human(start.elapsed())));
            print(&if json { value.to_string() } else { text })
        }
        Verdict::Refused(value, text) => {
            if json {
                print(&value.to_string())?;
            }
            Err(CliError::Input(text))
        }
    }
}

/// Checks a result against its scene.
pub fn verified(
    args: &VerifyArgs,
    pvs: &Pvs,
    source: &Source,
    hooks: &Hooks<'_>,
) -> Result<Verdict, CliError> {
    serve::use_threads(threads(args.threads.map(usize::from)))?;
    let scene = opening::read_for(source, &args.kinds, pvs, &args.result)?;
    if !scene.sides().are_both() {
        return Err(CliError::Input(format!(
            "back faces of {} are culled for {}, and certificates are about triangles that are seen from \
             both sides; verify a result of a bake without --cull-back-faces",
            source.path().display(),
            args.result.display()
        )));
    }
    if pvs.method() == MethodName::Portals.name() {
        let Some(wanted) = args.sample else {
            return Err(CliError::Input(format!(
                "{} has no certificates: portals prove what they hide while they look. --sample N asks exact \
                 queries about N pairs that are called hidden",
                args.result.display()
            )));
        };
        return verify_hidden::check(args, (pvs, &scene), wanted, hooks);
    }
    let triangles: Vec<[Vec3; 3]> = scene.triangles().iter().map(|t| t.v).collect();
    // The digest of the scene, which the result names, covers the kinds.
    let (blocks, shows): (Vec<bool>, Vec<bool>) = scene
        .kinds()
        .by_triangle()
        .iter()
        .map(|k| (k.blocks(), k.shows()))
        .unzip();
    let report = verify(
        &triangles,
        pvs,
        &VerifyOptions {
            kinds: Kinds {
                blocks: &blocks,
                shows: &shows,
            },
            sample: args.sample.map(|pairs| Sample {
                pairs,
                seed: args.seed,
            }),
            progress: Some(hooks.progress),
            cancelled: Some(hooks.cancelled),
        },
    );
    match report {
        Ok(report) => Ok(Verdict::Accepted(
            report_json(&report, pvs, args),
            report_text(&report, args),
        )),
        Err(VerifyError::Refused(refused)) => Ok(Verdict::refused(
            refused.cell,
            &refused.reason,
            &args.result,
        )),
        Err(VerifyError::Cancelled { verified, cells }) => Err(CliError::Interrupted(format!(
            "interrupted; {verified} of {cells} cells verified so far, all accepted"
        ))),
        Err(VerifyError::NoCertificates { .. }) => Err(no_certificates(pvs, &args.result)),
        Err(e @ VerifyError::OtherScene { .. }) => Err(CliError::Input(e.to_string())),
    }
}

/// Lets the first Ctrl-C cancel the verification and the second one end the process.
#[expect(
    clippy::disallowed_methods,
    reason = "the second Ctrl-C ends a process that keeps no temporary file"
)]
fn cancel_on_interrupt() -> Result<(), CliError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()
        .map_err(|e| CliError::Internal(format!("cannot watch for Ctrl-C: {e}")))?;
    let wait = move || {
        runtime.block_on(async {
            // Without a signal handler, Ctrl-C ends the process in the ordinary way.
            if tokio::signal::ctrl_c().await.is_ok() {
                CANCELLED.store(true, Ordering::Relaxed);
                say("interrupted: finishing the claims in progress; interrupt again to stop at once");
                if tokio::signal::ctrl_c().await.is_ok() {
                    std::process::exit(130);
                }
            }
        });
    };
    let thread = std::thread::Builder::new()
        .name("interrupt".to_owned())
        .spawn(wait);
    thread
        .map(drop)
        .map_err(|e| CliError::Internal(format!("cannot watch for Ctrl-C: {e}")))
}

fn no_certificates(pvs: &Pvs, result: &Path) -> CliError {
    CliError::Input(format!(
        "{} has no certificates (method {}), so there is nothing to verify; bake it with {}--certificates",
        result.display(),
        pvs.method(),
        if pvs.method() == "aggressive" {
            "--method exact "
        } else {
            ""
        }
    ))
}

fn report_json(report: &Report, pvs: &Pvs, args: &VerifyArgs) -> Value {
    let t = &report.totals;
    json!({
        "accepted": true,
        "method": pvs.method(),
        "cells": report.cells,
        "pairs": report.pairs,
        "witnesses": t.witnesses.all,
        "certificates": t.certificates.all,
        "meeting": t.meeting.all,
        "witnesses_checked": t.witnesses.checked,
        "certificates_checked": t.certificates.checked,
        "meeting_checked": t.meeting.checked,
        "hidden_by_surfaces": t.hidden.by_surface,
        "hidden_in_boxes": t.hidden.in_boxes,
        "hidden_alone": t.hidden.alone,
        "undecided": t.undecided,
        "cells_not_reached": t.cells_unreached,
        "cell_pairs_hidden": t.cells_apart,
        "cell_boxes": t.apart.all,
        "cell_boxes_checked": t.apart.checked,
        "without_area": report.without_area(),
        "evidence_bytes": t.bytes,
        "sampled": args.sample.is_some(),
        "sample": args.sample,
        "seed": args.sample.map(|_| args.seed),
    })
}

fn report_text(report: &Report, args: &VerifyArgs) -> String {
    let t = &report.totals;
    format!(
        "accepted{}: {} pairs of cell and triangle in {} cells\n\
         visible: {} with a witness ({} checked), {} meet their cell ({} checked)\n\
         hidden: {} by the closed surface they belong to, {} in hidden boxes, {} alone or with a polygon; \
         {} certificates ({} checked), {} bytes with the witnesses\n\
         neither: {} undecided, {} without area{}{}",
        args.sample
            .map_or(String::new(), |n| format!(" by a sample of {n} pairs")),
        report.pairs,
        report.cells,
        t.witnesses.all,
        t.witnesses.checked,
        t.meeting.all,
        t.meeting.checked,
        t.hidden.by_surface,
        t.hidden.in_boxes,
        t.hidden.alone,
        t.certificates.all,
        t.certificates.checked,
        t.bytes,
        t.undecided,
        report.without_area(),
        match t.cells_unreached {
            0 => String::new(),
            n => format!(
                "\nno viewpoint is in {n} of the cells, and nothing is claimed about what they see"
            ),
        },
        match t.cells_apart {
            0 => String::new(),
            apart => format!(
                "\ncells: {apart} pairs do not see each other, by {} hidden boxes ({} checked)",
                t.apart.all, t.apart.checked
            ),
        },
    )
}
