//! Answers for many receivers, in blocks that share a partition and nothing else. So blocks may be solved in
//! any order, on any machine, and answers are functions of scene, receivers and settings.

use rayon::prelude::*;
use sightline_scene::{Scene, SceneError};

use crate::blockers::Blockers;
use crate::descend::{Rays, Scratch};
use crate::fragments::{Falloff, Fragment, first};
use crate::inside::Inside;
use crate::items::{Items, Reach};
use crate::lights::{Light, factors};
use crate::openness::{Openness, Seen, open};
use crate::partition::{Partition, Tells};
use crate::receivers::{Receiver, Source, blocks};

/// Most receivers of a block.
const BLOCK: usize = 64;
/// Largest extent of a block, by the distance.
const EXTENT: f64 = 0.5;
/// Boxes that take more of the sphere, in steradians, are opened before the first query.
const OPEN_FAR: f64 = 0.01;
/// Items that the classes of a block may have been told, by its receivers, before what is left of the block
/// is divided: where much is near that is small beside the block, its points see too little alike.
const TOLD: usize = 20_000;
/// Into how many.
const DIVISION: usize = 4;
/// Most bytes of a partition and its items. One that takes more is begun anew.
const BYTES: usize = 48 << 20;

/// What is asked.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Distance beyond which nothing hides, in units of the scene; may be infinite.
    pub distance: f64,
    /// How things darken. The distance must be finite for one with the distance.
    pub falloff: Falloff,
    /// Whether fragments are wanted.
    pub fragments: bool,
    /// Lights whose form factors are wanted. All of the scene may hide them, whatever the distance.
    pub lights: Vec<Light>,
    /// Most receivers of a block, and its largest extent by the distance. They change times, and answers
    /// within their bounds.
    pub block: (usize, f64),
}

impl Settings {
    /// Openness alone.
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

/// What is known of a receiver.
#[derive(Clone, Debug, Default)]
pub struct Answer {
    /// Its openness.
    pub openness: Openness,
    /// Whether it is inside of a closed solid.
    pub inside: bool,
    /// The form factors of the lights.
    pub lights: Vec<f64>,
    /// What is seen first, by triangles, if that was asked for.
    pub fragments: Vec<Fragment>,
}

/// A scene, prepared.
pub struct Prepared {
    /// Joined polygons, for openness and lights.
    joined: Blockers,
    /// Triangles by themselves, for fragments.
    single: Option<Blockers>,
    inside: Inside,
}

impl Prepared {
    /// Prepares a scene, on all of rayon's threads; for fragments as well if they are wanted.
    ///
    /// # Errors
    /// When the scene has more corners than can be numbered, or an alpha texture is repeated too often.
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

    /// Whether a receiver, a hair above its surface, is inside of a closed solid.
    pub fn is_inside(&self, receiver: &Receiver) -> bool {
        self.inside.holds(receiver)
    }
}

/// Answers questions about a scene.
pub struct Solver<'a> {
    prepared: &'a Prepared,
    settings: Settings,
}

/// What blocks can use again.
#[derive(Default)]
pub struct Memory {
    scratch: Scratch,
    seen: Seen,
    cuts: Vec<f64>,
}

impl<'a> Solver<'a> {
    /// Answers with these settings. Fragments are told only of a scene that is prepared for them.
    pub fn new(prepared: &'a Prepared, settings: Settings) -> Self {
        let fragments = settings.fragments && prepared.single.is_some();
        Self {
            prepared,
            settings: Settings {
                fragments,
                ..settings
            },
        }
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The blocks of some receivers: lists of their numbers.
    pub fn blocks(&self, receivers: &[Receiver]) -> Vec<Vec<u32>> {
        let (most, extent) = self.settings.block;
        let size = self.settings.distance * extent;
        blocks(receivers, |t| self.prepared.joined.of(t), most, size)
    }

    /// Answers for all receivers, in their order, on all of rayon's threads. `done` is told of how many more
    /// there are answers.
    pub fn solve(&self, receivers: &[Receiver], done: impl Fn(usize) + Sync) -> Vec<Answer> {
        let blocks = self.blocks(receivers);
        let answers: Vec<Vec<Answer>> = blocks
            .par_iter()
            // Some take much longer than others.
            .with_max_len(1)
            .map_init(Memory::default, |memory, block| {
                let receivers: Vec<Receiver> =
                    block.iter().map(|i| receivers[*i as usize]).collect();
                let answers = self.block(&receivers, memory);
                done(receivers.len());
                answers
            })
            .collect();
        let mut all = vec![Answer::default(); receivers.len()];
        for (i, answer) in blocks
            .into_iter()
            .flatten()
            .zip(answers.into_iter().flatten())
        {
            all[i as usize] = answer;
        }
        all
    }

    /// Answers for the receivers of one block, in their order. Those on different surfaces share nothing.
    pub fn block(&self, receivers: &[Receiver], memory: &mut Memory) -> Vec<Answer> {
        let mut answers = Vec::new();
        let surface = |r: &Receiver| r.triangle.and_then(|t| self.prepared.joined.of(t));
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

    /// Adds answers for the first receivers of a part of a block: for all, unless they see too little alike.
    fn part(&self, receivers: &[Receiver], memory: &mut Memory, all: &mut Vec<Answer>) {
        let Settings {
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
        let source = Source::around(receivers);
        let own = receivers
            .first()
            .and_then(|r| r.triangle)
            .and_then(|t| joined.of(t));
        let mut items = Items::new(blockers, &source, Reach::Distance(distance), own);
        let root = items.begin(OPEN_FAR);
        let mut tree = Partition::new(if union { Tells::Union } else { Tells::First }, root);
        let Memory {
            scratch,
            seen,
            cuts,
        } = memory;
        seen.clear();
        let mut answers: Vec<Answer> = Vec::new();
        // One receiver sees alike, whatever it takes.
        let most_told = if receivers.len() > 1 {
            TOLD * receivers.len()
        } else {
            usize::MAX
        };
        for r in receivers {
            let mut rays = Rays {
                tree: &mut tree,
                items: &mut items,
                source: &source,
                bytes: BYTES,
                most_told,
            };
            let answer = if union {
                open(&mut rays, r, scratch, (seen, cuts)).map(|openness| (openness, Vec::new()))
            } else {
                first(
                    &mut rays,
                    r,
                    (distance, falloff, fragments),
                    scratch,
                    (seen, cuts),
                )
            };
            let Some((openness, mut found)) = answer else {
                break;
            };
            found
                .iter_mut()
                .for_each(|f| f.polygon = blockers.triangle(f.polygon));
            let inside = self.prepared.is_inside(r);
            answers.push(Answer {
                openness,
                inside,
                lights: Vec::new(),
                fragments: found,
            });
        }
        let receivers = &receivers[..answers.len()];
        for light in &self.settings.lights {
            let found = factors(joined, receivers, light, (OPEN_FAR, BYTES), scratch);
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

    /// Small triangles all around, which few points share.
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
    fn items_count_as_memory_and_are_forgotten_between_queries() {
        let blockers = Blockers::new(&cloud(3000), None).unwrap();
        // They look all around, so that each opens other boxes.
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
        let source = Source::around(&receivers);
        for tells in [Tells::Union, Tells::First] {
            let solve = |bytes: usize| {
                let mut items = Items::new(&blockers, &source, Reach::Distance(8.0), None);
                let root = items.begin(OPEN_FAR);
                let begun = items.bytes();
                let mut tree = Partition::new(tells, root);
                let Memory {
                    mut scratch,
                    mut seen,
                    mut cuts,
                } = Memory::default();
                let (mut most, mut shrunk, mut answers) = (0, 0, Vec::new());
                for r in &receivers {
                    let before = items.bytes();
                    let (tree, source, items) = (&mut tree, &source, &mut items);
                    let mut rays = Rays {
                        tree,
                        items,
                        source,
                        bytes,
                        most_told: usize::MAX,
                    };
                    let room = (&mut seen, &mut cuts);
                    answers.push(match tells {
                        Tells::Union => open(&mut rays, r, &mut scratch, room).unwrap(),
                        Tells::First => {
                            first(&mut rays, r, (8.0, Falloff::None, true), &mut scratch, room)
                                .unwrap()
                                .0
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
                // Which of two occluders ends a class, one behind the other, is the tree's choice.
                assert!((a.open - b.open).abs() <= a.bound + b.bound, "{a:?} {b:?}");
                assert!((0.01..0.99).contains(&a.open), "{a:?}");
            }
        }
    }
}
