//! Affine transforms in `f64`. The transforms of nested nodes are multiplied, and each transformed vertex is
//! rounded to `f32` once.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

use super::json::Node;

/// Computes the transform of a node relative to its parent. The error is a sentence that describes the fault.
///
/// A matrix must be affine. The function normalises a rotation, because exporters round quaternions to `f32`.
pub(super) fn local(node: &Node) -> Result<DAffine3, String> {
    let result = match &node.matrix {
        Some(m) => {
            if node.translation.is_some() || node.rotation.is_some() || node.scale.is_some() {
                return Err(
                    "the node has both a matrix and a translation, rotation or scale".to_owned(),
                );
            }
            if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
                return Err("the last row of the matrix is not 0 0 0 1".to_owned());
            }
            let column = |i: usize| DVec3::new(m[4 * i], m[4 * i + 1], m[4 * i + 2]);
            DAffine3 {
                matrix3: DMat3::from_cols(column(0), column(1), column(2)),
                translation: column(3),
            }
        }
        None => {
            let unbox = |v: &Option<Box<[f64; 3]>>| v.as_ref().map(|v| **v);
            compose(
                unbox(&node.translation),
                node.rotation.as_ref().map(|r| **r),
                unbox(&node.scale),
            )
            .ok_or("the rotation is not a quaternion of positive length")?
        }
    };
    if result.is_finite() {
        Ok(result)
    } else {
        Err("the transform is not finite".to_owned())
    }
}

/// Composes a transform from a translation, a rotation (quaternion x, y, z, w) and a scale. A missing
/// argument stands for the identity. Returns `None` if the length of the quaternion is not finite or at most
/// 10⁻⁶.
pub(super) fn compose(
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
) -> Option<DAffine3> {
    let rotation = match rotation {
        None => DQuat::IDENTITY,
        Some(r) => {
            let q = DQuat::from_array(r);
            let length = q.length();
            if !(length.is_finite() && length > 1e-6) {
                return None;
            }
            q / length
        }
    };
    Some(DAffine3::from_scale_rotation_translation(
        scale.map_or(DVec3::ONE, DVec3::from_array),
        rotation,
        translation.map_or(DVec3::ZERO, DVec3::from_array),
    ))
}

/// Transforms `p` to world space and rounds the result to `f32`. A coordinate out of range becomes infinite.
///
/// The identity preserves every bit, including the sign of a zero.
pub(super) fn apply(world: &DAffine3, p: [f64; 3]) -> Vec3 {
    let p = DVec3::from_array(p);
    if *world == DAffine3::IDENTITY {
        p.as_vec3()
    } else {
        world.transform_point3(p).as_vec3()
    }
}
