//! How a job's specification is kept: in the job's record, or, when the marks of its viewpoints make it too
//! large for a record, as a blob that the record names.

use prost::Message as _;
use sightline_model::JobSpec;
use sightline_proto::v1;

use crate::ids::Digest;
use crate::store::{BlobError, Blobs, MAX_SPEC_BYTES};

/// The first byte of a record whose viewpoints are a blob; no message begins with it. The blob's digest and
/// the specification without viewpoints follow.
const NAMED: u8 = 0x07;

/// The bytes of a record for a specification. Stores its viewpoints as a blob when they are too large.
pub(crate) fn stored(blobs: &dyn Blobs, spec: &JobSpec) -> Result<Vec<u8>, BlobError> {
    let mut message = spec.to_proto();
    let whole = message.encode_to_vec();
    if whole.len() <= MAX_SPEC_BYTES {
        return Ok(whole);
    }
    let digest = blobs.put(&std::mem::take(&mut message.viewpoints))?;
    let mut bytes = vec![NAMED];
    bytes.extend(digest);
    bytes.extend(message.encode_to_vec());
    Ok(bytes)
}

/// A record's specification without its viewpoints if they are a blob, and the blob's digest.
///
/// # Errors
/// The reason, when it cannot be decoded.
pub(crate) fn part(bytes: &[u8]) -> Result<(v1::JobSpec, Option<Digest>), String> {
    let (rest, digest) = match bytes.strip_prefix(&[NAMED]).and_then(|b| b.split_first_chunk::<32>()) {
        Some((digest, rest)) => (rest, Some(*digest)),
        None => (bytes, None),
    };
    v1::JobSpec::decode(rest).map(|spec| (spec, digest)).map_err(|e| format!("{e}; submit it again"))
}

/// A record's whole specification.
///
/// # Errors
/// The reason, when it cannot be decoded or read.
pub(crate) fn whole(blobs: &dyn Blobs, bytes: &[u8]) -> Result<v1::JobSpec, String> {
    let (mut spec, digest) = part(bytes)?;
    if let Some(digest) = digest {
        spec.viewpoints = blobs
            .read(&digest)
            .map_err(|e| format!("its viewpoints cannot be read: {e}; submit it again"))?;
    }
    Ok(spec)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;
    use sightline_scene::Aabb;
    use sightline_viewcells::{Division, Viewpoints};

    use super::*;
    use crate::store::MemoryBlobs;

    #[test]
    fn a_large_specification_comes_back_from_its_blob() {
        let blobs = MemoryBlobs::default();
        let view_box = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let grid = [16, 16, 16];
        let mut spec = JobSpec::new([7; 32], Division::Grid(grid), view_box);
        assert_eq!(stored(&blobs, &spec).unwrap(), spec.to_proto().encode_to_vec());
        let mut marks = Viewpoints::none(grid);
        (0..64).step_by(3).for_each(|x| (0..64).step_by(5).for_each(|y| marks.mark([x, y, (x + y) % 64])));
        spec.viewpoints = Some(Arc::new(marks));
        let bytes = stored(&blobs, &spec).unwrap();
        assert!(bytes.len() < MAX_SPEC_BYTES && spec.to_proto().encode_to_vec().len() > MAX_SPEC_BYTES);
        assert_eq!(whole(&blobs, &bytes).unwrap(), spec.to_proto());
        assert!(part(&bytes).unwrap().0.viewpoints.is_empty());
        let other = MemoryBlobs::default();
        assert!(whole(&other, &bytes).unwrap_err().contains("viewpoints"));
        assert!(part(&bytes[..20]).is_err());
    }
}
