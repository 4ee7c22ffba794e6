//! A specification as a message of the gRPC interface, and back.
//!
//! Every number, flag and choice of the message is optional. An absent one has its default when the message
//! is read. A message that this module writes has every field, so that a default makes one key, written or
//! absent.

use std::sync::Arc;

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_proto::v1;
use sightline_viewcells::{Division, KdTree, MOST_BLOCK_CELLS, USUAL_BLOCK_CELLS, Viewpoints};

use crate::ambient::Ambient;
use crate::choice::{BackendChoice, Choice, Method, Sampler, Up};
use crate::params::SamplingParams;
use crate::spec::{JobSpec, SpecError, default_block_cells, marked_cells};

/// Cells along each axis where a message has no division.
pub const USUAL_GRID: [u32; 3] = [8; 3];

/// Depth of an adaptive tree where a message has none.
const USUAL_DEPTH: u32 = 12;

/// The facts about a scene on which the defaults of a job depend.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneFacts {
    /// The number of its triangles.
    pub triangles: u32,
    /// The scene's bounds in world space, which are the view box of a message that has none.
    pub bounds: Option<Aabb>,
}

impl JobSpec {
    /// Reads and checks a specification. Fields that are absent have their defaults, for a scene with these
    /// facts. Messages of [`Self::to_proto`] have every field and need no facts.
    ///
    /// # Errors
    /// [`SpecError`] naming the first field that is rejected.
    pub fn from_proto(m: &v1::JobSpec, scene: Option<SceneFacts>) -> Result<Self, SpecError> {
        let facts = scene.unwrap_or_default();
        let digest = m.scene.as_slice().try_into();
        let digest =
            digest.map_err(|_| SpecError::Field("scene", "give the 32 bytes of its digest"))?;
        let ambient = m.ambient.as_ref().map(Ambient::from_proto).transpose()?;
        // The fields about cells have fixed values in a job of ambient occlusion.
        let ambient_job = ambient.map(|ambient| Self::of_receivers(digest, ambient));
        let division = match &m.division {
            Some(v1::job_spec::Division::Grid(g)) => {
                let [x, y, z] = USUAL_GRID;
                Division::Grid([g.x.unwrap_or(x), g.y.unwrap_or(y), g.z.unwrap_or(z)])
            }
            Some(v1::job_spec::Division::Adaptive(a)) => Division::Adaptive {
                budget: a.triangle_budget.ok_or(SpecError::Field(
                    "triangle-budget",
                    "an adaptive division has no default; give at least 1",
                ))?,
                max_depth: a.max_depth.unwrap_or(USUAL_DEPTH),
            },
            Some(v1::job_spec::Division::Tree(tree)) => {
                Division::Tree(Arc::new(KdTree::new(&tree.axes, &tree.planes)?))
            }
            None => ambient_job
                .as_ref()
                .map_or(Division::Grid(USUAL_GRID), |job| job.division.clone()),
        };
        let bounds = ambient_job
            .as_ref()
            .map(|job| job.view_box)
            .or(facts.bounds);
        let view_box = match (m.view_box.as_slice(), bounds) {
            ([x0, y0, z0, x1, y1, z1], _) => {
                Aabb::new(Vec3::new(*x0, *y0, *z0), Vec3::new(*x1, *y1, *z1))
            }
            ([], Some(bounds)) => bounds,
            _ => return Err(SpecError::Field("view box", "give x0,y0,z0,x1,y1,z1")),
        };
        let sampling = SamplingParams::from_proto(&m.sampling.unwrap_or_default())?;
        let method = m.method.map_or(Ok(Method::default()), Method::from_wire)?;
        // Cubes and trees have no blocks. A number that they do not use makes no other job.
        let has_blocks =
            sampling.sampler != Sampler::Cubes && matches!(division, Division::Grid(_));
        let block_cells = match m.block_cells {
            Some(cells) if has_blocks || !(1..=MOST_BLOCK_CELLS).contains(&cells) => cells,
            None if has_blocks && ambient.is_none() => {
                default_block_cells(facts.triangles, &sampling, method)
            }
            _ => USUAL_BLOCK_CELLS,
        };
        let viewpoints = match (m.viewpoints.as_slice(), marked_cells(&division)) {
            ([], _) => None,
            (bytes, Some(cells)) => {
                // The number of cells is checked before memory is allocated for them.
                division.lattice(view_box.min, view_box.max)?;
                Some(Arc::new(Viewpoints::decode(bytes, cells)?))
            }
            (_, None) => {
                return Err(SpecError::Field(
                    "viewpoints",
                    "the cells of an adaptive tree cannot have them",
                ));
            }
        };
        let up = match m.up {
            None => None,
            Some(up) if up == v1::Up::Unspecified as i32 => None,
            Some(up) => Some(Up::from_wire(up)?),
        };
        let needs_none = method == Method::Portals || ambient.is_some();
        let backend = if needs_none {
            BackendChoice::None
        } else {
            BackendChoice::default()
        };
        let spec = Self {
            scene: digest,
            division,
            view_box,
            sampling,
            backend: m.backend.map_or(Ok(backend), BackendChoice::from_wire)?,
            seed: m.seed(),
            time_budget_ms: match m.time_budget_ms {
                Some(0) => {
                    return Err(SpecError::Field(
                        "time-budget",
                        "it is 0; give at least 1 ms, or leave it out for no limit",
                    ));
                }
                budget => budget.unwrap_or(0),
            },
            block_cells,
            method,
            certificates: m.certificates(),
            viewpoints,
            up,
            ambient,
        };
        spec.check()?;
        Ok(spec)
    }

    /// Returns the specification as a message. Every field is set, except where absence has a meaning: no
    /// time budget, viewpoints everywhere, an unknown axis.
    pub fn to_proto(&self) -> v1::JobSpec {
        let [min, max] = self.view_box.corners().map(|c| c.to_array());
        v1::JobSpec {
            scene: self.scene.to_vec(),
            division: Some(match &self.division {
                Division::Grid(cells) => {
                    let [x, y, z] = cells.map(Some);
                    v1::job_spec::Division::Grid(v1::Grid { x, y, z })
                }
                &Division::Adaptive { budget, max_depth } => {
                    let (triangle_budget, max_depth) = (Some(budget), Some(max_depth));
                    v1::job_spec::Division::Adaptive(v1::Adaptive {
                        triangle_budget,
                        max_depth,
                    })
                }
                Division::Tree(tree) => {
                    let (axes, planes) = tree.parts();
                    v1::job_spec::Division::Tree(v1::Tree { axes, planes })
                }
            }),
            view_box: min.into_iter().chain(max).collect(),
            sampling: Some(self.sampling.to_proto()),
            backend: Some(self.backend.to_wire()),
            seed: Some(self.seed),
            time_budget_ms: Some(self.time_budget_ms).filter(|budget| *budget > 0),
            block_cells: Some(self.block_cells),
            method: Some(self.method.to_wire()),
            certificates: Some(self.certificates),
            viewpoints: self
                .viewpoints
                .as_ref()
                .map_or_else(Vec::new, |marks| marks.encode()),
            up: self.up.map(Choice::to_wire),
            ambient: self.ambient.map(Ambient::to_proto),
        }
    }
}
