//! The check that a proof shows that one list of polygons is hidden from another: traverses the steps.

use std::cmp::Ordering;

use glam::Vec3;

use super::cone::Cone;
use super::geometry::{Plane, Point, height, plane, sign};
use super::occluder::{Occluder, OccluderConstraints};
use super::polygon::{Side, check_polygons, divide, parts};
use super::start::start;
use super::vector::Vector;
use super::{Corners, Refusal};
use crate::proof::{Proof, QueryPolygon, Step};

/// Checks a proof that no line between the interiors of `a` and `b` is unobstructed.
///
/// `a` and `b` are lists of convex flat polygons in scene coordinates. A polygon that is flat only up to
/// rounding must be given as the triangles of a fan.
///
/// # Errors
/// [`Refusal`] for the first fault of the proof.
pub fn check_hidden(
    scene: &[[Vec3; 3]],
    a: &[Corners],
    b: &[Corners],
    proof: &Proof,
) -> Result<(), Refusal> {
    check_polygons(a)?;
    check_polygons(b)?;
    let mut occluders = Vec::with_capacity(proof.occluders.len());
    for triangles in &proof.occluders {
        occluders.push(Occluder::new(scene, triangles).ok_or(Refusal::Occluder(occluders.len()))?);
    }
    let mut check = Check {
        steps: &proof.steps,
        at: 0,
        occluders,
    };
    for x in a {
        for y in b {
            for (x, y) in parts(x, y) {
                check.pair(&x, &y)?;
            }
        }
    }
    if check.at < proof.steps.len() {
        Err(Refusal::Length("too many"))
    } else {
        Ok(())
    }
}

struct Check<'a> {
    steps: &'a [Step],
    at: usize,
    occluders: Vec<Occluder>,
}

impl<'a> Check<'a> {
    fn next(&mut self) -> Result<&'a Step, Refusal> {
        let step = self.steps.get(self.at).ok_or(Refusal::Length("too few"))?;
        self.at += 1;
        Ok(step)
    }

    fn pair(&mut self, a: &[Point], b: &[Point]) -> Result<(), Refusal> {
        // Divisions nest. Each division uses a step, so the stack is never longer than the proof.
        let mut open = vec![(a.to_vec(), b.to_vec())];
        while let Some((a, b)) = open.pop() {
            if let Some(Step::Divide {
                polygon: of,
                from,
                to,
            }) = self.steps.get(self.at)
            {
                let unknown = Refusal::Unknown {
                    step: self.at,
                    what: "a dividing line of a polygon",
                };
                self.at += 1;
                let whole = if *of == QueryPolygon::A { &a } else { &b };
                let [first, second] = divide(whole, *from, *to).ok_or(unknown)?;
                let with = |half| {
                    if *of == QueryPolygon::A {
                        (half, b.clone())
                    } else {
                        (a.clone(), half)
                    }
                };
                open.extend([with(second), with(first)]);
                continue;
            }
            let (pa, pb) = (plane([&a[0], &a[1], &a[2]]), plane([&b[0], &b[1], &b[2]]));
            let other = |p: &Plane, c: &[Point]| {
                c.iter()
                    .map(|x| sign(&height(p, x)))
                    .find(|s| *s != Ordering::Equal)
                    .unwrap_or(Ordering::Equal)
            };
            let (ahead, behind) = (other(&pa, &b), other(&pb, &a));
            let a = Side {
                corners: a,
                plane: pa,
                other: ahead,
            };
            let b = Side {
                corners: b,
                plane: pb,
                other: behind,
            };
            let mut known = OccluderConstraints::new();
            for cone in start(&a, &b) {
                self.region(&a, &b, &mut known, cone.ok_or(Refusal::Start)?)?;
            }
        }
        Ok(())
    }

    /// Checks the steps about one cone. `known` stores the constraints by the planes of A and B for each
    /// occluder.
    fn region(
        &mut self,
        a: &Side,
        b: &Side,
        known: &mut OccluderConstraints,
        cone: Cone,
    ) -> Result<(), Refusal> {
        let mut open = vec![Some(cone)];
        while let Some(cone) = open.pop() {
            let at = self.at;
            match self.next()? {
                Step::Unreal => {
                    if cone.is_some_and(|c| !c.unreal()) {
                        return Err(Refusal::False {
                            step: at,
                            what: "the region may contain real lines; the step claims the opposite",
                        });
                    }
                }
                Step::Block {
                    occluder,
                    negative,
                    cuts,
                } => {
                    let number = *occluder as usize;
                    let occluder = self.occluders.get(number).ok_or(Refusal::Unknown {
                        step: at,
                        what: "an occluder",
                    })?;
                    let planes = known.entry(number).or_insert_with(|| occluder.planes(a, b));
                    let planes = planes
                        .as_ref()
                        .map_err(|what| Refusal::False { step: at, what })?;
                    let constraints = || occluder.boundary.iter().chain(planes);
                    let inner = if *negative {
                        Ordering::Less
                    } else {
                        Ordering::Greater
                    };
                    let mut rest = cone;
                    let mut outside = Vec::with_capacity(cuts.len());
                    for cut in cuts {
                        let line = &constraints()
                            .find(|c| c.number == usize::from(*cut))
                            .ok_or(Refusal::Unknown {
                                step: at,
                                what: "a constraint",
                            })?
                            .line;
                        let (positive, beyond) = rest.map_or((None, None), |c| c.split(line));
                        let (inside, out) = if *negative {
                            (beyond, positive)
                        } else {
                            (positive, beyond)
                        };
                        outside.push(out);
                        rest = inside;
                    }
                    // The remaining region is inside the constraints that have cut it, so test only the other
                    // constraints.
                    let mut others = constraints()
                        .filter(|c| !cuts.iter().any(|cut| usize::from(*cut) == c.number));
                    if rest.is_some_and(|c| !others.all(|other| c.within(&other.line, inner))) {
                        return Err(Refusal::False {
                            step: at,
                            what: "the occluder does not block the whole remaining region",
                        });
                    }
                    open.extend(outside.into_iter().rev());
                }
                Step::Split { polar } => {
                    let polar = Vector::new((**polar).clone());
                    let (positive, negative) = cone.map_or((None, None), |c| c.split(&polar));
                    open.extend([positive, negative]);
                }
                Step::Divide { .. } => {
                    return Err(Refusal::False {
                        step: at,
                        what: "steps of a region must not divide a polygon",
                    });
                }
            }
        }
        Ok(())
    }
}
