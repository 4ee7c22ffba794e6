//! `sightline look`: selects the program for the type of the file.

use std::io::Read as _;

use sightline::Error;
use sightline::output::Format;

use crate::args::tetra::LookArgs;
use crate::results::look_portals;
use crate::results::look_tets;

/// Answers every point of a file, in order.
pub fn run(args: &LookArgs) -> Result<(), Error> {
    let [tets, pvs] = [Format::Tets, Format::Pvs].map(Format::magic);
    let mut begin = Vec::new();
    // If the file cannot be read, the selected program reports the error.
    let read = std::fs::File::open(&args.file)
        .and_then(|f| f.take(tets.len() as u64).read_to_end(&mut begin));
    let is_named = args
        .file
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("tets"));
    if read.is_ok() && begin != tets && !begin.starts_with(pvs) && !is_named {
        return Err(Error::input(format!(
            "{} is neither a file of `sightline tetra` (.tets) nor a result (.pvs); create one of \
             these from the scene",
            args.file.display()
        )));
    }
    if begin == tets || (is_named && (read.is_err() || !begin.starts_with(pvs))) {
        return look_tets::run(args);
    }
    look_portals::run(args)
}
