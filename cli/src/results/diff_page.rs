//! A page with the difference of two results in the viewer.
//!
//! The page shows the newer result with heat maps of the changes, at the cell with the largest change.

use std::path::Path;

use sightline::output::Output;
use sightline::{CellIndex, Error};
use sightline_pvs::Pvs;
use sightline_scene::Scene;
use sightline_view::{Map, View, page};

/// The change of a cell's set: the numbers of items that only one of the two results contains.
pub struct CellChange {
    /// The number of the cell.
    pub cell: CellIndex,
    /// The number of items of only the newer set.
    pub came: usize,
    /// The number of items of only the older set.
    pub went: usize,
}

/// Writes the page.
pub fn write(
    output: &Output,
    [older, newer]: [&Path; 2],
    pvs: &Pvs,
    scene: Option<&Scene>,
    changes: &[CellChange],
    about: &str,
) -> Result<(), Error> {
    let mut view = View::new(pvs, scene)?;
    view.title = format!("{} after {}", newer.display(), older.display());
    about.clone_into(&mut view.about);
    let map = |name: &str, value: &dyn Fn(&CellChange) -> usize| {
        let mut values = vec![0.0; pvs.cells() as usize];
        changes
            .iter()
            .for_each(|change| values[change.cell.at()] = value(change) as f32);
        Map {
            name: name.to_owned(),
            values,
        }
    };
    let maps = [
        map("items gained", &|c| c.came),
        map("items lost", &|c| c.went),
    ];
    view.maps
        .splice(0..0, maps.into_iter().filter(Map::says_something));
    if let Some(most) = changes
        .iter()
        .max_by_key(|c| (c.came + c.went, std::cmp::Reverse(c.cell)))
    {
        view.start = most.cell;
    }
    let page = page(&view).map_err(|e| Error::input(format!("{}: {e}", newer.display())))?;
    output.write(|out| {
        out.write_all(page.as_bytes())
            .map_err(|e| Error::writing(output.path(), &e))
    })
}
