//! Verifies a result with the checker as a library: `cargo run --example verify -- SCENE OUT.pvs`.
#![allow(clippy::print_stdout, reason = "an example")]

use std::error::Error;
use std::path::Path;

use sightline_certificate::{Report, VerifyOptions, verify};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(scene), Some(result)) = (arguments.next(), arguments.next()) else {
        return Err("usage: verify SCENE OUT.pvs".into());
    };
    let report = verify_files(Path::new(&scene), Path::new(&result))?;
    println!(
        "accepted: {} pairs of cell and triangle, {} visible with a witness, {} hidden",
        report.pairs,
        report.totals.witnesses.all,
        report.totals.hidden.sum()
    );
    Ok(())
}

/// Checks every claim of a result baked with `--certificates`.
pub fn verify_files(scene: &Path, result: &Path) -> Result<Report, Box<dyn Error>> {
    let scene = sightline_scene::load(scene)?;
    let triangles: Vec<_> = scene.triangles().iter().map(|t| t.v).collect();
    let result = sightline_pvs::Pvs::open(result)?;
    let progress = |done, cells| println!("{done} of {cells} cells");
    Ok(verify(
        &triangles,
        &result,
        &VerifyOptions {
            progress: Some(&progress),
            ..VerifyOptions::default()
        },
    )?)
}
