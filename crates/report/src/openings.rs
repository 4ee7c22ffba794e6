//! Openings: boxes that most of the segments between an object and the cells that see it pass.

use glam::{UVec3, Vec3};
use rustc_hash::{FxHashMap, FxHashSet};
use serde::Serialize;
use sightline_scene::Aabb;

/// The numbers of boxes along the longest side of the scene, from the finest grid to the coarsest.
const GRIDS: [u32; 4] = [96, 48, 24, 12];
/// The minimum share of the cells that see the object through the box.
const SHARE: f64 = 0.6;
/// The minimum share of a cell's free segments that pass the box.
const MOST: f64 = 0.9;
/// The maximum share of a cell's blocked segments that pass the box. All segments converge in front of the
/// object, free or not; only free segments pass an opening.
const FEW: f64 = 0.5;
/// The maximum number of inspected segments per cell.
const LOOKED_AT: usize = 16;

/// A box in space.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Opening {
    /// The lowest and highest corner, in world space.
    pub bounds: [[f32; 3]; 2],
}

impl Opening {
    fn corners(&self) -> [Vec3; 2] {
        self.bounds.map(Vec3::from)
    }

    /// Returns true if a segment passes the box.
    pub fn is_passed(&self, [a, b]: [Vec3; 2]) -> bool {
        let [min, max] = self.corners();
        let (mut from, mut to) = (0.0f32, 1.0f32);
        for axis in 0..3 {
            let (start, along) = (a[axis], b[axis] - a[axis]);
            if along == 0.0 {
                if start < min[axis] || start > max[axis] {
                    return false;
                }
                continue;
            }
            let ends = [(min[axis] - start) / along, (max[axis] - start) / along];
            from = from.max(ends[0].min(ends[1]));
            to = to.min(ends[0].max(ends[1]));
        }
        from <= to
    }

    /// Returns true if two boxes have a point in common.
    pub fn meets(&self, other: &Self) -> bool {
        let ([a0, a1], [b0, b1]) = (self.corners(), other.corners());
        a0.cmple(b1).all() && b0.cmple(a1).all()
    }
}

/// A cell that sees an object, and the sampled segments from the cell to the object.
pub struct Sights {
    /// The cell's box.
    pub cell: Aabb,
    /// The free segments from the cell to the object.
    pub segments: Vec<[Vec3; 2]>,
    /// The blocked segments from the cell to the object.
    pub blocked: Vec<[Vec3; 2]>,
}

impl Sights {
    /// Returns true if at least half of the segments between the cell and the object are blocked. Otherwise
    /// no opening restricts the view of the object, although all segments converge in front of the object.
    fn is_narrow(&self) -> bool {
        self.segments.len() <= self.blocked.len()
    }
}

/// Returns the smallest box through which most of these cells see the object, outside the cells and away from
/// the object. Returns `None` if no such box exists, or if only one cell sees the object.
pub fn find(scene: Aabb, object: Aabb, sights: &[&Sights]) -> Option<Opening> {
    if sights.len() < 2 {
        return None;
    }
    let longest = (scene.max - scene.min).max_element();
    GRIDS
        .into_iter()
        .find_map(|grid| of_size(scene, object, sights, longest / grid as f32))
}

/// Returns the box of this size through which most cells see the object. Boxes overlap by half, so that an
/// opening of half the size is in one of them.
fn of_size(scene: Aabb, object: Aabb, sights: &[&Sights], size: f32) -> Option<Opening> {
    let half = size / 2.0;
    let near = Aabb {
        min: object.min - size,
        max: object.max + size,
    };
    let mut cells: FxHashMap<[u32; 3], u32> = FxHashMap::default();
    for narrow in sights.iter().filter(|s| s.is_narrow()) {
        let passes = |segments: &[[Vec3; 2]], share: f64| {
            let (passed, count) = passing(scene, &[narrow.cell, near], segments, half);
            let enough = share * count as f64;
            passed
                .into_iter()
                .filter(move |(_, n)| f64::from(*n) >= enough)
                .map(|(place, _)| place)
        };
        let full: FxHashSet<[u32; 3]> = passes(&narrow.blocked, FEW).collect();
        for place in passes(&narrow.segments, MOST).filter(|place| !full.contains(place)) {
            *cells.entry(place).or_default() += 1;
        }
    }
    // Of several boxes with equal counts, choose the first in order, so that the result is unique.
    let (place, count) = cells
        .into_iter()
        .max_by(|a, b| a.1.cmp(&b.1).then(b.0.cmp(&a.0)))?;
    (f64::from(count) >= SHARE * sights.len() as f64).then(|| {
        let min = scene.min + Vec3::from(place.map(|p| p as f32)) * half;
        Opening {
            bounds: [min.to_array(), (min + size).to_array()],
        }
    })
}

/// Returns, for each box of the grid, the number of segments that pass the box outside the boxes `but`. Also
/// returns the number of inspected segments.
fn passing(
    scene: Aabb,
    but: &[Aabb],
    segments: &[[Vec3; 2]],
    half: f32,
) -> (FxHashMap<[u32; 3], u32>, usize) {
    // The value also stores the last segment that passed the box.
    let mut passed: FxHashMap<[u32; 3], (u32, usize)> = FxHashMap::default();
    let every = segments.len().div_ceil(LOOKED_AT).max(1);
    let looked_at = segments.iter().step_by(every);
    let count = looked_at.len();
    for (number, [a, b]) in looked_at.enumerate() {
        // Each step is at most half a box long. A segment that cuts a corner of a box may not count, which is
        // harmless.
        let steps = ((*b - *a).length() / half).ceil().max(1.0) as u32;
        for step in 1..steps {
            let at = a.lerp(*b, step as f32 / steps as f32);
            if but.iter().any(|not| not.contains(at)) || !scene.contains(at) {
                continue;
            }
            let place = ((at - scene.min) / half).as_uvec3();
            for corner in 0..8 {
                let back = UVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
                let entry = passed
                    .entry(place.saturating_sub(back).to_array())
                    .or_insert((0, usize::MAX));
                if entry.1 != number {
                    *entry = (entry.0 + 1, number);
                }
            }
        }
    }
    (
        passed
            .into_iter()
            .map(|(place, (n, _))| (place, n))
            .collect(),
        count,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_passed_tests_segment_against_box() {
        let unit = Opening {
            bounds: [[0.0; 3], [1.0; 3]],
        };
        let passes = |a: [f32; 3], b: [f32; 3]| unit.is_passed([a.into(), b.into()]);
        assert!(passes([-1.0, 0.5, 0.5], [2.0, 0.5, 0.5]));
        assert!(!passes([-1.0, 0.5, 0.5], [-0.5, 0.5, 0.5]));
        assert!(!passes([-1.0, 0.5, 0.5], [0.5, 2.6, 0.5]));
        assert!(passes([0.5, 0.5, 0.5], [0.6, 0.5, 0.5]));
    }

    #[test]
    fn find_returns_door_but_nothing_in_open() {
        let scene = Aabb {
            min: Vec3::ZERO,
            max: Vec3::new(24.0, 4.0, 24.0),
        };
        let object = Aabb {
            min: Vec3::new(20.0, 0.0, 10.0),
            max: Vec3::new(22.0, 2.0, 14.0),
        };
        // All segments pass a door at x = 12, z = 11.5 to 12.5, or go straight.
        let sights = |through: bool| -> Vec<Sights> {
            let from = |k: u32| {
                let cell_min = Vec3::new(2.0, 0.0, 2.0 * k as f32 + 2.0);
                let a = cell_min + 0.5;
                // Other segments were tried, to all of the object past all of the wall.
                let aside = (0..9u8).map(|n| [a, Vec3::new(21.0, 1.0, 2.2 * f32::from(n) + 1.0)]);
                let blocked = if through { aside.collect() } else { Vec::new() };
                let segments = (0..9u8).map(|n| {
                    let door = Vec3::new(12.0, 1.0, 11.6 + 0.1 * f32::from(n));
                    let b = a + (door - a) * 1.9;
                    if through {
                        [a, b]
                    } else {
                        [a, Vec3::new(21.0, 1.0, a.z + f32::from(n) * 0.1)]
                    }
                });
                Sights {
                    cell: Aabb {
                        min: cell_min,
                        max: cell_min + 1.0,
                    },
                    segments: segments.collect(),
                    blocked,
                }
            };
            (0..8).map(from).collect()
        };
        let found = |sights: &[Sights]| find(scene, object, &sights.iter().collect::<Vec<_>>());
        let door = found(&sights(true)).unwrap();
        let [min, max] = door.bounds;
        assert!(
            min[0] <= 12.5 && max[0] >= 11.5 && max[0] - min[0] <= 2.0,
            "{door:?}"
        );
        assert!(min[2] <= 12.5 && max[2] >= 11.5, "{door:?}");
        assert_eq!(found(&sights(false)), None);
        // In the open, all segments converge in front of a small object, and no other segments were tried.
        let mut open = sights(true);
        open.iter_mut().for_each(|sights| sights.blocked.clear());
        assert_eq!(found(&open), None);
        assert_eq!(found(&sights(true)[..1]), None);
    }
}
