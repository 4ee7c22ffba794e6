//! The check of a tile's output against the job's plan.

use sightline_model::codec::{self, CodecError};
use sightline_model::{CellSet, Granularity, SubtreeNode, TileOutput, Visibility};
use sightline_pvs::Portals;
use sightline_viewcells::{CellBox, Division, Tile, TileIndex, TileKind};

use crate::placeholder::expected_nodes;

/// Maximum length of a cell's data without its set, in bytes.
const LEAST_UNPACKED: u64 = 4096;

/// A difference between a tile's output and the job's plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OutputError {
    /// The bytes are not an encoded output.
    #[error(transparent)]
    Encoding(#[from] CodecError),
    /// The output unpacks to more bytes than the caller allowed.
    #[error("the output unpacks to more bytes than this check allows")]
    Large,
    /// The tree of the output's cells differs from the tile's tree.
    #[error("the cells of the output differ from the cells of the tile")]
    Cells,
    /// The output and the job mark different cells as cells without viewpoints.
    #[error(
        "the cells without viewpoints of the output differ from the cells without viewpoints of \
         the job"
    )]
    Viewpoints,
    /// The output's portals are unreadable, missing or unexpected. Only the first tile of a job with portals
    /// has portals.
    #[error("the output's portals are malformed, missing, or unexpected in this tile")]
    Portals,
    /// The output lacks contributions that the job requests, or has contributions that the job does not
    /// request.
    #[error(
        "the output lacks contributions that the job requests, or has contributions that the job \
         does not request"
    )]
    Contributions,
    /// A cell lacks the results of exact queries and the job's method is not aggressive, or the reverse.
    #[error(
        "a cell of the output lacks requested results of exact queries, or has unrequested results"
    )]
    Method,
    /// A cell has undecided items, and the job neither decides nor completes its sets.
    #[error("a cell of the output has undecided items, and the job does not complete its sets")]
    Completion,
    /// The output's pairs of cells are missing or unexpected, or are over other cells than the job's.
    #[error(
        "the output's pairs of cells are missing or unexpected, or are over other cells than the job's"
    )]
    Pairs,
    /// The output contains a pack of samples and the tile has cells, or the reverse.
    #[error(
        "the output contains samples and the tile has cells, or the output contains cells and the \
         tile has samples"
    )]
    Kind,
}

/// The numbers of triangles and objects of a scene.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneSize {
    /// The number of triangles.
    pub triangles: u32,
    /// The number of objects.
    pub objects: u32,
}

impl SceneSize {
    /// Returns an upper limit on the number of items that the sets of a job's tiles name. A scene has at most
    /// as many clusters as triangles; objects may be empty.
    pub(crate) fn items(self, task: &Visibility) -> u32 {
        match task.items() {
            Granularity::Triangles | Granularity::Clusters => self.triangles,
            Granularity::Objects => self.objects,
        }
    }

    /// Returns the maximum number of items that an output of a tile of this kind can name.
    fn items_of(self, task: &Visibility, kind: TileKind) -> u32 {
        match kind {
            TileKind::Leaf => self.items(task),
            TileKind::Face(_) | TileKind::Separator(_) => self.triangles,
        }
    }
}

/// Returns the maximum length of a tile's compressed output, in bytes. Compression adds few bytes to an
/// output that it cannot shorten.
pub fn most_packed(task: &Visibility, tile: &Tile, scene: SceneSize) -> u64 {
    packed(most_unpacked(task, tile, scene))
}

/// Returns the maximum compressed length of an output of `unpacked` bytes, in bytes.
fn packed(unpacked: u64) -> u64 {
    unpacked
        .saturating_add(unpacked / 64)
        .saturating_add(LEAST_UNPACKED)
        .min(codec::MAX_UNPACKED)
}

/// Returns the maximum length of a tile's unpacked output, in bytes. A set has at most all items, each with
/// two differences and a count of at most five bytes. Proofs and packs have no such bound.
fn most_unpacked(task: &Visibility, tile: &Tile, scene: SceneSize) -> u64 {
    if tile.kind != TileKind::Leaf || task.is_decided() || tile.cells == 0 {
        return codec::MAX_UNPACKED;
    }
    let items = u64::from(scene.items_of(task, tile.kind));
    let pairs = task
        .pair_cells()
        .map_or(0, |sides| sides.map(u64::from).iter().product::<u64>());
    // An adaptive tile counts as one cell in the plan, and has at most two to the depth of its tree.
    let cells = match task.division() {
        Division::Adaptive { .. } => tile.cells.saturating_mul(1 << 12),
        Division::Grid(_) | Division::Tree(_) => tile.cells,
    };
    let sets = cells.saturating_mul(items.saturating_mul(15).saturating_add(LEAST_UNPACKED));
    sets.saturating_add(pairs.saturating_mul(pairs))
        .saturating_add(1 << 20)
        .min(codec::MAX_UNPACKED)
}

/// Checks the output of tile `number` of the job's plan and returns the number of the output's cells.
/// Unpacking stops after `most` bytes.
///
/// # Errors
/// [`OutputError`] for the first difference from the plan; [`OutputError::Large`] if the output unpacks to
/// more than `most` bytes.
pub fn check(
    task: &Visibility,
    number: TileIndex,
    tile: &Tile,
    scene: SceneSize,
    bytes: &[u8],
    most: u64,
) -> Result<u64, OutputError> {
    let items = scene.items_of(task, tile.kind);
    let is_pack = tile.kind != TileKind::Leaf;
    let all = most_unpacked(task, tile, scene);
    let output = codec::check(bytes, items, is_pack, all.min(most)).map_err(|e| match e {
        e if e.is_too_large() && most < all => OutputError::Large,
        e => e.into(),
    })?;
    let sets = match (&output, is_pack) {
        (TileOutput::Cells(sets), false) => sets,
        (TileOutput::Pack(_), true) => return Ok(0),
        _ => return Err(OutputError::Kind),
    };
    let expected = expected_nodes(task, tile);
    let unreached = expected
        .as_ref()
        .map_or_else(Vec::new, |nodes| unreached(task, &tile.cell, nodes));
    if expected.is_some_and(|nodes| nodes != sets.nodes) {
        return Err(OutputError::Cells);
    }
    let exact = task.is_decided();
    if sets
        .cells
        .iter()
        .any(|cell| cell.decision.is_some() != exact)
    {
        return Err(OutputError::Method);
    }
    let may_complete = exact || task.is_completed();
    if !may_complete && sets.cells.iter().any(|cell| !cell.undecided.is_empty()) {
        return Err(OutputError::Completion);
    }
    let pairs = task
        .pair_cells()
        .map(|sides| (sides.iter().product::<u32>(), exact));
    if sets
        .pairs
        .as_ref()
        .map(|p| (p.seen.cells(), p.hidden.is_some()))
        != pairs
    {
        return Err(OutputError::Pairs);
    }
    let as_asked = |(cell, unreached): (&CellSet, &bool)| cell.unreached == *unreached;
    if !unreached.is_empty() && !sets.cells.iter().zip(&unreached).all(as_asked)
        || unreached.is_empty() && sets.cells.iter().any(|cell| cell.unreached)
    {
        return Err(OutputError::Viewpoints);
    }
    let has_portals = task.has_portals() && number == TileIndex(0);
    let is_table = |bytes: &[u8]| Portals::decode(bytes, scene.triangles).is_ok();
    if has_portals && !is_table(&sets.portals) || !has_portals && !sets.portals.is_empty() {
        return Err(OutputError::Portals);
    }
    if sets
        .cells
        .iter()
        .any(|cell| cell.hits.is_some() != task.has_contributions())
    {
        return Err(OutputError::Contributions);
    }
    Ok(sets.cells.len() as u64)
}

/// Returns, for each cell of a tile with these nodes, true if the cell has no viewpoint. The list is empty if
/// viewpoints are everywhere.
fn unreached(task: &Visibility, root: &CellBox, nodes: &[SubtreeNode]) -> Vec<bool> {
    if task.viewpoints().mask().is_none() {
        return Vec::new();
    }
    let (mut open, mut out) = (vec![*root], Vec::new());
    for node in nodes {
        let Some(cell) = open.pop() else { break };
        match node {
            SubtreeNode::Split(split) => {
                let [below, above] = cell.children(*split);
                open.extend([above, below]);
            }
            SubtreeNode::Cell => out.push(task.marks(&cell) == 0),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_model::numbers::{TargetError, TileCells, TriangleBudget};
    use sightline_model::{
        Adaptive, CellSets, CellToCell, Completion, Effort, GridCells, JobSpec, KnownCells,
        LineAim, Method, Pack, PlannedJob, Sampler, Sampling, Task, Viewpoints,
    };
    use sightline_numbers::Aabb;
    use sightline_viewcells::PartMask;

    use super::*;
    use crate::placeholder::{empty_cells, placeholder};

    const SCENE: SceneSize = SceneSize {
        triangles: 10,
        objects: 1,
    };

    #[test]
    fn packed_output_is_little_longer_than_its_content() {
        assert_eq!(packed(0), LEAST_UNPACKED);
        assert_eq!(packed(6400), 6500 + LEAST_UNPACKED);
        assert_eq!(packed(u64::MAX), codec::MAX_UNPACKED);
    }

    /// Returns a job of lines over two cells, without pairs.
    fn job(completion: Completion) -> PlannedJob {
        let view_box = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let cells = KnownCells::Grid(GridCells::new(view_box, [2, 1, 1]).unwrap());
        let method = Method::Aggressive {
            sampling: Sampling::new(Sampler::lines(cells)),
            items: Granularity::Triangles,
            completion,
        };
        let task = Visibility {
            pairs: CellToCell::Off,
            ..method.into()
        };
        let task = Task::Visibility(task);
        let scene = [7; 32];
        PlannedJob::new(JobSpec { scene, task }).unwrap()
    }

    fn checked(job: &PlannedJob, bytes: &[u8]) -> Result<u64, OutputError> {
        let task = job.visibility().unwrap();
        check(
            task,
            TileIndex(0),
            &job.plan().tiles[0],
            SCENE,
            bytes,
            u64::MAX,
        )
    }

    #[test]
    fn longest_output_follows_from_cells_and_items() {
        let job = job(Completion::Off);
        let (task, tile) = (job.visibility().unwrap(), &job.plan().tiles[0]);
        let sets = 2 * (10 * 15 + LEAST_UNPACKED);
        assert_eq!(most_unpacked(task, tile, SCENE), sets + (1 << 20));
        assert_eq!(
            most_packed(task, tile, SCENE),
            packed(sets + (1 << 20)),
            "compressed"
        );
        let with_pairs = Visibility {
            pairs: CellToCell::On,
            ..task.clone()
        };
        assert_eq!(
            most_unpacked(&with_pairs, tile, SCENE),
            sets + 4 + (1 << 20)
        );
        // A tile of samples, and a tile whose number of cells is unknown.
        for unbounded in [
            Tile {
                kind: TileKind::Face(0),
                ..tile.clone()
            },
            Tile {
                cells: 0,
                ..tile.clone()
            },
        ] {
            assert_eq!(most_unpacked(task, &unbounded, SCENE), codec::MAX_UNPACKED);
        }
        let cells = KnownCells::Grid(GridCells::new(task.view_box(), [2, 1, 1]).unwrap());
        let exact = Method::exact(Sampling::new(Sampler::lines(cells)), Effort::Full);
        assert_eq!(
            most_unpacked(&exact.into(), tile, SCENE),
            codec::MAX_UNPACKED
        );
        let budget = TriangleBudget::new(5).unwrap();
        let aim = LineAim::Adaptive {
            cells: Adaptive::new(task.view_box(), budget, 6).unwrap(),
            error: TargetError::default(),
        };
        let adaptive = Visibility {
            pairs: CellToCell::Off,
            ..Method::aggressive(Sampling::new(Sampler::Lines { aim, time: None })).into()
        };
        assert_eq!(
            most_unpacked(&adaptive, tile, SCENE),
            4096 * sets + (1 << 20)
        );
    }

    #[test]
    fn numbers_of_items_follow_granularity() {
        let task_with = |items| -> Visibility {
            let job = job(Completion::Off);
            let sampling = job.visibility().unwrap().sampling().unwrap().clone();
            let completion = Completion::Off;
            Method::Aggressive {
                sampling,
                items,
                completion,
            }
            .into()
        };
        for (items, number) in [
            (Granularity::Triangles, 10),
            (Granularity::Clusters, 10),
            (Granularity::Objects, 1),
        ] {
            assert_eq!(SCENE.items_of(&task_with(items), TileKind::Leaf), number);
            assert_eq!(SCENE.items_of(&task_with(items), TileKind::Face(0)), 10);
        }
    }

    #[test]
    fn too_long_output_is_not_damaged_output() {
        let job = job(Completion::Off);
        let (task, tile) = (job.visibility().unwrap(), &job.plan().tiles[0]);
        let mut sets = empty_cells(task, tile);
        sets.portals = vec![0; 2 << 20];
        let long = codec::encode(&TileOutput::Cells(sets)).unwrap();
        let all = most_unpacked(task, tile, SCENE);
        let checked = |bytes: &[u8], most| check(task, TileIndex(0), tile, SCENE, bytes, most);
        assert_eq!(checked(&long, all - 1), Err(OutputError::Large));
        for most in [all, all + 1] {
            let error = checked(&long, most);
            assert!(matches!(error, Err(OutputError::Encoding(_))), "{error:?}");
        }
        let error = checked(b"nonsense", all - 1);
        assert!(matches!(error, Err(OutputError::Encoding(_))), "{error:?}");
    }

    #[test]
    fn only_cells_without_viewpoints_are_unreached() {
        let view_box = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let mut mask = PartMask::empty([2, 1, 1]);
        mask.mark([0; 3]);
        let grid = GridCells::new(view_box, [2, 1, 1]).unwrap();
        let grid = grid.with_viewpoints(Viewpoints::new(mask, None)).unwrap();
        let task = Visibility {
            pairs: CellToCell::Off,
            ..Method::aggressive(Sampling::new(Sampler::lines(KnownCells::Grid(grid)))).into()
        };
        let job = PlannedJob::new(JobSpec {
            scene: [7; 32],
            task: Task::Visibility(task),
        })
        .unwrap();
        let with = |unreached: [bool; 2]| {
            let mut sets = empty_cells(job.visibility().unwrap(), &job.plan().tiles[0]);
            for (cell, unreached) in sets.cells.iter_mut().zip(unreached) {
                cell.unreached = unreached;
            }
            checked(&job, &codec::encode(&TileOutput::Cells(sets)).unwrap())
        };
        assert_eq!(with([false, true]), Ok(2));
        for wrong in [[false, false], [true, false], [true, true]] {
            assert_eq!(with(wrong), Err(OutputError::Viewpoints));
        }
    }

    #[test]
    fn first_tile_of_portals_has_portals() {
        let view_box = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let grid = GridCells::new(view_box, [2, 1, 1]).unwrap();
        let grid = grid.with_tile_cells(TileCells::new(1).unwrap()).unwrap();
        let task = Visibility {
            pairs: CellToCell::Off,
            ..Method::portals(KnownCells::Grid(grid)).into()
        };
        let job = PlannedJob::new(JobSpec {
            scene: [7; 32],
            task: Task::Visibility(task),
        })
        .unwrap();
        let task = job.visibility().unwrap();
        let with = |number: TileIndex, portals: Vec<u8>| {
            let tile = &job.plan().tiles[number.at()];
            let mut sets = empty_cells(task, tile);
            sets.portals = portals;
            for cell in &mut sets.cells {
                cell.decision = Some(Default::default());
            }
            let bytes = codec::encode(&TileOutput::Cells(sets)).unwrap();
            check(task, number, tile, SCENE, &bytes, u64::MAX)
        };
        let portals = Portals::undivided(SCENE.triangles).encode();
        assert_eq!(with(TileIndex(0), portals.clone()), Ok(1));
        assert_eq!(with(TileIndex(1), Vec::new()), Ok(1));
        for (number, portals) in [
            (TileIndex(0), Vec::new()),
            (TileIndex(0), vec![1]),
            (TileIndex(1), portals),
        ] {
            assert_eq!(with(number, portals), Err(OutputError::Portals));
        }
    }

    #[test]
    fn undecided_items_are_accepted_with_completion() {
        let job = job(Completion::Auto);
        let mut sets = empty_cells(job.visibility().unwrap(), &job.plan().tiles[0]);
        (sets.cells[0].visible, sets.cells[0].undecided) = (vec![2, 3], vec![3]);
        let bytes = codec::encode(&TileOutput::Cells(sets)).unwrap();
        assert_eq!(checked(&job, &bytes), Ok(2));
    }

    #[test]
    fn outputs_that_differ_from_the_plan_are_rejected() {
        let job = job(Completion::Off);
        let good = placeholder(&job, &job.plan().tiles[0]).unwrap();
        assert_eq!(checked(&job, &good), Ok(2));
        assert!(matches!(
            checked(&job, b"nonsense"),
            Err(OutputError::Encoding(_))
        ));
        let change = |change: &dyn Fn(&mut CellSets)| {
            let TileOutput::Cells(mut sets) = codec::decode(&good, SCENE.triangles).unwrap() else {
                panic!("a leaf tile has cells")
            };
            change(&mut sets);
            checked(&job, &codec::encode(&TileOutput::Cells(sets)).unwrap())
        };
        let one_cell = |sets: &mut CellSets| {
            sets.nodes = vec![SubtreeNode::Cell];
            sets.cells.truncate(1);
        };
        assert_eq!(change(&one_cell), Err(OutputError::Cells));
        assert_eq!(
            change(&|sets| sets.cells[0].unreached = true),
            Err(OutputError::Viewpoints)
        );
        let decided = |sets: &mut CellSets| sets.cells[1].decision = Some(Default::default());
        assert_eq!(change(&decided), Err(OutputError::Method));
        let complete = |sets: &mut CellSets| {
            (sets.cells[0].visible, sets.cells[0].undecided) = (vec![3], vec![3]);
        };
        assert_eq!(change(&complete), Err(OutputError::Completion));
        assert_eq!(
            change(&|sets| sets.portals = vec![1]),
            Err(OutputError::Portals)
        );
        let beyond = change(&|sets| sets.cells[0].visible = vec![10]);
        assert!(
            matches!(beyond, Err(OutputError::Encoding(_))),
            "{beyond:?}"
        );
        let pack = codec::encode(&TileOutput::Pack(Pack::default())).unwrap();
        assert!(matches!(
            checked(&job, &pack),
            Err(OutputError::Encoding(_))
        ));
    }
}
