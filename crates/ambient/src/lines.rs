//! Points and lights in JSON: the format of a line, and its conversion.

use glam::DVec3;
use serde::Deserialize;
use serde_json::Value;
use sightline_geometry::convex::ConvexError;
use sightline_scene::TriangleId;

use crate::lights::Light;
use crate::receivers::Receiver;

/// An error in a line of a points or lights file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LineError {
    /// A point outside the range of scenes.
    #[error("point {0:?} is out of range; give three coordinates from -3.4e38 to 3.4e38")]
    Far([f64; 3]),
    /// A normal that is 0 or not finite.
    #[error("normal {0:?} has no direction; give a finite vector of any length but 0")]
    NoDirection([f64; 3]),
    /// A triangle id that does not exist in the scene.
    #[error("the scene has no triangle {triangle}; use a triangle id below {triangles}")]
    NoTriangle {
        /// The id of the triangle. The first triangle has the id 0.
        triangle: TriangleId,
        /// The number of triangles in the scene.
        triangles: usize,
    },
    /// A light whose id is neither a text nor a number.
    #[error("the light's id is {0}; use a name or a number")]
    Name(Value),
    /// A light that is not a convex polygon.
    #[error("light {name:?}: {reason}")]
    Light {
        /// The id of the light, as a text.
        name: String,
        /// The reason why the polygon is rejected.
        reason: ConvexError,
    },
}

/// A point in JSON: `{"id":1,"point":[x,y,z],"normal":[x,y,z],"triangle":t}`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointLine {
    /// The id that the answer repeats. Optional.
    #[serde(default)]
    pub id: Value,
    /// The point, in the frame of the scene.
    pub point: [f64; 3],
    /// The normal, of any length but 0.
    pub normal: [f64; 3],
    /// The id of the triangle that contains the point, if known.
    pub triangle: Option<TriangleId>,
}

impl PointLine {
    /// Returns the receiver, for a scene with the given number of triangles. The receiver's normal has unit
    /// length.
    ///
    /// # Errors
    /// [`LineError`] if the point or the normal is out of range, or if the scene does not have the triangle.
    pub fn receiver(&self, triangles: usize) -> Result<Receiver, LineError> {
        let [point, normal] = [self.point, self.normal].map(DVec3::from);
        // Squares of larger numbers overflow, and the coordinates of scenes are in single precision.
        let near = point.abs().max_element() <= f64::from(f32::MAX);
        if !near {
            return Err(LineError::Far(self.point));
        }
        // Divide by the largest coordinate first: squares of very large and very small numbers are not
        // representable.
        let normal = normal / normal.abs().max_element();
        let size = normal.length();
        if !(size.is_finite() && size > 0.0) {
            return Err(LineError::NoDirection(self.normal));
        }
        if let Some(triangle) = self.triangle.filter(|t| t.at() >= triangles) {
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

/// A light in JSON: `{"id":"lamp","polygon":[[x,y,z],…]}`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightLine {
    /// The id that answers repeat: a text or a number.
    pub id: Value,
    /// The corners of the light in order, in the frame of the scene.
    pub polygon: Vec<[f64; 3]>,
}

impl LightLine {
    /// Returns the light and its name.
    ///
    /// # Errors
    /// [`LineError`] if the id is neither a text nor a number, or the polygon is not convex.
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
