//! Questions about a point, with their numbers checked, and the searches that answer them.

use thiserror::Error;

use super::eye::{Eye, unit_of};
use super::hierarchy::Boxes;
use super::scratch::Scratch;
use super::search::{Budget, Scene, Search};
use super::space::Space;
use super::stack::Entry;
use super::view::{Engine, Mode, Seen, Target, View};
use super::within::Limits;
use crate::cells::CellsView;
use crate::surfaces::{FLAT, SHOWS, SurfacesView};

/// What is wrong with a question.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LookError {
    /// A coordinate that is not a finite number of single precision's range.
    #[error(
        "{what} has the coordinate {value:e}, which is not a finite number below 3.4e38; correct it"
    )]
    Coordinate {
        /// What has it.
        what: &'static str,
        /// The coordinate.
        value: f64,
    },
    /// A direction of no length.
    #[error("the direction has no length; give the axis of the view")]
    NoDirection,
    /// An angle that is not in its range.
    #[error("{what} is {degrees} degrees; give one above 0, from {least} up to {most}")]
    Angle {
        /// Which angle.
        what: &'static str,
        /// The angle.
        degrees: f64,
        /// The least one that is allowed: circles of narrower cones are lost in rounding.
        least: f64,
        /// The largest one that is allowed.
        most: f64,
    },
    /// The engine needs cells, and there are none.
    #[error("there are no cells between the surfaces; make them, or let the boxes answer")]
    NoCells,
    /// A distance that is not positive.
    #[error("the distance is {0}; give a positive number")]
    Distance(f64),
    /// A box that ends before it begins.
    #[error("the target's min {low} is above its max {high}; exchange them")]
    Target {
        /// The least coordinate.
        low: f64,
        /// The largest coordinate.
        high: f64,
    },
}

/// A scene that can be looked at. Any number of threads may ask, each with a [`Scratch`] of its own.
pub struct Looker<'a> {
    surfaces: SurfacesView<'a>,
    boxes: Boxes<'a>,
    /// The points of the surfaces, and after them the corners of the cells' box.
    points: &'a [[f32; 3]],
    cells: Option<CellsView<'a>>,
    unit: i32,
}

impl<'a> Looker<'a> {
    /// A scene and the boxes over its triangles.
    pub fn new(surfaces: SurfacesView<'a>, boxes: Boxes<'a>) -> Self {
        Self {
            surfaces,
            boxes,
            points: surfaces.points,
            cells: None,
            unit: Self::unit(surfaces.points),
        }
    }

    /// The same with the cells between the surfaces, which must be those of `surfaces`.
    pub fn with_cells(surfaces: SurfacesView<'a>, boxes: Boxes<'a>, cells: CellsView<'a>) -> Self {
        Self::with_unit(surfaces, boxes, cells, Self::unit(cells.points))
    }

    /// The same with the unit of the cells' points, where it is known.
    pub(crate) fn with_unit(
        surfaces: SurfacesView<'a>,
        boxes: Boxes<'a>,
        cells: CellsView<'a>,
        unit: i32,
    ) -> Self {
        Self {
            surfaces,
            boxes,
            points: cells.points,
            cells: Some(cells),
            unit,
        }
    }

    /// The power of two that all coordinates are multiples of.
    pub(crate) fn unit(points: &[[f32; 3]]) -> i32 {
        unit_of(points.as_flattened().iter().map(|c| f64::from(*c)))
    }

    /// A cell that holds `x`, its border included, by a walk from `hint` or from a cell that is rather near;
    /// nothing outside of the cells' box, and where there are no cells.
    ///
    /// # Errors
    /// [`LookError::Coordinate`].
    pub fn locate(&self, x: [f64; 3], hint: Option<u32>) -> Result<Option<u32>, LookError> {
        check_point("the point", x)?;
        let eye = Eye::new(x, self.points, &[], self.unit);
        Ok(self
            .cells
            .and_then(|cells| Space::new(cells).locate(&eye, hint)))
    }

    /// The cells that hold `x`, their borders included; none outside of the cells' box.
    ///
    /// # Errors
    /// [`LookError::Coordinate`].
    pub(crate) fn cells_at<'s>(
        &self,
        x: [f64; 3],
        scratch: &'s mut Scratch,
    ) -> Result<&'s [Entry], LookError> {
        check_point("the point", x)?;
        let eye = Eye::new(x, self.points, &[], self.unit);
        let Scratch { rings, hint, .. } = scratch;
        rings.start.clear();
        if let Some(cells) = self.cells {
            Space::new(cells).around(&eye, hint, &mut rings.start);
        }
        Ok(&rings.start)
    }

    /// What is visible from `x`, a point in world coordinates. The answer is in `scratch.seen` too.
    ///
    /// A triangle is visible along an open set of directions, or if it holds the point. From a point in its
    /// plane, outside of it, a triangle neither is visible nor hides anything.
    ///
    /// # Errors
    /// [`LookError`] for numbers that are out of range.
    pub fn look<'s>(
        &self,
        x: [f64; 3],
        view: &View,
        mode: Mode,
        scratch: &'s mut Scratch,
    ) -> Result<&'s Seen, LookError> {
        self.look_for(x, (view, mode), &Budget::ALL, scratch)?;
        Ok(&scratch.seen)
    }

    /// The same with a budget; says whether it was enough. If not, there is no answer, and `scratch.seen` has
    /// counts alone.
    pub(crate) fn look_for(
        &self,
        x: [f64; 3],
        (view, mode): (&View, Mode),
        budget: &Budget,
        scratch: &mut Scratch,
    ) -> Result<bool, LookError> {
        check_point("the point", x)?;
        self.check_view(view)?;
        check_mode(mode)?;
        scratch.stack.clear();
        scratch.planes.list.clear();
        (scratch.planes.decided, scratch.planes.integers) = (0, 0);
        scratch
            .entered
            .begin(self.cells.map_or(0, |cells| cells.cell_count()));
        scratch
            .tally
            .begin(self.surfaces.triangles.len(), view.witnesses);
        let seen = &mut scratch.seen;
        (seen.sky, seen.unseen, seen.dropped, seen.cells, seen.beams) = (0.0, 0.0, 0.0, 0, 0);
        self.see_touched(x, scratch);
        let limits = Limits::of(view);
        let sides = limits.planes(&mut scratch.planes);
        let mut search = self.search(x, &[], &[], (mode, view.engine), limits, scratch);
        search.begin(&sides, &[]);
        let is_enough = search.run(budget);
        let Scratch {
            planes,
            tally,
            seen,
            ..
        } = scratch;
        if is_enough {
            tally.finish(view.witnesses, seen);
        } else {
            seen.visible.clear();
            seen.areas.clear();
            seen.witnesses.clear();
        }
        (seen.decided, seen.integers) = (planes.decided, planes.integers);
        Ok(is_enough)
    }

    /// What share of a box's picture is visible from `x`, in 0…1: of the solid angle of the box, as if
    /// nothing else were there, the part in which no triangle is nearer than the box and that is within the
    /// view. 1 from inside of the box; 0 for a box that has no picture. The mode's angle drops or keeps beams
    /// as it does for sets: a conservative share is not smaller than the exact one. Signs are counted in
    /// `scratch.seen`.
    ///
    /// # Errors
    /// [`LookError`] for numbers that are out of range.
    pub fn sees(
        &self,
        x: [f64; 3],
        target: &Target,
        view: &View,
        mode: Mode,
        scratch: &mut Scratch,
    ) -> Result<f64, LookError> {
        check_point("the point", x)?;
        self.check_view(view)?;
        check_mode(mode)?;
        check_point("the target", target.low)?;
        check_point("the target", target.high)?;
        for k in 0..3 {
            if target.low[k] > target.high[k] {
                return Err(LookError::Target {
                    low: target.low[k],
                    high: target.high[k],
                });
            }
        }
        if (0..3).all(|k| target.low[k] <= x[k] && x[k] <= target.high[k]) {
            return Ok(1.0);
        }
        let base = self.points.len() as u32;
        let corners: [[f64; 3]; 8] = std::array::from_fn(|c| {
            std::array::from_fn(|k| {
                if c >> k & 1 == 1 {
                    target.high[k]
                } else {
                    target.low[k]
                }
            })
        });
        let limits = Limits::of(view);
        (scratch.planes.decided, scratch.planes.integers) = (0, 0);
        let (mut part, mut all) = (0.0, 0.0);
        for k in 0..3 {
            let high = x[k] > target.high[k];
            if !high && x[k] >= target.low[k] {
                continue;
            }
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            if target.low[i] >= target.high[i] || target.low[j] >= target.high[j] {
                continue;
            }
            let at = |u: usize, v: usize| base + (usize::from(high) << k | u << i | v << j) as u32;
            let mut around = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            // Seen from outside, above the high face, this order has its normal against the way of looking.
            if high {
                around.reverse();
            }
            let faces = [[around[0], around[1], around[2]]];
            scratch.stack.clear();
            scratch.planes.list.clear();
            scratch
                .entered
                .begin(self.cells.map_or(0, |cells| cells.cell_count()));
            scratch.tally.begin(self.surfaces.triangles.len(), false);
            let eye = Eye::new(x, self.points, &corners, self.unit);
            let sides: [_; 4] = std::array::from_fn(|n| {
                scratch
                    .planes
                    .add_edge(&eye, around[n], around[(n + 1) % 4])
            });
            let mut search = self.search(x, &corners, &faces, (mode, view.engine), limits, scratch);
            search.begin(&sides, &[self.surfaces.triangles.len() as u32]);
            search.run(&Budget::ALL);
            part += search.of_faces;
            all += search.begun;
        }
        (scratch.seen.decided, scratch.seen.integers) =
            (scratch.planes.decided, scratch.planes.integers);
        Ok(if all > 0.0 {
            (part / all).min(1.0)
        } else {
            0.0
        })
    }

    fn check_view(&self, view: &View) -> Result<(), LookError> {
        match (view.engine, self.cells) {
            (Engine::Cells, None) => Err(LookError::NoCells),
            _ => check_limits(view),
        }
    }

    fn search<'s>(
        &'s self,
        x: [f64; 3],
        corners: &'s [[f64; 3]],
        faces: &'s [[u32; 3]],
        (mode, engine): (Mode, Engine),
        limits: Limits,
        scratch: &'s mut Scratch,
    ) -> Search<'s> {
        let reach = self.boxes.nodes.first().map_or(0.0, |n| {
            (0..3).fold(0.0f64, |m, k| {
                m.max((f64::from(n.low[k]) - x[k]).abs())
                    .max((f64::from(n.high[k]) - x[k]).abs())
            })
        });
        scratch.sieve.begin(x, reach);
        let space = self
            .cells
            .filter(|_| engine == Engine::Cells)
            .map(Space::new);
        if space.is_none() {
            scratch.outlines.begin();
        }
        let SurfacesView {
            triangles, flags, ..
        } = self.surfaces;
        Search {
            scene: Scene {
                triangles,
                flags,
                nodes: self.boxes.nodes,
                order: self.boxes.order,
                neighbours: self.boxes.neighbours,
                space,
            },
            eye: Eye::new(x, self.points, corners, self.unit),
            mode,
            limits,
            faces,
            scratch,
            of_faces: 0.0,
            begun: 0.0,
        }
    }

    /// Counts the triangles that hold the point as seen.
    fn see_touched(&self, x: [f64; 3], scratch: &mut Scratch) {
        // Boxes are compared first: most do not hold the point.
        let holds = |low: &[f32; 3], high: &[f32; 3]| {
            (0..3).all(|k| f64::from(low[k]) <= x[k] && x[k] <= f64::from(high[k]))
        };
        let eye = Eye::new(x, self.points, &[], self.unit);
        let Scratch {
            tally, boxes: open, ..
        } = scratch;
        open.clear();
        open.push(0);
        while let Some(number) = open.pop() {
            let Some(node) = self.boxes.nodes.get(number as usize) else {
                continue;
            };
            if !holds(&node.low, &node.high) {
                continue;
            }
            if node.count == 0 {
                open.extend([node.first, node.first + 1]);
                continue;
            }
            for t in &self.boxes.order[node.first as usize..][..node.count as usize] {
                let flags = self.surfaces.flags[*t as usize];
                if flags & FLAT == 0
                    && flags & SHOWS != 0
                    && super::planes::holds(&eye, self.surfaces.triangles[*t as usize])
                {
                    tally.see(*t);
                }
            }
        }
    }
}

fn check_point(what: &'static str, p: [f64; 3]) -> Result<(), LookError> {
    match p
        .into_iter()
        .find(|c| c.is_nan() || c.abs() > f64::from(f32::MAX))
    {
        Some(value) => Err(LookError::Coordinate { what, value }),
        None => Ok(()),
    }
}

fn check_limits(view: &View) -> Result<(), LookError> {
    if let Some(direction) = view.direction {
        check_point("the direction", direction)?;
        if direction == [0.0; 3] {
            return Err(LookError::NoDirection);
        }
        check_angle("the view's angle", view.angle, 1e-4, 360.0)?;
    }
    match view.distance {
        Some(distance) if distance.is_nan() || distance <= 0.0 => {
            Err(LookError::Distance(distance))
        }
        _ => Ok(()),
    }
}

fn check_mode(mode: Mode) -> Result<(), LookError> {
    match mode {
        Mode::Exact => Ok(()),
        Mode::Aggressive(angle) | Mode::Conservative(angle) => {
            check_angle("the mode's angle", angle, 0.0, 180.0)
        }
    }
}

/// In radians, above 0, and from `least` up to `most` degrees.
fn check_angle(what: &'static str, angle: f64, least: f64, most: f64) -> Result<(), LookError> {
    match angle > 0.0 && angle >= least.to_radians() && angle <= most.to_radians() {
        true => Ok(()),
        false => Err(LookError::Angle {
            what,
            degrees: angle.to_degrees(),
            least,
            most,
        }),
    }
}
