//! A perfect maze by depth-first search: exactly one path joins any two cells. The maze has a floor and walls
//! but no ceiling, so the scene's bounds end at the top of the walls.

use glam::Vec3;

use super::build::Builder;
use super::params::{
    GenerateError, MAX_TRIANGLES, SceneKind, SceneParams, contradiction, isqrt, within,
};
use super::plan::{FloorPlan, Wall, WallPosition};
use super::random::Random;

/// The number of triangles of a cell in a large maze: one wall and one pillar.
const PER_CELL: u64 = 24;
/// Maximum number of columns and of rows. In larger mazes, coordinates would be too large for the thickness
/// of the walls.
const MAX_SIDE: u64 = 20_000;

pub(super) fn build(b: &mut Builder, params: &SceneParams) -> Result<(), GenerateError> {
    let [cols, rows] = grid(SceneKind::Maze, params, PER_CELL, [16, 16], 150)?;
    let plan = FloorPlan {
        origin: Vec3::ZERO,
        cols,
        rows,
        cell: 2.0,
        height: 2.5,
        thickness: 0.2,
    };
    let mut r = Random::new(params.seed, 0);
    let open = carve(cols, rows, &mut r);
    b.object("floor".into(), |b| plan.plate(b, -0.2, 0.0, 0.0));
    for j in 0..=rows {
        for i in 0..=cols {
            b.object(format!("pillar {i} {j}"), |b| plan.pillar(b, i, j));
        }
    }
    for p in plan
        .places()
        .filter(|p| plan.is_outer(*p) || !open.between(*p))
    {
        b.object(wall_name(p), |b| plan.wall(b, p, Wall::Solid, &mut r));
    }
    Ok(())
}

/// Returns the name of the wall at `p`.
pub(super) fn wall_name(p: WallPosition) -> String {
    format!("wall {} {} {}", if p.along_z { 'z' } else { 'x' }, p.i, p.j)
}

/// Computes columns and rows from `params.grid`, or from `params.triangles` (at least `least`) with
/// `per_cell` triangles per cell. Returns `default` if neither is given.
pub(super) fn grid(
    kind: SceneKind,
    params: &SceneParams,
    per_cell: u64,
    default: [u32; 2],
    least: u64,
) -> Result<[u32; 2], GenerateError> {
    let [cols, rows] = match (params.grid, params.triangles) {
        (Some(_), Some(_)) if kind == SceneKind::Maze => {
            return Err(contradiction(kind, "--grid already determines the number"));
        }
        (Some(grid), _) => grid.map(u64::from),
        (None, Some(total)) => {
            within(kind, "--triangles", total, least, MAX_TRIANGLES)?;
            // The pillars and walls of the border need the triangles of an additional strip of cells.
            let side = isqrt(total / per_cell).saturating_sub(1).max(1);
            [
                side,
                ((total / per_cell).saturating_sub(side) / (side + 1)).max(1),
            ]
        }
        (None, None) => default.map(u64::from),
    };
    within(kind, "columns of --grid", cols, 1, MAX_SIDE)?;
    within(kind, "rows of --grid", rows, 1, MAX_SIDE)?;
    within(
        kind,
        "columns × rows × triangles per cell",
        cols * rows * per_cell,
        1,
        MAX_TRIANGLES,
    )?;
    // Both numbers are at most MAX_SIDE.
    Ok([cols as u32, rows as u32])
}

/// The pairs of neighbouring cells that are joined.
pub(super) struct JoinedCells {
    cols: u32,
    /// For each cell, row by row: true if the cell is joined to its neighbour in the next column, and true if
    /// the cell is joined to its neighbour in the next row.
    joined: Vec<[bool; 2]>,
}

impl JoinedCells {
    /// Returns true if the cells on both sides of an inner wall are joined.
    pub(super) fn between(&self, p: WallPosition) -> bool {
        let (i, j, which) = if p.along_z {
            (p.i - 1, p.j, 0)
        } else {
            (p.i, p.j - 1, 1)
        };
        self.joined[(j as usize) * self.cols as usize + i as usize][which]
    }
}

/// Computes a random spanning tree of the cells by depth-first search from a random cell.
pub(super) fn carve(cols: u32, rows: u32, r: &mut Random) -> JoinedCells {
    let (c, n) = (cols as usize, cols as usize * rows as usize);
    let mut joined = vec![[false; 2]; n];
    let mut seen = vec![false; n];
    let mut path = vec![r.below(rows) as usize * c + r.below(cols) as usize];
    seen[path[0]] = true;
    while let Some(&at) = path.last() {
        let (i, j) = (at % c, at / c);
        let ways: [Option<usize>; 4] = [
            (i + 1 < c).then(|| at + 1),
            (j + 1 < rows as usize).then(|| at + c),
            (i > 0).then(|| at - 1),
            (j > 0).then(|| at - c),
        ];
        let free: Vec<usize> = ways.into_iter().flatten().filter(|w| !seen[*w]).collect();
        let Some(&next) = free.get(r.below(free.len() as u32) as usize) else {
            path.pop();
            continue;
        };
        joined[at.min(next)][usize::from(at.abs_diff(next) != 1 || c == 1)] = true;
        seen[next] = true;
        path.push(next);
    }
    JoinedCells { cols, joined }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::generate;

    #[test]
    fn maze_of_n_cells_has_n_minus_one_openings() {
        for grid in [[1, 1], [1, 7], [7, 1], [2, 2], [9, 5]] {
            let open = carve(grid[0], grid[1], &mut Random::new(5, 0));
            let count = open.joined.iter().flatten().filter(|o| **o).count() as u32;
            assert_eq!(count, grid[0] * grid[1] - 1);
            let s = generate(
                SceneKind::Maze,
                &SceneParams {
                    grid: Some(grid),
                    ..SceneParams::default()
                },
            )
            .unwrap();
            let walls = s
                .objects()
                .iter()
                .filter(|o| o.name.starts_with("wall"))
                .count() as u32;
            assert_eq!(walls, grid[0] * grid[1] + grid[0] + grid[1] + 1);
        }
    }
}
