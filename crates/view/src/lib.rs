//! A result and its scene as one page: a file that a browser can display without other files.
//!
//! The page contains the sections of the result that look-ups read, the scene's triangles, and one number per
//! cell for each heat map. The page's program is in `page/`. The program reads the result with
//! `readers/js/pvs.mjs`, which other pages can use, too.
//!
//! # Modules
//!
//! - `view`, `html`, `pack`: the contents of a page, [`page()`] that writes it, and compressed blocks of
//!   data.
//! - `dashboard`: [`dashboard()`], the page of a coordinator's jobs and workers. The page contains no data;
//!   its program requests the data from the coordinator.
//!
//! # Invariants
//!
//! - A page loads no file from another address, and needs no build step
//!   (`docs/decisions/0011-a-page-without-a-framework.md`).

mod dashboard;
mod html;
mod pack;
mod view;

use sightline_numbers::ids::CellIndex;

pub use dashboard::dashboard;
pub use html::page;
pub use view::each;

/// The reason why a page cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// The result cannot be read.
    #[error(transparent)]
    Pvs(#[from] sightline_pvs::PvsError),
    /// The data cannot be compressed.
    #[error("the data of the page cannot be compressed: {0}")]
    Compress(#[from] std::io::Error),
}

/// A heat map: one number per cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// The name of the map for users, such as “undecided triangles”.
    pub name: String,
    /// One number per cell, NaN for a missing number.
    pub values: Vec<f32>,
}

/// A viewpoint where `measure` found a large error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worst {
    /// The viewpoint, in world space.
    pub viewpoint: [f32; 3],
    /// The cell that contains the viewpoint.
    pub cell: CellIndex,
    /// The fraction of wrong pixels.
    pub error: f64,
}

/// The contents of a page.
pub struct View<'a> {
    /// The result.
    pub pvs: &'a sightline_pvs::Pvs,
    /// The scene that the result was baked from. Without a scene, the page shows only cells.
    pub scene: Option<&'a sightline_scene::Scene>,
    /// The page's title.
    pub title: String,
    /// The description of the result, as text.
    pub about: String,
    /// The axis that points up: 1 for y or 2 for z.
    pub up: usize,
    /// The heat maps that the user can choose.
    pub maps: Vec<Map>,
    /// A viewpoint in each cell, with NaN coordinates if no viewpoint in the cell is known. If the list is
    /// empty, the page uses the centres of the cells.
    pub places: Vec<[f32; 3]>,
    /// The viewpoints with the largest errors.
    pub worst: Vec<Worst>,
    /// The maximum length of sight lines in world units; `None` for unlimited lines.
    pub far: Option<f64>,
    /// The properties of the scene that the page's rays ignore, as text for users.
    pub caveat: Option<String>,
    /// The address to which the page sends exact queries; `None` if the page offers no exact queries.
    pub ask: Option<ViewRequest>,
    /// The cell that the page shows first.
    pub start: CellIndex,
    /// The attribute that a content policy requires for the page's style and program, with a leading space.
    /// Empty for a file.
    pub nonce: String,
}

/// An address on the page's own server for exact queries. The server accepts
/// `{"job":…,"cell":…,"triangle":…}` like the call `sightline.v1.Results/Why` in JSON, and returns the same
/// answer.
#[derive(Clone, Debug)]
pub struct ViewRequest {
    /// The path on the server.
    pub url: String,
    /// The job whose result the page shows; `None` if the server has only one result.
    pub job: Option<u64>,
}

impl ViewRequest {
    /// Creates the address for exact queries about a scene. Returns `None` if exact queries do not support
    /// the scene, because back faces are culled or triangles are masked.
    pub fn about(scene: &sightline_scene::Scene, url: &str, job: Option<u64>) -> Option<Self> {
        let can = scene.sides().are_both() && !scene.kinds().any_masked();
        can.then(|| Self {
            url: url.to_owned(),
            job,
        })
    }
}
