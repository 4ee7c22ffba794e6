//! How a job's specification is kept: in the job's record, or, when the marks of its viewpoints or its tree
//! of boxes make it too large for a record, with these as a blob that the record names.

use prost::Message as _;
use sightline_model::JobSpec;
use sightline_proto::v1;

use crate::ids::Digest;
use crate::store::{BlobError, Blobs, MAX_SPEC_BYTES};

/// The first byte of a record whose viewpoints are a blob; no message begins with it. The blob's digest and
/// the specification without viewpoints follow.
const NAMED: u8 = 0x07;
/// The first byte of a record whose viewpoints and division are a blob, as a message with these fields alone.
const PARTS: u8 = 0x0f;

/// The bytes of a record for a specification. Stores its large parts as a blob when they are too large.
pub(crate) fn stored(blobs: &dyn Blobs, spec: &JobSpec) -> Result<Vec<u8>, BlobError> {
    let mut message = spec.to_proto();
    let whole = message.encode_to_vec();
    if whole.len() <= MAX_SPEC_BYTES {
        return Ok(whole);
    }
    let viewpoints = std::mem::take(&mut message.viewpoints);
    let (kind, blob) = match &message.division {
        Some(v1::job_spec::Division::Tree(_)) => {
            let parts = v1::JobSpec {
                viewpoints,
                division: message.division.take(),
                ..Default::default()
            };
            (PARTS, parts.encode_to_vec())
        }
        _ => (NAMED, viewpoints),
    };
    let digest = blobs.put(&blob)?;
    let mut bytes = vec![kind];
    bytes.extend(digest);
    bytes.extend(message.encode_to_vec());
    Ok(bytes)
}

/// A record's specification without its large parts if they are a blob, and the blob's digest.
///
/// # Errors
/// The reason, when it cannot be decoded.
pub(crate) fn part(bytes: &[u8]) -> Result<(v1::JobSpec, Option<Digest>), String> {
    let named = bytes
        .split_first()
        .filter(|(kind, _)| [NAMED, PARTS].contains(kind));
    let (rest, digest) = match named.and_then(|(_, bytes)| bytes.split_first_chunk::<32>()) {
        Some((digest, rest)) => (rest, Some(*digest)),
        None => (bytes, None),
    };
    v1::JobSpec::decode(rest)
        .map(|spec| (spec, digest))
        .map_err(|e| format!("{e}; submit it again"))
}

/// The receivers that a record's specification names, if it can be read.
pub(crate) fn receivers(bytes: &[u8]) -> Option<v1::Ambient> {
    part(bytes).ok().and_then(|(spec, _)| spec.ambient)
}

/// The blobs that a record's specification names: its large parts, and its receivers. A specification of
/// another version names nothing that can be read.
pub(crate) fn named(bytes: &[u8]) -> Vec<Digest> {
    let Ok((spec, parts)) = part(bytes) else {
        return Vec::new();
    };
    let receivers = spec
        .ambient
        .and_then(|ambient| ambient.receivers.try_into().ok());
    parts.into_iter().chain(receivers).collect()
}

/// A record's whole specification.
///
/// # Errors
/// The reason, when it cannot be decoded or read.
pub(crate) fn whole(blobs: &dyn Blobs, bytes: &[u8]) -> Result<v1::JobSpec, String> {
    let (mut spec, digest) = part(bytes)?;
    if let Some(digest) = digest {
        let blob = blobs.read(&digest);
        let blob = blob
            .map_err(|e| format!("its viewpoints or boxes cannot be read: {e}; submit it again"))?;
        if bytes.first() == Some(&PARTS) {
            let parts = v1::JobSpec::decode(&*blob);
            let parts =
                parts.map_err(|e| format!("its boxes cannot be read: {e}; submit it again"))?;
            (spec.viewpoints, spec.division) = (parts.viewpoints, parts.division);
        } else {
            spec.viewpoints = blob;
        }
    }
    Ok(spec)
}

/// A record's specification without its viewpoints where they are a blob: what a plan needs.
///
/// # Errors
/// The reason, when it cannot be decoded or read.
pub(crate) fn planned(blobs: &dyn Blobs, bytes: &[u8]) -> Result<JobSpec, String> {
    let (spec, _) = part(bytes)?;
    let spec = if spec.division.is_some() {
        spec
    } else {
        whole(blobs, bytes)?
    };
    JobSpec::from_proto(&spec, None).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;
    use sightline_scene::Aabb;
    use sightline_viewcells::{Division, KdTree, Viewpoints};

    use super::*;
    use crate::store::MemoryBlobs;

    #[test]
    fn a_large_specification_comes_back_from_its_blob() {
        let blobs = MemoryBlobs::default();
        let view_box = Aabb {
            min: Vec3::ZERO,
            max: Vec3::ONE,
        };
        let grid = [16, 16, 16];
        let mut spec = JobSpec::new([7; 32], Division::Grid(grid), view_box);
        assert_eq!(
            stored(&blobs, &spec).unwrap(),
            spec.to_proto().encode_to_vec()
        );
        let mut marks = Viewpoints::none(grid);
        (0..64).step_by(3).for_each(|x| {
            (0..64)
                .step_by(5)
                .for_each(|y| marks.mark([x, y, (x + y) % 64]))
        });
        spec.viewpoints = Some(Arc::new(marks));
        let bytes = stored(&blobs, &spec).unwrap();
        assert!(
            bytes.len() < MAX_SPEC_BYTES && spec.to_proto().encode_to_vec().len() > MAX_SPEC_BYTES
        );
        assert_eq!(whole(&blobs, &bytes).unwrap(), spec.to_proto());
        assert!(part(&bytes).unwrap().0.viewpoints.is_empty());
        let other = MemoryBlobs::default();
        assert!(whole(&other, &bytes).unwrap_err().contains("viewpoints"));
        assert!(part(&bytes[..20]).is_err());
    }

    #[test]
    fn a_large_tree_comes_back_from_its_blob() {
        let blobs = MemoryBlobs::default();
        let view_box = Aabb {
            min: Vec3::ZERO,
            max: Vec3::splat(1000.0),
        };
        // Slabs of width 1.
        let axes: Vec<u32> = (1..1000).flat_map(|_| [2, 3]).chain([3]).collect();
        assert!(KdTree::new(&axes, &[]).is_err());
        // At most 64 planes are above a box, so the slabs are halved.
        fn halve(lo: u32, hi: u32, out: &mut (Vec<u32>, Vec<f32>)) {
            let middle = lo.midpoint(hi);
            if middle == lo {
                return out.0.push(3);
            }
            out.0.push(2);
            out.1.push(middle as f32);
            halve(lo, middle, out);
            halve(middle, hi, out);
        }
        let mut nodes = (Vec::new(), Vec::new());
        halve(0, 1000, &mut nodes);
        let tree = Division::Tree(Arc::new(KdTree::new(&nodes.0, &nodes.1).unwrap()));
        let spec = JobSpec::new([7; 32], tree, view_box);
        let bytes = stored(&blobs, &spec).unwrap();
        assert!(
            bytes.len() < MAX_SPEC_BYTES && spec.to_proto().encode_to_vec().len() > MAX_SPEC_BYTES
        );
        let back = whole(&blobs, &bytes).unwrap();
        assert_eq!(back, spec.to_proto());
        assert_eq!(JobSpec::from_proto(&back, None).unwrap(), spec);
        assert!(part(&bytes).unwrap().0.division.is_none());
    }
}
