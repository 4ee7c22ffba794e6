//! A specification as a message of the gRPC interface, and back.

use std::sync::Arc;

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_proto::v1;
use sightline_viewcells::{Division, KdTree, USUAL_BLOCK_CELLS, Viewpoints};

use crate::ambient::Ambient;
use crate::choice::{BackendChoice, Choice, Method, Sampler, Up};
use crate::params::SamplingParams;
use crate::spec::{JobSpec, SpecError, marked_cells};

impl JobSpec {
    /// Reads and checks a specification. `bounds` is the view box of a message that has none: the scene's
    /// bounds in world space.
    ///
    /// # Errors
    /// [`SpecError`] naming the first field that is refused.
    pub fn from_proto(m: &v1::JobSpec, bounds: Option<Aabb>) -> Result<Self, SpecError> {
        let scene = m.scene.as_slice().try_into();
        let scene = scene.map_err(|_| SpecError::Field("scene", "give the 32 bytes of its digest"))?;
        let division = match m.division {
            Some(v1::job_spec::Division::Grid(g)) => Division::Grid([g.x, g.y, g.z]),
            Some(v1::job_spec::Division::Adaptive(a)) => {
                Division::Adaptive { budget: a.triangle_budget, max_depth: a.max_depth }
            }
            Some(v1::job_spec::Division::Tree(ref tree)) => {
                Division::Tree(Arc::new(KdTree::new(&tree.axes, &tree.planes)?))
            }
            None => return Err(SpecError::Field("division", "give a grid, an adaptive division or a tree")),
        };
        let view_box = match (m.view_box.as_slice(), bounds) {
            ([x0, y0, z0, x1, y1, z1], _) => Aabb::new(Vec3::new(*x0, *y0, *z0), Vec3::new(*x1, *y1, *z1)),
            ([], Some(bounds)) => bounds,
            _ => return Err(SpecError::Field("view box", "give x0,y0,z0,x1,y1,z1")),
        };
        let sampling = m.sampling.as_ref();
        let sampling = sampling.ok_or(SpecError::Field("sampling", "give the sampling parameters"))?;
        let sampling = SamplingParams::from_proto(sampling)?;
        // Cubes and trees have no blocks. A number that they do not use makes no other job.
        let has_blocks = sampling.sampler != Sampler::Cubes && matches!(division, Division::Grid(_));
        let viewpoints = match (m.viewpoints.as_slice(), marked_cells(&division)) {
            ([], _) => None,
            (bytes, Some(cells)) => {
                // The number of cells is checked before memory is taken for them.
                division.lattice(view_box.min, view_box.max)?;
                Some(Arc::new(Viewpoints::decode(bytes, cells)?))
            }
            (_, None) => {
                return Err(SpecError::Field("viewpoints", "the cells of an adaptive tree cannot have them"));
            }
        };
        let up = match m.up() {
            v1::Up::Unspecified if m.up == 0 => None,
            _ => Some(Up::from_wire(m.up)?),
        };
        let spec = Self {
            scene,
            division,
            view_box,
            sampling,
            backend: BackendChoice::from_wire(m.backend)?,
            seed: m.seed,
            time_budget_ms: m.time_budget_ms,
            block_cells: if has_blocks && m.block_cells > 0 { m.block_cells } else { USUAL_BLOCK_CELLS },
            method: Method::from_wire(m.method)?,
            certificates: m.certificates,
            viewpoints,
            up,
            ambient: m.ambient.as_ref().map(Ambient::from_proto).transpose()?,
        };
        spec.check()?;
        Ok(spec)
    }

    /// The specification as a message, with every field set.
    pub fn to_proto(&self) -> v1::JobSpec {
        let [min, max] = self.view_box.corners().map(|c| c.to_array());
        v1::JobSpec {
            scene: self.scene.to_vec(),
            division: Some(match &self.division {
                &Division::Grid([x, y, z]) => v1::job_spec::Division::Grid(v1::Grid { x, y, z }),
                &Division::Adaptive { budget, max_depth } => {
                    v1::job_spec::Division::Adaptive(v1::Adaptive { triangle_budget: budget, max_depth })
                }
                Division::Tree(tree) => {
                    let (axes, planes) = tree.parts();
                    v1::job_spec::Division::Tree(v1::Tree { axes, planes })
                }
            }),
            view_box: min.into_iter().chain(max).collect(),
            sampling: Some(self.sampling.to_proto()),
            backend: self.backend.to_wire(),
            seed: self.seed,
            time_budget_ms: self.time_budget_ms,
            block_cells: self.block_cells,
            method: self.method.to_wire(),
            certificates: self.certificates,
            viewpoints: self.viewpoints.as_ref().map_or_else(Vec::new, |marks| marks.encode()),
            up: self.up.map_or(0, Choice::to_wire),
            ambient: self.ambient.map(Ambient::to_proto),
        }
    }
}
