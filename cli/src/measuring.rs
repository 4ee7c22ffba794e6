//! `sightline measure`: wrong pixels of a result, compared with item buffers of the full scene.

use std::path::Path;
use std::sync::Arc;

use serde_json::Value;
use sightline_measure::{MeasureError, Options, Viewpoints, measure, measure_exact, measure_pairs};
use sightline_pvs::{Pvs, PvsError};
use sightline_sampling::sight::{Sight, least_step};
use sightline_sampling::{CubeSpec, PreparedScene, Strata, layers};
use sightline_scene::Scene;
use sightline_tetra::look::{Hierarchy, Looker};
use sightline_tetra::surfaces::Surfaces;
use sightline_viewpoints::points::Weighted;

use crate::args::MeasureArgs;
use crate::backends::{open_backend, say_other};
use crate::enclosure;
use crate::error::CliError;
use crate::opening::{self, Source};
use crate::places::read_viewpoints;
use crate::progress::{Progress, say};
use crate::serve::{self, print};

/// Number of worst frames that --images writes.
const WORST: usize = 8;

/// Measures a result and prints one JSON object.
pub fn run(args: &MeasureArgs) -> Result<(), CliError> {
    let pvs = opening::open(&args.result)?;
    let progress = Progress::new();
    let mut show = |done, total| {
        progress.count(done, total, "frames");
        true
    };
    let value = measured(args, &pvs, &Source::File(args.scene.clone()), &mut show);
    progress.end();
    print(&value?.to_string())
}

/// Measures a result: the object that `sightline measure` prints. `progress` takes the numbers of frames that
/// are done and of all, and says whether to go on.
pub fn measured(
    args: &MeasureArgs,
    pvs: &Pvs,
    source: &Source,
    progress: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<Value, CliError> {
    // Before the first use of the thread pool.
    serve::use_threads(serve::threads(None))?;
    let view_box = pvs.tree().view_box();
    // What can be wrong without the scene is found before it is read.
    let on_path = match &args.path {
        None => None,
        Some(path) => {
            let file = std::fs::File::open(path).map_err(|e| {
                CliError::Input(format!(
                    "{} cannot be read: {e}; give --path a file with a viewpoint `x y z` per line",
                    path.display()
                ))
            })?;
            let views = Viewpoints::path(std::io::BufReader::new(file), view_box);
            Some(views.map_err(|e| CliError::Input(format!("{}: {e}", path.display())))?)
        }
    };
    let given = args
        .viewpoints_file
        .as_deref()
        .map(|file| read_viewpoints(file).map(|all| (file, all)));
    let given = given.transpose()?;
    if !(8..=4096).contains(&args.resolution) {
        return Err(CliError::Usage(format!(
            "--resolution {} is not between 8 and 4096",
            args.resolution
        )));
    }
    if let Some(dir) = &args.images {
        writable_folder(dir)?;
    }
    if args.pairs > 0 && pvs.cell_pairs()?.is_none() {
        return Err(CliError::Input(format!(
            "{}: {}",
            args.result.display(),
            PvsError::NoPairs
        )));
    }
    let scene = Arc::new(opening::read_for(source, &args.kinds, pvs, &args.result)?);
    let value = measured_in(args, pvs, scene, (on_path, given), progress)?;
    let info: Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    if !args.exact {
        let [made, judged] =
            [&info["profile"], &value["backend"]].map(|p| p.as_str().unwrap_or_default());
        say_other(made, judged);
    }
    Ok(value)
}

/// Measures a result in its scene: on a path, at given viewpoints, or at random ones.
pub fn measured_in(
    args: &MeasureArgs,
    pvs: &Pvs,
    scene: Arc<Scene>,
    (on_path, given): (Option<Viewpoints>, Option<(&Path, Vec<Weighted>)>),
    progress: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<Value, CliError> {
    let view_box = pvs.tree().view_box();
    let region = enclosure::of_result(pvs, &scene, &args.result)?;
    let is_place = |p: [f32; 3]| {
        pvs.find_cell(p)
            .is_some_and(|c| pvs.is_reached(c).unwrap_or(false))
            && region.as_ref().is_none_or(|region| region.holds(p.into()))
    };
    let views = match (on_path, given) {
        (Some(views), _) => views,
        (None, Some((file, all))) => listed(args, (file, &all), &is_place)?,
        (None, None)
            if region.is_none() && (0..pvs.cells()).all(|c| pvs.is_reached(c).unwrap_or(true)) =>
        {
            Viewpoints::random(args.viewpoints, args.seed, view_box)
        }
        // Viewpoints are only in some of the cells, or in a region.
        (None, None) => Viewpoints::random_where(args.viewpoints, args.seed, view_box, is_place),
    };
    // A result whose lines end at a distance is judged up to that distance.
    let info: Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    let far = info["spec"]["visibility"]["far"].as_f64();
    if args.exact {
        return exactly(args, pvs, &scene, &views, far, progress);
    }
    let spec = CubeSpec {
        resolution: args.resolution,
        strata: Strata::One,
        keep_pixels: false,
    };
    let (profile, backend) = open_backend(args.backend, &scene, spec)?;
    let step = least_step(scene.bounds());
    let prepared = PreparedScene::new(scene)?;
    let renderer =
        layers::renderer(&*backend, &prepared, spec, None, far).map_err(CliError::internal)?;
    let options = Options {
        images_dir: args.images.clone(),
        turntable: args.turntable.then(|| {
            if info["spec"]["visibility"]["up"] == "z" {
                2
            } else {
                1
            }
        }),
        images: WORST,
        worst: WORST,
    };
    let report = measure(&*renderer, pvs, &views, &options, progress).map_err(|e| match e {
        MeasureError::Stopped { .. } => CliError::Interrupted(e.to_string()),
        e => CliError::Input(e.to_string()),
    })?;
    let pairs = match args.pairs {
        0 => None,
        count => {
            let sight = Sight::new(&*backend, prepared.traced())
                .map_err(CliError::internal)?
                .up_to(far);
            let found = measure_pairs(&sight, pvs, count, args.seed, step, &is_place);
            Some(found.map_err(|e| CliError::Input(format!("{}: {e}", args.result.display())))?)
        }
    };
    let mut value = serde_json::to_value(report).map_err(CliError::internal)?;
    value["backend"] = profile.into();
    if let Some(pairs) = pairs {
        value["cell_to_cell"] = serde_json::to_value(pairs).map_err(CliError::internal)?;
    }
    Ok(value)
}

/// Measures a result by exact sets from the viewpoints.
fn exactly(
    args: &MeasureArgs,
    pvs: &Pvs,
    scene: &Scene,
    views: &Viewpoints,
    far: Option<f64>,
    progress: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<Value, CliError> {
    if !scene.sides().are_both() {
        return Err(CliError::Input(format!(
            "back faces are culled for {}, and exact sets are about triangles that are met from both sides; \
             leave out --exact",
            args.result.display()
        )));
    }
    opening::without_masks(scene)?;
    let surfaces = Surfaces::new(scene)?;
    let hierarchy = Hierarchy::new(surfaces.view());
    let looker = Looker::new(surfaces.view(), hierarchy.view());
    let report = measure_exact(&looker, pvs, views, far, WORST, progress).map_err(|e| match e {
        MeasureError::Stopped { .. } => CliError::Interrupted(e.to_string()),
        e => CliError::Input(e.to_string()),
    })?;
    serde_json::to_value(report).map_err(CliError::internal)
}

/// The viewpoints of --viewpoints-file that are in reached cells.
fn listed(
    args: &MeasureArgs,
    (file, all): (&Path, &[Weighted]),
    is_place: &dyn Fn([f32; 3]) -> bool,
) -> Result<Viewpoints, CliError> {
    let inside: Vec<([f32; 3], f64)> = all
        .iter()
        .filter(|w| is_place(w.point))
        .map(|w| (w.point, w.weight))
        .collect();
    if inside.is_empty() {
        return Err(CliError::Input(format!(
            "{}: none of its viewpoints is in a cell with viewpoints of {}; are they in the scene's units \
             and axes?",
            file.display(),
            args.result.display()
        )));
    }
    if inside.len() < all.len() {
        say(&format!(
            "warning: {}: {} of {} are outside the cells of the result and left out",
            file.display(),
            all.len() - inside.len(),
            opening::plural(all.len(), "viewpoint")
        ));
    }
    Ok(Viewpoints::weighted(&inside, args.viewpoints, args.seed))
}

/// Creates the folder for images and checks, by writing a file, that it is writable, before any frame is
/// rendered.
fn writable_folder(dir: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(dir)
        .and_then(|()| sightline_files::check(&dir.join("image")))
        .map_err(|e| {
            let dir = dir.display();
            CliError::Usage(format!(
                "{dir} cannot be written: {e}; give --images a folder where you may write"
            ))
        })
}
