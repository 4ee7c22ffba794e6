//! The check of a tile's output against the job's plan.

use sightline_model::codec::{self, CodecError};
use sightline_model::{CellSet, Granularity, Node, TileOutput, Visibility};
use sightline_pvs::Portals;
use sightline_viewcells::{CellBox, Division, Tile, TileKind};

use crate::placeholder::expected_nodes;

/// Maximum length of a cell without its set, in bytes.
const LEAST_UNPACKED: u64 = 4096;

/// An output that is not that of its tile.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OutputError {
    /// The bytes are not an encoded output.
    #[error(transparent)]
    Encoding(#[from] CodecError),
    /// The output unpacks to more than the caller allowed.
    #[error("the output is large and was not checked yet")]
    Large,
    /// The tree of the cells is not the tile's.
    #[error("the output has other cells than the tile's grid")]
    Cells,
    /// The job has other cells without viewpoints.
    #[error("the output has other cells without viewpoints than the job")]
    Viewpoints,
    /// The first tile of a job with portals has the portals of the result, and no other has.
    #[error("the output's portals cannot be read, or it lacks them, or it has some and should not")]
    Portals,
    /// The job asks for contributions and the output has none, or the other way round.
    #[error(
        "the output has no contributions and the job asks for them, or has some and the job does not"
    )]
    Contributions,
    /// The cells were decided by another method.
    #[error("the output's cells are not decided by the job's method")]
    Method,
    /// Pairs of cells are missing, or over other cells.
    #[error("the output's pairs of cells are not over the cells of the job")]
    Pairs,
    /// Samples in place of cells, or cells in place of samples.
    #[error("the output is not of the tile's kind")]
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
    /// Returns an upper limit on the numbers that the sets of a job's tiles name. There are at most as many
    /// clusters as triangles; objects may have none.
    pub(crate) fn items(self, task: &Visibility) -> u32 {
        match task.items() {
            Granularity::Triangles | Granularity::Clusters => self.triangles,
            Granularity::Objects => self.objects,
        }
    }

    /// Returns the number of items that an output of a kind can name.
    fn items_of(self, task: &Visibility, kind: TileKind) -> u32 {
        match kind {
            TileKind::Leaf => self.items(task),
            TileKind::Face(_) | TileKind::Separator(_) => self.triangles,
        }
    }
}

/// Returns the maximum length of a tile's output before it is unpacked, in bytes. Packing adds little to
/// bytes that it cannot shorten.
pub fn most_packed(task: &Visibility, tile: &Tile, scene: SceneSize) -> u64 {
    packed(most_unpacked(task, tile, scene))
}

/// Returns the maximum packed length of an output, by its unpacked length, in bytes.
fn packed(unpacked: u64) -> u64 {
    unpacked
        .saturating_add(unpacked / 64)
        .saturating_add(LEAST_UNPACKED)
        .min(codec::MAX_UNPACKED)
}

/// Returns the maximum length of a tile's output after it is unpacked, in bytes. A set has at most all items,
/// each with a difference and a count of at most five bytes; proofs and packs have no such bound.
fn most_unpacked(task: &Visibility, tile: &Tile, scene: SceneSize) -> u64 {
    if tile.kind != TileKind::Leaf || task.is_decided() || tile.cells == 0 {
        return codec::MAX_UNPACKED;
    }
    let items = u64::from(scene.items_of(task, tile.kind));
    let pairs = task
        .pair_cells()
        .map_or(0, |sides| sides.map(u64::from).iter().product::<u64>());
    // An adaptive tile has more cells than in its plan, and at most two to the depth of its tree.
    let cells = match task.division() {
        Division::Adaptive { .. } => tile.cells.saturating_mul(1 << 12),
        Division::Grid(_) | Division::Tree(_) => tile.cells,
    };
    let sets = cells.saturating_mul(items.saturating_mul(10).saturating_add(LEAST_UNPACKED));
    sets.saturating_add(pairs.saturating_mul(pairs))
        .saturating_add(1 << 20)
        .min(codec::MAX_UNPACKED)
}

/// Checks the output of a tile, the tile number `number` of the job's plan, and returns the number of its
/// cells. An output that unpacks to more than `most` bytes is not unpacked further.
///
/// # Errors
/// [`OutputError`] for the first difference from the plan.
pub fn check(
    task: &Visibility,
    (number, tile): (u32, &Tile),
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
    let has_portals = task.has_portals() && number == 0;
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

/// Returns for each cell of a tile with these nodes whether no viewpoint is in it; an empty list when
/// viewpoints are everywhere.
fn unreached(task: &Visibility, of: &CellBox, nodes: &[Node]) -> Vec<bool> {
    if task.viewpoints().mask().is_none() {
        return Vec::new();
    }
    let (mut open, mut out) = (vec![*of], Vec::new());
    for node in nodes {
        let Some(cell) = open.pop() else { break };
        match node {
            Node::Split(split) => {
                let [below, above] = cell.children(*split);
                open.extend([above, below]);
            }
            Node::Cell => out.push(task.marks(&cell) == 0),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_model::{
        CellSets, CellToCell, GridCells, JobSpec, KnownCells, Method, Pack, PlannedJob, Sampler,
        Sampling, Task,
    };
    use sightline_numbers::Aabb;

    use super::*;
    use crate::placeholder;

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
    fn job() -> PlannedJob {
        let view_box = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let cells = KnownCells::Grid(GridCells::new(view_box, [2, 1, 1]).unwrap());
        let task = Visibility {
            pairs: CellToCell::Off,
            ..Method::aggressive(Sampling::new(Sampler::lines(cells))).into()
        };
        let task = Task::Visibility(task);
        let scene = [7; 32];
        PlannedJob::new(JobSpec { scene, task }).unwrap()
    }

    fn checked(job: &PlannedJob, bytes: &[u8]) -> Result<u64, OutputError> {
        let task = job.visibility().unwrap();
        check(task, (0, &job.plan().tiles[0]), SCENE, bytes, u64::MAX)
    }

    #[test]
    fn outputs_that_differ_from_the_plan_are_rejected() {
        let job = job();
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
            sets.nodes = vec![Node::Cell];
            sets.cells.truncate(1);
        };
        assert_eq!(change(&one_cell), Err(OutputError::Cells));
        assert_eq!(
            change(&|sets| sets.cells[0].unreached = true),
            Err(OutputError::Viewpoints)
        );
        let decided = |sets: &mut CellSets| sets.cells[1].decision = Some(Default::default());
        assert_eq!(change(&decided), Err(OutputError::Method));
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
