//! Cache of the receivers of jobs of ambient occlusion: the tiles of a job have the same.

use std::sync::Arc;

use sightline_model::receivers::Receivers;

/// Most receivers kept: those of the current job and the next one.
const KEPT: usize = 2;

/// The receivers of one process, by their digest and the number of triangles of their scene.
#[derive(Default)]
pub struct ReceiverCache {
    // The most recently used ones are last.
    kept: tokio::sync::Mutex<Vec<Kept>>,
}

/// Receivers with their digest and the number of triangles.
type Kept = ([u8; 32], u32, Arc<Receivers>);

impl ReceiverCache {
    /// The receivers with `digest` on a scene of so many triangles; `fetch` is called when they are not in
    /// the cache, and checks the digest of what it gives. Simultaneous calls fetch them once.
    ///
    /// # Errors
    /// The error of `fetch`, or a message when the bytes are no receivers on such a scene.
    pub async fn get<F>(
        &self,
        digest: [u8; 32],
        triangles: u32,
        fetch: F,
    ) -> Result<Arc<Receivers>, String>
    where
        F: Future<Output = Result<Vec<u8>, String>>,
    {
        let mut kept = self.kept.lock().await;
        if let Some(at) = kept
            .iter()
            .position(|(d, t, _)| (*d, *t) == (digest, triangles))
        {
            let found = kept.remove(at);
            let receivers = Arc::clone(&found.2);
            kept.push(found);
            return Ok(receivers);
        }
        let bytes = fetch.await?;
        let decoded = tokio::task::spawn_blocking(move || Receivers::decode(&bytes, triangles));
        let decoded = decoded
            .await
            .map_err(|e| format!("the receivers could not be read: {e}"))?;
        let receivers = Arc::new(decoded.map_err(|e| e.to_string())?);
        if kept.len() == KEPT {
            kept.remove(0);
        }
        kept.push((digest, triangles, Arc::clone(&receivers)));
        Ok(receivers)
    }
}
