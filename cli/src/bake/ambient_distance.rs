//! The distance of `ambient`, beyond which nothing hides.

use sightline::Error;
use sightline_ambient::Falloff;
use sightline_scene::Scene;

use crate::args::ambient::AmbientArgs;
use crate::terminal::stderr::say;

/// The scene's diagonal by the default distance.
const DIAGONAL_BY_DISTANCE: f64 = 20.0;

/// The distance of the arguments, or that which fits the scene.
pub fn distance(args: &AmbientArgs, scene: &Scene) -> Result<f64, Error> {
    let Some(text) = &args.distance else {
        let bounds = scene.bounds();
        let distance =
            (bounds.max.as_dvec3() - bounds.min.as_dvec3()).length() / DIAGONAL_BY_DISTANCE;
        if distance <= 0.0 {
            return Err(Error::input(
                "the scene is a single point, which gives no distance; give --distance".to_owned(),
            ));
        }
        say(&format!(
            "distance {distance:.4}, a twentieth of the scene's diagonal; --distance sets another"
        ));
        return Ok(distance);
    };
    let distance: f64 = text.parse().unwrap_or(f64::NAN);
    if distance.is_nan() || distance <= 0.0 {
        return Err(Error::input(format!(
            "--distance {text}: it is no distance; give a number above 0, in units of the scene, or inf"
        )));
    }
    if distance.is_infinite() && args.falloff.falloff() == Falloff::Sqrt {
        return Err(Error::input(
            "--falloff sqrt compares distances with --distance, which is infinite; give a finite one"
                .to_owned(),
        ));
    }
    Ok(distance)
}
