//! The measurement: compares the visible triangles of each frame with the set of the viewpoint's cell.

use std::collections::BTreeSet;
use std::path::PathBuf;

use glam::Vec3;
use rayon::prelude::*;
use sightline_numbers::ids::CellIndex;
use sightline_pvs::Pvs;
use sightline_trace::{CubeImage, CubeRenderer, SKY};

use crate::error::MeasureError;
use crate::images;
use crate::pixel::is_wrong;
use crate::regions::{Regions, regions};
use crate::report::{Durations, Frame, Report, nearest_rank};
use crate::turntable;
use crate::viewpoints::Viewpoints;

/// The number of frames rendered between two reports of progress. Frames are independent, so all threads
/// render them. The result of a frame (ids, counts) is small, and a batch bounds the number of waiting
/// results.
const BATCH: usize = 32;

/// The options for images and lists of the worst frames.
#[derive(Clone, Debug)]
pub struct WorstFrameOptions {
    /// The folder for images of the worst frames, which is created if missing. `None` writes no images.
    pub images_dir: Option<PathBuf>,
    /// The axis that points up, 1 for y or 2 for z, for an animation of the worst frame. The animation shows
    /// the view of a camera that turns at the viewpoint. `None` writes no animation.
    pub turntable: Option<usize>,
    /// The number of worst frames to write images of. Default: 8.
    pub images: usize,
    /// The number of worst frames to list. Default: 8.
    pub worst: usize,
}

impl Default for WorstFrameOptions {
    /// Returns options without images and with the eight worst frames.
    fn default() -> Self {
        Self {
            images_dir: None,
            turntable: None,
            images: 8,
            worst: 8,
        }
    }
}

/// A cube image, and pairs of a pixel's index and a see-through triangle in front of that pixel.
type CubeLayers = (CubeImage, Vec<(u32, u32)>);

/// The judgement of a frame, which remains when its image is dropped.
struct FrameJudgement {
    cell: CellIndex,
    resolution: u32,
    wrong_pixels: u64,
    regions: Regions,
    /// The wrong triangles, ascending.
    wrong: Vec<u32>,
    /// The visible triangles, ascending.
    seen: Vec<u32>,
}

/// Measures a result from `views`. `renderer` must draw the whole scene that was baked. `progress` receives
/// the number of finished frames and of all frames, and returns true to continue. The report depends only on
/// the images, and not on threads or time.
///
/// # Errors
/// [`MeasureError::Stopped`] if `progress` returns false. [`MeasureError::Outside`] if a viewpoint has no
/// cell. [`MeasureError::OtherScene`] if the renderer shows another scene. [`MeasureError::NoViewpoints`] if
/// `views` is empty. Also the errors of the renderer, of the result's decoder and of the file system.
pub fn measure(
    renderer: &dyn CubeRenderer,
    pvs: &Pvs,
    views: &Viewpoints,
    options: &WorstFrameOptions,
    progress: &mut dyn FnMut(u64, u64) -> bool,
) -> Result<Report, MeasureError> {
    if views.points.is_empty() {
        return Err(MeasureError::NoViewpoints);
    }
    if let Some(dir) = &options.images_dir {
        // Create the folder before the work, so that a failure costs no time.
        std::fs::create_dir_all(dir).map_err(|e| MeasureError::Image {
            path: dir.clone(),
            reason: e.to_string(),
        })?;
    }
    let total = views.points.len() as u64;
    let mut seen = vec![false; pvs.triangle_count() as usize];
    let mut cells = BTreeSet::new();
    let mut durations = Durations::default();
    let mut frames: Vec<Frame> = Vec::new();
    let mut wrong_counts: Vec<u64> = Vec::new();
    let mut region_counts = 0u64;
    let mut largest: Vec<u64> = Vec::new();
    let mut resolution = 0;
    for (batch, points) in views.points.chunks(BATCH).enumerate() {
        let judged: Vec<Result<FrameJudgement, MeasureError>> = points
            .par_iter()
            .enumerate()
            .map(|(i, &point)| judge(renderer, pvs, batch * BATCH + i, point))
            .collect();
        for (judged, point) in judged.into_iter().zip(points) {
            let judged = judged?;
            resolution = judged.resolution;
            let pixels = pixels_of(resolution);
            judged.seen.iter().for_each(|&id| seen[id as usize] = true);
            cells.insert(judged.cell);
            durations.push(&judged.wrong);
            frames.push(Frame {
                frame: frames.len() as u64,
                viewpoint: point.to_array(),
                cell: judged.cell,
                error: judged.wrong_pixels as f64 / pixels,
                regions: judged.regions.count,
                max_region: f64::from(judged.regions.largest) / pixels,
                wrong_triangles: judged.wrong.len() as u64,
                image: None,
            });
            wrong_counts.push(judged.wrong_pixels);
            region_counts += u64::from(judged.regions.count);
            if judged.wrong_pixels > 0 {
                largest.push(u64::from(judged.regions.largest));
            }
        }
        let done = frames.len() as u64;
        if !progress(done, total) {
            return Err(MeasureError::Stopped { done, total });
        }
    }

    // These are sums of whole pixels, so the order of additions does not affect them.
    let pixels = pixels_of(resolution);
    let mean = |sum: u64, count: u64| {
        if count == 0 {
            0.0
        } else {
            sum as f64 / count as f64
        }
    };
    // With weights, the mean is weighted, in the order of the frames. The other measures are over frames.
    let weighted = (!views.weights.is_empty()).then(|| {
        let sum: f64 = views.weights.iter().sum();
        let wrong = wrong_counts
            .iter()
            .zip(&views.weights)
            .map(|(wrong, weight)| *wrong as f64 * weight);
        wrong.sum::<f64>() / sum
    });
    let wrong_sum: u64 = wrong_counts.iter().sum();
    wrong_counts.sort_unstable();
    frames.sort_by(|a, b| b.error.total_cmp(&a.error).then(a.frame.cmp(&b.frame)));
    frames.truncate(options.worst);
    if let Some(dir) = &options.images_dir {
        for (rank, frame) in frames.iter_mut().enumerate().take(options.images) {
            let path = dir.join(format!(
                "worst_{:02}_frame_{:06}.png",
                rank + 1,
                frame.frame
            ));
            let (mut image, passed) = render(renderer, pvs, Vec3::from(frame.viewpoint))?;
            let visible = visible_bits(pvs, frame.cell)?;
            // A missing see-through triangle is drawn in front of the geometry that it does not hide.
            for (pixel, id) in passed.into_iter().filter(|p| is_wrong(&visible, p.1)) {
                image.ids[pixel as usize] = id;
            }
            images::write(&path, &image, &visible)?;
            if let Some(up) = options.turntable.filter(|_| rank == 0) {
                turntable::write(&dir.join("worst_turntable.png"), &image, &visible, up)?;
            }
            frame.image = Some(path);
        }
    }
    Ok(Report {
        frames: total,
        resolution,
        mean_error: weighted.unwrap_or_else(|| mean(wrong_sum, total)) / pixels,
        p99_error: nearest_rank(&wrong_counts, 99).unwrap_or(0) as f64 / pixels,
        max_error: wrong_counts.last().copied().unwrap_or(0) as f64 / pixels,
        mean_regions: mean(region_counts, total),
        mean_max_region: mean(largest.iter().sum(), largest.len() as u64) / pixels,
        max_region: largest.iter().max().copied().unwrap_or(0) as f64 / pixels,
        frames_with_error: largest.len() as u64,
        cells_visited: cells.len() as u64,
        triangles_seen: seen.iter().filter(|&&s| s).count() as u64,
        worst: frames,
        path: views.is_path.then(|| durations.report()),
    })
}

/// Returns the number of pixels of a frame.
fn pixels_of(resolution: u32) -> f64 {
    6.0 * f64::from(resolution) * f64::from(resolution)
}

/// Renders a frame and compares it with its cell's set.
fn judge(
    renderer: &dyn CubeRenderer,
    pvs: &Pvs,
    frame: usize,
    point: Vec3,
) -> Result<FrameJudgement, MeasureError> {
    let point = point.to_array();
    let cell = pvs.find_cell(point).map(CellIndex);
    let cell = cell.ok_or(MeasureError::Outside { frame, point })?;
    let (image, passed) = render(renderer, pvs, Vec3::from(point))?;
    let visible = visible_bits(pvs, cell)?;
    let mut wrong_pixels: Vec<bool> = image.ids.iter().map(|&id| is_wrong(&visible, id)).collect();
    for (pixel, id) in &passed {
        wrong_pixels[*pixel as usize] |= is_wrong(&visible, *id);
    }
    let mut seen = image.ids;
    seen.extend(passed.iter().map(|p| p.1));
    // Neighbouring pixels mostly agree, so few ids remain to sort without repetitions.
    seen.dedup();
    seen.sort_unstable();
    seen.dedup();
    seen.pop_if(|last| *last == SKY);
    Ok(FrameJudgement {
        cell,
        resolution: image.resolution,
        wrong_pixels: wrong_pixels.iter().filter(|&&w| w).count() as u64,
        regions: regions(image.resolution, &wrong_pixels),
        wrong: seen
            .iter()
            .copied()
            .filter(|&id| is_wrong(&visible, id))
            .collect(),
        seen,
    })
}

/// Renders the layers from a point. Checks that every id in them is sky or a triangle of the result.
fn render(renderer: &dyn CubeRenderer, pvs: &Pvs, point: Vec3) -> Result<CubeLayers, MeasureError> {
    let (image, passed) = renderer.layers(point)?;
    let (resolution, pixels) = (image.resolution, image.ids.len());
    if resolution == 0 || pixels as u64 != 6 * u64::from(resolution) * u64::from(resolution) {
        return Err(MeasureError::ImageSize { resolution, pixels });
    }
    let triangles = pvs.triangle_count();
    let mut ids = image.ids.iter().copied().chain(passed.iter().map(|p| p.1));
    match ids.find(|&id| id != SKY && id >= triangles) {
        Some(id) => Err(MeasureError::OtherScene { id, triangles }),
        None => Ok((image, passed)),
    }
}

fn visible_bits(pvs: &Pvs, cell: CellIndex) -> Result<Vec<u64>, MeasureError> {
    let mut bits = vec![0u64; (pvs.triangle_count() as usize).div_ceil(64)];
    pvs.visible_bits(cell.0, &mut bits)?;
    Ok(bits)
}
