//! A result and its scene as one page: a file that a browser shows without any other.
//!
//! The page holds the sections of the result that look-ups read, the scene's triangles, and numbers of each
//! cell for its heat maps. Its program is in `page/`; it reads the result with `readers/js/pvs.mjs`, as any
//! other page could.

mod dashboard;
mod html;
mod pack;
mod view;

pub use dashboard::dashboard;
pub use html::page;
pub use view::each;

/// Why a page cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// The result cannot be read.
    #[error(transparent)]
    Pvs(#[from] sightline_pvs::PvsError),
    /// Memory cannot be compressed.
    #[error("the page cannot be compressed: {0}")]
    Compress(#[from] std::io::Error),
}

/// Numbers of all cells, as a heat map shows them.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// What they are, in words.
    pub name: String,
    /// One number for each cell; NaN where there is none.
    pub values: Vec<f32>,
}

/// A place where `measure` found much wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worst {
    /// The viewpoint, in world space.
    pub viewpoint: [f32; 3],
    /// Its cell.
    pub cell: u32,
    /// The fraction of wrong pixels.
    pub error: f64,
}

/// What a page shows.
pub struct View<'a> {
    /// The result.
    pub pvs: &'a sightline_pvs::Pvs,
    /// The scene that it was baked from; without it the page shows cells alone.
    pub scene: Option<&'a sightline_scene::Scene>,
    /// The page's title.
    pub title: String,
    /// What is said about the result, as text.
    pub about: String,
    /// The axis that points up: 1 or 2 for y or z.
    pub up: usize,
    /// Heat maps.
    pub maps: Vec<Map>,
    /// For each cell a viewpoint in it, NaN where none is known; empty to take the cells' middles.
    pub places: Vec<[f32; 3]>,
    /// The viewpoints of the worst frames.
    pub worst: Vec<Worst>,
    /// How far sight lines go, if that is limited.
    pub far: Option<f64>,
    /// What the page's rays do not know about the scene, in words.
    pub caveat: Option<String>,
    /// Where the page asks for exact answers.
    pub ask: Option<Ask>,
    /// The cell in which the page begins.
    pub start: u32,
    /// The attribute of the page's style and program that a content policy asks for, with a space before it;
    /// empty for a file.
    pub nonce: String,
}

/// An address of the page's own server that takes `{"job":…,"cell":…,"triangle":…}` as the call
/// `sightline.v1.Results/Why` does in JSON, and answers alike.
#[derive(Clone, Debug)]
pub struct Ask {
    /// The path on the server.
    pub url: String,
    /// The job whose result the page shows, where the server has several.
    pub job: Option<u64>,
}

impl Ask {
    /// The address for a scene; `None` where exact queries cannot answer, because back faces are culled or
    /// alpha textures are read.
    pub fn about(scene: &sightline_scene::Scene, url: &str, job: Option<u64>) -> Option<Self> {
        let can = scene.sides().are_both() && !scene.kinds().any_masked();
        can.then(|| Self {
            url: url.to_owned(),
            job,
        })
    }
}
