//! The alpha of triangles according to a material with `alphaMode` MASK.
//!
//! A texel blocks if the alpha of the base colour reaches the cutoff. This alpha is the alpha of the texture
//! times the factor. A transform of the texture (KHR_texture_transform) is applied to the coordinates of the
//! vertices.

use serde_json::Value;

use super::texels::Cutoff;
use crate::turn;

/// The reason for the kind of masked triangles, and of see-through triangles if textures are not read.
pub(super) const MASK: &str = "alphaMode MASK";

/// The alpha properties of a material.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Alpha {
    /// The index of the texture of the base colour, if the material has such a texture.
    pub(super) texture: Option<usize>,
    /// The set of texture coordinates: the n of TEXCOORD_n.
    pub(super) set: u64,
    pub(super) cutoff: Cutoff,
    /// The matrix of the scale and rotation of KHR_texture_transform, row by row. `offset` is the offset of
    /// this transform.
    matrix: [[f64; 2]; 2],
    offset: [f64; 2],
}

impl Alpha {
    /// Reads the alpha properties of a material. The error describes the fault of an invalid field.
    pub(super) fn read(material: &Value) -> Result<Self, String> {
        // If a material has both material models, the older extension has precedence, as the extension itself
        // specifies.
        let glossy = material
            .get("extensions")
            .and_then(|e| e.get("KHR_materials_pbrSpecularGlossiness"));
        let (model, texture, factor) = match glossy {
            Some(model) => (Some(model), "diffuseTexture", "diffuseFactor"),
            None => (
                material.get("pbrMetallicRoughness"),
                "baseColorTexture",
                "baseColorFactor",
            ),
        };
        let texture = model.and_then(|m| m.get(texture));
        let factor = model
            .and_then(|m| m.get(factor))
            .map_or(Some(&Value::Null), |f| f.get(3));
        let cutoff = Cutoff {
            factor: number(
                factor.ok_or("the base colour factor has no alpha")?,
                1.0,
                "base colour factor",
            )?,
            least: number(
                material.get("alphaCutoff").unwrap_or(&Value::Null),
                0.5,
                "alphaCutoff",
            )?,
        };
        let placed = texture
            .and_then(|t| t.get("extensions"))
            .and_then(|e| e.get("KHR_texture_transform"));
        let pair = |key: &str, default: f64| -> Result<[f64; 2], String> {
            let given = placed.and_then(|p| p.get(key));
            let at = |i| {
                given
                    .map_or(Some(&Value::Null), |v| v.get(i))
                    .unwrap_or(&Value::Bool(false))
            };
            Ok([number(at(0), default, key)?, number(at(1), default, key)?])
        };
        let rotation = placed
            .and_then(|p| p.get("rotation"))
            .unwrap_or(&Value::Null);
        let (scale, offset) = (pair("scale", 1.0)?, pair("offset", 0.0)?);
        let (cos, sin) =
            turn::of_quarters(number(rotation, 0.0, "rotation")? / std::f64::consts::FRAC_PI_2);
        let set = placed
            .and_then(|p| p.get("texCoord"))
            .or_else(|| texture.and_then(|t| t.get("texCoord")));
        let index =
            |v: &Value, what: &str| v.as_u64().ok_or(format!("the {what} is not an index: {v}"));
        let texture = texture
            .map(|t| index(t.get("index").unwrap_or(&Value::Null), "texture").map(|i| i as usize))
            .transpose()?;
        // The rotation is counter-clockwise where v points down, as in every renderer (glTF issue 1563).
        let matrix = [
            [cos * scale[0], sin * scale[1]],
            [-sin * scale[0], cos * scale[1]],
        ];
        let set = set.map_or(Ok(0), |s| index(s, "texCoord"))?;
        Ok(Self {
            texture,
            set,
            cutoff,
            matrix,
            offset,
        })
    }

    /// Applies the transform of the texture to the texture coordinates of a vertex. Returns `None` if the
    /// result is not finite.
    pub(super) fn placed(&self, [u, v]: [f64; 2]) -> Option<[f32; 2]> {
        let along =
            |a: usize| (self.matrix[a][0] * u + self.matrix[a][1] * v + self.offset[a]) as f32;
        Some([along(0), along(1)]).filter(|uv| uv.iter().all(|c| c.is_finite()))
    }
}

/// Returns `value` as a finite number, or `default` for null. `what` names the value in the error.
fn number(value: &Value, default: f64, what: &str) -> Result<f64, String> {
    match value {
        Value::Null => Ok(default),
        v => v
            .as_f64()
            .filter(|n| n.is_finite())
            .ok_or(format!("the {what} is not a finite number: {v}")),
    }
}
