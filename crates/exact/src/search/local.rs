//! The state of the search between two polygons, or parts of polygons: their space, and the occluders as
//! half-spaces of this space.

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
use crate::search::side_bitsets::{FusedEdge, SideBitsets};

/// An end of a sight line: the index of a point of the space, and its rounded position in world space.
pub type SightLineEnd = (u32, DVec3);

/// An occluder as half-spaces of one pair's space.
pub struct Constraints {
    /// The scene's occluders that form this occluder, in ascending order.
    pub members: Vec<OrientedOccluder>,
    /// The half-spaces that bound the lines that the occluder blocks.
    pub lines: Vec<Constraint>,
}

/// One half-space of an occluder.
#[derive(Clone, Copy)]
pub struct Constraint {
    /// The line whose hyperplane bounds the half-space.
    pub line: VectorId,
    /// True if the border runs opposite to the line.
    pub flipped: bool,
    /// The number by which a proof's cuts refer to the half-space: the index of its edge in the occluder's
    /// border, or, for the planes of A and B, the length of the border plus 0 or 1.
    pub number: u16,
    /// The number of the edge's line in [`SideBitsets`], and a flag.
    ///
    /// The flag is true if the border runs opposite to that line. The value is `None` if the edge has no line
    /// there, or if the half-space is from a polygon's plane that cuts the occluder.
    pub row: Option<(u32, bool)>,
}

/// The position of an occluder relative to A's plane and to B's plane.
///
/// Index 0 is for A's plane, and index 1 for B's plane. `within` is true if part of the occluder is on the
/// side of the plane that contains the other polygon, and `beyond` is true if part of the occluder is on the
/// opposite side.
#[derive(Clone, Copy, Debug, Default)]
pub struct Extent {
    within: [bool; 2],
    beyond: [bool; 2],
}

/// Converts the edges of a border to constraints. Edges on the same line with the same direction share one
/// constraint.
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

/// The state of the search between one pair of polygons, or parts of polygons.
pub struct PairState<'a> {
    pub space: Space,
    pub pair: Pair,
    /// The occluders and fused occluders converted to half-spaces so far. Other fields and methods return
    /// indices into this list.
    pub known: Vec<Constraints>,
    /// The corners of the scene as points of the space.
    pub corners: Corners,
    /// The positions, relative to the planes of A and B, of the occluders inspected so far.
    pub extents: FxHashMap<OccluderId, Extent>,
    /// The index of an occluder in `known`; `None` if no part of the occluder is between the polygons.
    pub places: FxHashMap<OccluderId, Option<usize>>,
    /// The index of a fused occluder in `known`, by its members.
    pub patches: FxHashMap<Vec<OrientedOccluder>, Option<usize>>,
    /// The lines of occluders' edges that exist in the space.
    pub lines: EdgeLines,
    /// The sides of boundary edges on which the rays of the current region lie.
    pub side_bitsets: SideBitsets,
    /// The rays of the current region, for the computation of Klein forms.
    pub forms: Forms,
    /// The sides of rays. The buffer is reused.
    pub sides: Vec<Ordering>,
    /// The border of the fused occluder. The buffer is reused.
    pub border: Vec<FusedEdge>,
    /// The triangles that a line may meet. The buffer is reused.
    pub candidates: Vec<u32>,
    /// Both polygons, with their rounded vertices.
    pub ends: [(&'a Polygon, &'a [DVec3]); 2],
}

impl<'a> PairState<'a> {
    /// Creates the initial state of the search between two polygons, given with their rounded vertices.
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

impl PairState<'_> {
    /// Computes the half-spaces of the part of an occluder between A and B, and returns their index in
    /// `known`.
    ///
    /// The result is `None` if no part of the occluder is between A and B.
    pub fn constraints(&mut self, scene: &Occluders, id: OccluderId) -> Option<usize> {
        if let Some(at) = self.places.get(&id) {
            return *at;
        }
        let at = self.make_constraints(scene, id);
        self.places.insert(id, at);
        at
    }

    /// Returns the lines of a border's edges, as [`EdgeLines::border`] does.
    pub fn border_lines(&mut self, border: &[[u32; 2]], ends: &[[Vec3; 2]]) -> Vec<Edge> {
        self.lines
            .border(&mut self.space, &mut self.corners, border, ends)
    }

    /// Returns the indices of a triangle's corners among the points of the space.
    pub fn corner_points(&mut self, scene: &Occluders, triangle: u32) -> [u32; 3] {
        let (numbers, at) = (scene.corners(triangle), scene.triangle(triangle));
        std::array::from_fn(|k| self.corners.point(&mut self.space, numbers[k], at[k]))
    }

    /// Computes the position of an occluder relative to the planes of A and B.
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

    /// Returns true if the whole occluder is between the polygons.
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
                // The part of the occluder on the side of the other polygon is to the left of n_plane ×
                // n_own, seen from the side to which n_own points.
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

/// Returns the triangles of some occluders, in order.
pub fn triangles(scene: &Occluders, members: &[OrientedOccluder]) -> Vec<OccluderTriangle> {
    members
        .iter()
        .flat_map(|member| {
            scene
                .occluder(member.id)
                .triangles
                .iter()
                .map(move |t| OccluderTriangle {
                    triangle: t.triangle,
                    reversed: t.reversed != member.reversed,
                })
        })
        .collect()
}
