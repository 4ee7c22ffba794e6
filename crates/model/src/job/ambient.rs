//! The task of ambient occlusion: the digest and the counts of its receivers.
//!
//! A job of ambient occlusion has no cells. Its tiles are runs of receivers, and its plan counts receivers in
//! place of cells. All workers compute the same bytes, so the job needs no tracer.

use sightline_proto::v1;
use sightline_viewcells::{CellBox, Plan, UNITS_PER_CELL};

use super::SpecError;
use crate::receivers::{MOST_BYTES, MOST_LIGHTS, TILE, tiles};

/// The receivers that a job references.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ambient {
    /// The BLAKE3 digest of the receivers.
    pub receivers: [u8; 32],
    /// The length of the receivers in bytes.
    pub bytes: u64,
    /// The number of receivers.
    pub points: u32,
    /// The number of lights.
    pub lights: u32,
}

impl Ambient {
    /// Returns the number of values per receiver: the openness, then the form factor of each light.
    pub fn numbers(self) -> u32 {
        1 + self.lights
    }

    /// Computes the plan, whose tiles are runs of receivers.
    pub(super) fn plan(self) -> Plan {
        let unit = CellBox {
            lo: [0; 3],
            hi: [UNITS_PER_CELL; 3],
        };
        Plan::of_counts(unit, self.counts())
    }

    /// Returns the approximate number of receivers of each tile. A tile has whole blocks, so it may have more
    /// or fewer receivers. The sum is exact.
    fn counts(self) -> impl Iterator<Item = u64> {
        (0..tiles(self.points)).map(move |tile| u64::from((self.points - tile * TILE).min(TILE)))
    }

    /// Reads the receivers that a message references.
    pub(super) fn from_message(m: &v1::Ambient) -> Result<Self, SpecError> {
        let receivers = m.receivers.as_slice().try_into();
        let receivers = receivers.map_err(|_| {
            SpecError::new(
                "receivers",
                "their digest does not have 32 bytes; give the BLAKE3 digest",
            )
        })?;
        let (Some(bytes), Some(points), Some(lights)) = (m.bytes, m.points, m.lights) else {
            return Err(SpecError::new(
                "receivers",
                "their size or a count is absent; the coordinator sets size and counts at Submit",
            ));
        };
        if points == 0 || bytes > MOST_BYTES || lights > MOST_LIGHTS {
            return Err(SpecError::new(
                "receivers",
                "their size or a count is out of range; send them with PutReceivers",
            ));
        }
        Ok(Self {
            receivers,
            bytes,
            points,
            lights,
        })
    }

    /// Returns the message of the receivers.
    pub(super) fn to_message(self) -> v1::Ambient {
        v1::Ambient {
            receivers: self.receivers.to_vec(),
            bytes: Some(self.bytes),
            points: Some(self.points),
            lights: Some(self.lights),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{JobSpec, PlannedJob, SceneFacts};

    fn ambient(points: u32) -> Ambient {
        Ambient {
            receivers: [9; 32],
            bytes: 1000,
            points,
            lights: 0,
        }
    }

    #[test]
    fn receivers_round_trip_through_message_and_change_key() {
        let read = |m: &v1::JobSpec| JobSpec::from_message(m, &SceneFacts::default());
        let spec = JobSpec::of_receivers([7; 32], ambient(5));
        let message = spec.to_message();
        assert_eq!(read(&message).as_ref(), Ok(&spec));
        let with = |change: &dyn Fn(&mut v1::Ambient)| {
            let mut changed = ambient(5).to_message();
            change(&mut changed);
            let task = Some(v1::job_spec::Task::Ambient(changed));
            let scene = message.scene.clone();
            read(&v1::JobSpec { scene, task }).unwrap_err().to_string()
        };
        assert!(with(&|a| a.points = Some(0)).contains("PutReceivers"));
        assert!(with(&|a| a.lights = None).contains("absent"));
        assert!(with(&|a| a.receivers.truncate(3)).contains("32 bytes"));
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
        let key = |a: &Ambient| JobSpec::of_receivers([7; 32], *a).key();
        let mut keys: Vec<_> = others.iter().map(key).collect();
        keys.extend([spec.key(), JobSpec::of_receivers([8; 32], ambient(5)).key()]);
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), others.len() + 2);
    }

    #[test]
    fn tiles_are_runs_of_receivers() {
        for points in [1, TILE, TILE + 1, 3 * TILE - 1] {
            let job = PlannedJob::new(JobSpec::of_receivers([7; 32], ambient(points))).unwrap();
            let plan = job.plan();
            assert_eq!(plan.tiles.len() as u32, tiles(points));
            let cells = plan.tiles.iter().map(|tile| tile.cells).sum::<u64>();
            assert_eq!(cells, u64::from(points));
            assert_eq!(plan.leaves().count(), plan.tiles.len());
            assert!(
                plan.tiles
                    .iter()
                    .all(|tile| tile.needs.is_empty() && tile.cells > 0)
            );
        }
    }
}
