//! A bake without a coordinator: `plan` writes a job, its scene and its plan into a folder, `tile` computes
//! one tile there, and `assemble` joins them. Every process that sees the folder can compute tiles, in any
//! order that their needs allow; two processes that compute the same tile write the same file.

mod assemble;
mod place;
mod plan;
mod planned;
mod tile;
mod tile_file;

pub use assemble::assemble;
pub use plan::plan;
pub use tile::tile;
