//! The state of uploads: chunks, reservations and turns of unfinished uploads, and the facts of the last
//! scene and the last receivers.

use std::sync::{Arc, Mutex};

use sightline_assemble::SceneSummary;
use sightline_model::receivers::Facts;
use sightline_records::ids::Digest;
use tokio::sync::Semaphore;

use crate::outputs::staged_outputs::StagedOutputs;
use crate::quota::{Budget, FairQueue};
use crate::uploads::chunks::Uploads;

/// Maximum number of scene files that are read at the same time. Further files wait.
const FILES_AT_ONCE: usize = 2;
/// Maximum number of tile outputs that are checked at the same time. Further outputs wait on the disk.
const MAX_CHECKS: usize = 32;

/// Stored receivers.
#[derive(Clone, Debug)]
pub(crate) struct StoredReceivers {
    /// The length of the receivers in bytes.
    pub(crate) bytes: u64,
    /// The header of the receivers.
    pub(crate) facts: Arc<Facts>,
}

/// The state of uploads.
pub(crate) struct UploadState {
    /// The chunks that do not form a scene yet.
    pub(crate) chunks: Uploads,
    /// The bytes of uploads that have not ended.
    pub(crate) unfinished: Budget,
    /// The outputs that workers may write directly to the blob store.
    pub(crate) presigned: StagedOutputs,
    /// The turns for keeping a large upload in memory. Users take turns; all workers together count as one
    /// user.
    pub(crate) large: FairQueue,
    /// Permits for reading scenes from files.
    pub(crate) files: Arc<Semaphore>,
    /// Permits for checking outputs of tiles.
    pub(crate) checks: Arc<Semaphore>,
    /// The facts of the scene that was used last, because consecutive jobs often have the same scene.
    pub(crate) last_scene: Mutex<Option<(Digest, Arc<SceneSummary>)>>,
    /// The facts of the receivers that were used last, because all tiles of a job have the same receivers.
    pub(crate) last_receivers: Mutex<Option<(Digest, StoredReceivers)>>,
}

impl Default for UploadState {
    fn default() -> Self {
        Self {
            chunks: Uploads::default(),
            unfinished: Budget::default(),
            presigned: StagedOutputs::default(),
            large: FairQueue::of_bounded_requests(),
            files: Arc::new(Semaphore::new(FILES_AT_ONCE)),
            checks: Arc::new(Semaphore::new(MAX_CHECKS)),
            last_scene: Mutex::new(None),
            last_receivers: Mutex::new(None),
        }
    }
}
