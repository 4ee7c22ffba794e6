//! What may hide something from a block of receivers: polygons, and boxes that stand for the polygons inside
//! until they are opened (section 6.6 of the paper asks for such a far field).

use glam::DVec3;
use sightline_geometry::Below;
use sightline_geometry::rounding::UNIT as U;

use crate::blockers::{Blockers, corners_of};
use crate::hull::Hull;
use crate::receivers::Source;

/// On which side of a polygon's plane the source lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum From {
    /// On the side the normal points to, or the other one.
    Side(bool),
    /// The plane passes through the source, or too close by to tell.
    Both,
}

/// Up to where something hides.
#[derive(Clone, Copy, Debug)]
pub enum Reach {
    /// What is nearer than this; infinite for everything.
    Distance(f64),
    /// What is before a light's plane.
    Light {
        /// The unit normal of the plane, away from the source.
        normal: DVec3,
        /// A point of the plane, from the source's origin.
        at: DVec3,
        /// What is that near the plane is in it.
        slack: f64,
    },
}

impl Reach {
    /// The distance, infinite for a light.
    pub fn distance(&self) -> f64 {
        match self {
            Self::Distance(distance) => *distance,
            Self::Light { .. } => f64::INFINITY,
        }
    }

    /// Whether corners all lie in or behind the light's plane.
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
    /// Its number in the scene.
    pub polygon: u32,
    /// Its item.
    pub item: u32,
    /// (b − a) × (c − a) of three of its corners, not of unit length.
    pub normal: DVec3,
    /// A corner, from the origin.
    pub at: DVec3,
    /// Bound on the error of normal·d, by |d|.
    pub error: f64,
    /// Where the source lies.
    pub from: From,
    /// Whether it hides from everywhere in the source all that is behind it, because all of it is within
    /// reach.
    pub within: bool,
}

/// What a leaf of the partition lists.
#[derive(Clone, Copy, Debug)]
pub struct Item {
    /// The corners of its hull: first and number among the points.
    first: u32,
    count: u32,
    /// Largest distance between a point of the source and a corner.
    pub far: f64,
    /// About the solid angle it takes; the largest is asked first.
    pub weight: f64,
    /// The face's number, or the box's node.
    pub what: What,
}

/// The kind of an item.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// A face.
    Face(u32),
    /// A node of the hierarchy.
    Box(u32),
}

/// All items that a block has met.
pub struct Items<'a> {
    blockers: &'a Blockers,
    source: &'a Source,
    reach: Reach,
    /// A surface that hides nothing.
    own: Option<u32>,
    points: Vec<DVec3>,
    items: Vec<Item>,
    faces: Vec<Face>,
    /// The items of an opened box: first and number among `children`. By item.
    opened: Vec<Option<(u32, u32)>>,
    children: Vec<u32>,
    /// How many there were to begin with.
    begun: Counts,
}

/// Lengths of the lists of [`Items`].
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    points: usize,
    items: usize,
    faces: usize,
    children: usize,
}

/// Distance of a point from a convex polygon.
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
    /// No items yet.
    pub fn new(blockers: &'a Blockers, source: &'a Source, reach: Reach, own: Option<u32>) -> Self {
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
            begun: Counts::default(),
        }
    }

    /// Bytes that they take, about.
    pub fn bytes(&self) -> usize {
        self.points.len() * size_of::<DVec3>()
            + self.items.len() * (size_of::<Item>() + size_of::<Option<(u32, u32)>>())
            + self.faces.len() * size_of::<Face>()
            + self.children.len() * size_of::<u32>()
    }

    /// Forgets what has been opened since [`Self::begin`]. Numbers of later items and faces mean nothing any
    /// more.
    pub fn forget(&mut self) {
        let Counts {
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

    /// Up to where something hides.
    pub fn reach(&self) -> &Reach {
        &self.reach
    }

    /// An item.
    pub fn item(&self, id: u32) -> &Item {
        &self.items[id as usize]
    }

    /// The corners of an item's hull, from the origin.
    pub fn corners(&self, id: u32) -> &[DVec3] {
        let item = &self.items[id as usize];
        &self.points[item.first as usize..(item.first + item.count) as usize]
    }

    /// An item's hull, from the origin.
    pub fn hull(&self, id: u32) -> Hull<'_> {
        let corners = self.corners(id);
        match self.items[id as usize].what {
            What::Face(_) => Hull::Of(corners),
            What::Box(_) => {
                let (min, max) = (corners[0], corners[7]);
                Hull::Box((min + max) * 0.5, (max - min) * 0.5)
            }
        }
    }

    /// The number of an item's first corner.
    pub fn first(&self, id: u32) -> u32 {
        self.items[id as usize].first
    }

    /// A corner.
    pub fn point(&self, at: u32) -> DVec3 {
        self.points[at as usize]
    }

    /// A face.
    pub fn face(&self, face: u32) -> &Face {
        &self.faces[face as usize]
    }

    /// The items to begin with, the largest first: boxes that take more than `largest` of solid angle are
    /// opened.
    pub fn begin(&mut self, largest: f64) -> Vec<u32> {
        let mut open = Vec::new();
        if !self.blockers.bvh().is_empty() {
            open.extend(self.add_box(0));
        }
        let mut list = Vec::new();
        while let Some(id) = open.pop() {
            let item = self.items[id as usize];
            if matches!(item.what, What::Face(_)) || item.weight <= largest {
                list.push(id);
            } else {
                let (first, count) = self.inside(id);
                open.extend((first..first + count).map(|k| self.children[k as usize]));
            }
        }
        self.sort(&mut list);
        let (points, items) = (self.points.len(), self.items.len());
        self.begun = Counts {
            points,
            items,
            faces: self.faces.len(),
            children: self.children.len(),
        };
        list
    }

    /// Sorts items, the largest first.
    pub fn sort(&self, list: &mut [u32]) {
        list.sort_unstable_by(|a, b| {
            let weight = |id: &u32| self.items[*id as usize].weight;
            weight(b).total_cmp(&weight(a)).then(a.cmp(b))
        });
    }

    /// Puts the items in a box into a list that is sorted by size.
    pub fn open(&mut self, id: u32, list: &mut Vec<u32>) {
        let (first, count) = self.inside(id);
        for k in first..first + count {
            let child = self.children[k as usize];
            let weight = self.items[child as usize].weight;
            let at = list.partition_point(|other| self.items[*other as usize].weight >= weight);
            list.insert(at, child);
        }
    }

    /// The items in a box, by their places among the children.
    fn inside(&mut self, id: u32) -> (u32, u32) {
        if let Some(found) = self.opened[id as usize] {
            return found;
        }
        let What::Box(node) = self.items[id as usize].what else {
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

    /// Whether corners are all at or below the horizon of every point.
    fn is_below(&self, corners: &[DVec3]) -> bool {
        self.source
            .normal
            .is_some_and(|n| corners.iter().all(|c| n.dot(*c) <= self.source.lowest))
    }

    fn add(&mut self, corners: &[DVec3], weight: f64, what: What) -> u32 {
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
        Some(self.add(&corners, weight, What::Box(node)))
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
        // The two edges from the first corner that make the largest triangle.
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
        // Differences, products and sums: as `sightline_geometry::predicates::orient3d_sign`.
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
            // Its plane holds every point.
            return None;
        }
        let from = if unsure || sides[0] == sides[1] {
            From::Both
        } else {
            From::Side(sides[1])
        };
        let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let away = middle.length().max(self.source.radius * 0.5);
        let seen = (sum.dot(middle) * 0.5).abs() / (away * away * away);
        let within = match self.reach {
            Reach::Distance(most) => {
                let ways = corners
                    .iter()
                    .flat_map(|c| self.source.corners.iter().map(move |s| (*c - *s).length()));
                ways.fold(0.0f64, f64::max) + self.source.slack < most * (1.0 - 1e-12)
            }
            Reach::Light { normal, at, slack } => {
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
        Some(self.add(&corners, seen, What::Face(face)))
    }
}
