//! Points, planes, polygons and boxes in world space, and the frame of a query.

pub(crate) mod frame;
pub(crate) mod parts;
pub mod polygon;
pub mod predicates;
mod view_cell;

pub use frame::PointOrigin;
pub use polygon::{Polygon, PolygonError};
pub use view_cell::Cell;
