//! Measurements of a result: wrong pixels compared with item buffers of the full scene, or exact sets.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sightline_measure::{
    ExactReport, MeasureError, PairReport, Report, Viewpoints, WorstFrameOptions,
    measure as measure_frames, measure_exact, measure_pairs,
};
use sightline_model::TracerChoice;
use sightline_pvs::PvsError;
use sightline_scene::Scene;
use sightline_tetra::point_query::{Hierarchy, Looker};
use sightline_tetra::surfaces::Surfaces;
use sightline_trace::sight::{SightLineTracer, least_step};
use sightline_trace::{CubeSpec, PreparedScene, Strata, layers};
use sightline_viewpoints::points::WeightedViewpoint;

use crate::error::Error;
use crate::observer::{Observer, warn};
use crate::process::{threads, use_threads};
use crate::progress::Counter;
use crate::result::{NamedResult, without_masks};
use crate::scene::{LoadOptions, SceneSource, read_scene_of};
use crate::tracers::{note_other, open_tracer};
use crate::viewpoints::{read_viewpoints, region_of_result};
use crate::words::plural;

/// The number of worst frames in a report.
const WORST: usize = 8;

/// The options of a measurement, which correspond to the options of `sightline measure`.
///
/// ```
/// use sightline::MeasureOptions;
///
/// let options = MeasureOptions { viewpoints: 500, seed: 7, ..Default::default() };
/// assert_eq!(options.resolution, 256);
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MeasureOptions {
    /// The options for reading the scene. Default: the options of the bake.
    pub scene: LoadOptions,
    /// The number of random viewpoints, uniform in the cells with viewpoints. With a file of viewpoints, the
    /// maximum number of drawn viewpoints. Each frame is a full cube around a viewpoint. Default: 200.
    pub viewpoints: u32,
    /// The path of a file of viewpoints, with a line `x y z` or `x y z weight` for each. Default: random
    /// viewpoints.
    pub viewpoints_file: Option<PathBuf>,
    /// The seed of the random viewpoints. Default: 1.
    pub seed: u64,
    /// The path of a file with a camera path, with a line `x y z` for each frame. Default: random viewpoints.
    pub path: Option<PathBuf>,
    /// The number of random pairs of points for measuring the visibility between cells. Default: 0.
    pub pairs: u64,
    /// True to measure by exact sets, without pixels.
    pub exact: bool,
    /// The side of one face of a cube, in pixels, 8 to 4096. Default: 256.
    pub resolution: u32,
    /// The tracer that renders the frames.
    pub backend: TracerChoice,
    /// The folder for pictures of the eight worst frames. Default: no pictures.
    pub images: Option<PathBuf>,
    /// True to write an animated picture of the worst frame to the same folder.
    pub turntable: bool,
}

impl Default for MeasureOptions {
    /// Returns the default options: 200 random viewpoints with seed 1, and 256 pixels per side of a face.
    fn default() -> Self {
        Self {
            scene: LoadOptions::default(),
            viewpoints: 200,
            viewpoints_file: None,
            seed: 1,
            path: None,
            pairs: 0,
            exact: false,
            resolution: 256,
            backend: TracerChoice::Auto,
            images: None,
            turntable: false,
        }
    }
}

/// The outcome of a measurement. Its serialisation is the document that `sightline measure` prints.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum MeasureReport {
    /// Wrong pixels of frames.
    Frames(FrameReport),
    /// Solid angles of wrong triangles, computed from exact sets.
    Exact(ExactReport),
}

/// Wrong pixels of frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameReport {
    /// The error measures of the frames.
    #[serde(flatten)]
    pub report: Report,
    /// The numerics profile of the tracer that rendered the frames.
    pub backend: String,
    /// The measures of the visibility between cells, if pairs of points were drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cell_to_cell: Option<PairReport>,
}

/// Measures a result in its scene.
///
/// ```no_run
/// use sightline::{MeasureOptions, NamedResult, SceneSource, Silent};
///
/// let path = "level.pvs".as_ref();
/// let pvs = sightline::open(path)?;
/// let source = SceneSource::File("level.glb".into());
/// let result = NamedResult::new(&pvs, path);
/// let report = sightline::measure(&source, result, &MeasureOptions::default(), &Silent)?;
/// println!("{}", serde_json::to_string(&report).unwrap());
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Usage`] if options are unsuitable, [`crate::ErrorKind::Input`] if a file cannot be
/// read or the scene is not the scene of the result, [`crate::ErrorKind::Internal`] if the machine has no
/// tracer, or [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn measure(
    source: &SceneSource,
    result: NamedResult<'_>,
    options: &MeasureOptions,
    observer: &dyn Observer,
) -> Result<MeasureReport, Error> {
    // Set the size before the first use of the thread pool.
    use_threads(threads(None))?;
    // Detect errors that do not depend on the scene before reading it.
    let places = MeasuredViewpoints::read(result, options)?;
    if !(8..=4096).contains(&options.resolution) {
        return Err(Error::usage(format!(
            "--resolution {} is not between 8 and 4096 pixels",
            options.resolution
        ))
        .about("resolution"));
    }
    if let Some(dir) = &options.images {
        writable_folder(dir)?;
    }
    if options.pairs > 0 && result.pvs.cell_pairs()?.is_none() {
        return Err(result.error(PvsError::NoPairs));
    }
    let scene = read_scene_of(source, &options.scene, result, observer)?;
    let report = measure_at(places, result, scene, options, observer)?;
    if let MeasureReport::Frames(frames) = &report {
        let info = result.info();
        let made = info["profile"].as_str().unwrap_or_default();
        note_other(made, &frames.backend, observer);
    }
    Ok(report)
}

/// Measures a result in a scene that is in memory, at random viewpoints.
///
/// # Errors
/// As for [`measure`].
pub fn measure_in(
    result: NamedResult<'_>,
    scene: Arc<Scene>,
    options: &MeasureOptions,
    observer: &dyn Observer,
) -> Result<MeasureReport, Error> {
    measure_at(MeasuredViewpoints::Random, result, scene, options, observer)
}

/// The viewpoints of a measurement.
enum MeasuredViewpoints {
    /// Random viewpoints in the cells.
    Random,
    /// A camera path.
    Path(Viewpoints),
    /// Viewpoints that a file lists with weights, and the path of the file.
    File(PathBuf, Vec<WeightedViewpoint>),
}

impl MeasuredViewpoints {
    /// Reads the files of the options.
    fn read(result: NamedResult<'_>, options: &MeasureOptions) -> Result<Self, Error> {
        if let Some(path) = &options.path {
            let file = std::fs::File::open(path).map_err(|e| {
                Error::input(format!(
                    "{} cannot be read: {e}; give --path a file with a viewpoint `x y z` per line",
                    path.display()
                ))
                .about("path")
            })?;
            let view_box = result.pvs.tree().view_box();
            let views = Viewpoints::path(std::io::BufReader::new(file), view_box);
            return views
                .map(Self::Path)
                .map_err(|e| Error::input(format!("{}: {e}", path.display())));
        }
        Ok(match &options.viewpoints_file {
            Some(file) => Self::File(file.clone(), read_viewpoints(file)?),
            None => Self::Random,
        })
    }
}

/// Measures a result at viewpoints.
fn measure_at(
    places: MeasuredViewpoints,
    result: NamedResult<'_>,
    scene: Arc<Scene>,
    options: &MeasureOptions,
    observer: &dyn Observer,
) -> Result<MeasureReport, Error> {
    let pvs = result.pvs;
    let view_box = pvs.tree().view_box();
    let region = region_of_result(result, &scene)?;
    let is_place = |p: [f32; 3]| {
        pvs.find_cell(p)
            .is_some_and(|c| pvs.is_reached(c).unwrap_or(false))
            && region.as_ref().is_none_or(|region| region.holds(p.into()))
    };
    let (count, seed) = (options.viewpoints, options.seed);
    let views = match &places {
        MeasuredViewpoints::Path(views) => views.clone(),
        MeasuredViewpoints::File(file, all) => {
            select(result, options, file, all, &is_place, observer)?
        }
        MeasuredViewpoints::Random
            if region.is_none() && (0..pvs.cells()).all(|c| pvs.is_reached(c).unwrap_or(true)) =>
        {
            Viewpoints::random(count, seed, view_box)
        }
        // Viewpoints are restricted to some of the cells, or to a region.
        MeasuredViewpoints::Random => Viewpoints::random_where(count, seed, view_box, is_place),
    };
    // If the sight lines of a result end at a distance, the frames must end there, too.
    let info = result.info();
    let far = info["spec"]["visibility"]["far"].as_f64();
    let counter = Counter::new("frames", observer);
    let mut progress = |done, total| {
        counter.show(done, total);
        !observer.is_cancelled()
    };
    if options.exact {
        return by_exact_sets(result, &scene, &views, far, &mut progress).map(MeasureReport::Exact);
    }
    let spec = CubeSpec {
        resolution: options.resolution,
        strata: Strata::One,
        keep_pixels: false,
    };
    let (profile, backend) = open_tracer(options.backend, &scene, spec, observer)?;
    let step = least_step(scene.bounds());
    let prepared = PreparedScene::new(scene)?;
    let renderer =
        layers::renderer(&*backend, &prepared, spec, None, far).map_err(Error::internal)?;
    let up = if info["spec"]["visibility"]["up"] == "z" {
        2
    } else {
        1
    };
    let frames = WorstFrameOptions {
        images_dir: options.images.clone(),
        turntable: options.turntable.then_some(up),
        images: WORST,
        worst: WORST,
    };
    let report = measure_frames(&*renderer, pvs, &views, &frames, &mut progress);
    let report = report.map_err(|e| measure_error(&e))?;
    let cell_to_cell = match options.pairs {
        0 => None,
        count => {
            let sight = SightLineTracer::new(&*backend, prepared.traced())
                .map_err(Error::internal)?
                .up_to(far);
            let found = measure_pairs(&sight, pvs, count, seed, step, &is_place);
            Some(found.map_err(|e| result.error(e))?)
        }
    };
    Ok(MeasureReport::Frames(FrameReport {
        report,
        backend: profile,
        cell_to_cell,
    }))
}

/// Converts an error of a measurement.
fn measure_error(e: &MeasureError) -> Error {
    match e {
        MeasureError::Stopped { .. } => Error::cancelled(e.to_string()),
        e => Error::input(e.to_string()),
    }
}

/// Measures a result by exact sets from the viewpoints.
fn by_exact_sets(
    result: NamedResult<'_>,
    scene: &Scene,
    views: &Viewpoints,
    far: Option<f64>,
    progress: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<ExactReport, Error> {
    if !scene.sides().are_both() {
        return Err(Error::input(format!(
            "back faces are culled for {}, but exact sets use both sides of triangles; omit \
             --exact",
            result.name.display()
        )));
    }
    without_masks(scene)?;
    let surfaces = Surfaces::new(scene)?;
    let hierarchy = Hierarchy::new(surfaces.view());
    let looker = Looker::new(surfaces.view(), hierarchy.view());
    let report = measure_exact(&looker, result.pvs, views, far, WORST, progress);
    report.map_err(|e| measure_error(&e))
}

/// Returns the viewpoints of a file that are in cells with viewpoints, at most `options.viewpoints` of them.
/// A larger number is drawn at random by weight.
fn select(
    result: NamedResult<'_>,
    options: &MeasureOptions,
    file: &Path,
    all: &[WeightedViewpoint],
    is_place: &dyn Fn([f32; 3]) -> bool,
    observer: &dyn Observer,
) -> Result<Viewpoints, Error> {
    let inside: Vec<([f32; 3], f64)> = all
        .iter()
        .filter(|w| is_place(w.point))
        .map(|w| (w.point, w.weight))
        .collect();
    if inside.is_empty() {
        return Err(Error::input(format!(
            "{}: no point of the file is in a cell with viewpoints of {}; give the points in the scene's \
             units and axes",
            file.display(),
            result.name.display()
        )));
    }
    if inside.len() < all.len() {
        warn(
            observer,
            format!(
                "{}: {} of {} are outside the cells with viewpoints of the result, and are skipped",
                file.display(),
                all.len() - inside.len(),
                plural(all.len(), "viewpoint")
            ),
        );
    }
    Ok(Viewpoints::weighted(
        &inside,
        options.viewpoints,
        options.seed,
    ))
}

/// Creates the folder for images and checks, by writing a file, that it is writable, before any frame is
/// rendered.
fn writable_folder(dir: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(dir)
        .and_then(|()| sightline_files::check(&dir.join("image")))
        .map_err(|e| {
            let dir = dir.display();
            Error::usage(format!(
                "{dir} cannot be written: {e}; give --images a folder where you may write"
            ))
        })
}
