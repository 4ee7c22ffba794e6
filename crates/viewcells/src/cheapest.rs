//! The cheapest kd-tree over a fine grid: the view cells with the least cost for a limited size.
//!
//! Each box of cells of the fine grid has a cost and a size. The cost is the weight of the box's viewpoints
//! times the number of items in its set, so the cost of a tree is proportional to the expected set of a
//! viewpoint. The size is 1, or the number of bytes of the set. A box without viewpoints has neither.
//!
//! With a price for each unit of size, dynamic programming over all boxes finds the tree with the least sum
//! of cost and price. Such a tree is a vertex of the lower convex hull of sizes and costs. The price between
//! two vertices is the slope of the line through them (Eisner and Severance 1976, "Mathematical techniques
//! for efficient record segmentation in large shared databases", Journal of the ACM 23). If no tree is below
//! this line, the line is an edge of the hull. All numbers are integers, so equal input gives equal trees.

/// The cost and the size of a box, or of a tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoxCost {
    /// The weight of the viewpoints times the number of items of the set.
    pub cost: u64,
    /// The number of cells with a set, or the number of bytes of their sets.
    pub size: u64,
}

/// A box of cells of the fine grid: the cells from `lo` to below `hi`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FineBox {
    /// The first cell along x, y and z.
    pub lo: [usize; 3],
    /// The cell after the last one along x, y and z.
    pub hi: [usize; 3],
}

/// A node of a tree over the fine grid, in preorder with lower children first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FineNode {
    /// A plane between two layers of cells.
    Split {
        /// The axis: 0, 1 or 2 for x, y or z.
        axis: usize,
        /// The first cell above the plane along the axis.
        at: usize,
    },
    /// A view cell.
    Leaf(FineBox),
}

/// A tree with the least cost for its size.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheapestTree {
    /// The nodes, in preorder.
    pub nodes: Vec<FineNode>,
    /// The sum of the costs and the sum of the sizes of the leaves.
    pub total: BoxCost,
}

/// The numbering of the boxes of a fine grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FineGrid {
    cells: [usize; 3],
}

/// The largest number of cells of a fine grid along an axis. A grid of 16×16×16 cells has 2.5
/// million boxes.
pub const MOST_FINE_CELLS: usize = 32;
/// The largest sum of the numbers of cells along the axes, so that no tree is deeper than a result's tree may
/// be.
pub const MOST_FINE_SUM: usize = 64;
/// The largest number of boxes of a fine grid, each of which needs about 50 bytes.
pub const MOST_FINE_BOXES: usize = 1 << 23;

/// A fine grid with too many boxes, or with an empty axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{x}x{y}x{z} fine cells are not possible; use 1 to {MOST_FINE_CELLS} along each axis, a sum of at most \
     {MOST_FINE_SUM}, and at most {MOST_FINE_BOXES} boxes of cells (16x16x16 cells have 2515456)"
)]
pub struct FineGridError {
    x: usize,
    y: usize,
    z: usize,
}

fn intervals(cells: usize) -> usize {
    cells * (cells + 1) / 2
}

impl FineGrid {
    /// Creates the numbering of a grid with these numbers of cells along x, y and z.
    ///
    /// # Errors
    /// [`FineGridError`] if an axis has no cell or too many, or the grid has too many boxes.
    pub fn new(cells: [usize; 3]) -> Result<Self, FineGridError> {
        let [x, y, z] = cells;
        let fits = |n: &usize| (1..=MOST_FINE_CELLS).contains(n);
        let boxes = || cells.iter().map(|n| intervals(*n)).product::<usize>();
        // A tree over the grid has a depth of at most x + y + z − 3.
        let is_deep = x.saturating_add(y).saturating_add(z) > MOST_FINE_SUM;
        if !cells.iter().all(fits) || is_deep || boxes() > MOST_FINE_BOXES {
            return Err(FineGridError { x, y, z });
        }
        Ok(Self { cells })
    }

    /// Returns the numbers of cells along x, y and z.
    pub fn cells(self) -> [usize; 3] {
        self.cells
    }

    /// Returns the number of boxes.
    pub fn boxes(self) -> usize {
        self.cells.iter().map(|n| intervals(*n)).product()
    }

    /// Returns the number of a box, which must not be empty. Boxes that are shorter along z, then y, then x
    /// have smaller numbers, so the parts of a box have smaller numbers than the box.
    pub fn number(self, of_cells: FineBox) -> usize {
        let interval = |axis: usize| {
            let (lo, n) = (of_cells.lo[axis], self.cells[axis]);
            let shorter = of_cells.hi[axis] - lo - 1;
            // There are n intervals of one cell, n − 1 of two, and so on.
            shorter * (2 * n - shorter + 1) / 2 + lo
        };
        let [nx, ny, _] = self.cells.map(intervals);
        (interval(2) * ny + interval(1)) * nx + interval(0)
    }

    /// Calls `each` with every box, in the order of the numbers.
    pub fn each(self, mut each: impl FnMut(FineBox)) {
        let along = |axis: usize| {
            let n = self.cells[axis];
            (1..=n).flat_map(move |length| (0..=n - length).map(move |lo| (lo, lo + length)))
        };
        for z in along(2) {
            for y in along(1) {
                for x in along(0) {
                    each(FineBox {
                        lo: [x.0, y.0, z.0],
                        hi: [x.1, y.1, z.1],
                    });
                }
            }
        }
    }
}

impl FineBox {
    /// Returns the parts of the box below and above a plane.
    fn parts(self, axis: usize, at: usize) -> [Self; 2] {
        let (mut below, mut above) = (self, self);
        (below.hi[axis], above.lo[axis]) = (at, at);
        [below, above]
    }
}

/// The price of a unit of size, as a fraction of two whole numbers; 1/0 compares trees by size first.
#[derive(Clone, Copy, Debug)]
struct Price {
    above: u64,
    below: u64,
}

impl Price {
    /// Returns the priced cost, and the number that decides between equal priced costs.
    fn of_total(self, total: BoxCost) -> (u128, u64) {
        let priced = u128::from(total.cost) * u128::from(self.below)
            + u128::from(total.size) * u128::from(self.above);
        let second = if self.below == 0 {
            total.cost
        } else {
            total.size
        };
        (priced, second)
    }
}

/// The costs of all boxes of a fine grid, for the search of trees.
pub struct CheapestTrees {
    grid: FineGrid,
    costs: Vec<BoxCost>,
}

/// A budget below the size of every tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("every tree has a size of at least {least}; allow this size")]
pub struct TooSmall {
    /// The least size of a tree.
    pub least: u64,
}

impl CheapestTrees {
    /// Creates the search over boxes whose costs are in the order of [`FineGrid::number`].
    ///
    /// # Panics
    /// If `costs` has another number of boxes than the grid.
    pub fn new(grid: FineGrid, costs: Vec<BoxCost>) -> Self {
        assert_eq!(costs.len(), grid.boxes(), "a cost for every box");
        Self { grid, costs }
    }

    /// Finds the vertex of the hull with the least cost whose size is at most `budget`.
    ///
    /// # Errors
    /// [`TooSmall`] if every tree is larger.
    pub fn within(&self, budget: u64) -> Result<CheapestTree, TooSmall> {
        let mut small = self.smallest();
        if small.total.size > budget {
            return Err(TooSmall {
                least: small.total.size,
            });
        }
        let mut large = self.cheapest();
        if large.total.size <= budget {
            return Ok(large);
        }
        while let Some(between) = self.between(small.total, large.total) {
            if between.total.size <= budget {
                small = between;
            } else {
                large = between;
            }
        }
        Ok(small)
    }

    /// Returns trees at vertices of the hull with ascending sizes: the smallest tree, the cheapest tree, and
    /// vertices between them, at most `most` if `most` is above 1. The largest gaps between costs are filled
    /// first.
    pub fn hull(&self, most: usize) -> Vec<CheapestTree> {
        let mut vertices = vec![self.smallest()];
        let cheapest = self.cheapest();
        if cheapest.total != vertices[0].total {
            vertices.push(cheapest);
        }
        // True for each edge between two vertices that may have a vertex below it.
        let mut open = vec![true; vertices.len() - 1];
        while vertices.len() < most {
            let gap = |at: &usize| vertices[*at].total.cost - vertices[at + 1].total.cost;
            let widest = (0..open.len()).filter(|at| open[*at]).max_by_key(gap);
            let Some(at) = widest else { break };
            match self.between(vertices[at].total, vertices[at + 1].total) {
                Some(tree) => {
                    vertices.insert(at + 1, tree);
                    open.insert(at + 1, true);
                }
                None => open[at] = false,
            }
        }
        vertices
    }

    /// Finds the tree with the least size, and of these the least cost.
    pub fn smallest(&self) -> CheapestTree {
        self.priced(Price { above: 1, below: 0 })
    }

    /// Finds the tree with the least cost, and of these the least size.
    fn cheapest(&self) -> CheapestTree {
        self.priced(Price { above: 0, below: 1 })
    }

    /// Finds a vertex below the line through two vertices of the hull, the first of which is smaller. Returns
    /// `None` if the line is an edge of the hull.
    fn between(&self, small: BoxCost, large: BoxCost) -> Option<CheapestTree> {
        if small.size >= large.size || small.cost <= large.cost {
            return None;
        }
        let price = Price {
            above: small.cost - large.cost,
            below: large.size - small.size,
        };
        let tree = self.priced(price);
        (price.of_total(tree.total).0 < price.of_total(small).0).then_some(tree)
    }

    /// Finds the tree with the least sum of cost and price, and of these the tree with the least size (with
    /// the price 1/0, the least cost). Of equal trees of a box, an undivided box wins, then the first axis
    /// and the lowest plane.
    fn priced(&self, price: Price) -> CheapestTree {
        // The best total of each box, with the plane of its first split.
        let mut best: Vec<(u128, u64)> = Vec::with_capacity(self.costs.len());
        let mut planes: Vec<Option<(u8, u8)>> = Vec::with_capacity(self.costs.len());
        self.grid.each(|of_cells| {
            let whole = self.costs[best.len()];
            let (mut least, mut plane) = (price.of_total(whole), None);
            if whole != BoxCost::default() {
                for axis in 0..3 {
                    for at in of_cells.lo[axis] + 1..of_cells.hi[axis] {
                        let [a, b] = of_cells.parts(axis, at).map(|p| best[self.grid.number(p)]);
                        let sum = (a.0 + b.0, a.1 + b.1);
                        if sum < least {
                            (least, plane) = (sum, Some((axis as u8, at as u8)));
                        }
                    }
                }
            }
            best.push(least);
            planes.push(plane);
        });
        let mut tree = CheapestTree {
            nodes: Vec::new(),
            total: BoxCost::default(),
        };
        let mut open = vec![FineBox {
            lo: [0; 3],
            hi: self.grid.cells,
        }];
        while let Some(of_cells) = open.pop() {
            let number = self.grid.number(of_cells);
            match planes[number] {
                Some((axis, at)) => {
                    let (axis, at) = (usize::from(axis), usize::from(at));
                    tree.nodes.push(FineNode::Split { axis, at });
                    let [below, above] = of_cells.parts(axis, at);
                    open.extend([above, below]);
                }
                None => {
                    tree.nodes.push(FineNode::Leaf(of_cells));
                    tree.total.cost += self.costs[number].cost;
                    tree.total.size += self.costs[number].size;
                }
            }
        }
        tree
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    /// Returns the costs of all boxes for cells with these weights and sets of at most 32 items. A cell with
    /// the weight `None` has no viewpoint. With `bytes`, the size of a set is its number of items plus 1.
    fn search(cells: [usize; 3], fine: &[(Option<u64>, u32)], bytes: bool) -> CheapestTrees {
        let grid = FineGrid::new(cells).unwrap();
        let mut costs = Vec::new();
        grid.each(|of_cells| {
            let (mut weight, mut set) = (None, 0u32);
            for z in of_cells.lo[2]..of_cells.hi[2] {
                for y in of_cells.lo[1]..of_cells.hi[1] {
                    for x in of_cells.lo[0]..of_cells.hi[0] {
                        let (own, items) = fine[(z * cells[1] + y) * cells[0] + x];
                        if let Some(own) = own {
                            weight = Some(weight.unwrap_or(0) + own);
                            set |= items;
                        }
                    }
                }
            }
            assert_eq!(grid.number(of_cells), costs.len());
            let items = u64::from(set.count_ones());
            costs.push(weight.map_or_else(BoxCost::default, |weight| BoxCost {
                cost: weight * items,
                size: if bytes { items + 1 } else { 1 },
            }));
        });
        CheapestTrees::new(grid, costs)
    }

    /// Returns the totals of all trees over a box, without totals that another total beats in both numbers.
    fn all_trees(
        search: &CheapestTrees,
        of_cells: FineBox,
        known: &mut BTreeMap<usize, Vec<BoxCost>>,
    ) -> Vec<BoxCost> {
        let number = search.grid.number(of_cells);
        if let Some(found) = known.get(&number) {
            return found.clone();
        }
        let mut all = vec![search.costs[number]];
        for axis in 0..3 {
            for at in of_cells.lo[axis] + 1..of_cells.hi[axis] {
                let [below, above] = of_cells
                    .parts(axis, at)
                    .map(|part| all_trees(search, part, known));
                for a in &below {
                    all.extend(above.iter().map(|b| BoxCost {
                        cost: a.cost + b.cost,
                        size: a.size + b.size,
                    }));
                }
            }
        }
        all.sort_unstable_by_key(|total| (total.size, total.cost));
        let mut best = Vec::<BoxCost>::new();
        for total in all {
            if best.last().is_none_or(|last| total.cost < last.cost) {
                best.push(total);
            }
        }
        known.insert(number, best.clone());
        best
    }

    /// Returns the vertices of the lower convex hull of totals with ascending sizes and descending costs.
    fn hull_of(totals: &[BoxCost]) -> Vec<BoxCost> {
        let mut hull = Vec::<BoxCost>::new();
        for c in totals {
            while let [.., a, b] = hull[..] {
                let wide = |low: BoxCost, high: BoxCost, of_cost: BoxCost, to: BoxCost| {
                    u128::from(high.size - low.size) * u128::from(of_cost.cost - to.cost)
                };
                // b is on or above the line from a to c.
                if wide(a, *c, a, b) <= wide(a, b, a, *c) {
                    hull.pop();
                } else {
                    break;
                }
            }
            hull.push(*c);
        }
        hull
    }

    fn fine(cells: usize) -> impl Strategy<Value = Vec<(Option<u64>, u32)>> {
        // Sets of neighbours overlap if few bits differ.
        let set = (any::<u32>(), any::<u32>()).prop_map(|(a, b)| a & b & 0xffff);
        let weight = proptest::option::weighted(0.7, 0u64..20);
        proptest::collection::vec((weight, set), cells)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn trees_are_vertices_of_hull_of_all_trees(
            input in prop_oneof![
                Just([4, 1, 1]), Just([3, 2, 1]), Just([2, 2, 2]), Just([3, 2, 2]), Just([1, 3, 3]),
            ].prop_flat_map(|cells: [usize; 3]| {
                (Just(cells), fine(cells.iter().product()))
            }),
            bytes: bool,
        ) {
            let (cells, fine) = input;
            let search = search(cells, &fine, bytes);
            let whole = FineBox { lo: [0; 3], hi: cells };
            let totals = all_trees(&search, whole, &mut BTreeMap::new());
            let hull = hull_of(&totals);
            let found = search.hull(usize::MAX);
            let found: Vec<BoxCost> = found.iter().map(|tree| tree.total).collect();
            prop_assert_eq!(found, hull.clone());
            for budget in 0..=hull.last().unwrap().size + 2 {
                let best = hull.iter().rfind(|vertex| vertex.size <= budget);
                match search.within(budget) {
                    Ok(tree) => {
                        prop_assert_eq!(Some(&tree.total), best);
                        let mut volume = 0;
                        for node in &tree.nodes {
                            if let FineNode::Leaf(leaf) = node {
                                volume += (0..3).map(|a| leaf.hi[a] - leaf.lo[a]).product::<usize>();
                            }
                        }
                        prop_assert_eq!(volume, cells.iter().product::<usize>());
                    }
                    Err(e) => {
                        prop_assert_eq!(best, None);
                        prop_assert_eq!(e.least, hull[0].size);
                    }
                }
            }
        }
    }

    #[test]
    fn planes_separate_cells_with_different_sets() {
        // Two rooms of two cells each, seen from inside only, and a cell without viewpoints between them.
        let (a, b) = ((Some(5), 0b1111), (Some(1), 0b1111_0000));
        let search = search([5, 1, 1], &[a, a, (None, 0), b, b], false);
        let tree = search.within(2).unwrap();
        assert_eq!(tree.total, BoxCost { cost: 48, size: 2 });
        assert_eq!(search.within(100).unwrap().total.size, 2);
        assert_eq!(search.within(1).unwrap().total.cost, 12 * 8);
        assert_eq!(search.within(0), Err(TooSmall { least: 1 }));
    }

    #[test]
    fn grids_have_limits() {
        assert!(FineGrid::new([16; 3]).is_ok());
        for cells in [[0, 1, 1], [33, 1, 1], [32, 32, 8]] {
            assert!(FineGrid::new(cells).is_err(), "{cells:?}");
        }
        assert_eq!(FineGrid::new([16; 3]).unwrap().boxes(), 2_515_456);
    }
}
