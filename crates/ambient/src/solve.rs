//! Answers for many receivers, in blocks. The receivers of a block share a partition, and blocks share no
//! state. So blocks can be solved in any order, on any machine, and answers depend only on scene, receivers
//! and settings.

use rayon::prelude::*;
use sightline_scene::{Scene, SceneError};

use crate::blockers::Blockers;
use crate::descent::{RayPartition, Scratch};
use crate::fragments::{Falloff, Fragment, first};
use crate::inside::Inside;
use crate::items::{HidingRange, Items};
use crate::lights::{Light, factors};
use crate::openness::{Openness, SeenFaces, open};
use crate::partition::{Partition, PartitionUse};
use crate::receivers::{Receiver, ReceiverHull, blocks};

/// Maximum number of receivers of a block.
const BLOCK: usize = 64;
/// Maximum extent of a block, divided by the distance of the settings.
const EXTENT: f64 = 0.5;
/// The solid angle, in steradians, above which boxes of occluders are opened before the first query.
const OPEN_FAR: f64 = 0.01;
/// Maximum number of list entries per receiver that the classes of a block may receive. If a block exceeds
/// this number, its unanswered receivers are divided into smaller blocks: many small, near occluders are
/// visible from few receivers each, so a common partition does not save work.
const TOLD: usize = 20_000;
/// The number of smaller blocks into which such a block is divided.
const DIVISION: usize = 4;
/// Maximum memory of a partition and its items, in bytes. A partition that needs more is cleared.
const BYTES: usize = 48 << 20;

/// The parameters of a [`Solver`].
#[derive(Clone, Debug, PartialEq)]
pub struct SolverSettings {
    /// The distance beyond which triangles do not hide directions, in units of the scene. May be infinite.
    pub distance: f64,
    /// The falloff. If the falloff is not [`Falloff::None`], the distance must be finite.
    pub falloff: Falloff,
    /// True if fragments are computed.
    pub fragments: bool,
    /// The lights whose form factors are computed. Every triangle of the scene can hide a light, regardless
    /// of the distance.
    pub lights: Vec<Light>,
    /// Maximum number of receivers of a block, and maximum extent of a block divided by the distance. Both
    /// affect the running time, and change answers at most by the bounds of the answers.
    pub block: (usize, f64),
}

impl SolverSettings {
    /// Creates settings that request only the openness, without a falloff.
    pub fn new(distance: f64) -> Self {
        Self {
            distance,
            falloff: Falloff::None,
            fragments: false,
            lights: Vec::new(),
            block: (BLOCK, EXTENT),
        }
    }
}

/// The results of a receiver.
#[derive(Clone, Debug, Default)]
pub struct ReceiverResult {
    /// The openness of the receiver.
    pub openness: Openness,
    /// True if the receiver is inside a closed solid.
    pub inside: bool,
    /// The form factors of the lights, in the order of the settings. The bound of `openness` also applies to
    /// each form factor.
    pub lights: Vec<f64>,
    /// The fragments, if the settings request fragments. The `polygon` of each is the id of a triangle.
    pub fragments: Vec<Fragment>,
}

/// A scene, prepared for a [`Solver`].
pub struct AmbientScene {
    /// The joined polygons, for openness and lights.
    joined: Blockers,
    /// The separate triangles, for fragments.
    single: Option<Blockers>,
    inside: Inside,
}

impl AmbientScene {
    /// Prepares a scene, on all of rayon's threads. Prepares the scene for fragments, too, if `fragments` is
    /// true.
    ///
    /// # Errors
    /// [`SceneError`] if the scene has more corners than 32-bit numbers can count, or if the masked triangles
    /// cover more than 2²⁴ texels.
    pub fn new(scene: &Scene, fragments: bool) -> Result<Self, SceneError> {
        let joined = Blockers::new(scene, None)?;
        let single = fragments
            .then(|| Blockers::new(scene, Some(&joined)))
            .transpose()?;
        Ok(Self {
            joined,
            single,
            inside: Inside::new(scene)?,
        })
    }

    /// Returns true if a receiver, moved slightly above its surface, is inside a closed solid.
    pub fn is_inside(&self, receiver: &Receiver) -> bool {
        self.inside.holds(receiver)
    }
}

/// A solver of the openness, fragments and form factors of receivers in a scene.
pub struct Solver<'a> {
    prepared: &'a AmbientScene,
    settings: SolverSettings,
}

/// The reusable memory of blocks.
#[derive(Default)]
pub struct BlockMemory {
    scratch: Scratch,
    seen: SeenFaces,
    cuts: Vec<f64>,
}

impl<'a> Solver<'a> {
    /// Creates a solver with these settings. The solver computes fragments only if the scene is prepared for
    /// fragments.
    pub fn new(prepared: &'a AmbientScene, settings: SolverSettings) -> Self {
        let fragments = settings.fragments && prepared.single.is_some();
        Self {
            prepared,
            settings: SolverSettings {
                fragments,
                ..settings
            },
        }
    }

    /// Returns the settings of the solver.
    pub fn settings(&self) -> &SolverSettings {
        &self.settings
    }

    /// Divides receivers into blocks: lists of indices into `receivers`.
    pub fn blocks(&self, receivers: &[Receiver]) -> Vec<Vec<u32>> {
        let (most, extent) = self.settings.block;
        let size = self.settings.distance * extent;
        blocks(
            receivers,
            |t| self.prepared.joined.triangle_surface(t),
            most,
            size,
        )
    }

    /// Computes the answers for all receivers, in the order of `receivers`, on all of rayon's threads. Calls
    /// `done` after each block with the number of receivers of the block.
    pub fn solve(
        &self,
        receivers: &[Receiver],
        done: impl Fn(usize) + Sync,
    ) -> Vec<ReceiverResult> {
        let blocks = self.blocks(receivers);
        let answers: Vec<Vec<ReceiverResult>> = blocks
            .par_iter()
            // The durations of blocks differ widely, so each thread requests one block at a time.
            .with_max_len(1)
            .map_init(BlockMemory::default, |memory, block| {
                let receivers: Vec<Receiver> =
                    block.iter().map(|i| receivers[*i as usize]).collect();
                let answers = self.block(&receivers, memory);
                done(receivers.len());
                answers
            })
            .collect();
        let mut all = vec![ReceiverResult::default(); receivers.len()];
        for (i, answer) in blocks
            .into_iter()
            .flatten()
            .zip(answers.into_iter().flatten())
        {
            all[i as usize] = answer;
        }
        all
    }

    /// Computes the answers for the receivers of one block, in the order of `receivers`. Receivers on
    /// different surfaces do not share a partition.
    pub fn block(&self, receivers: &[Receiver], memory: &mut BlockMemory) -> Vec<ReceiverResult> {
        let mut answers = Vec::new();
        let surface = |r: &Receiver| {
            r.triangle
                .and_then(|t| self.prepared.joined.triangle_surface(t))
        };
        let runs = receivers.chunk_by(|a, b| surface(a) == surface(b));
        let mut waiting: Vec<&[Receiver]> = runs.collect();
        waiting.reverse();
        while let Some(part) = waiting.pop() {
            let before = answers.len();
            self.part(part, memory, &mut answers);
            let rest = &part[answers.len() - before..];
            if !rest.is_empty() {
                waiting.extend(rest.chunks(part.len().div_ceil(DIVISION)).rev());
            }
        }
        answers
    }

    /// Appends the answers for receivers on one surface to `all`, in the order of `receivers`. Stops before
    /// the first receiver with which the partition exceeds [`TOLD`] list entries per receiver.
    fn part(
        &self,
        receivers: &[Receiver],
        memory: &mut BlockMemory,
        all: &mut Vec<ReceiverResult>,
    ) {
        let SolverSettings {
            distance,
            falloff,
            fragments,
            ..
        } = self.settings;
        let union = falloff == Falloff::None && !fragments;
        let joined = &self.prepared.joined;
        let blockers = self
            .prepared
            .single
            .as_ref()
            .filter(|_| fragments)
            .unwrap_or(joined);
        let source = ReceiverHull::around(receivers);
        let own = receivers
            .first()
            .and_then(|r| r.triangle)
            .and_then(|t| joined.triangle_surface(t));
        let mut items = Items::new(blockers, &source, HidingRange::Distance(distance), own);
        let root = items.begin(OPEN_FAR);
        let mut tree = Partition::new(
            if union {
                PartitionUse::Union
            } else {
                PartitionUse::First
            },
            root,
        );
        let BlockMemory {
            scratch,
            seen,
            cuts,
        } = memory;
        seen.clear();
        let mut answers: Vec<ReceiverResult> = Vec::new();
        // A single receiver is never divided, so its lists are not limited.
        let most_told = if receivers.len() > 1 {
            TOLD * receivers.len()
        } else {
            usize::MAX
        };
        for r in receivers {
            let mut rays = RayPartition {
                tree: &mut tree,
                items: &mut items,
                source: &source,
                bytes: BYTES,
                most_told,
            };
            let answer = if union {
                open(&mut rays, r, scratch, seen, cuts).map(|openness| (openness, Vec::new()))
            } else {
                first(
                    &mut rays, r, distance, falloff, fragments, scratch, seen, cuts,
                )
            };
            let Some((openness, mut found)) = answer else {
                break;
            };
            found
                .iter_mut()
                .for_each(|f| f.polygon = blockers.triangle(f.polygon).0);
            let inside = self.prepared.is_inside(r);
            answers.push(ReceiverResult {
                openness,
                inside,
                lights: Vec::new(),
                fragments: found,
            });
        }
        let receivers = &receivers[..answers.len()];
        for light in &self.settings.lights {
            let found = factors(joined, receivers, light, OPEN_FAR, BYTES, scratch);
            for (answer, (factor, bound)) in answers.iter_mut().zip(found) {
                answer.lights.push(factor);
                answer.openness.bound = answer.openness.bound.max(bound);
            }
        }
        all.extend(answers);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use glam::{DVec3, Vec3};
    use sightline_numbers::random::SplitMix64;
    use sightline_scene::{Object, Triangle};

    use super::*;

    /// Creates small triangles all around, few of which are visible from more than one point.
    fn cloud(count: u32) -> Scene {
        let mut random = SplitMix64::named(&[29]);
        let mut number = || ((random.bits() >> 40) as f32 / (1u32 << 24) as f32) - 0.5;
        let mut point = |size: f32| Vec3::new(number(), number(), number()) * size;
        let triangles = (0..count).map(|_| {
            let at = point(20.0);
            Triangle {
                v: [at, at + point(1.0), at + point(1.0)],
            }
        });
        let object = Object {
            name: "cloud".to_owned(),
            first: 0,
            count,
        };
        Scene::new("cloud", triangles.collect(), vec![object]).unwrap()
    }

    #[test]
    fn items_count_as_memory_and_are_cleared_between_queries() {
        let blockers = Blockers::new(&cloud(3000), None).unwrap();
        // The receivers look in six directions, so that each query opens other boxes.
        let ways = [
            DVec3::X,
            DVec3::Y,
            DVec3::Z,
            -DVec3::X,
            -DVec3::Y,
            -DVec3::Z,
        ];
        let receivers = ways.map(|normal| Receiver {
            point: normal * 0.25,
            normal,
            triangle: None,
        });
        let source = ReceiverHull::around(&receivers);
        for tells in [PartitionUse::Union, PartitionUse::First] {
            let solve = |bytes: usize| {
                let mut items = Items::new(&blockers, &source, HidingRange::Distance(8.0), None);
                let root = items.begin(OPEN_FAR);
                let begun = items.bytes();
                let mut tree = Partition::new(tells, root);
                let BlockMemory {
                    mut scratch,
                    mut seen,
                    mut cuts,
                } = BlockMemory::default();
                let (mut most, mut shrunk, mut answers) = (0, 0, Vec::new());
                for r in &receivers {
                    let before = items.bytes();
                    let (tree, source, items) = (&mut tree, &source, &mut items);
                    let mut rays = RayPartition {
                        tree,
                        items,
                        source,
                        bytes,
                        most_told: usize::MAX,
                    };
                    answers.push(match tells {
                        PartitionUse::Union => {
                            open(&mut rays, r, &mut scratch, &mut seen, &mut cuts).unwrap()
                        }
                        PartitionUse::First => {
                            let answer = first(
                                &mut rays,
                                r,
                                8.0,
                                Falloff::None,
                                true,
                                &mut scratch,
                                &mut seen,
                                &mut cuts,
                            );
                            answer.unwrap().0
                        }
                    });
                    most = most.max(items.bytes() + tree.bytes());
                    shrunk += u32::from(items.bytes() < before);
                }
                assert!(items.bytes() > begun, "boxes are opened as queries arrive");
                items.forget();
                assert_eq!(items.bytes(), begun);
                (answers, most, shrunk)
            };
            let (roomy, all, never) = solve(usize::MAX);
            let (tight, less, often) = solve(all / 4);
            assert!(
                never == 0 && often > 0 && less < all,
                "{never} {often}, {less} of {all} bytes"
            );
            for (a, b) in roomy.iter().zip(&tight) {
                // If one occluder is behind another, the tree determines which of them ends a class.
                assert!((a.open - b.open).abs() <= a.bound + b.bound, "{a:?} {b:?}");
                assert!((0.01..0.99).contains(&a.open), "{a:?}");
            }
        }
    }
}
