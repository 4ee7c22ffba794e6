//! Tests of the verification of a result as a library call: acceptance, totals, samples, rejections,
//! cancellation.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use sightline_certificate::{
    BakedResult, CellCertificate, Count, Hidden, NOT_REACHED, Sample, VerifyError, VerifyOptions,
    codec, verify,
};
use sightline_numbers::Aabb;
use support::{CELL, alone, relying, sharing, triangles};

/// A result in memory whose cells all have the same box and set.
struct Memory {
    method: &'static str,
    parameters: &'static str,
    visible: Vec<u32>,
    flags: u32,
    certificates: Option<Vec<Vec<u8>>>,
}

impl Memory {
    fn new(cells: &[CellCertificate]) -> Self {
        let certificates = cells.iter().map(|c| codec::encode(c).unwrap()).collect();
        Self {
            method: "exact",
            parameters: "{}",
            visible: vec![0, 1],
            flags: 0,
            certificates: Some(certificates),
        }
    }
}

impl BakedResult for Memory {
    fn method(&self) -> &str {
        self.method
    }

    fn parameters(&self) -> &str {
        self.parameters
    }

    fn cell_count(&self) -> u32 {
        self.certificates.as_ref().map_or(1, |c| c.len() as u32)
    }

    fn triangle_count(&self) -> u32 {
        6
    }

    fn cell_bounds(&self, _cell: u32) -> Option<Aabb> {
        Some(CELL)
    }

    fn visible(&self, _cell: u32) -> Result<Vec<u32>, String> {
        Ok(self.visible.clone())
    }

    fn undecided(&self, _cell: u32) -> Result<Vec<u32>, String> {
        Ok(Vec::new())
    }

    fn certificate(&self, cell: u32) -> Result<Option<&[u8]>, String> {
        Ok(self.certificates.as_ref().map(|c| &*c[cell as usize]))
    }

    fn flags(&self, _cell: u32) -> Result<u32, String> {
        Ok(self.flags)
    }
}

#[test]
fn accepts_and_counts_sound_result() {
    let result = Memory::new(&[alone(), sharing(), relying()]);
    let calls = Mutex::new(Vec::new());
    let progress = |done, cells| calls.lock().unwrap().push((done, cells));
    let options = VerifyOptions {
        progress: Some(&progress),
        ..VerifyOptions::default()
    };
    let report = verify(&triangles(), &result, &options).unwrap();
    assert_eq!(
        (report.cells, report.pairs, report.without_area()),
        (3, 18, 0)
    );
    assert_eq!(report.totals.witnesses, Count { all: 6, checked: 6 });
    // The groups that two cells rely on are stored, checked, and counted once.
    assert_eq!(report.totals.certificates, Count { all: 4, checked: 4 });
    assert_eq!(
        report.totals.hidden,
        Hidden {
            by_surface: 0,
            in_boxes: 6,
            alone: 6
        }
    );
    assert_eq!(calls.lock().unwrap().last(), Some(&(3, 3)));
}

#[test]
fn sample_checks_fewer_claims_of_same_result() {
    let result = Memory::new(&[alone(), sharing(), relying()]);
    let sample = Some(Sample { pairs: 3, seed: 1 });
    let report = verify(
        &triangles(),
        &result,
        &VerifyOptions {
            sample,
            ..VerifyOptions::default()
        },
    )
    .unwrap();
    let totals = report.totals;
    assert_eq!((totals.witnesses.all, totals.certificates.all), (6, 4));
    let checked = totals.witnesses.checked + totals.certificates.checked + totals.meeting.checked;
    assert!((1..=3).contains(&checked), "{totals:?}");
}

#[test]
fn reports_cell_and_triangles_of_false_claim() {
    let mut false_witness = alone();
    false_witness.seen[1].1 = false_witness.seen[0].1.clone();
    let refused = verify(
        &triangles(),
        &Memory::new(&[alone(), false_witness]),
        &VerifyOptions::default(),
    );
    let Err(VerifyError::Refused(refused)) = refused else {
        panic!("{refused:?}")
    };
    assert_eq!((refused.cell, &*refused.triangles), (Some(1), &[1][..]));
    assert!(!refused.reason.is_empty());
    let mut moved = alone();
    moved.hidden[0].proofs.pop();
    let refused = verify(
        &triangles(),
        &Memory::new(&[moved]),
        &VerifyOptions::default(),
    );
    let Err(VerifyError::Refused(refused)) = refused else {
        panic!("{refused:?}")
    };
    assert_eq!((refused.cell, &*refused.triangles), (Some(0), &[2, 3][..]));
    // The second cell relies on a cell without a shared certificate.
    let refused = verify(
        &triangles(),
        &Memory::new(&[alone(), relying()]),
        &VerifyOptions::default(),
    );
    assert!(matches!(refused, Err(VerifyError::Refused(r)) if r.cell == Some(1)));
}

#[test]
fn rejects_false_statements_about_whole_result() {
    let check = |change: &dyn Fn(&mut Memory)| {
        let mut result = Memory::new(&[alone()]);
        change(&mut result);
        verify(&triangles(), &result, &VerifyOptions::default())
    };
    let one_cell = r#"{"spec":{"visibility":{"exact":{"effort":"full",
        "sampling":{"lines":{"grid":{"x":1,"y":1,"z":1}}}}}}}"#;
    let two_cells = r#"{"spec":{"visibility":{"exact":{
        "sampling":{"guided":{"grid":{"x":1,"y":2,"z":1}}}}}}}"#;
    assert!(check(&|r| r.parameters = one_cell).is_ok());
    let whole =
        |r: Result<_, VerifyError>| matches!(r, Err(VerifyError::Refused(r)) if r.cell.is_none());
    assert!(whole(check(&|r| r.method = "trust")));
    for other in [
        r#"{"spec":{"visibility":{"exact":{"effort":"bounded"}}}}"#,
        r#"{"spec":{"visibility":{"portals":{}}}}"#,
    ] {
        assert!(whole(check(&|r| r.parameters = other)), "{other}");
    }
    assert!(whole(check(&|r| r.parameters = two_cells)));
    assert!(whole(check(&|r| r.flags = 4)));
    // A cell may have the flag for missing viewpoints only if the parameters state how many cells have
    // viewpoints. The set of such a cell must be empty.
    assert!(whole(check(&|r| r.flags = NOT_REACHED)));
    let refused = check(&|r| {
        (r.flags, r.parameters) = (NOT_REACHED, r#"{"viewpoints":{"cells_reached":0}}"#);
    });
    assert!(matches!(refused, Err(VerifyError::Refused(r)) if r.cell == Some(0)));
    // Such a cell must store nothing that another cell could rely on, because only its boxes are checked.
    for stored in [alone(), sharing()] {
        let mut result = Memory::new(&[stored]);
        (result.flags, result.parameters) = (NOT_REACHED, r#"{"viewpoints":{"cells_reached":0}}"#);
        result.visible.clear();
        let refused = verify(&triangles(), &result, &VerifyOptions::default());
        assert!(
            matches!(refused, Err(VerifyError::Refused(r)) if r.reason.contains("claims about triangles"))
        );
    }
    assert!(matches!(
        check(&|r| r.certificates = None),
        Err(VerifyError::NoCertificates { .. })
    ));
    let fewer = verify(
        &triangles()[..5],
        &Memory::new(&[alone()]),
        &VerifyOptions::default(),
    );
    assert_eq!(
        fewer,
        Err(VerifyError::OtherScene {
            scene: 5,
            result: 6
        })
    );
}

#[test]
fn cancelled_verification_reports_progress() {
    let cells = vec![alone(); 400];
    let result = Memory::new(&cells);
    let asked = AtomicU32::new(0);
    let cancelled = || asked.fetch_add(1, Ordering::Relaxed) >= 900;
    let options = VerifyOptions {
        cancelled: Some(&cancelled),
        ..VerifyOptions::default()
    };
    match verify(&triangles(), &result, &options) {
        Err(VerifyError::Cancelled { verified, cells }) => {
            assert!(verified > 0 && verified < 400 && cells == 400)
        }
        other => panic!("{other:?}"),
    }
}
