//! The specification of a job: what is baked and how, with its key and its plan.

use std::sync::Arc;

use prost::Message as _;
use sightline_numbers::Aabb;
use sightline_viewcells::{CellBox, Division, DivisionError, Lattice, Layout, Plan, TreeError};
use sightline_viewcells::{MOST_BLOCK_CELLS, USUAL_BLOCK_CELLS};
use sightline_viewcells::{Viewpoints, ViewpointsError, viewpoints};

use crate::ambient::Ambient;
use crate::choice::{BackendChoice, CellToCell, Granularity, Method, Sampler, UnknownChoice, Up};
use crate::pairs::MOST_PAIR_CELLS;
use crate::params::{BOUND_AIM, ParamsError, SamplingParams};

/// The version of everything that decides bytes. It changes whenever the same specification would give other
/// bytes, of a result or of a tile's output, so that a stored result is never taken for one of another
/// version. The choices that it stands for are in `crates/bake/src/choices.rs`.
pub const ALGORITHM_VERSION: u32 = 28;

/// Longest time budget, in milliseconds: ten years.
const MAX_BUDGET_MS: u64 = 10 * 366 * 24 * 3600 * 1000;

/// Most blocks of a job, about: the scheduler goes through all of them.
const MOST_BLOCKS: u64 = 1 << 16;

/// Deepest adaptive tree that sight lines sample; visibility cubes make deeper ones.
pub const MOST_LINE_DEPTH: u32 = 12;

/// Work, in triangles divided by the target error, above which a tile has fewer cells, with the number of
/// cells. A guess at the work from which a lost worker, a pause and a second machine matter more than the
/// lines that are shared.
const HEAVY: [(f64, u32); 2] = [(5e10, 64), (5e9, 128)];

/// Cells of a tile that are decided exactly. Each takes seconds on real scenes; the time that sampling saves
/// in large blocks is nothing beside that.
const EXACT_BLOCK: u32 = 8;

/// Cells of a tile that are seen through portals, about a tenth of a second each.
const PORTAL_BLOCK: u32 = 64;

/// A checked specification.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSpec {
    /// BLAKE3 digest of the scene.
    pub scene: [u8; 32],
    /// How the view box is divided into cells.
    pub division: Division,
    /// Least and greatest corner of the view box, in world space.
    pub view_box: Aabb,
    /// Sampling parameters.
    pub sampling: SamplingParams,
    /// The backend.
    pub backend: BackendChoice,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Sampling stops this many milliseconds after submission; 0 for no limit.
    pub time_budget_ms: u64,
    /// Most grid cells of a tile of the samplers that share lines within a tile, 1 to [`MOST_BLOCK_CELLS`].
    pub block_cells: u32,
    /// How much is decided, and by which means.
    pub method: Method,
    /// Whether witnesses and certificates are kept.
    pub certificates: bool,
    /// Where in the cells of a grid or the boxes of a tree viewpoints can be; `None` for everywhere.
    pub viewpoints: Option<Arc<Viewpoints>>,
    /// The axis that points up, if it is known. It changes no set.
    pub up: Option<Up>,
    /// The receivers of a job of ambient occlusion, which has no sets; `None` for all others.
    pub ambient: Option<Ambient>,
}

/// Most cells of a job that says which cells see which without being asked: those of a usual tile. With
/// several tiles, each walks its lines through the whole division once more.
const FEW_PAIR_CELLS: u64 = USUAL_BLOCK_CELLS as u64;

/// Most cells of a tile when the user gives no number.
pub fn default_block_cells(triangles: u32, sampling: &SamplingParams, method: Method) -> u32 {
    match method {
        Method::Aggressive => {}
        Method::Exact | Method::Verified => return EXACT_BLOCK,
        Method::Portals => return PORTAL_BLOCK,
    }
    let work = match sampling.sampler {
        Sampler::Lines => {
            // The sampler aims at a bound from well below it.
            let aim = sampling.max_error.map_or(1.0, |most| most * BOUND_AIM);
            f64::from(triangles) / aim.min(sampling.target_error)
        }
        Sampler::Guided | Sampler::Cubes => 0.0,
    };
    HEAVY
        .iter()
        .find(|(least, _)| work >= *least)
        .map_or(USUAL_BLOCK_CELLS, |(_, cells)| *cells)
}

/// The grid whose cells marks of viewpoints are for: the boxes of a tree are one row. `None` for an adaptive
/// tree, whose cells are not known.
pub fn marked_cells(division: &Division) -> Option<[u32; 3]> {
    match division {
        Division::Grid(cells) => Some(*cells),
        Division::Tree(tree) => Some([tree.boxes() as u32, 1, 1]),
        Division::Adaptive { .. } => None,
    }
}

/// Why a specification is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// A field is missing, has the wrong length, or does not go with the others.
    #[error("the job's {0} cannot be used: {1}")]
    Field(&'static str, &'static str),
    /// A choice has a value that this program does not know.
    #[error(transparent)]
    Choice(#[from] UnknownChoice),
    /// The division of the view box.
    #[error(transparent)]
    Division(#[from] DivisionError),
    /// The boxes of a tree.
    #[error(transparent)]
    Tree(#[from] TreeError),
    /// A sampling parameter.
    #[error(transparent)]
    Params(#[from] ParamsError),
    /// The viewpoints.
    #[error(transparent)]
    Viewpoints(#[from] ViewpointsError),
}

impl JobSpec {
    /// A specification with the defaults of everything but the scene, the division and the view box.
    pub fn new(scene: [u8; 32], division: Division, view_box: Aabb) -> Self {
        Self {
            scene,
            division,
            view_box,
            sampling: SamplingParams::default(),
            backend: BackendChoice::Auto,
            seed: 0,
            time_budget_ms: 0,
            block_cells: USUAL_BLOCK_CELLS,
            method: Method::Aggressive,
            certificates: false,
            viewpoints: None,
            up: None,
            ambient: None,
        }
    }

    /// Checks the parameters' ranges and whether they go together.
    ///
    /// # Errors
    /// [`SpecError`] naming the first field that is refused.
    pub fn check(&self) -> Result<(), SpecError> {
        let refuse = |field, remedy| Err(SpecError::Field(field, remedy));
        if let Some(ambient) = self.ambient {
            return self.check_ambient(ambient);
        }
        let sampler = self.sampling.sampler;
        self.sampling.check()?;
        if !(1..=MOST_BLOCK_CELLS).contains(&self.block_cells) {
            return refuse("block-cells", "give 1 to 4096 cells");
        }
        if let Division::Adaptive { max_depth, .. } = self.division {
            if sampler == Sampler::Guided {
                return refuse(
                    "sampler",
                    "an adaptive division is sampled with lines or cubes",
                );
            }
            if sampler == Sampler::Lines && max_depth > MOST_LINE_DEPTH {
                return refuse("max-depth", "trees deeper than 12 are sampled with cubes");
            }
            if self.sampling.max_error.is_some() {
                return refuse(
                    "max-error",
                    "only the cells of a grid are refined to a bound",
                );
            }
        }
        if let Division::Tree(_) = self.division {
            self.check_boxes()?;
        }
        if self.sampling.max_error.is_some() && sampler != Sampler::Lines {
            return refuse("max-error", "only the sampler lines refines to a bound");
        }
        if self.certificates && self.method == Method::Aggressive {
            return refuse(
                "certificates",
                "sampling alone has none; give the method exact or verified",
            );
        }
        if self.time_budget_ms > MAX_BUDGET_MS {
            return refuse("time-budget", "give at most ten years");
        }
        if self.time_budget_ms > 0 && sampler == Sampler::Cubes {
            return refuse("time-budget", "the sampler cubes cannot stop early");
        }
        if self.sampling.min_share.is_some() && sampler != Sampler::Lines {
            return refuse(
                "min-share",
                "only the sampler lines searches until items of a share are found",
            );
        }
        if self.sampling.min_share.is_some() && self.sampling.max_error.is_some() {
            return refuse(
                "min-share",
                "give either a least share of items or max-error",
            );
        }
        if self.sampling.far.is_some() && self.certificates {
            return refuse(
                "far",
                "certificates prove that triangles are hidden, not that they are far",
            );
        }
        if self.sampling.granularity != Granularity::Triangles && self.method != Method::Aggressive
        {
            return refuse(
                "granularity",
                "exact methods decide triangles; `dump --items objects` lists the objects of their sets",
            );
        }
        if (self.method == Method::Portals) != (self.backend == BackendChoice::None) {
            return refuse(
                "backend",
                "give none with the method portals, and with no other method",
            );
        }
        if self.method == Method::Portals {
            self.check_portals()?;
        }
        let region = self.viewpoints.as_ref().and_then(|marks| marks.region());
        if region.is_some() && self.certificates {
            return refuse(
                "viewpoints",
                "certificates are about whole cells; leave out the region or them",
            );
        }
        if region.is_some() && sampler == Sampler::Cubes {
            return refuse(
                "viewpoints",
                "visibility cubes know no region; leave it out, or sample lines",
            );
        }
        self.lattice()?;
        if let Some(marks) = &self.viewpoints {
            if marked_cells(&self.division) != Some(marks.cells()) {
                return refuse(
                    "viewpoints",
                    "give them for the cells of the job's grid, or its boxes",
                );
            }
            if marks.encode().len() > viewpoints::MOST_BYTES {
                return refuse(
                    "viewpoints",
                    "they are too finely divided; use fewer or larger cells, or leave out the region",
                );
            }
        }
        if self.sampling.cell_to_cell == CellToCell::On && self.pair_grid_cells() > MOST_PAIR_CELLS
        {
            return refuse(
                "cell-to-cell",
                "at most 32768 cells can have it; give fewer cells, or off",
            );
        }
        // The lattice exists, so the product does not overflow.
        if let Division::Grid(cells) = self.division
            && cells.map(u64::from).iter().product::<u64>() / u64::from(self.block_cells)
                > MOST_BLOCKS
        {
            return refuse(
                "block-cells",
                "so few cells a tile make too many tiles; give more cells a tile",
            );
        }
        Ok(())
    }

    /// What the boxes of a tree cannot have.
    fn check_boxes(&self) -> Result<(), SpecError> {
        let refuse = |field, remedy| Err(SpecError::Field(field, remedy));
        if self.sampling.sampler == Sampler::Cubes {
            return refuse(
                "sampler",
                "visibility cubes are shared by the cells of a grid; sample lines",
            );
        }
        if self.certificates {
            return refuse(
                "certificates",
                "they are about closed cells, and boxes along walls are open",
            );
        }
        if self.sampling.cell_to_cell == CellToCell::On {
            return refuse(
                "cell-to-cell",
                "only cells of equal size say which see which; give a grid",
            );
        }
        Ok(())
    }

    /// What the method portals cannot do.
    fn check_portals(&self) -> Result<(), SpecError> {
        let refuse = |field, remedy| Err(SpecError::Field(field, remedy));
        if matches!(self.division, Division::Adaptive { .. }) {
            return refuse(
                "division",
                "give a grid or boxes with the method portals; an adaptive tree follows samples",
            );
        }
        if self.certificates {
            return refuse(
                "certificates",
                "what portals hide has none; give the method exact or verified",
            );
        }
        if self.sampling.sampler != Sampler::Lines
            || self.sampling.max_error.is_some()
            || self.sampling.min_share.is_some()
        {
            return refuse(
                "sampler",
                "the method portals samples nothing; leave out what is about samples",
            );
        }
        if self.sampling.contributions {
            return refuse(
                "contributions",
                "they are sampled, and the method portals samples nothing",
            );
        }
        if self.sampling.cell_to_cell == CellToCell::On {
            return refuse(
                "cell-to-cell",
                "the method portals does not say which cells see which",
            );
        }
        Ok(())
    }

    /// Whether the result has the scene divided along its walls, for look-ups from a point: with the method
    /// portals, and of exact methods where walls enclose the viewpoints. The first tile has it.
    pub fn has_portals(&self) -> bool {
        match self.method {
            Method::Portals => true,
            Method::Exact | Method::Verified => self
                .viewpoints
                .as_ref()
                .is_some_and(|marks| marks.region().is_some()),
            Method::Aggressive => false,
        }
    }

    /// The job's key: the digest of everything that its result depends on except the numerics profile, which
    /// is bound when the job first runs and is then part of the result.
    pub fn key(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_derive_key("sightline 2026 job key");
        hasher.update(&ALGORITHM_VERSION.to_le_bytes());
        // Prost writes fields in the order of their numbers, so equal specifications give equal bytes.
        hasher.update(&self.to_proto().encode_to_vec());
        *hasher.finalize().as_bytes()
    }

    /// The cells over which a tile says which see which: the regular grid over the view box with this many
    /// cells along each axis, or `None` when the job does not ask. An adaptive tree has a grid of the cells
    /// of its deepest level, at most [`MOST_LINE_DEPTH`]; each of its cells holds whole cells of this grid,
    /// or, with deeper trees, several are in one.
    pub fn pair_cells(&self) -> Option<[u32; 3]> {
        let asked = match self.sampling.cell_to_cell {
            _ if self.method == Method::Portals || matches!(self.division, Division::Tree(_)) => {
                false
            }
            CellToCell::Auto => self.pair_grid_cells() <= FEW_PAIR_CELLS,
            CellToCell::On => true,
            CellToCell::Off => false,
        };
        asked.then(|| self.pair_grid())
    }

    /// Number of cells of [`Self::pair_grid`].
    fn pair_grid_cells(&self) -> u64 {
        // At most 2²² by the division's check, which comes before.
        self.pair_grid().into_iter().map(u64::from).product()
    }

    fn pair_grid(&self) -> [u32; 3] {
        match self.division {
            Division::Grid(cells) => cells,
            // It is never asked for.
            Division::Tree(_) => [1; 3],
            Division::Adaptive { max_depth, .. } => {
                // An adaptive tree halves the longest side.
                let Aabb { min, max } = self.view_box;
                let size = [0, 1, 2].map(|a| f64::from(max[a]) - f64::from(min[a]));
                let mut cells = [1u32; 3];
                for _ in 0..max_depth.min(MOST_LINE_DEPTH) {
                    let side = |a: usize| size[a] / f64::from(cells[a]);
                    let axis = (1..3).fold(
                        0,
                        |longest, a| if side(a) > side(longest) { a } else { longest },
                    );
                    cells[axis] *= 2;
                }
                cells
            }
        }
    }

    /// The marked parts of a cell that is known before the bake: a bit for each part where viewpoints are.
    pub fn marks(&self, lattice: &Lattice, cell: &CellBox) -> u64 {
        let Some(marks) = &self.viewpoints else {
            return u64::MAX;
        };
        self.division
            .number(lattice, cell)
            .map_or(u64::MAX, |number| marks.of(number))
    }

    /// The lattice of sample positions.
    ///
    /// # Errors
    /// [`DivisionError`]; never after [`JobSpec::from_proto`], which has checked it.
    pub fn lattice(&self) -> Result<Lattice, DivisionError> {
        self.division.lattice(self.view_box.min, self.view_box.max)
    }

    /// The fraction of the thinnest view cell by which rounding to single precision can move a sight line; 0
    /// for jobs whose sets do not depend on it, because exact queries find the triangles that sampling
    /// misses.
    ///
    /// The coordinator checks it for new jobs only: a stored job of an earlier version keeps its result.
    ///
    /// # Errors
    /// [`DivisionError`] when the cells are thinner than rounding.
    pub fn moved_by_rounding(&self) -> Result<f64, DivisionError> {
        let lattice = self.lattice()?;
        match (self.sampling.sampler, self.method) {
            (Sampler::Lines, Method::Aggressive) => self.division.moved_by_rounding(&lattice),
            _ => Ok(0.0),
        }
    }

    /// The lattice and the plan of tiles.
    ///
    /// # Errors
    /// As [`JobSpec::lattice`].
    pub fn plan(&self) -> Result<(Lattice, Plan), DivisionError> {
        let lattice = self.lattice()?;
        if let Some(ambient) = self.ambient {
            let plan = Plan::of_counts(self.division.root(&lattice), ambient.counts());
            return Ok((lattice, plan));
        }
        let layout = match self.sampling.sampler {
            Sampler::Cubes => Layout::Samples,
            Sampler::Lines | Sampler::Guided => Layout::Blocks(self.block_cells),
        };
        let plan = Plan::new(&self.division, &lattice, layout);
        Ok((lattice, plan))
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_proto::v1;

    use super::*;
    use crate::choice::{ErrorMeasure, SupersetChoice};

    fn spec() -> JobSpec {
        JobSpec {
            scene: [7; 32],
            division: Division::Grid([4, 3, 2]),
            view_box: Aabb::new(Vec3::ZERO, Vec3::ONE),
            sampling: SamplingParams::default(),
            backend: BackendChoice::Auto,
            seed: 3,
            time_budget_ms: 0,
            block_cells: 64,
            method: Method::Aggressive,
            certificates: false,
            viewpoints: None,
            up: None,
            ambient: None,
        }
    }

    #[test]
    fn a_specification_comes_back_from_its_message_and_every_field_is_in_the_key() {
        let s = spec();
        assert_eq!(JobSpec::from_proto(&s.to_proto(), None).unwrap(), s);
        let sampling = s.sampling.clone();
        let others = [
            JobSpec {
                scene: [8; 32],
                ..s.clone()
            },
            JobSpec {
                division: Division::Adaptive {
                    budget: 5,
                    max_depth: 6,
                },
                sampling: SamplingParams {
                    sampler: Sampler::Cubes,
                    ..sampling.clone()
                },
                block_cells: USUAL_BLOCK_CELLS,
                ..s.clone()
            },
            JobSpec {
                time_budget_ms: 5,
                ..s.clone()
            },
            JobSpec {
                viewpoints: Some({
                    let mut marks = Viewpoints::none([4, 3, 2]);
                    marks.mark([5, 6, 7]);
                    Arc::new(marks)
                }),
                ..s.clone()
            },
            JobSpec {
                up: Some(Up::Y),
                ..s.clone()
            },
            JobSpec {
                up: Some(Up::Z),
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    granularity: Granularity::Clusters,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    min_share: Some(0.5),
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    far: Some(9.0),
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    cell_to_cell: CellToCell::Off,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    contributions: true,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                block_cells: 65,
                ..s.clone()
            },
            JobSpec {
                method: Method::Exact,
                ..s.clone()
            },
            JobSpec {
                method: Method::Exact,
                certificates: true,
                ..s.clone()
            },
            JobSpec {
                method: Method::Verified,
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    sampler: Sampler::Guided,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    target_error: 0.01,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    max_error: Some(0.01),
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    rays: 5,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                view_box: Aabb::new(Vec3::ZERO, Vec3::new(1.0, 1.0, 2.0)),
                ..s.clone()
            },
            JobSpec {
                backend: BackendChoice::Gpu,
                ..s.clone()
            },
            JobSpec {
                seed: 4,
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    resolution: 64,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    measure: ErrorMeasure::Sets,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    error_threshold: 0.9,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    interior_threshold: 0.9,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    min_distance: 0.25,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    solids: false,
                    ..sampling.clone()
                },
                ..s.clone()
            },
            JobSpec {
                sampling: SamplingParams {
                    superset: SupersetChoice::On,
                    ..sampling
                },
                ..s.clone()
            },
        ];
        let mut keys: Vec<_> = others.iter().map(JobSpec::key).chain([s.key()]).collect();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), others.len() + 1);
        for o in &others {
            assert_eq!(&JobSpec::from_proto(&o.to_proto(), None).unwrap(), o);
        }
    }

    #[test]
    fn cells_thinner_than_rounding_are_refused_where_lines_decide() {
        // Two metres at five million: five steps of 32-bit coordinates.
        let far =
            |wide: f32| Aabb::new(Vec3::new(5e6, 0.0, 0.0), Vec3::new(5e6 + wide, wide, wide));
        let lines = |wide, division| JobSpec {
            view_box: far(wide),
            division,
            method: Method::Aggressive,
            certificates: false,
            sampling: SamplingParams::default(),
            ..spec()
        };
        let thin = lines(16.0, Division::Grid([8; 3]));
        assert!(
            thin.moved_by_rounding()
                .unwrap_err()
                .to_string()
                .contains("2.00e0 wide along x")
        );
        let by_cubes = SamplingParams {
            sampler: Sampler::Cubes,
            ..SamplingParams::default()
        };
        assert_eq!(
            JobSpec {
                sampling: by_cubes,
                ..thin.clone()
            }
            .moved_by_rounding(),
            Ok(0.0)
        );
        assert_eq!(
            JobSpec {
                method: Method::Exact,
                ..thin
            }
            .moved_by_rounding(),
            Ok(0.0)
        );
        let part = lines(160.0, Division::Grid([8; 3]))
            .moved_by_rounding()
            .unwrap();
        assert!((0.2..0.3).contains(&part), "{part}");
        // Halved along each axis, as such a tree is in any case.
        let tree = |wide| {
            lines(
                wide,
                Division::Adaptive {
                    budget: 5,
                    max_depth: 6,
                },
            )
            .moved_by_rounding()
        };
        assert!(tree(8.0).is_err() && tree(16.0).is_ok());
    }

    #[test]
    fn a_wrong_field_is_refused_by_name() {
        let good = spec().to_proto();
        let refuse = |m: v1::JobSpec| JobSpec::from_proto(&m, None).unwrap_err().to_string();
        assert!(
            refuse(v1::JobSpec {
                scene: vec![1],
                ..good.clone()
            })
            .contains("scene")
        );
        let no_budget = Some(v1::job_spec::Division::Adaptive(v1::Adaptive::default()));
        assert!(
            refuse(v1::JobSpec {
                division: no_budget,
                ..good.clone()
            })
            .contains("triangle-budget")
        );
        assert!(
            refuse(v1::JobSpec {
                view_box: vec![],
                ..good.clone()
            })
            .contains("view box")
        );
        assert!(
            refuse(v1::JobSpec {
                block_cells: Some(4097),
                ..good.clone()
            })
            .contains("block-cells")
        );
        assert!(
            refuse(v1::JobSpec {
                time_budget_ms: Some(0),
                ..good.clone()
            })
            .contains("time-budget")
        );
        assert!(
            refuse(v1::JobSpec {
                backend: Some(9),
                ..good.clone()
            })
            .contains("backend")
        );
        assert!(
            refuse(v1::JobSpec {
                method: Some(9),
                ..good.clone()
            })
            .contains("method")
        );
        assert!(
            refuse(v1::JobSpec {
                certificates: Some(true),
                ..good.clone()
            })
            .contains("certificates")
        );
        let adaptive = JobSpec {
            division: Division::Adaptive {
                budget: 5,
                max_depth: 12,
            },
            block_cells: USUAL_BLOCK_CELLS,
            ..spec()
        };
        let deep = JobSpec {
            division: Division::Adaptive {
                budget: 5,
                max_depth: 13,
            },
            ..adaptive.clone()
        };
        assert!(refuse(deep.to_proto()).contains("max-depth"));
        assert_eq!(
            JobSpec::from_proto(&adaptive.to_proto(), None).unwrap(),
            adaptive
        );
        let with = |sampler, max_error| {
            let sampling = SamplingParams {
                sampler,
                max_error,
                ..SamplingParams::default()
            };
            refuse(
                JobSpec {
                    sampling,
                    ..adaptive.clone()
                }
                .to_proto(),
            )
        };
        assert!(with(Sampler::Guided, None).contains("sampler"));
        assert!(with(Sampler::Lines, Some(0.01)).contains("max-error"));
        let nan = v1::Sampling {
            error_threshold: Some(f64::NAN),
            ..good.sampling.unwrap()
        };
        assert!(
            refuse(v1::JobSpec {
                sampling: Some(nan),
                ..good
            })
            .contains("error-threshold")
        );
    }
}
