//! The state of the search between two parts: their space, and the occluders as half-spaces of it.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;
use sightline_certificate::proof::OccluderTriangle;

use crate::geometry::polygon::Polygon;
use crate::line_space::forms::Forms;
use crate::line_space::space::{Space, Through, VectorId};
use crate::line_space::stabbing_polyhedron::Pair;
use crate::occluders::{OccluderId, Occluders, OrientedOccluder};
use crate::search::corners::Corners;
use crate::search::edges::{Edge, EdgeLines};
use crate::search::maps::with_room;
use crate::search::side_bitsets::{Limit, SideBitsets};

/// An end of a sight line: a point of the space, and its rounded place in the world.
pub type Snapped = (u32, DVec3);

/// An occluder as half-spaces of one pair's space.
pub struct Constraints {
    /// The occluders of the scene in it, ascending.
    pub members: Vec<OrientedOccluder>,
    /// The half-spaces that bound the lines it blocks.
    pub lines: Vec<Constraint>,
}

/// One half-space of an occluder.
#[derive(Clone, Copy)]
pub struct Constraint {
    /// Its line.
    pub line: VectorId,
    /// Whether the border runs the other way.
    pub flipped: bool,
    /// Its number in a proof.
    pub number: u16,
    /// The number of its line in [`SideBitsets`], and whether the border runs the other way than that line;
    /// none where a polygon's plane cuts the occluder.
    pub row: Option<(u32, bool)>,
}

/// Position of an occluder relative to A's plane and to B's plane: `within` says whether part of it is on the
/// side of the other polygon, `beyond` whether part of it is on the opposite side.
#[derive(Clone, Copy, Debug, Default)]
pub struct Extent {
    within: [bool; 2],
    beyond: [bool; 2],
}

/// The lines of a border, one constraint for each.
pub fn lines_of(
    edges: &[Edge],
    border: &[[u32; 2]],
    side_bitsets: &SideBitsets,
) -> Vec<Constraint> {
    let mut lines: Vec<Constraint> = Vec::with_capacity(edges.len() + 2);
    for (number, (e, corners)) in edges.iter().zip(border).enumerate() {
        if !lines
            .iter()
            .any(|l| l.line == e.line && l.flipped == e.flipped)
        {
            let row = side_bitsets
                .line(*corners)
                .map(|row| (row, corners[0] > corners[1]));
            lines.push(Constraint {
                line: e.line,
                flipped: e.flipped,
                number: number as u16,
                row,
            });
        }
    }
    lines
}

/// The state of the search between one pair of parts.
pub struct Local<'a> {
    pub space: Space,
    pub pair: Pair,
    pub known: Vec<Constraints>,
    /// Corners of the scene as points of the space.
    pub corners: Corners,
    /// On which sides of the two planes the occluders looked up so far lie.
    pub extents: FxHashMap<OccluderId, Extent>,
    /// The index of an occluder in `known`; none if no part of it is between the polygons.
    pub places: FxHashMap<OccluderId, Option<usize>>,
    /// The index of a fused occluder in `known`, by its members.
    pub patches: FxHashMap<Vec<OrientedOccluder>, Option<usize>>,
    /// Lines made for occluders' edges.
    pub lines: EdgeLines,
    /// On which sides of boundary edges the rays of the current region are.
    pub side_bitsets: SideBitsets,
    /// The Klein form on the rays of the current region.
    pub forms: Forms,
    /// Sides of rays; kept to reuse its memory.
    pub sides: Vec<Ordering>,
    /// The border of the fused occluder; kept to reuse its memory.
    pub border: Vec<Limit>,
    /// Triangles a line may meet; kept to reuse its memory.
    pub candidates: Vec<u32>,
    /// Both polygons, with their vertices rounded.
    pub ends: [(&'a Polygon, &'a [DVec3]); 2],
}

impl<'a> Local<'a> {
    /// The state at the beginning of the search between two polygons, with their vertices rounded.
    pub fn new(space: Space, pair: Pair, ends: [(&'a Polygon, &'a [DVec3]); 2]) -> Self {
        Self {
            space,
            pair,
            known: Vec::new(),
            corners: Corners::new(),
            extents: with_room(16),
            places: with_room(16),
            patches: FxHashMap::default(),
            lines: EdgeLines::new(),
            side_bitsets: SideBitsets::new(),
            forms: Forms::default(),
            sides: Vec::new(),
            candidates: Vec::new(),
            border: Vec::new(),
            ends,
        }
    }
}

impl Local<'_> {
    /// The half-spaces of the part of an occluder between A and B, as an index into `known`; none if no part
    /// is.
    pub fn constraints(&mut self, scene: &Occluders, id: OccluderId) -> Option<usize> {
        if let Some(at) = self.places.get(&id) {
            return *at;
        }
        let at = self.make_constraints(scene, id);
        self.places.insert(id, at);
        at
    }

    /// The lines of a border, given by numbers of corners and by positions.
    pub fn border_lines(&mut self, border: &[[u32; 2]], ends: &[[Vec3; 2]]) -> Vec<Edge> {
        self.lines
            .border(&mut self.space, &mut self.corners, border, ends)
    }

    /// A triangle's corners as points of the space.
    pub fn corner_points(&mut self, scene: &Occluders, triangle: u32) -> [u32; 3] {
        let (numbers, at) = (scene.corners(triangle), scene.triangle(triangle));
        std::array::from_fn(|k| self.corners.point(&mut self.space, numbers[k], at[k]))
    }

    /// The extent of an occluder.
    fn extent(&mut self, scene: &Occluders, id: OccluderId) -> Extent {
        if let Some(known) = self.extents.get(&id) {
            return *known;
        }
        let good = [self.pair.ahead, self.pair.behind];
        let mut extent = Extent::default();
        let occluder = scene.occluder(id);
        for (number, at) in occluder.edges.iter().zip(&occluder.border) {
            let sides = self
                .corners
                .sides(&mut self.space, &self.pair, number[0], at[0]);
            for k in 0..2 {
                extent.within[k] |= sides[k] == good[k];
                extent.beyond[k] |= sides[k] == good[k].reverse();
            }
        }
        self.extents.insert(id, extent);
        extent
    }

    /// Whether all of an occluder is between the polygons.
    pub fn is_between(&mut self, scene: &Occluders, id: OccluderId) -> bool {
        let extent = self.extent(scene, id);
        extent.within == [true; 2] && extent.beyond == [false; 2]
    }

    fn make_constraints(&mut self, scene: &Occluders, id: OccluderId) -> Option<usize> {
        let Extent { within, beyond } = self.extent(scene, id);
        if within.contains(&false) {
            return None;
        }
        let occluder = scene.occluder(id);
        let planes = [
            (self.pair.a.clone(), self.pair.ahead),
            (self.pair.b.clone(), self.pair.behind),
        ];
        let edges = self.border_lines(&occluder.edges, &occluder.border);
        let mut lines = lines_of(&edges, &occluder.edges, &self.side_bitsets);
        if beyond.contains(&true) {
            let OccluderTriangle {
                triangle,
                reversed: turned,
            } = occluder.triangles[0];
            let points = self.corner_points(scene, triangle);
            let own = Through { points, turned };
            for (k, (plane, good)) in planes.iter().enumerate() {
                if !beyond[k] {
                    continue;
                }
                let toward = Through {
                    points: [plane[0], plane[1], plane[2]],
                    turned: *good == Ordering::Less,
                };
                // The part of the occluder on the good side is to the left of n_plane × n_own, seen from
                // n_own's side.
                let line = self.space.meet(toward, own);
                let number = (occluder.border.len() + k) as u16;
                lines.push(Constraint {
                    line,
                    flipped: false,
                    number,
                    row: None,
                });
            }
        }
        self.known.push(Constraints {
            members: vec![OrientedOccluder {
                id,
                reversed: false,
            }],
            lines,
        });
        Some(self.known.len() - 1)
    }
}

/// The triangles of some occluders, in order.
pub fn triangles(scene: &Occluders, members: &[OrientedOccluder]) -> Vec<OccluderTriangle> {
    members
        .iter()
        .flat_map(|of| {
            scene
                .occluder(of.id)
                .triangles
                .iter()
                .map(move |t| OccluderTriangle {
                    triangle: t.triangle,
                    reversed: t.reversed != of.reversed,
                })
        })
        .collect()
}
