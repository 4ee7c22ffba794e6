//! A Bevy plugin that hides the entities that are not visible from the cell of the camera.
//!
//! ```no_run
//! # use bevy_app::App; use bevy_ecs::prelude::*; use sightline_bevy::*;
//! let pvs = sightline_pvs::Pvs::open("level.pvs")?;
//! let mut app = App::new();
//! app.add_plugins(SightlinePlugin).insert_resource(Sightline::new(pvs)?);
//! // The camera gets `SightlineEye`, and each entity with a mesh `SightlineObject` with its object's number.
//! # Ok::<(), sightline_pvs::PvsError>(())
//! ```
//!
//! Objects are pairs of a glTF node and primitive. `bevy_gltf` spawns an entity for each. Find its number
//! with [`Sightline::object`] when the scene is ready. Give the number to the entities with meshes and not to
//! their nodes, because hiding a node hides its children. The level must not have a transform: its
//! coordinates are the coordinates of its file.

use bevy_app::{App, Plugin, PostUpdate};
use bevy_camera::visibility::{Visibility, VisibilitySystems};
use bevy_ecs::prelude::*;
use bevy_transform::TransformSystems;
use bevy_transform::prelude::GlobalTransform;
use sightline_pvs::{Pvs, PvsError};

/// The entity whose cell determines the visible objects: the camera.
#[derive(Component)]
pub struct SightlineEye;

/// The number of an object of the result.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
pub struct SightlineObject(pub u32);

/// A result with the visible objects of the current cell.
#[derive(Resource)]
pub struct Sightline {
    pvs: Pvs,
    /// True for each object that is in at least one set. The visibility of other objects, such as moving
    /// ones, is unknown.
    known: Vec<bool>,
    cell: Option<u32>,
    visible: Vec<u32>,
}

impl Sightline {
    /// Wraps a result.
    ///
    /// # Errors
    /// [`PvsError`] if the result is damaged.
    pub fn new(pvs: Pvs) -> Result<Self, PvsError> {
        let mut known = vec![false; pvs.objects().len()];
        let mut visible = Vec::new();
        for cell in 0..pvs.cells() {
            pvs.visible_objects(cell, &mut visible)?;
            visible
                .iter()
                .for_each(|object| known[*object as usize] = true);
        }
        Ok(Self {
            pvs,
            known,
            cell: None,
            visible,
        })
    }

    /// Returns the number of the object that a node of the glTF file draws as a primitive of its mesh.
    pub fn object(&self, node: u32, primitive: u32) -> Option<u32> {
        let is = |s: &sightline_pvs::Source| s.node == node && s.primitive == primitive;
        let found = self
            .pvs
            .objects()
            .iter()
            .position(|object| object.source.as_ref().is_some_and(is));
        found.map(|number| number as u32)
    }

    /// Returns the cell of the camera. `None` outside known cells, where all objects are drawn.
    pub fn cell(&self) -> Option<u32> {
        self.cell
    }

    /// Returns true if an object should be drawn.
    fn shows(&self, SightlineObject(number): SightlineObject) -> bool {
        let is_known = self.known.get(number as usize).is_some_and(|is| *is);
        self.cell.is_none() || !is_known || self.visible.binary_search(&number).is_ok()
    }

    /// Moves the eye. Returns true if the visible objects may have changed.
    fn look_from(&mut self, eye: [f32; 3]) -> Result<bool, PvsError> {
        let mut cell = self.pvs.find_cell(eye);
        if let Some(number) = cell
            && !self.pvs.is_reached(number)?
        {
            cell = None;
        }
        if cell == self.cell {
            return Ok(false);
        }
        if let Some(number) = cell {
            self.pvs.visible_objects(number, &mut self.visible)?;
        }
        self.cell = cell;
        Ok(true)
    }
}

/// A plugin that hides the objects outside the set of the eye's cell, whenever the cell changes. It also
/// hides entities that are spawned later.
pub struct SightlinePlugin;

impl Plugin for SightlinePlugin {
    fn build(&self, app: &mut App) {
        // The eye's position in this frame is known here, and visibility is not propagated yet.
        let between = cull
            .after(TransformSystems::Propagate)
            .before(VisibilitySystems::VisibilityPropagate);
        app.add_systems(PostUpdate, between.run_if(resource_exists::<Sightline>));
    }
}

fn cull(
    mut sightline: ResMut<Sightline>,
    eye: Query<&GlobalTransform, With<SightlineEye>>,
    mut all: Query<(Ref<SightlineObject>, &mut Visibility)>,
) -> Result {
    let Ok(eye) = eye.single() else { return Ok(()) };
    let moved = sightline.look_from(eye.translation().to_array())?;
    for (object, mut visibility) in &mut all {
        if moved || object.is_changed() {
            let wanted = if sightline.shows(*object) {
                Visibility::Inherited
            } else {
                Visibility::Hidden
            };
            visibility.set_if_neq(wanted);
        }
    }
    Ok(())
}
