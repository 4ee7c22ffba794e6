//! The rules with which exact queries decide the cells of a tile.

use sightline_exact::QueryLimits;
use sightline_model::{Effort, Visibility};

use crate::choices::exact_limits;
use crate::scope::TileScope;

/// The rules by which the cells of a tile are decided.
pub struct Deciding<'a> {
    /// The division, lattice and cells of the tile.
    pub scope: &'a TileScope,
    /// The limits of a single query.
    pub limits: QueryLimits,
    /// True if certificates are stored.
    pub certificates: bool,
    /// The distance from the viewpoint at which sight lines end, in the scene's units; `None` for unlimited
    /// sight.
    pub far: Option<f64>,
}

impl<'a> Deciding<'a> {
    /// Creates the rules with which a task decides the cells of a tile.
    pub fn new(task: &Visibility, effort: Effort, scope: &'a TileScope) -> Self {
        Self {
            scope,
            limits: exact_limits(effort),
            certificates: task.has_certificates(),
            far: task.far.map(|far| far.get()),
        }
    }
}
