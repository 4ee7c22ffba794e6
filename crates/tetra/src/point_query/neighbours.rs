//! The triangle across each edge of a triangle.
//!
//! Neighbours are pairs: if triangle B is across an edge of triangle A, then A is across the same edge of B.
//! If more than two triangles share an edge, triangles that use the edge in opposite directions are paired
//! first. Triangles with the same three points are never neighbours.

use crate::surfaces::{BLOCKS, FLAT, SurfacesView};

/// Marker for a missing neighbour.
pub const NONE: u32 = u32::MAX;

/// Maximum number of candidates for the neighbour of a triangle across an edge.
///
/// The candidates are the next triangles in the list of triangles at the edge, in the order of ids.
const SEARCHED: usize = 16;

/// Returns true if a triangle with these flags can have neighbours.
fn counts(flags: u8) -> bool {
    flags & FLAT == 0 && flags & BLOCKS != 0
}

/// An edge: the numbers of its two points, the smaller first; the id of the triangle; and the index of the
/// triangle's corner at which the edge starts.
type EdgeOf = (u32, u32, u32, u8);

/// Computes, for each triangle, the id of the triangle across the edge from each corner to the next corner,
/// or [`NONE`].
pub fn neighbours(surfaces: SurfacesView<'_>) -> Vec<[u32; 3]> {
    let triangles = surfaces.triangles;
    let mut sides: Vec<EdgeOf> = Vec::new();
    for (t, points) in (0u32..)
        .zip(triangles)
        .filter(|(t, _)| counts(surfaces.flags[*t as usize]))
    {
        for k in 0..3u8 {
            let (a, b) = (points[usize::from(k)], points[(usize::from(k) + 1) % 3]);
            sides.push((a.min(b), a.max(b), t, k));
        }
    }
    sides.sort_unstable();
    let mut across = vec![[NONE; 3]; triangles.len()];
    for group in sides.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let start = |s: &EdgeOf| triangles[s.2 as usize][usize::from(s.3)];
        let third = |s: &EdgeOf| triangles[s.2 as usize][(usize::from(s.3) + 2) % 3];
        for turned in [false, true] {
            for (at, own) in group.iter().enumerate() {
                let is_free = |s: &EdgeOf| across[s.2 as usize][usize::from(s.3)] == NONE;
                let fits = |s: &&EdgeOf| {
                    is_free(s) && third(s) != third(own) && (turned || start(s) != start(own))
                };
                let next = &group[at + 1..group.len().min(at + 1 + SEARCHED)];
                if let Some(other) = next.iter().find(fits).filter(|_| is_free(own)) {
                    across[own.2 as usize][usize::from(own.3)] = other.2;
                    across[other.2 as usize][usize::from(other.3)] = own.2;
                }
            }
        }
    }
    across
}

/// Checks that neighbours are pairs of triangles that block.
///
/// Neighbours must share the two points of their edge but not the third point.
///
/// # Errors
/// A description of the first fault.
pub fn check(across: &[[u32; 3]], surfaces: SurfacesView<'_>) -> Result<(), String> {
    let triangles = surfaces.triangles;
    if across.len() != triangles.len() {
        return Err("the list does not contain three entries per triangle".to_owned());
    }
    for (t, beside) in (0u32..).zip(across) {
        for k in 0..3 {
            if beside[k] == NONE {
                continue;
            }
            let own = triangles[t as usize];
            let edge = [own[k], own[(k + 1) % 3]];
            let third = own[(k + 2) % 3];
            let fits = triangles.get(beside[k] as usize).is_some_and(|points| {
                let back = (0..3).find(|j| {
                    edge.contains(&points[*j])
                        && edge.contains(&points[(*j + 1) % 3])
                        && points[(*j + 2) % 3] != third
                });
                let both_count = [t, beside[k]]
                    .iter()
                    .all(|t| counts(surfaces.flags[*t as usize]));
                both_count && back.is_some_and(|j| across[beside[k] as usize][j] == t)
            });
            if !fits {
                return Err(format!(
                    "the neighbour of triangle {t} across edge {k} does not have the edge, does not \
                     block, or has another neighbour across the edge"
                ));
            }
        }
    }
    Ok(())
}

/// Returns the id of the triangle across the edge between the points `a` and `b` of a triangle, or [`NONE`].
pub fn across(
    neighbours: &[[u32; 3]],
    triangles: &[[u32; 3]],
    triangle: u32,
    a: u32,
    b: u32,
) -> u32 {
    let t = triangle as usize;
    let (Some(points), Some(of)) = (triangles.get(t), neighbours.get(t)) else {
        return NONE;
    };
    let is_it = |k: &usize| {
        [points[*k], points[(*k + 1) % 3]]
            .iter()
            .all(|p| *p == a || *p == b)
    };
    (0..3).find(is_it).map_or(NONE, |k| of[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computes and checks the neighbours of triangles that all block.
    fn checked_neighbours(triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
        let flags = vec![BLOCKS; triangles.len()];
        let surfaces = SurfacesView {
            points: &[[0.0; 3]; 8],
            triangles,
            flags: &flags,
        };
        let found = neighbours(surfaces);
        check(&found, surfaces).unwrap();
        found
    }

    #[test]
    fn two_triangles_of_a_square_are_neighbours() {
        assert_eq!(
            checked_neighbours(&[[0, 1, 2], [0, 2, 3]]),
            [[NONE, NONE, 1], [0, NONE, NONE]]
        );
    }

    #[test]
    fn doubled_triangles_pair_by_orientation() {
        // The list contains a square, and the same square seen from behind.
        let found = checked_neighbours(&[[0, 1, 2], [0, 2, 1], [0, 2, 3], [0, 3, 2]]);
        assert_eq!(
            found,
            [
                [NONE, NONE, 2],
                [3, NONE, NONE],
                [0, NONE, NONE],
                [NONE, NONE, 1]
            ]
        );
    }

    #[test]
    fn edge_of_three_triangles_has_one_pair() {
        let found = checked_neighbours(&[[0, 1, 2], [0, 1, 3], [1, 0, 4]]);
        assert_eq!([found[0][0], found[1][0], found[2][0]], [2, NONE, 0]);
    }

    #[test]
    fn check_rejects_neighbours_without_pair() {
        let triangles = [[0, 1, 2], [0, 2, 3]];
        let good = checked_neighbours(&triangles);
        let flags = [BLOCKS; 2];
        let surfaces = SurfacesView {
            points: &[[0.0; 3]; 4],
            triangles: &triangles,
            flags: &flags,
        };
        for (t, k, to) in [
            (0, 2, NONE),
            (0, 2, 0),
            (0, 2, 7),
            (0, 0, 1),
            (1, 0, NONE),
            (1, 1, 0),
        ] {
            let mut bad = good.clone();
            bad[t][k] = to;
            assert!(check(&bad, surfaces).is_err(), "{t} {k} {to}");
        }
        let through = SurfacesView {
            flags: &[BLOCKS, 0],
            ..surfaces
        };
        assert!(check(&good, through).is_err());
        assert!(check(&good[..1], surfaces).is_err());
    }
}
