//! Triangles that are in memory already: the rules of the user decide their kinds, as those of a file.

use super::limits::{too_many_objects, too_many_triangles};
use super::marks::{Mark, Marks};
use super::names::Names;
use super::{Loaded, Options};
use crate::{Object, Scene, SceneError, Sides, Triangle};

/// A scene of triangles in the order of their ids, and of the objects that they form, whose names are made
/// unique. `name` appears in errors. Rules match the names of objects.
///
/// # Errors
/// As [`Scene::new`], and [`SceneError::Bad`] when the scene is beyond the limits or a rule is none.
pub fn from_memory(
    name: &str,
    (triangles, mut objects): (Vec<Triangle>, Vec<Object>),
    options: &Options,
) -> Result<Loaded, SceneError> {
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
    let mut names = Names::default();
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
    Ok(Loaded {
        scene: scene
            .with_masks(name, kinds, masks)?
            .with_sides(name, sides)?,
        warnings,
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::{Kind, Rule};

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
        let mesh = (
            vec![triangle; 3],
            vec![
                object("wall", 0, 1),
                object("wall", 1, 1),
                object("glass pane", 2, 1),
            ],
        );
        let rules = vec![
            Rule::new(Kind::SeeThrough, "glass*").unwrap(),
            Rule::new(Kind::Door, "gate").unwrap(),
        ];
        let loaded = from_memory(
            "mesh",
            mesh,
            &Options {
                rules,
                ..Options::default()
            },
        )
        .unwrap();
        let kinds: Vec<Kind> = (0..3).map(|id| loaded.scene.kinds().kind(id)).collect();
        assert_eq!(kinds, [Kind::Opaque, Kind::Opaque, Kind::SeeThrough]);
        assert_eq!(loaded.scene.objects()[1].name, "wall#2");
        assert_eq!(loaded.warnings.len(), 1, "{:?}", loaded.warnings);
        let nothing = from_memory("mesh", (Vec::new(), Vec::new()), &Options::default());
        assert!(nothing.unwrap_err().to_string().contains("no triangles"));
    }
}
