//! The specification of a job of ambient occlusion: a scene, receivers, and nothing else.

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_proto::v1;
use sightline_viewcells::Division;

use crate::ambient::Ambient;
use crate::choice::BackendChoice;
use crate::receivers::{MOST_BYTES, MOST_LIGHTS};
use crate::spec::{JobSpec, SpecError};

impl Ambient {
    /// Reads the receivers that a message names.
    pub(crate) fn from_proto(m: &v1::Ambient) -> Result<Self, SpecError> {
        let receivers = m.receivers.as_slice().try_into();
        let receivers = receivers
            .map_err(|_| SpecError::Field("receivers", "give the 32 bytes of their digest"))?;
        let (Some(bytes), Some(points), Some(lights)) = (m.bytes, m.points, m.lights) else {
            return Err(SpecError::Field(
                "receivers",
                "their length and numbers are absent; the coordinator fills them in at Submit",
            ));
        };
        Ok(Self {
            receivers,
            bytes,
            points,
            lights,
        })
    }

    /// Returns the message.
    pub(crate) fn to_proto(self) -> v1::Ambient {
        let Self {
            receivers,
            bytes,
            points,
            lights,
        } = self;
        let (bytes, points, lights) = (Some(bytes), Some(points), Some(lights));
        v1::Ambient {
            receivers: receivers.to_vec(),
            bytes,
            points,
            lights,
        }
    }
}

impl JobSpec {
    /// The specification of a job of ambient occlusion. What is about cells has values that mean nothing: the
    /// plan is within a unit cube.
    pub fn of_receivers(scene: [u8; 32], ambient: Ambient) -> Self {
        let cell = Aabb {
            min: Vec3::ZERO,
            max: Vec3::ONE,
        };
        let spec = Self::new(scene, Division::Grid([1; 3]), cell);
        Self {
            backend: BackendChoice::None,
            ambient: Some(ambient),
            ..spec
        }
    }

    /// Checks a specification that names these receivers.
    pub(crate) fn check_ambient(&self, ambient: Ambient) -> Result<(), SpecError> {
        let refuse = |field, remedy| Err(SpecError::Field(field, remedy));
        if ambient.points == 0 || ambient.bytes > MOST_BYTES || ambient.lights > MOST_LIGHTS {
            return refuse(
                "receivers",
                "send them with PutReceivers and name their digest",
            );
        }
        if *self != Self::of_receivers(self.scene, ambient) {
            return refuse("ambient", "leave out all fields beside it but the scene");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::receivers::{TILE, tiles};

    fn ambient(points: u32) -> Ambient {
        Ambient {
            receivers: [9; 32],
            bytes: 1000,
            points,
            lights: 0,
        }
    }

    #[test]
    fn a_scene_and_receivers_are_a_job_and_nothing_else_may_be_given() {
        let spec = JobSpec::of_receivers([7; 32], ambient(5));
        assert_eq!(spec.check(), Ok(()));
        assert_eq!(
            JobSpec::from_proto(&spec.to_proto(), None).as_ref(),
            Ok(&spec)
        );
        let ambient_alone = Some(ambient(5).to_proto());
        let short = v1::JobSpec {
            scene: vec![7; 32],
            ambient: ambient_alone,
            ..Default::default()
        };
        assert_eq!(JobSpec::from_proto(&short, None).as_ref(), Ok(&spec));
        let refused =
            |message: v1::JobSpec| JobSpec::from_proto(&message, None).unwrap_err().to_string();
        assert!(
            refused(v1::JobSpec {
                seed: Some(1),
                ..short.clone()
            })
            .contains("leave out all fields")
        );
        assert!(
            refused(v1::JobSpec {
                method: Some(1),
                ..short.clone()
            })
            .contains("leave out all fields")
        );
        let blocks = v1::JobSpec {
            block_cells: Some(64),
            ..short.clone()
        };
        assert!(refused(blocks).contains("leave out all fields"));
        let of = |change: &dyn Fn(&mut v1::Ambient)| {
            let mut message = short.clone();
            message.ambient.iter_mut().for_each(change);
            refused(message)
        };
        assert!(of(&|a| a.points = Some(0)).contains("PutReceivers"));
        assert!(of(&|a| a.lights = None).contains("absent"));
        assert!(of(&|a| a.receivers.truncate(3)).contains("32 bytes"));
        let others = [
            Ambient {
                receivers: [8; 32],
                ..ambient(5)
            },
            Ambient {
                bytes: 1001,
                ..ambient(5)
            },
            Ambient {
                points: 6,
                ..ambient(5)
            },
            Ambient {
                lights: 1,
                ..ambient(5)
            },
        ];
        let mut keys: Vec<_> = others
            .iter()
            .map(|a| JobSpec::of_receivers([7; 32], *a).key())
            .collect();
        keys.extend([spec.key(), JobSpec::of_receivers([8; 32], ambient(5)).key()]);
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), others.len() + 2);
    }

    #[test]
    fn the_tiles_are_runs_of_receivers() {
        for points in [1, TILE, TILE + 1, 3 * TILE - 1] {
            let (_, plan) = JobSpec::of_receivers([7; 32], ambient(points))
                .plan()
                .unwrap();
            assert_eq!(plan.tiles.len() as u32, tiles(points));
            assert_eq!(
                plan.tiles.iter().map(|tile| tile.cells).sum::<u64>(),
                points.into()
            );
            assert_eq!(plan.leaves().count(), plan.tiles.len());
            assert!(
                plan.tiles
                    .iter()
                    .all(|tile| tile.needs.is_empty() && tile.cells > 0)
            );
        }
    }
}
