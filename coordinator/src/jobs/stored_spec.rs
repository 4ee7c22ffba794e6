//! The stored specification of a job.
//!
//! The specification is in the job's record. If its viewpoints or boxes make it too large for a record, it is
//! a blob. The record then has the blob's digest, and the specification without viewpoints and boxes.

use prost::Message as _;
use sightline_model::job::message::{has_boxes, remove_large_parts};
use sightline_model::{JobSpec, PlannedJob, SceneFacts};
use sightline_proto::v1;
use sightline_records::MAX_SPEC_BYTES;
use sightline_records::ids::Digest;
use sightline_store::{BlobError, Blobs};

/// The first byte of a stored specification whose complete form is a blob. No message starts with this byte.
/// The blob's digest and the specification without its large parts follow it.
const NAMED: u8 = 0x07;

/// Returns the specification as the bytes that the job's record stores. A specification that is too large for
/// the record is stored as a blob.
///
/// # Errors
/// [`BlobError`] if the blob cannot be stored.
pub(crate) fn stored(blobs: &dyn Blobs, spec: &JobSpec) -> Result<Vec<u8>, BlobError> {
    let mut message = spec.to_message();
    let whole = message.encode_to_vec();
    if whole.len() <= MAX_SPEC_BYTES {
        return Ok(whole);
    }
    let digest = blobs.put(&whole)?;
    remove_large_parts(&mut message);
    let mut bytes = vec![NAMED];
    bytes.extend(digest);
    bytes.extend(message.encode_to_vec());
    Ok(bytes)
}

/// Reads a record's specification and the digest of its blob, if it has one. The specification then lacks its
/// large parts.
///
/// # Errors
/// The reason, if the bytes cannot be decoded.
pub(crate) fn part(bytes: &[u8]) -> Result<(v1::JobSpec, Option<Digest>), String> {
    let named = bytes.split_first().filter(|(kind, _)| **kind == NAMED);
    let (rest, digest) = match named.and_then(|(_, bytes)| bytes.split_first_chunk::<32>()) {
        Some((digest, rest)) => (rest, Some(*digest)),
        None => (bytes, None),
    };
    v1::JobSpec::decode(rest)
        .map(|spec| (spec, digest))
        .map_err(|e| format!("{e}; submit the job again"))
}

/// Returns the receivers that a record's specification references, or `None` without receivers or if the
/// record cannot be read.
pub(crate) fn receivers(bytes: &[u8]) -> Option<v1::Ambient> {
    match part(bytes).ok()?.0.task? {
        v1::job_spec::Task::Ambient(ambient) => Some(ambient),
        v1::job_spec::Task::Visibility(_) => None,
    }
}

/// Returns the blobs that a record's specification references: the whole specification, and the receivers.
/// Returns no blobs for a specification that this version cannot read.
pub(crate) fn named(bytes: &[u8]) -> Vec<Digest> {
    let whole = part(bytes).ok().and_then(|(_, whole)| whole);
    let receivers = receivers(bytes).and_then(|ambient| ambient.receivers.try_into().ok());
    whole.into_iter().chain(receivers).collect()
}

/// Reads and plans a record's whole specification.
///
/// # Errors
/// The reason, if the specification cannot be read or decoded.
pub(crate) fn whole(blobs: &dyn Blobs, bytes: &[u8]) -> Result<PlannedJob, String> {
    whole_spec(blobs, bytes).map(PlannedJob::stored)
}

fn whole_spec(blobs: &dyn Blobs, bytes: &[u8]) -> Result<JobSpec, String> {
    let (part, digest) = part(bytes)?;
    let Some(digest) = digest else {
        return checked(&part);
    };
    let blob = blobs.read(&digest).map_err(|e| {
        format!("the job's viewpoints or boxes cannot be read: {e}; submit the job again")
    })?;
    let whole = v1::JobSpec::decode(&*blob);
    checked(&whole.map_err(|e| {
        format!("the job's specification cannot be read: {e}; submit the job again")
    })?)
}

/// Reads and plans a record's specification, without its viewpoints if the whole is a blob.
///
/// # Errors
/// The reason, if the specification cannot be read or decoded.
pub(crate) fn without_viewpoints(blobs: &dyn Blobs, bytes: &[u8]) -> Result<PlannedJob, String> {
    spec_without_viewpoints(blobs, bytes).map(PlannedJob::stored)
}

/// Reads a record's specification, without its viewpoints if the whole is a blob.
///
/// # Errors
/// The reason, if the specification cannot be read or decoded.
pub(crate) fn spec_without_viewpoints(blobs: &dyn Blobs, bytes: &[u8]) -> Result<JobSpec, String> {
    let (part, digest) = part(bytes)?;
    match digest.is_some() && has_boxes(&part) {
        true => whole_spec(blobs, bytes),
        false => checked(&part),
    }
}

fn checked(message: &v1::JobSpec) -> Result<JobSpec, String> {
    // A stored message has every field, so decoding it needs no facts about the scene.
    let spec = JobSpec::from_message(message, &SceneFacts::default());
    spec.map_err(|e| format!("{e}; submit the job again"))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;
    use sightline_model::{BoxCells, GridCells, KnownCells, Method, Sampler, Sampling, Viewpoints};
    use sightline_scene::Aabb;
    use sightline_viewcells::{KdTree, PartMask};

    use super::*;
    use sightline_store::MemoryBlobs;

    fn job(cells: KnownCells) -> JobSpec {
        let sampling = Sampling::new(Sampler::lines(cells));
        JobSpec::new([7; 32], Method::aggressive(sampling))
    }

    #[test]
    fn large_specification_round_trips_through_blob() {
        let blobs = MemoryBlobs::default();
        let view_box = Aabb {
            min: Vec3::ZERO,
            max: Vec3::ONE,
        };
        let grid = [16, 16, 16];
        let cells = GridCells::new(view_box, grid).unwrap();
        let small = job(KnownCells::Grid(cells.clone()));
        let bytes = stored(&blobs, &small).unwrap();
        assert_eq!(bytes, small.to_message().encode_to_vec());
        assert_eq!(whole(&blobs, &bytes).unwrap().spec(), &small);
        let mut marks = PartMask::empty(grid);
        (0..64).step_by(3).for_each(|x| {
            (0..64)
                .step_by(5)
                .for_each(|y| marks.mark([x, y, (x + y) % 64]))
        });
        let marked = cells.with_viewpoints(Viewpoints::new(marks, None)).unwrap();
        let spec = job(KnownCells::Grid(marked));
        let bytes = stored(&blobs, &spec).unwrap();
        assert!(
            bytes.len() < MAX_SPEC_BYTES
                && spec.to_message().encode_to_vec().len() > MAX_SPEC_BYTES
        );
        assert_eq!(whole(&blobs, &bytes).unwrap().spec(), &spec);
        assert_eq!(without_viewpoints(&blobs, &bytes).unwrap().spec(), &small);
        let other = MemoryBlobs::default();
        assert!(whole(&other, &bytes).unwrap_err().contains("viewpoints"));
        assert!(part(&bytes[..20]).is_err());
    }

    #[test]
    fn large_tree_round_trips_through_blob() {
        let blobs = MemoryBlobs::default();
        let view_box = Aabb {
            min: Vec3::ZERO,
            max: Vec3::splat(1000.0),
        };
        // The slabs have a width of 1.
        let axes: Vec<u32> = (1..1000).flat_map(|_| [2, 3]).chain([3]).collect();
        assert!(KdTree::new(&axes, &[]).is_err());
        // At most 64 planes may lie above a box in the tree, so the slabs are halved.
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
        let tree = Arc::new(KdTree::new(&nodes.0, &nodes.1).unwrap());
        let spec = job(KnownCells::Boxes(BoxCells::new(view_box, tree).unwrap()));
        let bytes = stored(&blobs, &spec).unwrap();
        assert!(
            bytes.len() < MAX_SPEC_BYTES
                && spec.to_message().encode_to_vec().len() > MAX_SPEC_BYTES
        );
        assert_eq!(whole(&blobs, &bytes).unwrap().spec(), &spec);
        assert_eq!(without_viewpoints(&blobs, &bytes).unwrap().spec(), &spec);
    }
}
