//! Points and lights as users give them: what a line of JSON must hold, and what becomes of it.

use glam::DVec3;
use serde::Deserialize;
use serde_json::Value;
use sightline_geometry::convex::ConvexError;

use crate::lights::Light;
use crate::receivers::Receiver;

/// A line that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LineError {
    /// A point that no scene can hold.
    #[error("point {0:?} is not near any scene; give three numbers below 3.4e38")]
    Far([f64; 3]),
    /// A normal that is 0 or not finite.
    #[error("normal {0:?} has no direction; give a vector of any length but 0")]
    NoDirection([f64; 3]),
    /// A triangle that the scene does not have.
    #[error("there is no triangle {triangle}; the scene has {triangles}, the first one is 0")]
    NoTriangle {
        /// The triangle's number.
        triangle: u32,
        /// How many the scene has.
        triangles: usize,
    },
    /// The id of a light is neither a text nor a number.
    #[error("id is {0}; give each light a name or a number")]
    Name(Value),
    /// A light that is no convex polygon.
    #[error("light {name:?}: {reason}")]
    Light {
        /// The light's id.
        name: String,
        /// What is wrong with it.
        reason: ConvexError,
    },
}

/// A point: `{"id":1,"point":[x,y,z],"normal":[x,y,z],"triangle":t}`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointLine {
    /// What the answer is named by; may be left out.
    #[serde(default)]
    pub id: Value,
    /// The point, in the frame of the scene.
    pub point: [f64; 3],
    /// Its normal, of any length but 0.
    pub normal: [f64; 3],
    /// The triangle that it lies on, if that is known.
    pub triangle: Option<u32>,
}

impl PointLine {
    /// The receiver, on a scene of so many triangles. Its normal is of unit length.
    ///
    /// # Errors
    /// [`LineError`] when no scene can hold it, or this one does not have its triangle.
    pub fn receiver(&self, triangles: usize) -> Result<Receiver, LineError> {
        let [point, normal] = [self.point, self.normal].map(DVec3::from);
        // Squares of larger numbers overflow, and scenes are in single precision.
        let near = point.abs().max_element() <= f64::from(f32::MAX);
        if !near {
            return Err(LineError::Far(self.point));
        }
        // Neither the squares of large numbers nor those of small ones can be told.
        let normal = normal / normal.abs().max_element();
        let size = normal.length();
        if !(size.is_finite() && size > 0.0) {
            return Err(LineError::NoDirection(self.normal));
        }
        if let Some(triangle) = self.triangle.filter(|t| *t as usize >= triangles) {
            return Err(LineError::NoTriangle {
                triangle,
                triangles,
            });
        }
        Ok(Receiver {
            point,
            normal: normal / size,
            triangle: self.triangle,
        })
    }
}

/// A light: `{"id":"lamp","polygon":[[x,y,z],…]}`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightLine {
    /// What answers name it by: a text or a number.
    pub id: Value,
    /// Its corners in order, in the frame of the scene.
    pub polygon: Vec<[f64; 3]>,
}

impl LightLine {
    /// The light, and its name.
    ///
    /// # Errors
    /// [`LineError`] when it has no name or is no convex polygon.
    pub fn light(self) -> Result<(String, Light), LineError> {
        let name = match self.id {
            Value::String(name) => name,
            id @ Value::Number(_) => id.to_string(),
            id => return Err(LineError::Name(id)),
        };
        match Light::new(&self.polygon) {
            Ok(light) => Ok((name, light)),
            Err(reason) => Err(LineError::Light { name, reason }),
        }
    }
}
