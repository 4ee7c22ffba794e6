//! The limits of a view: a round cone and a distance.

use sightline_geometry::vector::{cross, dot};

use super::areas::{Cone, area, area_within, is_within};
use super::beam::Edge;
use super::planes::{EyePlane, Facing, PlaneOrigin, Planes, Side};
use super::rounded::{Rounded, unit};
use super::view::View;

/// The limits of a view.
#[derive(Clone, Copy, Debug, Default)]
pub struct ViewLimits {
    cone: Option<Cone>,
    /// True if the view is the complement of the cone, because the view's angle exceeds 180 degrees.
    complement: bool,
    /// Half of the view's angle, in radians.
    half: f64,
    /// The distance from the viewpoint at which visibility ends, in world units.
    pub distance: Option<f64>,
}

/// Number of planes around a cone. Beams start within these planes; the round border is applied when beams
/// end.
const PLANES: u32 = 8;
/// Margin that is added to half of the cone's angle, in radians. The margin keeps the planes outside of the
/// cone despite rounding.
const MARGIN: f64 = 1e-9;
/// Largest half angle, in radians, of a cone around which planes are placed.
const WIDEST: f64 = 1.3;

impl ViewLimits {
    /// Computes the limits of a view whose numbers were checked.
    pub fn from_view(view: &View) -> Self {
        let half = view.angle / 2.0;
        let cone = view.direction.map(|d| {
            let size = d.iter().fold(0.0f64, |m, c| m.max(c.abs()));
            let axis = unit(d.map(|c| c / size));
            if half > std::f64::consts::FRAC_PI_2 {
                Cone {
                    axis: axis.map(|c| -c),
                    cosine: -libm::cos(half),
                }
            } else {
                Cone {
                    axis,
                    cosine: libm::cos(half).max(0.0),
                }
            }
        });
        Self {
            cone,
            complement: half > std::f64::consts::FRAC_PI_2,
            half,
            distance: view.distance,
        }
    }

    /// Adds planes around the cone to `planes`, and returns the sides of these planes that contain the cone.
    ///
    /// Returns no sides if the view has no cone, or if half of the cone's angle exceeds [`WIDEST`].
    pub fn planes(&self, planes: &mut Planes) -> Vec<Side> {
        let Some(Cone { axis, .. }) = self.cone.filter(|_| self.half <= WIDEST) else {
            return Vec::new();
        };
        let least = (0..3)
            .min_by(|a, b| axis[*a].abs().total_cmp(&axis[*b].abs()))
            .unwrap_or(0);
        let side: [f64; 3] = std::array::from_fn(|k| f64::from(u8::from(k == least)));
        let u = unit(cross(axis, side));
        let v = cross(axis, u);
        let half = self.half + MARGIN;
        (0..PLANES)
            .map(|k| {
                let turn = std::f64::consts::TAU * f64::from(k) / f64::from(PLANES);
                let (c, s) = (libm::cos(turn), libm::sin(turn));
                let normal = std::array::from_fn(|k| {
                    libm::sin(half) * axis[k] + libm::cos(half) * (c * u[k] + s * v[k])
                });
                planes.add(EyePlane {
                    kind: PlaneOrigin::Normal(normal),
                    normal: Rounded::exact(normal).scaled(),
                })
            })
            .collect()
    }

    /// Computes two solid angles of a beam, in steradians.
    ///
    /// The first is the solid angle of the beam's part within the view's cone. The second is the solid angle
    /// of the directions of this part in which `face` is nearer than the view's distance. A solid angle is
    /// `None` if its part is empty; the second is also `None` without a face.
    pub fn areas(&self, ring: &[Edge], face: Option<&Facing>) -> (Option<f64>, Option<f64>) {
        let whole = self.within(ring, None);
        let near = match (face, self.distance) {
            (None, _) => None,
            (Some(_), None) => whole,
            (Some(face), Some(distance)) => {
                let n = face.normal.v;
                let size = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
                let cosine = face.height.value / size / distance;
                let cone = Cone {
                    axis: unit(n),
                    cosine: cosine.max(0.0),
                };
                (cosine < 1.0)
                    .then(|| self.within(ring, Some(cone)))
                    .flatten()
            }
        };
        (whole, near)
    }

    /// Computes the solid angle of a beam within the view's cone and another cone, in steradians.
    fn within(&self, ring: &[Edge], other: Option<Cone>) -> Option<f64> {
        let clipped_area = |cones: &[Cone]| {
            if cones.is_empty() {
                Some(area(ring))
            } else {
                area_within(ring, cones)
            }
        };
        let Some(cone) = self.cone else {
            return clipped_area(other.as_slice());
        };
        let both = [Some(cone), other]
            .into_iter()
            .flatten()
            .collect::<Vec<_>>();
        if !self.complement {
            return clipped_area(&both);
        }
        // If the excluded cone contains the part, a difference of rounded areas would not be exactly 0.
        if is_within(ring, other.as_slice(), &cone) {
            return None;
        }
        let all = clipped_area(other.as_slice())?;
        Some((all - clipped_area(&both).unwrap_or_default()).max(0.0))
    }

    /// Returns true if a direction is within the view's cone and, if a face is given, the face is nearer than
    /// the view's distance in this direction.
    pub fn hold(&self, way: [f64; 3], face: Option<&Facing>) -> bool {
        let way = unit(way);
        let in_cone = self.cone.is_none_or(|c| c.holds(way) != self.complement);
        let is_near = match (self.distance, face) {
            (Some(distance), Some(face)) => face.height.value < distance * dot(face.normal.v, way),
            _ => true,
        };
        in_cone && is_near
    }

    /// Returns true if a box is certainly farther from the viewpoint `x` than the view's distance.
    pub fn beyond(&self, x: [f64; 3], low: [f32; 3], high: [f32; 3]) -> bool {
        self.distance.is_some_and(|distance| {
            let mut sum = 0.0;
            for k in 0..3 {
                let d = (f64::from(low[k]) - x[k])
                    .max(x[k] - f64::from(high[k]))
                    .max(0.0);
                sum += d * d;
            }
            // The margin covers a few roundings with a relative error of 2⁻⁵³ each.
            sum.sqrt() > distance * (1.0 + 1e-12)
        })
    }
}
