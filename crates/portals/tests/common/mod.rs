//! Random buildings, and segments whose first triangle exact signs determine.

#![allow(dead_code, reason = "no test uses all of it")]

use glam::{Quat, Vec3};
use sightline_exact::{Cell, CellTask, ExactScene, decide};
use sightline_geometry::predicates::crossed_alone;
use sightline_numbers::Aabb;
use sightline_numbers::random::SplitMix64;
use sightline_portals::{EnclosureLimits, Partition, sights};
use sightline_scene::{Object, Scene, Triangle};

/// Creates the two triangles of a quad from its corners in order.
fn quad(v: [[f32; 3]; 4]) -> [Triangle; 2] {
    let v = v.map(Vec3::from);
    [
        Triangle {
            v: [v[0], v[1], v[2]],
        },
        Triangle {
            v: [v[0], v[2], v[3]],
        },
    ]
}

/// Creates a rectangle across an axis.
pub fn across(axis: usize, at: f32, u: [f32; 2], v: [f32; 2]) -> [Triangle; 2] {
    let corner = |s: usize, t: usize| {
        let mut p = [at; 3];
        p[(axis + 1) % 3] = u[s];
        p[(axis + 2) % 3] = v[t];
        p
    };
    quad([corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)])
}

pub fn scene(triangles: Vec<Triangle>) -> Scene {
    let object = Object {
        name: "all".to_owned(),
        first: 0,
        count: triangles.len() as u32,
    };
    Scene::new("test", triangles, vec![object]).unwrap()
}

/// Creates a building of 3×2×2 rooms: walls with random doors and windows, some furniture, turned by an
/// angle.
pub fn building(seed: u64, angle: f32) -> Scene {
    let mut random = SplitMix64::new(seed);
    let mut unit = || random.unit_f32();
    let size = [3usize, 2, 2];
    let mut all = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for at in 0..=size[axis] {
            for i in 0..size[u] {
                for k in 0..size[v] {
                    let (lo, hi) = ([i as f32, k as f32], [i as f32 + 1.0, k as f32 + 1.0]);
                    let at = at as f32;
                    if unit() < 0.4 {
                        all.extend(across(axis, at, [lo[0], hi[0]], [lo[1], hi[1]]));
                        continue;
                    }
                    // This wall has an opening.
                    let [a, b] = [lo[0], lo[1]].map(|x| x + 0.1 + 0.4 * unit());
                    let (c, d) = (a + 0.1 + 0.2 * unit(), b + 0.1 + 0.2 * unit());
                    all.extend(across(axis, at, [lo[0], a], [lo[1], hi[1]]));
                    all.extend(across(axis, at, [c, hi[0]], [lo[1], hi[1]]));
                    all.extend(across(axis, at, [a, c], [lo[1], b]));
                    all.extend(across(axis, at, [a, c], [d, hi[1]]));
                }
            }
        }
    }
    for _ in 0..20 {
        let p = Vec3::new(3.0 * unit(), 2.0 * unit(), 2.0 * unit());
        let mut off = || (Vec3::new(unit(), unit(), unit()) - 0.5) * 0.4;
        all.push(Triangle {
            v: [p, p + off(), p + off()],
        });
    }
    scene(
        all.into_iter()
            .map(|t| Triangle {
                v: t.v.map(|p| turned(p, angle)),
            })
            .collect(),
    )
}

/// Returns the position of a building's point in the building turned by an angle.
pub fn turned(p: Vec3, angle: f32) -> Vec3 {
    let turn = Quat::from_euler(glam::EulerRot::XYZ, angle, 0.7 * angle, 0.3 * angle);
    if angle == 0.0 { p } else { turn * p }
}

/// Returns the only triangle that a segment crosses, or `None` if exact signs do not determine it.
pub fn strictly_seen(scene: &Scene, p: Vec3, q: Vec3) -> Option<u32> {
    crossed_alone(scene.triangles().iter().map(|t| t.v), p, q)
}

/// The numbers of triangles listed from cells in the middles of all rooms of a building.
pub struct Lists {
    /// The number of leaves of the partition.
    pub leaves: usize,
    /// The number of triangles listed by portals, summed over all cells.
    pub portals: usize,
    /// The number of triangles listed by exact queries, summed over all cells.
    pub exact: usize,
}

/// Counts the triangles listed in a building that was turned by an angle.
pub fn lists(seed: u64, angle: f32) -> Lists {
    let scene = building(seed, angle);
    let partition = Partition::new(
        &scene,
        None,
        scene.bounds(),
        EnclosureLimits::default(),
        &|| false,
    )
    .unwrap();
    let prepared = ExactScene::prepare(&scene).unwrap();
    let mut lists = Lists {
        leaves: partition.leaves(),
        portals: 0,
        exact: 0,
    };
    for place in
        (0..12u8).map(|k| Vec3::new(f32::from(k % 3), f32::from(k / 3 % 2), f32::from(k / 6)))
    {
        let middle = turned(place + 0.5, angle);
        let cell = Aabb::new(middle - 0.1, middle + 0.1);
        let listed = sights(&partition, cell, false, &|| false).unwrap();
        let decided = decide(&CellTask {
            scene: &prepared,
            cell: Cell::new(cell.min, cell.max).unwrap(),
            region: None,
            seen: &[],
            above: &[],
            listed: Some(&listed),
            limits: sightline_exact::QueryLimits::default(),
            seed: 1,
            keep: false,
            stop: &|| false,
            asked: &|| {},
        });
        lists.portals += listed.len();
        lists.exact += decided.visible.len() + decided.undecided.len();
    }
    lists
}
