//! Scenes from triangles in memory. The user's rules determine the kinds of triangles, as for files.

use super::limits::{too_many_objects, too_many_triangles};
use super::marks::{Mark, Marks};
use super::names::UniqueNames;
use super::{LoadOptions, LoadedScene};
use crate::{Object, Scene, SceneError, Sides, Triangle};

/// Creates a scene from `triangles` in id order and from `objects`, which must cover the ids in order.
///
/// The function appends `#2`, `#3`, … to names that several objects have. `name` is the file name in errors.
/// Rules match the names of objects.
///
/// # Errors
/// The errors of [`Scene::new`], and [`SceneError::Bad`] if the scene exceeds the limits or a rule is
/// invalid.
pub fn from_memory(
    name: &str,
    triangles: Vec<Triangle>,
    mut objects: Vec<Object>,
    options: &LoadOptions,
) -> Result<LoadedScene, SceneError> {
    if triangles.len() > options.limits.triangles as usize {
        return Err(too_many_triangles(name, "mesh".to_owned(), &options.limits));
    }
    if objects.len() > options.limits.objects as usize {
        return Err(too_many_objects(name, "mesh".to_owned(), &options.limits));
    }
    let mut marks = Marks::new(name, &options.rules, options.alpha_textures)?;
    objects
        .iter()
        .for_each(|o| marks.push(o.count, &[&o.name], &Mark::DEFAULT));
    let mut names = UniqueNames::default();
    objects
        .iter_mut()
        .for_each(|o| o.name = names.unique(std::mem::take(&mut o.name)));
    let scene = Scene::new(name, triangles, objects)?;
    scene.check_reach(name)?;
    let sides = if options.cull_back_faces {
        marks.sides(scene.len())
    } else {
        Sides::both()
    };
    let (kinds, masks, warnings) = marks.finish();
    Ok(LoadedScene {
        scene: scene
            .with_masks(name, kinds, masks)?
            .with_sides(name, sides)?,
        warnings,
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_numbers::ids::TriangleId;

    use super::*;
    use crate::{KindRule, SurfaceKind};

    #[test]
    fn rules_match_the_names_of_objects() {
        let triangle = Triangle {
            v: [Vec3::ZERO, Vec3::X, Vec3::Y],
        };
        let object = |name: &str, first, count| Object {
            name: name.to_owned(),
            first,
            count,
        };
        let objects = vec![
            object("wall", 0, 1),
            object("wall", 1, 1),
            object("glass pane", 2, 1),
        ];
        let rules = vec![
            KindRule::new(SurfaceKind::SeeThrough, "glass*").unwrap(),
            KindRule::new(SurfaceKind::Door, "gate").unwrap(),
        ];
        let loaded = from_memory(
            "mesh",
            vec![triangle; 3],
            objects,
            &LoadOptions {
                rules,
                ..LoadOptions::default()
            },
        )
        .unwrap();
        let kinds: Vec<SurfaceKind> = (0..3)
            .map(|id| loaded.scene.kinds().kind(TriangleId(id)))
            .collect();
        assert_eq!(
            kinds,
            [
                SurfaceKind::Opaque,
                SurfaceKind::Opaque,
                SurfaceKind::SeeThrough
            ]
        );
        assert_eq!(loaded.scene.objects()[1].name, "wall#2");
        assert_eq!(loaded.warnings.len(), 1, "{:?}", loaded.warnings);
        let nothing = from_memory("mesh", Vec::new(), Vec::new(), &LoadOptions::default());
        assert!(nothing.unwrap_err().to_string().contains("no triangles"));
    }
}
