//! Scenes with view cells, and functions that decide these cells.

use glam::Vec3;
use sightline_exact::{Cell, CellDecisions, CellTask, ExactScene, QueryLimits, decide};
use sightline_scene::Aabb;
use sightline_scene::{Object, Scene, Triangle};

use super::Corners;

pub fn exact_scene(triangles: &[Corners]) -> ExactScene {
    let objects = vec![Object {
        name: "test".into(),
        first: 0,
        count: triangles.len() as u32,
    }];
    let all = triangles.iter().map(|v| Triangle { v: *v }).collect();
    ExactScene::prepare(&Scene::new("test", all, objects).unwrap()).unwrap()
}

pub fn solve(
    scene: &ExactScene,
    cell: Aabb,
    seen: &[u32],
    stop: &(dyn Fn() -> bool + Sync),
) -> CellDecisions {
    decide(&CellTask {
        scene,
        cell: Cell::new(cell.min, cell.max).unwrap(),
        region: None,
        seen,
        above: &[],
        listed: None,
        limits: QueryLimits::default(),
        seed: 7,
        keep: true,
        stop,
        asked: &|| (),
    })
}

/// Returns the set of a cell as results store it: with the undecided triangles.
pub fn set(d: &CellDecisions) -> Vec<u32> {
    let mut all = [d.visible.as_slice(), &d.undecided].concat();
    all.sort_unstable();
    all
}

/// Creates a room of two chambers, and a cell in the first chamber.
///
/// A door connects the chambers, and both contain boxes.
pub fn chambers() -> (Vec<Corners>, Aabb) {
    let mut t: Vec<Corners> = Vec::new();
    let mut quad = |a: [f32; 3], b: [f32; 3], c: [f32; 3], d: [f32; 3]| {
        let [a, b, c, d] = [a, b, c, d].map(Vec3::from);
        t.extend([[a, b, c], [a, c, d]]);
    };
    let mut block = |lo: [f32; 3], hi: [f32; 3]| {
        let p = |x: usize, y: usize, z: usize| [[lo, hi][x][0], [lo, hi][y][1], [lo, hi][z][2]];
        quad(p(0, 0, 0), p(0, 1, 0), p(0, 1, 1), p(0, 0, 1));
        quad(p(1, 0, 0), p(1, 1, 0), p(1, 1, 1), p(1, 0, 1));
        quad(p(0, 0, 0), p(1, 0, 0), p(1, 0, 1), p(0, 0, 1));
        quad(p(0, 1, 0), p(1, 1, 0), p(1, 1, 1), p(0, 1, 1));
        quad(p(0, 0, 0), p(1, 0, 0), p(1, 1, 0), p(0, 1, 0));
        quad(p(0, 0, 1), p(1, 0, 1), p(1, 1, 1), p(0, 1, 1));
    };
    // The shell, the dividing wall with a door at y < 1, and the boxes in the chambers.
    block([0.0, 0.0, 0.0], [20.0, 10.0, 3.0]);
    block([10.0, 1.0, 0.0], [10.5, 10.0, 3.0]);
    for k in 0..6 {
        let x = 11.5 + 1.25 * k as f32;
        block([x, 2.0 + k as f32, 0.0], [x + 0.5, 2.75 + k as f32, 1.5]);
    }
    block([4.0, 4.0, 0.5], [5.0, 5.0, 1.0]);
    // This box is outside of the room.
    block([30.0, 0.0, 0.0], [31.0, 1.0, 1.0]);
    (
        t,
        Aabb::new(Vec3::new(1.0, 6.0, 1.0), Vec3::new(3.0, 8.0, 2.0)),
    )
}
