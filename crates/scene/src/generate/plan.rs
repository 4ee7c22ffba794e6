//! A floor plan on a grid: pillars at the grid corners, walls between the pillars, and doors and windows in
//! the walls.
//!
//! Walls end at the faces of the pillars, so the solids touch without overlaps and without cracks. Pillars
//! are slightly thicker than walls, so walls and pillars do not share edges and each remains a closed solid.

use glam::Vec3;

use super::build::Builder;
use super::random::Random;

/// The kinds of walls between two neighbouring pillars.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Wall {
    /// A wall without opening.
    Solid,
    /// A wall with an opening from the floor to door height, at a random position.
    Door,
    /// A wall with an opening at breast height, at a random position.
    Window,
}

/// The position of a wall: along x between the corners (i, j) and (i+1, j), or along z between (i, j) and (i,
/// j+1).
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct WallPosition {
    pub(super) along_z: bool,
    pub(super) i: u32,
    pub(super) j: u32,
}

/// A storey of `cols` × `rows` square cells.
#[derive(Clone, Copy)]
pub(super) struct FloorPlan {
    /// The foot of the pillar at corner (0, 0).
    pub(super) origin: Vec3,
    pub(super) cols: u32,
    pub(super) rows: u32,
    /// The distance between grid lines, in metres.
    pub(super) cell: f32,
    /// The height of walls and pillars, in metres.
    pub(super) height: f32,
    /// The thickness of walls, in metres.
    pub(super) thickness: f32,
}

impl FloorPlan {
    /// Returns all positions of walls: the walls along x row by row, then the walls along z.
    pub(super) fn places(&self) -> impl Iterator<Item = WallPosition> + use<> {
        let Self { cols, rows, .. } = *self;
        let along_x = (0..=rows).flat_map(move |j| {
            (0..cols).map(move |i| WallPosition {
                along_z: false,
                i,
                j,
            })
        });
        let along_z = (0..rows).flat_map(move |j| {
            (0..=cols).map(move |i| WallPosition {
                along_z: true,
                i,
                j,
            })
        });
        along_x.chain(along_z)
    }

    /// Returns true if a wall at this position is on the border.
    pub(super) fn is_outer(&self, p: WallPosition) -> bool {
        if p.along_z {
            p.i == 0 || p.i == self.cols
        } else {
            p.j == 0 || p.j == self.rows
        }
    }

    /// Returns the minimum and maximum coordinate of a wall on grid line `k` along `axis` (0: x, 2: z).
    fn line(&self, axis: usize, k: u32) -> [f32; 2] {
        let middle = self.origin[axis] + k as f32 * self.cell;
        [middle - self.thickness / 2.0, middle + self.thickness / 2.0]
    }

    /// Returns the minimum and maximum coordinate of a pillar on grid line `k` along `axis` (0: x, 2: z).
    fn pillars(&self, axis: usize, k: u32) -> [f32; 2] {
        let middle = self.origin[axis] + k as f32 * self.cell;
        [
            middle - self.thickness * 0.75,
            middle + self.thickness * 0.75,
        ]
    }

    /// Returns the free floor of cell (i, j): the minimum and maximum corner at floor height.
    pub(super) fn floor(&self, i: u32, j: u32) -> [Vec3; 2] {
        let y = self.origin.y;
        let (x, z) = (
            [self.line(0, i)[1], self.line(0, i + 1)[0]],
            [self.line(2, j)[1], self.line(2, j + 1)[0]],
        );
        [Vec3::new(x[0], y, z[0]), Vec3::new(x[1], y, z[1])]
    }

    /// Adds a box below or above the whole plan, between the heights `from` and `to` in metres above the
    /// floor. The box extends `overhang` metres beyond the outer pillars.
    pub(super) fn plate(&self, b: &mut Builder, from: f32, to: f32, overhang: f32) {
        let y = self.origin.y;
        let out = Vec3::new(overhang, 0.0, overhang);
        let min = Vec3::new(self.pillars(0, 0)[0], y + from, self.pillars(2, 0)[0]) - out;
        let max = Vec3::new(
            self.pillars(0, self.cols)[1],
            y + to,
            self.pillars(2, self.rows)[1],
        ) + out;
        b.cuboid(min, max);
    }

    /// Adds the pillar at grid corner (i, j).
    pub(super) fn pillar(&self, b: &mut Builder, i: u32, j: u32) {
        let (x, z) = (self.pillars(0, i), self.pillars(2, j));
        let y = [self.origin.y, self.origin.y + self.height];
        b.cuboid(Vec3::new(x[0], y[0], z[0]), Vec3::new(x[1], y[1], z[1]));
    }

    /// Adds a wall at `p`.
    pub(super) fn wall(&self, b: &mut Builder, p: WallPosition, wall: Wall, r: &mut Random) {
        let (axes, u, line) = if p.along_z {
            ([2, 1, 0], p.j, p.i)
        } else {
            ([0, 1, 2], p.i, p.j)
        };
        let (from, to) = (self.pillars(axes[0], u)[1], self.pillars(axes[0], u + 1)[0]);
        let ns = self.line(axes[2], line);
        let (low, high) = (self.origin.y, self.origin.y + self.height);
        let v = |f: f32| low + self.height * f;
        let length = to - from;
        let half = length * r.range(0.1, 0.2);
        let middle = from + length * r.range(0.35, 0.65);
        let us = [from, middle - half, middle + half, to];
        match wall {
            Wall::Solid => b.slab(axes, &[from, to], &[low, high], ns, |_, _| false),
            Wall::Door => b.slab(axes, &us, &[low, v(0.7), high], ns, |i, j| (i, j) == (1, 0)),
            Wall::Window => b.slab(axes, &us, &[low, v(0.3), v(0.75), high], ns, |i, j| {
                (i, j) == (1, 1)
            }),
        }
    }
}
