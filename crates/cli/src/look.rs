//! `sightline look`: finds out from the file who answers.

use std::io::Read as _;

use crate::error::CliError;
use crate::tetra_args::LookArgs;
use crate::{look_portals, look_tets};

/// How a file of `sightline tetra` begins.
const TETS: &[u8] = b"\x89TET";
/// How a result begins.
const PVS: &[u8] = b"\x89PVS";

/// Looks from every point of a file, in order.
pub fn run(args: &LookArgs) -> Result<(), CliError> {
    let mut begin = Vec::new();
    // What cannot be read is told by who would have answered.
    let read =
        std::fs::File::open(&args.file).and_then(|f| f.take(TETS.len() as u64).read_to_end(&mut begin));
    let is_named = args.file.extension().is_some_and(|e| e.eq_ignore_ascii_case("tets"));
    if read.is_ok() && begin != TETS && !begin.starts_with(PVS) && !is_named {
        return Err(CliError::Input(format!(
            "{} is neither a file of `sightline tetra` (.tets) nor a result (.pvs); make one of these \
             of the scene",
            args.file.display()
        )));
    }
    if begin == TETS || (is_named && (read.is_err() || !begin.starts_with(PVS))) {
        return look_tets::run(args);
    }
    look_portals::run(args)
}
