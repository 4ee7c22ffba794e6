//! The potential occluders of a block of receivers: polygons, and boxes that represent the polygons inside
//! until a query opens the box. (Section 6.6 of the paper asks for such a far field.)

use glam::DVec3;
use sightline_geometry::Below;
use sightline_geometry::rounding::UNIT as U;

use crate::blockers::{Blockers, corners_of};
use crate::hull::Hull;
use crate::receivers::ReceiverHull;

/// The side of a polygon's plane on which the source lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceSide {
    /// One side: true for the side that the normal points to, false for the other side.
    Side(bool),
    /// Both sides: the plane passes through the source, or too close to the source for doubles to decide.
    Both,
}

/// The range within which faces hide directions.
#[derive(Clone, Copy, Debug)]
pub enum HidingRange {
    /// A distance in units of the scene. Faces nearer than this distance hide; an infinite distance includes
    /// every face.
    Distance(f64),
    /// A light's plane. Faces in front of the plane hide.
    Light {
        /// The unit normal of the plane, which points away from the source.
        normal: DVec3,
        /// A point of the plane, relative to the source's origin.
        at: DVec3,
        /// Maximum distance of a point that counts as in the plane.
        slack: f64,
    },
}

impl HidingRange {
    /// Returns the distance, which is infinite for a light.
    pub fn distance(&self) -> f64 {
        match self {
            Self::Distance(distance) => *distance,
            Self::Light { .. } => f64::INFINITY,
        }
    }

    /// Returns true if all corners lie in or behind the light's plane. Returns false if the range is a
    /// distance.
    fn is_beyond(&self, corners: &[DVec3]) -> bool {
        match self {
            Self::Distance(_) => false,
            Self::Light { normal, at, slack } => {
                corners.iter().all(|c| normal.dot(*c - *at) >= -slack)
            }
        }
    }
}

/// A polygon as seen from a source.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// The number of the polygon in [`Blockers`].
    pub polygon: u32,
    /// The number of the face's item in [`Items`].
    pub item: u32,
    /// The normal (b − a) × (c − a) of three corners a, b and c of the polygon. Not of unit length.
    pub normal: DVec3,
    /// A corner of the polygon, relative to the source's origin.
    pub at: DVec3,
    /// A bound on the error of normal·d, divided by |d|.
    pub error: f64,
    /// The side of the face's plane on which the source lies.
    pub from: SourceSide,
    /// True if the whole face is within the hiding range of every point of the source, so that the face hides
    /// all directions to its points.
    pub within: bool,
}

/// A potential occluder: a face or a box. The lists of the partition's classes contain item numbers.
#[derive(Clone, Copy, Debug)]
pub struct Item {
    /// The index of the hull's first corner in `Items::points`.
    first: u32,
    /// The number of the hull's corners.
    count: u32,
    /// Maximum distance between a point of the source and a corner of the item, in units of the scene.
    pub far: f64,
    /// The approximate solid angle of the item, in steradians. The partition processes items with larger
    /// weights first.
    pub weight: f64,
    /// The number of the item's face, or the node of the item's box.
    pub what: ItemKind,
}

/// The kind of an item: a face or a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ItemKind {
    /// The number of a face in [`Items`].
    Face(u32),
    /// The number of a box's node in the hierarchy of [`Blockers::bvh`].
    Box(u32),
}

/// The items that the queries of a block have reached.
pub struct Items<'a> {
    blockers: &'a Blockers,
    source: &'a ReceiverHull,
    reach: HidingRange,
    /// The number of the surface that contains the receivers. This surface does not hide directions.
    own: Option<u32>,
    points: Vec<DVec3>,
    items: Vec<Item>,
    faces: Vec<Face>,
    /// For each opened box, its items in `children`: the index of the first entry, and the number of entries.
    /// `None` for faces and for boxes that are not open.
    opened: Vec<Option<(u32, u32)>>,
    /// The numbers of the items of all opened boxes.
    children: Vec<u32>,
    /// The lengths of the lists after `begin`.
    begun: ListLengths,
}

/// The lengths of the lists of [`Items`].
#[derive(Clone, Copy, Debug, Default)]
struct ListLengths {
    points: usize,
    items: usize,
    faces: usize,
    children: usize,
}

/// Returns the distance of a point from a convex polygon.
fn distance(p: DVec3, corners: &[DVec3], normal: DVec3) -> f64 {
    let size = normal.length();
    let (mut inside, mut nearest) = (size > 0.0, f64::INFINITY);
    let Some(last) = corners.last() else {
        return f64::INFINITY;
    };
    let mut a = *last;
    for b in corners {
        let (edge, way) = (*b - a, p - a);
        inside &= normal.dot(edge.cross(way)) >= 0.0;
        let t = (way.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        nearest = nearest.min((way - edge * t).length());
        a = *b;
    }
    if inside {
        (normal.dot(p - a) / size).abs()
    } else {
        nearest
    }
}

impl<'a> Items<'a> {
    /// Creates an empty set of items.
    pub fn new(
        blockers: &'a Blockers,
        source: &'a ReceiverHull,
        reach: HidingRange,
        own: Option<u32>,
    ) -> Self {
        Self {
            blockers,
            source,
            reach,
            own,
            points: Vec::new(),
            items: Vec::new(),
            faces: Vec::new(),
            opened: Vec::new(),
            children: Vec::new(),
            begun: ListLengths::default(),
        }
    }

    /// Returns the approximate memory of the items, in bytes.
    pub fn bytes(&self) -> usize {
        self.points.len() * size_of::<DVec3>()
            + self.items.len() * (size_of::<Item>() + size_of::<Option<(u32, u32)>>())
            + self.faces.len() * size_of::<Face>()
            + self.children.len() * size_of::<u32>()
    }

    /// Removes the items that were opened since [`Self::begin`]. The numbers of these items and of their
    /// faces become invalid.
    pub fn forget(&mut self) {
        let ListLengths {
            points,
            items,
            faces,
            children,
        } = self.begun;
        self.points.truncate(points);
        self.items.truncate(items);
        self.faces.truncate(faces);
        self.children.truncate(children);
        self.opened.truncate(items);
        for opened in &mut self.opened {
            *opened = opened.filter(|(first, count)| (first + count) as usize <= children);
        }
    }

    /// Returns the range within which faces hide directions.
    pub fn reach(&self) -> &HidingRange {
        &self.reach
    }

    /// Returns the item with the number `id`.
    pub fn item(&self, id: u32) -> &Item {
        &self.items[id as usize]
    }

    /// Returns the corners of an item's hull, relative to the source's origin.
    pub fn corners(&self, id: u32) -> &[DVec3] {
        let item = &self.items[id as usize];
        &self.points[item.first as usize..(item.first + item.count) as usize]
    }

    /// Returns an item's hull, relative to the source's origin.
    pub fn hull(&self, id: u32) -> Hull<'_> {
        let corners = self.corners(id);
        match self.items[id as usize].what {
            ItemKind::Face(_) => Hull::Of(corners),
            ItemKind::Box(_) => {
                let (min, max) = (corners[0], corners[7]);
                Hull::Box((min + max) * 0.5, (max - min) * 0.5)
            }
        }
    }

    /// Returns the number of an item's first corner, for [`Self::point`].
    pub fn first(&self, id: u32) -> u32 {
        self.items[id as usize].first
    }

    /// Returns the corner with the number `at`, relative to the source's origin.
    pub fn point(&self, at: u32) -> DVec3 {
        self.points[at as usize]
    }

    /// Returns the face with the number `face`.
    pub fn face(&self, face: u32) -> &Face {
        &self.faces[face as usize]
    }

    /// Creates the initial items and returns their numbers, the item with the largest solid angle first.
    /// Opens boxes with a solid angle of more than `largest` steradians.
    pub fn begin(&mut self, largest: f64) -> Vec<u32> {
        let mut open = Vec::new();
        if !self.blockers.bvh().is_empty() {
            open.extend(self.add_box(0));
        }
        let mut list = Vec::new();
        while let Some(id) = open.pop() {
            let item = self.items[id as usize];
            if matches!(item.what, ItemKind::Face(_)) || item.weight <= largest {
                list.push(id);
            } else {
                let (first, count) = self.inside(id);
                open.extend((first..first + count).map(|k| self.children[k as usize]));
            }
        }
        self.sort(&mut list);
        let (points, items) = (self.points.len(), self.items.len());
        self.begun = ListLengths {
            points,
            items,
            faces: self.faces.len(),
            children: self.children.len(),
        };
        list
    }

    /// Sorts items by solid angle, the largest first.
    pub fn sort(&self, list: &mut [u32]) {
        list.sort_unstable_by(|a, b| {
            let weight = |id: &u32| self.items[*id as usize].weight;
            weight(b).total_cmp(&weight(a)).then(a.cmp(b))
        });
    }

    /// Opens box `id`, and inserts the numbers of its items into a list that is sorted by solid angle.
    pub fn open(&mut self, id: u32, list: &mut Vec<u32>) {
        let (first, count) = self.inside(id);
        for k in first..first + count {
            let child = self.children[k as usize];
            let weight = self.items[child as usize].weight;
            let at = list.partition_point(|other| self.items[*other as usize].weight >= weight);
            list.insert(at, child);
        }
    }

    /// Opens a box if it is not open, and returns its items in `children`: the index of the first entry, and
    /// the number of entries.
    fn inside(&mut self, id: u32) -> (u32, u32) {
        if let Some(found) = self.opened[id as usize] {
            return found;
        }
        let ItemKind::Box(node) = self.items[id as usize].what else {
            return (0, 0);
        };
        let mut found = Vec::new();
        match self.blockers.bvh().below(node) {
            Below::Nodes(nodes) => found.extend(nodes.into_iter().filter_map(|n| self.add_box(n))),
            Below::Items(polygons) => {
                found.extend(polygons.iter().filter_map(|p| self.add_face(*p)))
            }
        }
        let range = (self.children.len() as u32, found.len() as u32);
        self.children.extend(found);
        self.opened[id as usize] = Some(range);
        range
    }

    /// Returns true if all corners are at or below the horizon of every receiver.
    fn is_below(&self, corners: &[DVec3]) -> bool {
        self.source
            .normal
            .is_some_and(|n| corners.iter().all(|c| n.dot(*c) <= self.source.lowest))
    }

    fn add(&mut self, corners: &[DVec3], weight: f64, what: ItemKind) -> u32 {
        let first = self.points.len() as u32;
        self.points.extend(corners);
        let far = corners.iter().fold(0.0f64, |far, c| far.max(c.length())) + self.source.radius;
        self.items.push(Item {
            first,
            count: corners.len() as u32,
            far,
            weight,
            what,
        });
        self.opened.push(None);
        self.items.len() as u32 - 1
    }

    fn add_box(&mut self, node: u32) -> Option<u32> {
        let bounds = self.blockers.bvh().bounds(node);
        let corners = corners_of(bounds).map(|c| c - self.source.origin);
        let (min, max) = (corners[0], corners[7]);
        let near = DVec3::ZERO.clamp(min, max).length();
        let far = near > self.reach.distance() + self.source.radius;
        if far || self.is_below(&corners) || self.reach.is_beyond(&corners) {
            return None;
        }
        let middle = (min + max) * 0.5;
        let half = (max - min).length() * 0.5;
        let away = middle.length().max(self.source.radius);
        let weight = if near <= self.source.radius {
            f64::INFINITY
        } else {
            half * half / (away * away)
        };
        Some(self.add(&corners, weight, ItemKind::Box(node)))
    }

    fn add_face(&mut self, polygon: u32) -> Option<u32> {
        if self.own == Some(self.blockers.surface(polygon)) {
            return None;
        }
        let origin = self.source.origin;
        let corners: Vec<DVec3> = self
            .blockers
            .corners(polygon)
            .iter()
            .map(|c| *c - origin)
            .collect();
        if self.is_below(&corners) || self.reach.is_beyond(&corners) {
            return None;
        }
        // Use the two edges from the first corner that span the largest triangle.
        let at = corners[0];
        let (mut normal, mut size, mut sum) = (DVec3::ZERO, 0.0, DVec3::ZERO);
        for pair in corners[1..].windows(2) {
            let (p, q) = (pair[0] - at, pair[1] - at);
            let n = p.cross(q);
            sum += n;
            if n.length_squared() > normal.length_squared() {
                (normal, size) = (n, p.length() * q.length());
            }
        }
        let reach = self.reach.distance() + self.source.radius;
        if reach.is_finite() && distance(DVec3::ZERO, &corners, normal) > reach * (1.0 + 1e-9) {
            return None;
        }
        // The bound counts differences, products and sums, as in
        // `sightline_geometry::predicates::orient3d_sign`.
        let error = 16.0 * U * size;
        let mut sides = [false; 2];
        let mut unsure = false;
        for s in &self.source.corners {
            let d = *s - at;
            let value = normal.dot(d);
            let bound = error * d.length() + normal.length() * self.source.slack;
            match value.abs() > bound {
                true => sides[usize::from(value > 0.0)] = true,
                false => unsure = true,
            }
        }
        if unsure && sides == [false; 2] {
            // The plane of the face contains every receiver.
            return None;
        }
        let from = if unsure || sides[0] == sides[1] {
            SourceSide::Both
        } else {
            SourceSide::Side(sides[1])
        };
        let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let away = middle.length().max(self.source.radius * 0.5);
        let seen = (sum.dot(middle) * 0.5).abs() / (away * away * away);
        let within = match self.reach {
            HidingRange::Distance(most) => {
                let ways = corners
                    .iter()
                    .flat_map(|c| self.source.corners.iter().map(move |s| (*c - *s).length()));
                ways.fold(0.0f64, f64::max) + self.source.slack < most * (1.0 - 1e-12)
            }
            HidingRange::Light { normal, at, slack } => {
                corners.iter().all(|c| normal.dot(*c - at) < -slack)
            }
        };
        let face = self.faces.len() as u32;
        let item = self.items.len() as u32;
        self.faces.push(Face {
            polygon,
            item,
            normal,
            at,
            error,
            from,
            within,
        });
        Some(self.add(&corners, seen, ItemKind::Face(face)))
    }
}
