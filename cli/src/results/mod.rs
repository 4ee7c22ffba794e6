//! Commands about results.

pub mod cells;
pub mod diff;
pub mod diff_page;
pub mod dump;
pub mod export;
pub mod export_gltf;
pub mod info;
pub mod info_cells;
pub mod look_lines;
pub mod look_points;
pub mod look_portals;
pub mod look_tets;
pub mod query;
pub mod query_target;
pub mod query_why;
pub mod report;
pub mod view;
pub mod view_server;
