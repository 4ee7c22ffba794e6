//! The inputs of a tile in addition to its job.

use sightline_model::receivers::Receivers;
use sightline_trace::Tracer;

use crate::{BakeScene, PackDigest};

/// The pack of a tile that another tile needs.
#[derive(Clone, Copy, Debug)]
pub enum PackBytes<'a> {
    /// The pack's bytes.
    Present(&'a [u8]),
    /// The digest of a lost pack. The tile computes the pack again, which must have this digest.
    Lost(PackDigest),
}

/// The inputs of a tile in addition to its job. The job's task determines the inputs that the tile needs.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// The scene.
    pub scene: &'a BakeScene,
    /// The tracer, for jobs that sample.
    pub tracer: Option<&'a dyn Tracer>,
    /// The packs that the tile needs from other tiles, in the plan's order.
    pub packs: &'a [PackBytes<'a>],
    /// The receivers that a job of ambient occlusion references.
    pub receivers: Option<&'a Receivers>,
}

impl<'a> Inputs<'a> {
    /// Creates the inputs of a tile that needs only a scene.
    pub fn new(scene: &'a BakeScene) -> Self {
        Self {
            scene,
            tracer: None,
            packs: &[],
            receivers: None,
        }
    }

    /// Adds the tracer.
    #[must_use]
    pub fn with_tracer(self, tracer: &'a dyn Tracer) -> Self {
        let tracer = Some(tracer);
        Self { tracer, ..self }
    }

    /// Adds the packs that the tile needs from other tiles.
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
