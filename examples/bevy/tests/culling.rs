//! An app without a window: the camera moves through two rooms, and only the objects that its room sees are
//! shown.

use bevy_app::App;
use bevy_camera::visibility::Visibility;
use bevy_ecs::prelude::*;
use bevy_transform::TransformPlugin;
use bevy_transform::prelude::{GlobalTransform, Transform};
use sightline_bevy::{Sightline, SightlineEye, SightlineObject, SightlinePlugin};
use sightline_pvs::{Builder, CellTree, Header, Node, Object, Pvs, Source};

/// Creates a result of two cells and four objects. The last object is in no set, like a moving object.
fn result() -> Pvs {
    let nodes = vec![Node::Split { axis: 0, at: 1.0 }, Node::Leaf, Node::Leaf];
    let tree = CellTree::new([[0.0; 3], [2.0, 1.0, 1.0]], nodes).unwrap();
    let object = |k: u32| Object {
        name: format!("node{k}/mesh{k}#0"),
        first: 2 * k,
        count: 2,
        source: Some(Source {
            node: 10 + k,
            mesh: k,
            primitive: 0,
            instance: None,
        }),
    };
    let objects = (0..4).map(object).collect();
    let header = Header {
        triangles: 8,
        method: "aggressive".into(),
        tree,
        objects,
        info_json: "{}".into(),
    };
    let mut builder = Builder::new(header).unwrap();
    // Object 0 is visible from the first cell, 2 from the second, 1 from both, 3 from neither.
    builder.push_cell(&[0, 2], &[], 0).unwrap();
    builder.push_cell(&[3, 5], &[], 0).unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    Pvs::from_bytes(file).unwrap()
}

#[test]
fn objects_outside_set_of_camera_cell_are_hidden() {
    let mut app = App::new();
    app.add_plugins((TransformPlugin, SightlinePlugin));
    app.insert_resource(Sightline::new(result()).unwrap());
    let number = |app: &App, node| app.world().resource::<Sightline>().object(node, 0);
    assert_eq!((number(&app, 12), number(&app, 14)), (Some(2), None));
    let eye = app
        .world_mut()
        .spawn((
            SightlineEye,
            Transform::default(),
            GlobalTransform::default(),
        ))
        .id();
    let spawn = |app: &mut App, k| {
        app.world_mut()
            .spawn((SightlineObject(k), Visibility::default()))
            .id()
    };
    let mut all: Vec<Entity> = (0..4).map(|k| spawn(&mut app, k)).collect();
    let shown = |all: &[Entity], app: &mut App, x: f32| -> Vec<bool> {
        app.world_mut()
            .get_mut::<Transform>(eye)
            .unwrap()
            .translation = [x, 0.5, 0.5].into();
        app.update();
        all.iter()
            .map(|e| *app.world().get::<Visibility>(*e).unwrap() != Visibility::Hidden)
            .collect()
    };
    assert_eq!(shown(&all, &mut app, 0.5), [true, true, false, true]);
    assert_eq!(shown(&all, &mut app, 0.9), [true, true, false, true]);
    assert_eq!(shown(&all, &mut app, 1.5), [false, true, true, true]);
    // Outside the view box, visibility is unknown.
    assert_eq!(shown(&all, &mut app, 2.5), [true, true, true, true]);
    assert_eq!(shown(&all, &mut app, 1.5), [false, true, true, true]);
    // Entities that are spawned later are hidden, too.
    let late = spawn(&mut app, 0);
    all.push(late);
    app.update();
    assert_eq!(
        *app.world().get::<Visibility>(late).unwrap(),
        Visibility::Hidden
    );
    assert_eq!(app.world().resource::<Sightline>().cell(), Some(1));
}
