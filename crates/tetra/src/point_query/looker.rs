//! Point queries: the checks of their parameters, and the searches that compute the results.

use thiserror::Error;

use super::eye::{Eye, unit_of};
use super::hierarchy::Boxes;
use super::scratch::Scratch;
use super::search::{Search, SearchBudget, SearchedScene};
use super::space::Space;
use super::stack::StackEntry;
use super::view::{Engine, Mode, Target, View, VisibleTriangles};
use super::view_limits::ViewLimits;
use crate::cells::CellsView;
use crate::surfaces::{FLAT, SHOWS, SurfacesView};

/// The reason why the parameters of a query are rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LookError {
    /// A coordinate is not a finite number in the range of single precision.
    #[error(
        "{what} has the coordinate {value:e}, which is not a finite number below 3.4e38; correct the \
         coordinate"
    )]
    Coordinate {
        /// The name of the parameter, such as `the point`.
        what: &'static str,
        /// The value of the coordinate.
        value: f64,
    },
    /// The direction of the view is the vector 0.
    #[error("the direction has no length; use a vector other than 0 as the axis of the view")]
    NoDirection,
    /// An angle is out of range.
    #[error("{what} is {degrees} degrees; use an angle above 0 and from {least} to {most} degrees")]
    Angle {
        /// The name of the angle, such as `the view's angle`.
        what: &'static str,
        /// The angle in degrees.
        degrees: f64,
        /// The smallest allowed angle in degrees. Rounding errors exceed the size of narrower cones.
        least: f64,
        /// The largest allowed angle in degrees.
        most: f64,
    },
    /// The engine needs cells, but the looker has no cells.
    #[error("no cells between the surfaces exist; build the cells, or use the engine bvh")]
    NoCells,
    /// The view's distance is not positive.
    #[error("the view's distance is {0}; use a positive number")]
    Distance(f64),
    /// The smallest coordinate of a target box on an axis exceeds the largest coordinate on this axis.
    #[error(
        "a min coordinate of the target, {low}, is above its max coordinate {high}; swap these two"
    )]
    Target {
        /// The smallest coordinate.
        low: f64,
        /// The largest coordinate.
        high: f64,
    },
}

/// A scene that answers point queries. Threads can share a looker, each with a separate [`Scratch`].
pub struct Looker<'a> {
    surfaces: SurfacesView<'a>,
    boxes: Boxes<'a>,
    /// The points of the surfaces. If the looker has cells, the corners of the cells' box follow.
    points: &'a [[f32; 3]],
    cells: Option<CellsView<'a>>,
    /// The exponent of the largest power of two that divides all coordinates of `points`.
    unit: i32,
}

impl<'a> Looker<'a> {
    /// Creates a looker for a scene and the boxes over its triangles.
    pub fn new(surfaces: SurfacesView<'a>, boxes: Boxes<'a>) -> Self {
        Self {
            surfaces,
            boxes,
            points: surfaces.points,
            cells: None,
            unit: Self::unit(surfaces.points),
        }
    }

    /// Creates a looker with the cells between the surfaces. The cells must belong to `surfaces`.
    pub fn with_cells(surfaces: SurfacesView<'a>, boxes: Boxes<'a>, cells: CellsView<'a>) -> Self {
        Self::with_unit(surfaces, boxes, cells, Self::unit(cells.points))
    }

    /// Creates a looker with cells and with the known unit of their points ([`Self::unit`]).
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

    /// Returns the exponent of the largest power of two that divides all coordinates of `points`.
    pub(crate) fn unit(points: &[[f32; 3]]) -> i32 {
        unit_of(points.as_flattened().iter().map(|c| f64::from(*c)))
    }

    /// Finds a cell that contains the point `x`, and returns its number. A cell contains its border.
    ///
    /// The search walks from the cell `hint`. Without a hint, the search starts at the nearest of several
    /// cells that are spread over the scene. Returns `None` if `x` is outside of the cells' box, or if the
    /// looker has no cells.
    ///
    /// # Errors
    /// [`LookError::Coordinate`] if a coordinate is not finite or exceeds 3.4e38.
    pub fn locate(&self, x: [f64; 3], hint: Option<u32>) -> Result<Option<u32>, LookError> {
        check_point("the point", x)?;
        let eye = Eye::new(x, self.points, &[], self.unit);
        Ok(self
            .cells
            .and_then(|cells| Space::new(cells).locate(&eye, hint)))
    }

    /// Returns the cells that contain the point `x`, or no cells if `x` is outside of the cells' box. A cell
    /// contains its border.
    ///
    /// # Errors
    /// [`LookError::Coordinate`] if a coordinate is not finite or exceeds 3.4e38.
    pub(crate) fn cells_at<'s>(
        &self,
        x: [f64; 3],
        scratch: &'s mut Scratch,
    ) -> Result<&'s [StackEntry], LookError> {
        check_point("the point", x)?;
        let eye = Eye::new(x, self.points, &[], self.unit);
        let Scratch { rings, hint, .. } = scratch;
        rings.start.clear();
        if let Some(cells) = self.cells {
            Space::new(cells).around(&eye, hint, &mut rings.start);
        }
        Ok(&rings.start)
    }

    /// Computes the triangles that are visible from `x`, a point in world coordinates.
    ///
    /// The result is also in `scratch.seen`. A triangle is visible if it is visible along an open set of
    /// directions, or if it contains the point. From a point that is in a triangle's plane but outside of the
    /// triangle, the triangle is not visible and does not hide other triangles.
    ///
    /// # Errors
    /// [`LookError`] if a coordinate, angle or distance is out of range, or if the engine needs missing
    /// cells.
    pub fn look<'s>(
        &self,
        x: [f64; 3],
        view: &View,
        mode: Mode,
        scratch: &'s mut Scratch,
    ) -> Result<&'s VisibleTriangles, LookError> {
        self.look_for(x, view, mode, &SearchBudget::ALL, scratch)?;
        Ok(&scratch.seen)
    }

    /// Computes the visible triangles like [`Self::look`], within a budget.
    ///
    /// Returns true if the budget was sufficient. Otherwise the search stopped, and `scratch.seen` contains
    /// only counts.
    pub(crate) fn look_for(
        &self,
        x: [f64; 3],
        view: &View,
        mode: Mode,
        budget: &SearchBudget,
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
        let limits = ViewLimits::from_view(view);
        let sides = limits.planes(&mut scratch.planes);
        let mut search = self.search(x, &[], &[], mode, view.engine, limits, scratch);
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

    /// Computes the visible fraction of the solid angle of a box as seen from the point `x`, from 0 to 1.
    ///
    /// The denominator is the solid angle of the box in a scene without triangles. The numerator is the solid
    /// angle of the directions to the box that are within the view and in which no blocking triangle is
    /// nearer than the box. The result is 1 if the box contains `x`, and 0 if the box has no solid angle. The
    /// mode's angle drops or keeps beams as it does for visible sets: a conservative fraction is at least the
    /// exact fraction. The counts of signs are in `scratch.seen`.
    ///
    /// # Errors
    /// [`LookError`] if a coordinate, angle or distance is out of range, or if the engine needs missing
    /// cells.
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
        let limits = ViewLimits::from_view(view);
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
            // If the viewpoint is beyond the face with the largest coordinate, the order is reversed, so that
            // the normals of the four sides point into the face's beam.
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
            let mut search = self.search(x, &corners, &faces, mode, view.engine, limits, scratch);
            search.begin(&sides, &[self.surfaces.triangles.len() as u32]);
            search.run(&SearchBudget::ALL);
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
        mode: Mode,
        engine: Engine,
        limits: ViewLimits,
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
            scene: SearchedScene {
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

    /// Marks the triangles that show and contain the point `x` as visible.
    fn see_touched(&self, x: [f64; 3], scratch: &mut Scratch) {
        // Boxes are tested first, because most boxes do not contain the point.
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

/// Checks that an angle in radians is above 0 and between `least` and `most` degrees.
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
