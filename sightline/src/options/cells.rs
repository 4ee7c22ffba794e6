//! The view cells in options: a grid, or boxes along walls.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sightline_viewcells::MOST_BOXES;

use super::text::parse_grid;

/// The view cells of a job: a grid, or boxes along walls.
///
/// ```
/// use sightline::Cells;
///
/// assert_eq!(serde_json::from_str::<Cells>("\"8x2x8\"")?, Cells::Grid([8, 2, 8]));
/// assert_eq!(serde_json::from_str::<Cells>("\"walls:64\"")?, Cells::Walls(64));
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cells {
    /// A regular grid with these numbers of cells along x, y and z.
    Grid([u32; 3]),
    /// Boxes along walls. The number is the maximum number of boxes.
    Walls(usize),
}

/// Parses a grid of cells, as in `8x8x8`, or boxes along walls, as in `walls:512`.
///
/// # Errors
/// The remedy as a text, if `text` is neither a grid nor boxes along walls.
pub fn parse_cells(text: &str) -> Result<Cells, String> {
    if let Some(most) = text.trim().strip_prefix("walls:") {
        let most = most.parse().ok().filter(|n| (1..=MOST_BOXES).contains(n));
        return most
            .map(Cells::Walls)
            .ok_or_else(|| format!("give walls:N with a number N from 1 to {MOST_BOXES}"));
    }
    parse_grid(text)
        .map(Cells::Grid)
        .map_err(|e| format!("{e}, or walls:N for boxes along walls"))
}

impl Serialize for Cells {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Grid(cells) => cells.serialize(to),
            Self::Walls(most) => to.serialize_str(&format!("walls:{most}")),
        }
    }
}

impl<'de> Deserialize<'de> for Cells {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum CellsText {
            Cube(u32),
            Grid([u32; 3]),
            Text(String),
        }
        Ok(match CellsText::deserialize(from)? {
            CellsText::Cube(side) => Self::Grid([side; 3]),
            CellsText::Grid(cells) => Self::Grid(cells),
            CellsText::Text(text) => parse_cells(&text).map_err(serde::de::Error::custom)?,
        })
    }
}
