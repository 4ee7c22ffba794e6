//! The difference of two results in the viewer: the newer one, with heat maps of what came and went, at the
//! cell with the greatest change.

use std::path::Path;

use sightline::Error;
use sightline::output::Output;
use sightline_pvs::Pvs;
use sightline_scene::Scene;
use sightline_view::{Map, View, page};

/// What came and went in a cell: its number, and how many items.
pub struct CellChange {
    /// The cell.
    pub cell: u32,
    /// Items of the newer set alone.
    pub came: usize,
    /// Items of the older one alone.
    pub went: usize,
}

/// Writes the page.
pub fn write(
    output: &Output,
    [older, newer]: [&Path; 2],
    (pvs, scene): (&Pvs, Option<&Scene>),
    changes: &[CellChange],
    about: &str,
) -> Result<(), Error> {
    let mut view = View::of(pvs, scene)?;
    view.title = format!("{} after {}", newer.display(), older.display());
    about.clone_into(&mut view.about);
    let map = |name: &str, of: &dyn Fn(&CellChange) -> usize| {
        let mut values = vec![0.0; pvs.cells() as usize];
        changes
            .iter()
            .for_each(|change| values[change.cell as usize] = of(change) as f32);
        Map {
            name: name.to_owned(),
            values,
        }
    };
    let maps = [
        map("came into the set", &|c| c.came),
        map("went out of the set", &|c| c.went),
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
