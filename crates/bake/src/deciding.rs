//! The choices with which exact queries decide the cells of a tile.

use sightline_exact::Limits;
use sightline_model::{Effort, Visibility};

use crate::choices::exact_limits;
use crate::scope::TileScope;

/// The rules by which the cells of a tile are decided.
pub struct Deciding<'a> {
    /// The cells.
    pub scope: &'a TileScope,
    /// The limits of a single query.
    pub limits: Limits,
    /// Whether certificates are kept.
    pub certificates: bool,
    /// The distance from the viewpoint where sight lines end; `None` for no end.
    pub far: Option<f64>,
}

impl<'a> Deciding<'a> {
    /// Finds how a task decides the cells of a tile.
    pub fn new(task: &Visibility, effort: Effort, scope: &'a TileScope) -> Self {
        Self {
            scope,
            limits: exact_limits(effort),
            certificates: task.has_certificates(),
            far: task.far.map(|far| far.get()),
        }
    }
}
