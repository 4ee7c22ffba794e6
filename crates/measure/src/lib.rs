//! The visible error of a result: the error measures of Nirenstein and Blake 2004, section 7.2.
//!
//! For each viewpoint, a renderer draws the whole scene in all directions with triangle ids (a visibility
//! cube). A pixel is *wrong* if its triangle, or a see-through triangle in front of it, is not in the visible
//! set of the viewpoint's cell: an image of only the set would differ at this pixel. Sky is never wrong.
//! Adjacent wrong pixels form regions, because viewers notice a hole sooner than scattered pixels.
//!
//! This crate does not draw; a [`sightline_trace::CubeRenderer`] does.
//!
//! # Modules
//!
//! - `measure`, `report`, `viewpoints`: [`measure()`], its [`Report`], and the [`Viewpoints`] of a
//!   measurement.
//! - `pixel`, `regions`: the judgement of a pixel, and connected regions of wrong pixels.
//! - `exact`: [`measure_exact`], the missed solid angle by exact sets from points, without pixels.
//! - `pairs`: [`measure_pairs`], the error of the relation between cells.
//! - `camera`, `images`, `turntable`, `portrait`: pictures of frames and of targets.
//!
//! # Invariants
//!
//! - The measure judges the image and not the set: an unnecessary triangle in a set costs rendering time, but
//!   is not an error here.
//!
//! # Example
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_measure::{Viewpoints, WorstFrameOptions, measure};
//! use sightline_pvs::Pvs;
//! use sightline_trace::{Tracer as _, CubeSpec, Strata, cpu::CpuBackend};
//!
//! let scene = Arc::new(sightline_scene::load("level.glb".as_ref())?);
//! let pvs = Pvs::open("level.pvs")?;
//! let views = Viewpoints::random(200, 7, pvs.tree().view_box());
//! let spec = CubeSpec { resolution: 256, strata: Strata::One, keep_pixels: false };
//! let backend = CpuBackend::new(scene, spec)?;
//! let renderer = backend.prepare(None)?;
//! let report = measure(&*renderer, &pvs, &views, &WorstFrameOptions::default(), &mut |_, _| true)?;
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
pub use measure::{WorstFrameOptions, measure};
pub use pairs::{PairReport, measure_pairs};
pub use portrait::Portrait;
pub use report::{Frame, PathReport, Report};
pub use viewpoints::Viewpoints;
