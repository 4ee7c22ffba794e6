//! The view cells of a job: the view box, its division, and the parts that contain viewpoints.
//!
//! Each division has its own type. The constructor checks the cells, so that the lattice cannot fail later.

use std::sync::Arc;

use sightline_numbers::Aabb;
use sightline_viewcells::{
    CellBox, Division, DivisionError, KdTree, Lattice, Layout, PartMask, PartMaskError, Region,
    USUAL_BLOCK_CELLS,
};

use super::numbers::{TileCells, TriangleBudget};
use super::{CellsByCost, SpecError};

/// Maximum depth of an adaptive tree that sight lines sample. Visibility cubes sample deeper trees.
pub const MOST_LINE_DEPTH: u32 = 12;

/// Maximum depth of an adaptive tree that visibility cubes sample.
pub const MOST_CUBE_DEPTH: u32 = sightline_viewcells::division::MAX_DEPTH;

/// Approximate maximum number of tiles of a grid. The scheduler iterates over all tiles of a job, so more
/// tiles would slow it down.
const MOST_TILES: u64 = 1 << 16;

/// Maximum length of encoded viewpoints in bytes, well below the maximum size of a gRPC message.
const MOST_BYTES: usize = 1 << 20;

/// A view box with its division into cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    view_box: Aabb,
    division: Division,
    lattice: Lattice,
}

impl Cells {
    fn new(view_box: Aabb, division: Division) -> Result<Self, DivisionError> {
        let lattice = division.lattice(view_box.min, view_box.max)?;
        Ok(Self {
            view_box,
            division,
            lattice,
        })
    }

    /// Returns the view box, which contains all viewpoints, in world space.
    pub fn view_box(&self) -> Aabb {
        self.view_box
    }

    /// Returns the division of the view box.
    pub fn division(&self) -> &Division {
        &self.division
    }

    /// Returns the lattice of sample positions.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Returns the numbers of cells along x, y and z of the grid that a [`PartMask`] covers. The n boxes of a
    /// tree count as a grid of n × 1 × 1 cells. Returns `None` for an adaptive tree, whose cells are unknown
    /// before the bake.
    fn marked(&self) -> Option<[u32; 3]> {
        match &self.division {
            Division::Grid(cells) => Some(*cells),
            Division::Tree(tree) => Some([tree.boxes() as u32, 1, 1]),
            Division::Adaptive { .. } => None,
        }
    }
}

/// The parts of the view box that contain viewpoints.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Viewpoints {
    /// Everywhere in the view box.
    #[default]
    Everywhere,
    /// In marked parts of the cells.
    Parts(Arc<PartMask>),
    /// In marked parts of the cells, restricted to a region. An unobstructed segment that begins in the
    /// region does not leave the region.
    Region(Arc<PartMask>, Arc<Region>),
}

/// The viewpoints of a division that supports no mask.
static EVERYWHERE: Viewpoints = Viewpoints::Everywhere;

impl Viewpoints {
    /// Creates viewpoints from the mask of the marked parts and an optional region.
    pub fn new(mask: PartMask, region: Option<Region>) -> Self {
        match region {
            Some(region) => Self::Region(Arc::new(mask), Arc::new(region)),
            None => Self::Parts(Arc::new(mask)),
        }
    }

    /// Returns the marked parts, or `None` if viewpoints are everywhere.
    pub fn mask(&self) -> Option<&Arc<PartMask>> {
        match self {
            Self::Everywhere => None,
            Self::Parts(mask) | Self::Region(mask, _) => Some(mask),
        }
    }

    /// Returns the region of viewpoints, or `None` if the viewpoints are not restricted to a region.
    pub fn region(&self) -> Option<&Arc<Region>> {
        match self {
            Self::Everywhere | Self::Parts(_) => None,
            Self::Region(_, region) => Some(region),
        }
    }

    /// Encodes viewpoints as in a message: the mask of the marked parts, then the region. The encoding of
    /// viewpoints everywhere is empty.
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut bytes = self.mask().map_or_else(Vec::new, |mask| mask.encode());
        bytes.extend(self.region().iter().flat_map(|region| region.encode()));
        bytes
    }

    /// Decodes the viewpoints of a message for a grid of this many cells. The caller has checked the grid
    /// with a [`Division`].
    fn decode(mut bytes: &[u8], cells: [u32; 3]) -> Result<Self, SpecError> {
        if bytes.is_empty() {
            return Ok(Self::Everywhere);
        }
        if bytes.len() > MOST_BYTES {
            return Err(TOO_FINE);
        }
        let mask = PartMask::decode(&mut bytes, cells)?;
        let region = match bytes {
            [] => None,
            region => Some(Region::decode(region)?),
        };
        Ok(Self::new(mask, region))
    }
}

/// The error of viewpoints that are longer than [`MOST_BYTES`].
const TOO_FINE: SpecError = SpecError::new(
    "viewpoints",
    "their encoding exceeds 1 MiB; use fewer cells, or omit the region",
);

/// Checks that viewpoints are for these cells, and short enough for a message.
fn check_viewpoints(cells: &Cells, viewpoints: &Viewpoints) -> Result<(), SpecError> {
    let marks = viewpoints.mask().map(|mask| mask.cells());
    if marks.is_some() && marks != cells.marked() {
        return Err(SpecError::new(
            "viewpoints",
            "they mark other cells than the job has; give viewpoints for the cells of the job",
        ));
    }
    match viewpoints.encode().len() <= MOST_BYTES {
        true => Ok(()),
        false => Err(TOO_FINE),
    }
}

/// Checks a choice of view cells for a grid with these numbers of cells.
fn checked(
    by_cost: Option<CellsByCost>,
    sides: [u32; 3],
) -> Result<Option<Arc<CellsByCost>>, SpecError> {
    by_cost
        .map(|by_cost| by_cost.check(sides).map(|()| Arc::new(by_cost)))
        .transpose()
}

/// A grid of view cells.
#[derive(Clone, Debug, PartialEq)]
pub struct GridCells {
    cells: Cells,
    tile_cells: TileCells,
    viewpoints: Viewpoints,
    by_cost: Option<Arc<CellsByCost>>,
}

impl GridCells {
    /// Divides the view box into this many cells along x, y and z, with the default tiles and viewpoints
    /// everywhere.
    ///
    /// # Errors
    /// [`DivisionError`] if the view box cannot be divided.
    pub fn new(view_box: Aabb, cells: [u32; 3]) -> Result<Self, DivisionError> {
        Ok(Self {
            cells: Cells::new(view_box, Division::Grid(cells))?,
            tile_cells: TileCells::default(),
            viewpoints: Viewpoints::Everywhere,
            by_cost: None,
        })
    }

    /// Sets the maximum number of cells of a tile.
    ///
    /// # Errors
    /// [`SpecError`] if the grid would have too many tiles.
    pub fn with_tile_cells(self, tile_cells: TileCells) -> Result<Self, SpecError> {
        let cells = self.cells.marked().unwrap_or_default().map(u64::from);
        // The lattice exists, so the product does not overflow.
        if cells.iter().product::<u64>() / u64::from(tile_cells.get()) > MOST_TILES {
            return Err(SpecError::new(
                TileCells::OPTION,
                "this number of cells per tile makes more than 65536 tiles; give more cells per tile",
            ));
        }
        Ok(Self { tile_cells, ..self })
    }

    /// Sets the parts of the view box that contain viewpoints.
    ///
    /// # Errors
    /// [`SpecError`] if the viewpoints mark other cells, or if their encoding exceeds 1 MiB.
    pub fn with_viewpoints(self, viewpoints: Viewpoints) -> Result<Self, SpecError> {
        check_viewpoints(&self.cells, &viewpoints)?;
        Ok(Self { viewpoints, ..self })
    }

    /// Chooses the view cells of the result among the boxes of the grid's cells. Without a choice, every cell
    /// of the grid is a view cell.
    ///
    /// # Errors
    /// [`SpecError`] if the grid is too fine, or if the choice has weights for other cells.
    pub fn with_cells_by_cost(self, by_cost: Option<CellsByCost>) -> Result<Self, SpecError> {
        let by_cost = checked(by_cost, self.sides())?;
        Ok(Self { by_cost, ..self })
    }

    /// Sets the viewpoints from the bytes of a message.
    pub(super) fn with_encoded_viewpoints(self, bytes: &[u8]) -> Result<Self, SpecError> {
        let viewpoints = Viewpoints::decode(bytes, self.cells.marked().unwrap_or_default())?;
        self.with_viewpoints(viewpoints)
    }

    /// Returns the choice of view cells among the boxes of the grid's cells. `None` if every cell of the grid
    /// is a view cell.
    pub fn cells_by_cost(&self) -> Option<&CellsByCost> {
        self.by_cost.as_deref()
    }

    /// Returns the number of cells along x, y and z.
    pub fn sides(&self) -> [u32; 3] {
        self.cells.marked().unwrap_or_default()
    }

    /// Returns the maximum number of cells of a tile.
    pub fn tile_cells(&self) -> TileCells {
        self.tile_cells
    }

    /// Returns the view box with its division.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// Returns the parts of the view box that contain viewpoints.
    pub fn viewpoints(&self) -> &Viewpoints {
        &self.viewpoints
    }
}

/// View cells that are the boxes of a kd-tree, of any size. A wall in a face of a box blocks the sight lines
/// through the wall.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxCells {
    cells: Cells,
    viewpoints: Viewpoints,
}

impl BoxCells {
    /// Divides the view box by a tree, with viewpoints everywhere.
    ///
    /// # Errors
    /// [`DivisionError`] if the view box cannot be divided.
    pub fn new(view_box: Aabb, tree: Arc<KdTree>) -> Result<Self, DivisionError> {
        Ok(Self {
            cells: Cells::new(view_box, Division::Tree(tree))?,
            viewpoints: Viewpoints::Everywhere,
        })
    }

    /// Sets the parts of the view box that contain viewpoints.
    ///
    /// # Errors
    /// [`SpecError`] if the viewpoints mark other cells, or if their encoding exceeds 1 MiB.
    pub fn with_viewpoints(self, viewpoints: Viewpoints) -> Result<Self, SpecError> {
        check_viewpoints(&self.cells, &viewpoints)?;
        Ok(Self { viewpoints, ..self })
    }

    /// Sets the viewpoints from the bytes of a message.
    pub(super) fn with_encoded_viewpoints(self, bytes: &[u8]) -> Result<Self, SpecError> {
        let viewpoints = Viewpoints::decode(bytes, self.cells.marked().unwrap_or_default())?;
        self.with_viewpoints(viewpoints)
    }

    /// Returns the kd-tree of the boxes.
    pub(super) fn tree(&self) -> &KdTree {
        match &self.cells.division {
            Division::Tree(tree) => tree,
            Division::Grid(_) | Division::Adaptive { .. } => {
                unreachable!("boxes have this division")
            }
        }
    }

    /// Returns the view box with its division.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// Returns the parts of the view box that contain viewpoints.
    pub fn viewpoints(&self) -> &Viewpoints {
        &self.viewpoints
    }
}

/// A grid of view cells for visibility cubes. Cubes lie at the lattice's points, so viewpoints have no
/// region, and the grid determines the tiles.
#[derive(Clone, Debug, PartialEq)]
pub struct CubeGrid {
    cells: Cells,
    viewpoints: Viewpoints,
    by_cost: Option<Arc<CellsByCost>>,
}

impl CubeGrid {
    /// Divides the view box into this many cells along x, y and z, with viewpoints everywhere.
    ///
    /// # Errors
    /// [`DivisionError`] if the view box cannot be divided.
    pub fn new(view_box: Aabb, cells: [u32; 3]) -> Result<Self, DivisionError> {
        Ok(Self {
            cells: Cells::new(view_box, Division::Grid(cells))?,
            viewpoints: Viewpoints::Everywhere,
            by_cost: None,
        })
    }

    /// Sets the parts of the cells that contain viewpoints.
    ///
    /// # Errors
    /// [`SpecError`] if the mask is for other cells, or if its encoding exceeds 1 MiB.
    pub fn with_mask(self, mask: Arc<PartMask>) -> Result<Self, SpecError> {
        let viewpoints = Viewpoints::Parts(mask);
        check_viewpoints(&self.cells, &viewpoints)?;
        Ok(Self { viewpoints, ..self })
    }

    /// Sets the marked parts from the bytes of a message.
    pub(super) fn with_encoded_mask(self, mut bytes: &[u8]) -> Result<Self, SpecError> {
        if bytes.is_empty() {
            return Ok(self);
        }
        let mask = PartMask::decode(&mut bytes, self.sides())?;
        if !bytes.is_empty() {
            return Err(PartMaskError::LONG.into());
        }
        self.with_mask(Arc::new(mask))
    }

    /// Chooses the view cells of the result; see [`GridCells::with_cells_by_cost`].
    ///
    /// # Errors
    /// [`SpecError`] if the grid is too fine, or if the choice has weights for other cells.
    pub fn with_cells_by_cost(self, by_cost: Option<CellsByCost>) -> Result<Self, SpecError> {
        let by_cost = checked(by_cost, self.sides())?;
        Ok(Self { by_cost, ..self })
    }

    /// Returns the choice of view cells; see [`GridCells::cells_by_cost`].
    pub fn cells_by_cost(&self) -> Option<&CellsByCost> {
        self.by_cost.as_deref()
    }

    /// Returns the number of cells along x, y and z.
    pub fn sides(&self) -> [u32; 3] {
        self.cells.marked().unwrap_or_default()
    }

    /// Returns the view box with its division.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// Returns the parts of the view box that contain viewpoints.
    pub fn viewpoints(&self) -> &Viewpoints {
        &self.viewpoints
    }
}

/// The cells of an adaptive tree of at most `DEPTH` levels. The bake determines the cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Adaptive<const DEPTH: u32> {
    cells: Cells,
}

impl<const DEPTH: u32> Adaptive<DEPTH> {
    /// Creates cells that halve the view box. A cell is halved until at most `budget` triangles are visible
    /// from it or the tree is `max_depth` deep.
    ///
    /// # Errors
    /// [`SpecError`] if `max_depth` exceeds `DEPTH` or the view box cannot be divided.
    pub fn new(view_box: Aabb, budget: TriangleBudget, max_depth: u32) -> Result<Self, SpecError> {
        let budget = budget.get();
        let cells = Cells::new(view_box, Division::Adaptive { budget, max_depth })?;
        if max_depth > DEPTH {
            return Err(SpecError::new(
                "max-depth",
                "sight lines sample at most 12 levels; give at most 12, or the sampler cubes",
            ));
        }
        Ok(Self { cells })
    }

    /// Returns the view box with its division.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// Returns the triangle budget and the maximum depth.
    pub(super) fn limits(&self) -> (u32, u32) {
        match self.cells.division {
            Division::Adaptive { budget, max_depth } => (budget, max_depth),
            Division::Grid(_) | Division::Tree(_) => {
                unreachable!("an adaptive tree has this division")
            }
        }
    }
}

/// Cells that are known before the bake.
#[derive(Clone, Debug, PartialEq)]
pub enum KnownCells {
    /// Cells of equal size.
    Grid(GridCells),
    /// Boxes along walls.
    Boxes(BoxCells),
}

/// Cells that visibility cubes sample.
#[derive(Clone, Debug, PartialEq)]
pub enum CubeCells {
    /// Cells of equal size.
    Grid(CubeGrid),
    /// Cells that are smaller where more triangles are visible.
    Adaptive(Adaptive<MOST_CUBE_DEPTH>),
}

/// The properties of all kinds of cells.
pub(super) trait AnyCells {
    fn cells(&self) -> &Cells;
    fn viewpoints(&self) -> &Viewpoints;
    /// Returns the choice of view cells among the boxes of a grid's cells, if the job has one.
    fn cells_by_cost(&self) -> Option<&CellsByCost>;
    /// Returns the division of the cells into tiles.
    fn layout(&self) -> Layout;
}

impl AnyCells for KnownCells {
    fn cells(&self) -> &Cells {
        match self {
            Self::Grid(grid) => &grid.cells,
            Self::Boxes(boxes) => &boxes.cells,
        }
    }

    fn viewpoints(&self) -> &Viewpoints {
        match self {
            Self::Grid(grid) => &grid.viewpoints,
            Self::Boxes(boxes) => &boxes.viewpoints,
        }
    }

    fn cells_by_cost(&self) -> Option<&CellsByCost> {
        match self {
            Self::Grid(grid) => grid.cells_by_cost(),
            Self::Boxes(_) => None,
        }
    }

    fn layout(&self) -> Layout {
        match self {
            Self::Grid(grid) => Layout::Blocks(grid.tile_cells.get()),
            // Each box is a separate tile, whatever this number.
            Self::Boxes(_) => Layout::Blocks(USUAL_BLOCK_CELLS),
        }
    }
}

impl AnyCells for CubeCells {
    fn cells(&self) -> &Cells {
        match self {
            Self::Grid(grid) => &grid.cells,
            Self::Adaptive(tree) => &tree.cells,
        }
    }

    fn viewpoints(&self) -> &Viewpoints {
        match self {
            Self::Grid(grid) => &grid.viewpoints,
            Self::Adaptive(_) => &EVERYWHERE,
        }
    }

    fn cells_by_cost(&self) -> Option<&CellsByCost> {
        match self {
            Self::Grid(grid) => grid.cells_by_cost(),
            Self::Adaptive(_) => None,
        }
    }

    fn layout(&self) -> Layout {
        Layout::Samples
    }
}

impl AnyCells for Adaptive<MOST_LINE_DEPTH> {
    fn cells(&self) -> &Cells {
        &self.cells
    }

    fn viewpoints(&self) -> &Viewpoints {
        &EVERYWHERE
    }

    fn cells_by_cost(&self) -> Option<&CellsByCost> {
        None
    }

    fn layout(&self) -> Layout {
        // A tile is a subtree below the levels that are always split, whatever this number.
        Layout::Blocks(USUAL_BLOCK_CELLS)
    }
}

/// Returns the marked parts of a cell that is known before the bake. A bit is set for each part that contains
/// viewpoints; all bits are set if there is no mask.
pub(super) fn marks(cells: &Cells, viewpoints: &Viewpoints, cell: &CellBox) -> u64 {
    let number = cells.division.number(&cells.lattice, cell);
    match (viewpoints.mask(), number) {
        (Some(mask), Some(number)) => mask.parts(number),
        _ => u64::MAX,
    }
}
