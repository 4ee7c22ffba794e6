//! A cache of values that several tiles of a process use.
//!
//! The crate `lru` would replace six lines: it supports neither shared fetches nor decoding outside the
//! runtime's threads.

use std::sync::Arc;

/// Maximum number of values in a cache: one of the current job and one of the next job.
const CAPACITY: usize = 2;

/// The values that the tiles of a process used last, by key.
pub struct SharedCache<K, V> {
    // The most recently used entry is last.
    entries: tokio::sync::Mutex<Vec<(K, Arc<V>)>>,
}

impl<K, V> Default for SharedCache<K, V> {
    fn default() -> Self {
        Self {
            entries: tokio::sync::Mutex::default(),
        }
    }
}

impl<K: PartialEq, V: Send + Sync + 'static> SharedCache<K, V> {
    /// Creates a cache that contains one value.
    pub fn holding(key: K, value: Arc<V>) -> Self {
        Self {
            entries: tokio::sync::Mutex::new(vec![(key, value)]),
        }
    }

    /// Returns the value of `key`, and fetches it if it is not cached.
    ///
    /// `fetch` returns the bytes of the value after it has checked their digest. `decode` decodes them on a
    /// thread for blocking work. Simultaneous calls fetch once.
    ///
    /// # Errors
    /// The error of `fetch` or `decode`, or a message if `decode` panics.
    pub async fn get(
        &self,
        key: K,
        fetch: impl Future<Output = Result<Vec<u8>, String>>,
        decode: impl FnOnce(Vec<u8>) -> Result<V, String> + Send + 'static,
    ) -> Result<Arc<V>, String> {
        let mut entries = self.entries.lock().await;
        if let Some(at) = entries.iter().position(|(k, _)| *k == key) {
            let entry = entries.remove(at);
            let value = Arc::clone(&entry.1);
            entries.push(entry);
            return Ok(value);
        }
        let bytes = fetch.await?;
        let value = tokio::task::spawn_blocking(move || decode(bytes))
            .await
            .map_err(|e| format!("the bytes could not be decoded: {e}"))??;
        let value = Arc::new(value);
        if entries.len() == CAPACITY {
            entries.remove(0);
        }
        entries.push((key, Arc::clone(&value)));
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[tokio::test]
    async fn cache_fetches_oldest_value_again() {
        let cache = SharedCache::<u8, u8>::default();
        let fetches = Cell::new(0);
        let get = |key: u8| {
            let fetches = &fetches;
            let fetch = async move {
                fetches.set(fetches.get() + 1);
                Ok(vec![key])
            };
            cache.get(key, fetch, |bytes| Ok(bytes[0]))
        };
        for key in [1, 2, 1, 3, 1] {
            assert_eq!(*get(key).await.unwrap(), key);
        }
        assert_eq!(fetches.get(), 3);
        get(2).await.unwrap();
        assert_eq!(fetches.get(), 4);
    }

    #[tokio::test]
    async fn cache_keeps_no_errors() {
        let cache = SharedCache::<u8, u8>::default();
        let decode = |bytes: Vec<u8>| bytes.first().copied().ok_or_else(|| "empty".to_owned());
        let lost = cache.get(1, async { Err("lost".to_owned()) }, decode).await;
        assert_eq!(lost, Err("lost".to_owned()));
        let empty = cache.get(1, async { Ok(Vec::new()) }, decode).await;
        assert_eq!(empty, Err("empty".to_owned()));
        let found = cache.get(1, async { Ok(vec![7]) }, decode).await;
        assert_eq!(found, Ok(Arc::new(7)));
    }
}
