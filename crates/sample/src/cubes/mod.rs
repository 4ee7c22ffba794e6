//! Visibility cubes on adaptively split rectangles (Nirenstein and Blake 2004; Nirenstein 2003, chapter 4).
//!
//! A rectangle is sampled at its corners and split while the error measure over its corners exceeds a
//! threshold ([`refine`], [`measure`]). The samples of a tile are shared through a cache ([`cache`]).

pub mod cache;
pub mod measure;
pub mod refine;
pub mod tile;

pub use tile::run;
