//! `sightline measure`: wrong pixels of a result, compared with item buffers of the full scene.

use std::path::Path;
use std::sync::Arc;

use sightline_measure::{Options, Viewpoints, measure};
use sightline_model::BackendChoice;
use sightline_sampling::{CubeSpec, PreparedScene, Strata, layers};
use sightline_worker::Choice;

use crate::args::MeasureArgs;
use crate::error::CliError;
use crate::opening;
use crate::progress::Progress;
use crate::serve::{self, print};

/// Number of worst frames that --images writes.
const WORST: usize = 8;

/// Measures a result and prints one JSON object.
pub fn run(args: &MeasureArgs) -> Result<(), CliError> {
    // Before the first use of the thread pool.
    serve::use_threads(serve::threads(None))?;
    let pvs = opening::open(&args.result)?;
    let view_box = pvs.tree().view_box();
    let views = match &args.path {
        None => Viewpoints::random(args.viewpoints, args.seed, view_box),
        Some(path) => {
            let file = std::fs::File::open(path).map_err(|e| {
                CliError::Input(format!(
                    "{} cannot be read: {e}; give --path a file with a viewpoint `x y z` per line",
                    path.display()
                ))
            })?;
            Viewpoints::path(std::io::BufReader::new(file), view_box)
                .map_err(|e| CliError::Input(format!("{}: {e}", path.display())))?
        }
    };
    if !(8..=4096).contains(&args.resolution) {
        return Err(CliError::Usage(format!("--resolution {} is not between 8 and 4096", args.resolution)));
    }
    if let Some(dir) = &args.images {
        writable_folder(dir)?;
    }
    let scene = Arc::new(opening::scene_of(&args.scene, &args.kinds.rules, &pvs, &args.result)?);
    // Embree renders frames of the whole scene well, so the gpu is probed only when Embree is missing.
    let probe = |choice| sightline_worker::Backends::probe(choice, Default::default());
    let mut backends =
        probe(if args.backend == BackendChoice::Auto { Choice::Cpu } else { serve::choice(args.backend) });
    if args.backend == BackendChoice::Auto && backends.profiles().is_empty() {
        backends = probe(Choice::Auto);
    }
    serve::say_missing(&backends)?;
    let spec = CubeSpec { resolution: args.resolution, strata: Strata::One, keep_pixels: false };
    let profile = backends.profiles().into_iter().next().unwrap_or_default();
    let backend = backends.open(&profile, Arc::clone(&scene), spec).map_err(CliError::internal)?;
    let prepared = PreparedScene::new(scene)?;
    let renderer = layers::renderer(&*backend, &prepared, spec, None).map_err(CliError::internal)?;
    let options = Options { images_dir: args.images.clone(), worst: WORST };
    let progress = Progress::new();
    let report =
        measure(&*renderer, &pvs, &views, &options, &mut |done, total| progress.count(done, total, "frames"));
    progress.end();
    let mut value = serde_json::to_value(report.map_err(|e| CliError::Input(e.to_string()))?)
        .map_err(CliError::internal)?;
    value["backend"] = profile.into();
    print(&value.to_string())
}

/// Creates the folder for images and checks, by writing a file, that it is writable, before any frame is
/// rendered.
fn writable_folder(dir: &Path) -> Result<(), CliError> {
    let probe = dir.join(format!(".sightline-{}", std::process::id()));
    std::fs::create_dir_all(dir)
        .and_then(|()| std::fs::File::create(&probe))
        .and_then(|_| std::fs::remove_file(&probe))
        .map_err(|e| {
            let dir = dir.display();
            CliError::Usage(format!(
                "{dir} cannot be written: {e}; give --images a folder where you may write"
            ))
        })
}
