//! The parsed output of `sightline dump`. Parsing checks the format.

use serde_json::Value;

use crate::process::count;

/// A parsed dump.
#[derive(Clone, Debug, PartialEq)]
pub struct Dump {
    /// The first line.
    pub header: Value,
    /// The cell lines.
    pub cells: Vec<Cell>,
}

/// A leaf cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// The minimum corner.
    pub min: [f64; 3],
    /// The maximum corner.
    pub max: [f64; 3],
    /// The ids of the visible triangles.
    pub visible: Vec<u64>,
    /// The visible triangles that were neither seen nor proved hidden.
    pub undecided: Vec<u64>,
    /// True if viewpoints can be in the cell.
    pub reached: bool,
}

impl Dump {
    /// Parses a dump. Panics if the text does not have the format of `sightline dump`.
    pub fn parse(text: &str) -> Self {
        let mut lines = text.lines().map(|l| {
            serde_json::from_str::<Value>(l).unwrap_or_else(|e| panic!("no JSON line ({e}): {l}"))
        });
        let header = lines.next().unwrap();
        assert_eq!(header["format"], "sightline.pvs");
        assert_eq!(header["version"], 1);
        assert!(header["method"].is_string(), "{header}");
        let items = if header["items"] == "objects" {
            "objects"
        } else {
            "triangles"
        };
        let (all, expected) = (count(&header, items), count(&header, "cells"));
        let [low, high] = ["min", "max"].map(|corner| point(&header["view_box"][corner]));
        let cells: Vec<Cell> = lines
            .enumerate()
            .map(|(i, line)| {
                assert_eq!(line["cell"], i, "cells come in order");
                let cell = Cell {
                    min: point(&line["min"]),
                    max: point(&line["max"]),
                    visible: ids(&line["visible"], all),
                    undecided: ids(&line["undecided"], all),
                    reached: line["reached"].as_bool().unwrap_or(true),
                };
                assert!(
                    cell.reached || cell.visible.is_empty(),
                    "cell {i} has no viewpoints"
                );
                for axis in 0..3 {
                    assert!(
                        low[axis] <= cell.min[axis]
                            && cell.min[axis] < cell.max[axis]
                            && cell.max[axis] <= high[axis],
                        "cell {i} is empty or outside the view box: {line}"
                    );
                }
                assert!(
                    cell.undecided
                        .iter()
                        .all(|id| cell.visible.binary_search(id).is_ok()),
                    "cell {i}"
                );
                cell
            })
            .collect();
        assert_eq!(cells.len() as u64, expected, "as many lines as cells");
        Self { header, cells }
    }

    /// Returns the minimum and the maximum corner of the view box.
    pub fn view_box(&self) -> [[f64; 3]; 2] {
        ["min", "max"].map(|corner| point(&self.header["view_box"][corner]))
    }
}

impl Cell {
    /// Returns the volume of the cell.
    pub fn volume(&self) -> f64 {
        (0..3).map(|axis| self.max[axis] - self.min[axis]).product()
    }

    /// Returns the centre of the cell.
    pub fn middle(&self) -> [f64; 3] {
        std::array::from_fn(|axis| (self.min[axis] + self.max[axis]) / 2.0)
    }
}

fn point(value: &Value) -> [f64; 3] {
    let list: Vec<f64> = value
        .as_array()
        .unwrap()
        .iter()
        .map(|x| x.as_f64().unwrap())
        .collect();
    list.try_into()
        .unwrap_or_else(|_| panic!("no point: {value}"))
}

fn ids(value: &Value, all: u64) -> Vec<u64> {
    let ids: Vec<u64> = value
        .as_array()
        .unwrap()
        .iter()
        .map(|x| x.as_u64().unwrap())
        .collect();
    assert!(ids.is_sorted_by(|a, b| a < b), "ids ascend: {value}");
    assert!(
        ids.last().is_none_or(|last| *last < all),
        "ids are below {all}: {value}"
    );
    ids
}
