//! Checks an exact result: measures it, verifies its certificates, and explains one triangle:
//! `cargo run --release -p sightline --example check -- SCENE OUT.pvs`. The result was baked with
//! `--method exact --certificates`.
#![allow(clippy::print_stdout, reason = "an example")]

use std::path::Path;

use sightline::{
    CellIndex, Error, MeasureOptions, MeasureReport, NamedResult, SceneSource, Silent, TriangleId,
    Verdict, VerifyOptions,
};

/// The outcome of the checks of a result.
pub struct Checked {
    /// The measured errors.
    pub report: MeasureReport,
    /// The verdict about the certificates.
    pub verdict: Verdict,
    /// The reason why triangle 0 is visible from cell 0 or hidden.
    pub reason: serde_json::Value,
}

/// Checks a result file against its scene file.
pub fn check_files(scene: &Path, path: &Path) -> Result<Checked, Error> {
    let source = SceneSource::File(scene.to_owned());
    let pvs = sightline::open(path)?;
    let result = NamedResult::new(&pvs, path);
    let options = MeasureOptions {
        viewpoints: 20,
        resolution: 64,
        ..MeasureOptions::default()
    };
    Ok(Checked {
        report: sightline::measure(&source, result, &options, &Silent)?,
        verdict: sightline::verify(&source, result, &VerifyOptions::default(), &Silent)?,
        reason: sightline::explain(result, None, CellIndex(0), TriangleId(0), &Silent)?,
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, scene, result] = arguments.as_slice() else {
        return Err("usage: check SCENE OUT.pvs".into());
    };
    let checked = check_files(Path::new(scene), Path::new(result))?;
    println!("{}", serde_json::to_string_pretty(&checked.report)?);
    println!("{}", checked.verdict);
    println!("triangle 0 from cell 0: {}", checked.reason);
    Ok(())
}
