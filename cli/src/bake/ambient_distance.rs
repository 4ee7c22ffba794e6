//! The distance of `ambient`, beyond which triangles do not block.

use sightline::Error;
use sightline_ambient::Falloff;
use sightline_scene::Scene;

use crate::args::ambient::AmbientArgs;
use crate::terminal::stderr::say;

/// The ratio of the scene's diagonal to the default distance.
const DIAGONAL_BY_DISTANCE: f64 = 20.0;

/// Returns the distance in the arguments, or otherwise a twentieth of the scene's diagonal, in units of the
/// scene.
pub fn distance(args: &AmbientArgs, scene: &Scene) -> Result<f64, Error> {
    let Some(text) = &args.distance else {
        let bounds = scene.bounds();
        let distance =
            (bounds.max.as_dvec3() - bounds.min.as_dvec3()).length() / DIAGONAL_BY_DISTANCE;
        if distance <= 0.0 {
            return Err(Error::input(
                "the scene is a single point, so the default distance is 0; give --distance"
                    .to_owned(),
            ));
        }
        say(&format!(
            "occlusion distance {distance:.4}, a twentieth of the scene's diagonal; --distance sets \
             another distance"
        ));
        return Ok(distance);
    };
    let distance: f64 = text.parse().unwrap_or(f64::NAN);
    if distance.is_nan() || distance <= 0.0 {
        return Err(Error::input(format!(
            "--distance {text} is not a number above 0; give a number above 0, in units of the scene, or \
             inf"
        )));
    }
    if distance.is_infinite() && args.falloff.falloff() == Falloff::Sqrt {
        return Err(Error::input(
            "--falloff sqrt needs a finite --distance, not inf; give a number above 0".to_owned(),
        ));
    }
    Ok(distance)
}
