//! The visible error of a result: the error measures of Nirenstein and Blake 2004, section 7.2.
//!
//! From many viewpoints, all around, the whole scene is drawn with triangle ids (a visibility cube). A pixel
//! is *wrong* when its triangle, or a see-through triangle in front of that, is not in the visible set of the
//! viewpoint's cell: an image of only the set would differ there. Sky is never wrong. Wrong pixels
//! that touch form regions, since an eye forgives scattered pixels sooner than a hole.
//!
//! This crate does not draw (a [`sightline_trace::CubeRenderer`] does), and judges the image, not
//! the set: a triangle that is in a set without need costs time when drawn, and is not an error here.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_measure::{Options, Viewpoints, measure};
//! use sightline_pvs::Pvs;
//! use sightline_trace::{Backend as _, CubeSpec, Strata, embree::CpuBackend};
//!
//! let scene = Arc::new(sightline_scene::load("level.glb".as_ref())?);
//! let pvs = Pvs::open("level.pvs")?;
//! let views = Viewpoints::random(200, 7, pvs.tree().view_box());
//! let spec = CubeSpec { resolution: 256, strata: Strata::One, keep_pixels: false };
//! let backend = CpuBackend::new(scene, spec)?;
//! let renderer = backend.prepare(None)?;
//! let report = measure(&*renderer, &pvs, &views, &Options::default(), &mut |_, _| true)?;
//! println!("{}", serde_json::to_string(&report)?);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod camera;
pub mod error;
pub mod exact;
pub mod images;
pub mod measure;
pub mod pairs;
mod pixel;
pub mod portrait;
pub mod regions;
pub mod report;
mod turntable;
pub mod viewpoints;

pub use camera::Camera;
pub use error::MeasureError;
pub use exact::{ExactReport, measure_exact};
pub use measure::{Options, measure};
pub use pairs::{PairReport, measure_pairs};
pub use portrait::Portrait;
pub use report::{Frame, PathReport, Report};
pub use viewpoints::Viewpoints;
