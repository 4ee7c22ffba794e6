//! The items of a result: the triangles, clusters of triangles, or objects that its sets name.
//!
//! The section begins with one byte, 1 for clusters and 2 for objects, and the number of items as u32. For
//! clusters, one coded set of triangles per cluster follows (a LEB128 number, which is the length in bytes,
//! and the set). No two clusters share a triangle. For objects, whose triangles the object table lists, one
//! coded set follows: the triangles that are never visible, because they have no area or do not show. A
//! result whose sets name triangles has no such section.

use crate::codec::{self, read_varint, varint};
use crate::error::PvsError;
use crate::layout::Section;
use crate::{Object, runs};

/// The type of items that the sets of a result name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Granularity {
    /// The sets name triangles.
    Triangles,
    /// The sets name clusters of neighbouring triangles of one object.
    Clusters,
    /// The sets name objects.
    Objects,
}

impl Granularity {
    /// Returns the name of the granularity in flags and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Triangles => "triangles",
            Self::Clusters => "clusters",
            Self::Objects => "objects",
        }
    }
}

/// The items of a result whose sets do not name triangles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Items {
    /// The ascending triangles of each cluster.
    Clusters(Vec<Vec<u32>>),
    /// The objects, with the triangles that are never visible.
    Objects {
        /// The triangles without area and the triangles that do not show, ascending.
        never: Vec<u32>,
    },
}

/// The items of an opened file.
#[derive(Clone, Debug)]
pub(crate) enum ItemTable {
    Triangles,
    /// The boundaries of the runs of each cluster. The boundaries of cluster i are the range from `starts[i]`
    /// to `starts[i + 1]` of `bounds`.
    Clusters {
        starts: Vec<u32>,
        bounds: Vec<u32>,
    },
    /// The boundaries of the triangles that are never visible.
    Objects {
        never: Vec<u32>,
    },
}

impl Items {
    /// Codes the section of a file with `triangles` triangles and `objects` objects.
    pub(crate) fn encode(&self, triangles: u32, objects: usize) -> Result<Vec<u8>, PvsError> {
        let bad = |reason: &str| Section::Items.malformed(reason);
        let ascending = |ids: &[u32]| {
            ids.windows(2).all(|w| w[0] < w[1]) && ids.last().is_none_or(|last| *last < triangles)
        };
        let (kind, count, sets): (u8, usize, &[Vec<u32>]) = match self {
            Self::Clusters(clusters) => (1, clusters.len(), clusters),
            Self::Objects { never } => (2, objects, std::slice::from_ref(never)),
        };
        let mut out = vec![kind];
        let count = u32::try_from(count).map_err(|_| bad("the number of items exceeds 32 bits"))?;
        out.extend(count.to_le_bytes());
        let mut coded = Vec::new();
        for set in sets {
            if !ascending(set) {
                return Err(bad(
                    "the triangle ids of an item do not ascend or are too large",
                ));
            }
            coded.clear();
            codec::encode(&runs::from_ids(set), false, &mut coded);
            varint(coded.len() as u64, &mut out);
            out.extend_from_slice(&coded);
        }
        Ok(out)
    }
}

impl ItemTable {
    /// Decodes the section of a file with `triangles` triangles and these objects.
    pub fn decode(bytes: &[u8], triangles: u32, objects: &[Object]) -> Result<Self, PvsError> {
        let bad = |reason: &str| Section::Items.malformed(reason);
        let (kind, rest) = bytes
            .split_first()
            .ok_or_else(|| bad("the section is empty"))?;
        let (count, mut rest) = rest
            .split_first_chunk::<4>()
            .ok_or_else(|| bad("the number of items is missing"))?;
        let count = u32::from_le_bytes(*count) as usize;
        let mut next = |bounds: &mut Vec<u32>| {
            let (length, after) =
                read_varint(rest).ok_or_else(|| bad("the section is cut short"))?;
            let set = usize::try_from(length)
                .ok()
                .and_then(|n| after.split_at_checked(n));
            let (set, after) =
                set.ok_or_else(|| bad("an item reaches beyond the end of the section"))?;
            rest = after;
            codec::decode(set, triangles, |start, end| bounds.extend([start, end]))
                .map_err(|e| bad(&format!("an item: {}", e.0)))
        };
        let table = match kind {
            1 => {
                // An item has at least one byte.
                if count > bytes.len() {
                    return Err(bad("the section has fewer bytes than items"));
                }
                let (mut starts, mut bounds) = (vec![0], Vec::new());
                for _ in 0..count {
                    next(&mut bounds)?;
                    starts.push(
                        u32::try_from(bounds.len())
                            .map_err(|_| bad("the items have more than 2³¹ runs"))?,
                    );
                }
                let mut all: Vec<[u32; 2]> =
                    bounds.chunks_exact(2).map(|run| [run[0], run[1]]).collect();
                all.sort_unstable();
                if all.windows(2).any(|w| w[0][1] > w[1][0]) {
                    return Err(bad("two clusters share a triangle"));
                }
                Self::Clusters { starts, bounds }
            }
            2 => {
                if count != objects.len() {
                    return Err(bad(
                        "the number of items differs from the number of objects",
                    ));
                }
                let mut never = Vec::new();
                next(&mut never)?;
                Self::Objects { never }
            }
            _ => return Err(bad("the first byte is not 1 or 2")),
        };
        if rest.is_empty() {
            Ok(table)
        } else {
            Err(bad("bytes follow the last item"))
        }
    }

    /// Returns the type of items that the sets name.
    pub fn granularity(&self) -> Granularity {
        match self {
            Self::Triangles => Granularity::Triangles,
            Self::Clusters { .. } => Granularity::Clusters,
            Self::Objects { .. } => Granularity::Objects,
        }
    }

    /// Returns the number of items.
    pub fn count(&self, triangles: u32, objects: &[Object]) -> u32 {
        match self {
            Self::Triangles => triangles,
            Self::Clusters { starts, .. } => starts.len() as u32 - 1,
            Self::Objects { .. } => objects.len() as u32,
        }
    }

    /// Returns the triangles of `items` as the boundaries of maximal runs. `items` contains the boundaries of
    /// runs of items.
    pub fn triangles(&self, items: &[u32], objects: &[Object]) -> Vec<u32> {
        match self {
            Self::Triangles => items.to_vec(),
            Self::Clusters { starts, bounds } => {
                let mut all: Vec<[u32; 2]> = Vec::new();
                for run in items.chunks_exact(2) {
                    let range = starts[run[0] as usize] as usize..starts[run[1] as usize] as usize;
                    all.extend(bounds[range].chunks_exact(2).map(|r| [r[0], r[1]]));
                }
                all.sort_unstable();
                joined(all.into_iter())
            }
            Self::Objects { never } => {
                let objects_in = |run: &[u32]| objects[run[0] as usize..run[1] as usize].iter();
                let ranges = items
                    .chunks_exact(2)
                    .flat_map(objects_in)
                    .map(|o| [o.first, o.first + o.count]);
                let all = joined(ranges.filter(|r| r[0] < r[1]));
                let [shown] = runs::sweep([&all, never], |m| u32::from(m == 1));
                shown
            }
        }
    }
}

/// Returns the boundaries of ascending ranges, and joins adjacent ranges.
fn joined(ranges: impl Iterator<Item = [u32; 2]>) -> Vec<u32> {
    let mut bounds: Vec<u32> = Vec::new();
    for [start, end] in ranges {
        match bounds.last_mut() {
            Some(last) if *last == start => *last = end,
            _ => bounds.extend([start, end]),
        }
    }
    bounds
}
