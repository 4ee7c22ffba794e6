//! The arguments of the command line, as clap parses them.

pub mod ambient;
pub mod bench;
pub mod cli;
pub mod groups;
pub mod kinds;
pub mod remote;
pub mod results;
pub mod serve;
pub mod store;
pub mod tetra;
pub mod tiles;
pub mod token;
pub mod traces;
