//! The inputs of a tile in addition to its job.

use sightline_model::receivers::Receivers;
use sightline_trace::Backend;

use crate::{BakeScene, PackDigest};

/// The pack of a tile that another tile needs.
#[derive(Clone, Copy, Debug)]
pub enum PackBytes<'a> {
    /// The pack's bytes.
    Present(&'a [u8]),
    /// The digest of a lost pack. The tile computes the pack again, which must have this digest.
    Lost(PackDigest),
}

/// The inputs of a tile in addition to its job. Which of them it needs depends on the job's task.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// The scene.
    pub scene: &'a BakeScene,
    /// The tracer, for jobs that sample.
    pub tracer: Option<&'a dyn Backend>,
    /// The packs of the tiles that the tile needs, in the plan's order.
    pub packs: &'a [PackBytes<'a>],
    /// The receivers that a job of ambient occlusion names.
    pub receivers: Option<&'a Receivers>,
}

impl<'a> Inputs<'a> {
    /// Makes the inputs of a tile that needs only a scene.
    pub fn new(scene: &'a BakeScene) -> Self {
        Self {
            scene,
            tracer: None,
            packs: &[],
            receivers: None,
        }
    }

    /// Adds a tracer.
    #[must_use]
    pub fn with_tracer(self, tracer: &'a dyn Backend) -> Self {
        let tracer = Some(tracer);
        Self { tracer, ..self }
    }

    /// Adds the packs of the tiles that the tile needs.
    #[must_use]
    pub fn with_packs(self, packs: &'a [PackBytes<'a>]) -> Self {
        Self { packs, ..self }
    }

    /// Adds the receivers of a job of ambient occlusion.
    #[must_use]
    pub fn with_receivers(self, receivers: &'a Receivers) -> Self {
        let receivers = Some(receivers);
        Self { receivers, ..self }
    }
}
