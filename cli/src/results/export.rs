//! `sightline export`: writes the sets of a result for engines and tables.
//!
//! The output contains lists of objects for each cell as one JSON document or as CSV, or a manifest for
//! streaming with each cell's neighbours.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;

use serde_json::{Value, json};
use sightline::open;
use sightline::output::{Format, Output};
use sightline::{CellIndex, Error};
use sightline_pvs::Pvs;

use crate::args::results::{ExportArgs, ExportFormat};
use crate::results::export_gltf;
use crate::terminal::stdout::print;

/// Exports a result.
pub fn run(args: &ExportArgs, json: bool) -> Result<(), Error> {
    let pvs = match (args.format, &args.scene) {
        (ExportFormat::Gltf, Some(scene)) => {
            let pvs = open(&args.result)?;
            export_gltf::write(&args.output, &args.result, &pvs, scene)?;
            pvs
        }
        (ExportFormat::Gltf, None) => {
            let why = "--format gltf writes a copy of the scene's file; give the file with --scene \
             LEVEL.glb";
            return Err(Error::usage(why.to_owned()));
        }
        (_, Some(_)) => {
            let why = "only --format gltf needs the scene; omit --scene";
            return Err(Error::usage(why.to_owned()));
        }
        _ => write(args)?,
    };
    let path = args.output.display().to_string();
    print(&match json {
        true => json!({"output": path, "cells": pvs.cells(), "objects": pvs.objects().len()})
            .to_string(),
        false => format!(
            "wrote {path}: {} cells, {} objects",
            pvs.cells(),
            pvs.objects().len()
        ),
    })
}

/// Writes the lists as JSON, as a manifest or as CSV, and returns the result.
fn write(args: &ExportArgs) -> Result<Pvs, Error> {
    let format = if args.format == ExportFormat::Csv {
        Format::Csv
    } else {
        Format::Json
    };
    let output = Output::check(&args.output, format, Some(&args.result))?;
    let pvs = open(&args.result)?;
    output.write(|out| {
        let to = |e: std::io::Error| Error::writing(output.path(), &e);
        match args.format {
            ExportFormat::Manifest => writeln!(out, "{}", manifest(&pvs)?).map_err(to),
            ExportFormat::Csv => csv(&pvs, out, &to),
            _ => writeln!(out, "{}", sidecar(&pvs)?).map_err(to),
        }
    })?;
    Ok(pvs)
}

/// Returns the scene's objects as JSON, with their nodes and meshes in a glTF file if these are known.
fn objects(pvs: &Pvs) -> Vec<Value> {
    let object = |o: &sightline_pvs::Object| {
        let mut value = json!({"name": o.name, "first": o.first, "count": o.count});
        if let Some(source) = &o.source {
            (value["node"], value["mesh"]) = (source.node.into(), source.mesh.into());
            value["primitive"] = source.primitive.into();
            if let Some(instance) = source.instance {
                value["instance"] = instance.into();
            }
        }
        value
    };
    pvs.objects().iter().map(object).collect()
}

/// Returns a cell with its box and its objects, or `None` if the cell has no viewpoints.
fn cell(pvs: &Pvs, number: CellIndex) -> Result<Option<Value>, Error> {
    if !pvs.is_reached(number.0)? {
        return Ok(None);
    }
    let mut ids = Vec::new();
    pvs.visible_objects(number.0, &mut ids)?;
    let [min, max] = pvs.cell_bounds(number.0).unwrap_or_default();
    Ok(Some(
        json!({"cell": number, "min": min, "max": max, "objects": ids}),
    ))
}

/// Returns the lists of objects by cell, as a document that accompanies the scene's file.
fn sidecar(pvs: &Pvs) -> Result<Value, Error> {
    let cells = (0..pvs.cells()).filter_map(|number| cell(pvs, CellIndex(number)).transpose());
    let info: Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    let up = &info["spec"]["visibility"]["up"];
    Ok(json!({
        "format": "sightline.sidecar", "version": 1, "method": pvs.method(), "up": up,
        "view_box": pvs.tree().view_box(), "objects": objects(pvs),
        "cells": cells.collect::<Result<Vec<_>, _>>()?,
    }))
}

/// Returns the manifest: the objects of each cell, and the neighbouring cells to load next.
fn manifest(pvs: &Pvs) -> Result<Value, Error> {
    let bounds: Vec<[[f32; 3]; 2]> = (0..pvs.cells())
        .map(|number| pvs.cell_bounds(number).unwrap_or_default())
        .collect();
    let mut reached = Vec::new();
    for number in 0..pvs.cells() {
        if pvs.is_reached(number)? {
            reached.push(number);
        }
    }
    let neighbours = neighbours(&bounds, &reached);
    let mut cells = Vec::new();
    let mut items = Vec::new();
    for number in &reached {
        let Some(mut value) = cell(pvs, CellIndex(*number))? else {
            continue;
        };
        value["triangles"] = pvs.visible_count(*number)?.into();
        value["neighbours"] = neighbours[*number as usize].iter().copied().collect();
        // The lower bound of each object's share of the view, if the bake measured objects.
        if pvs.granularity() == sightline_pvs::Granularity::Objects
            && let Some(all) = pvs.contributions(*number)?
        {
            pvs.visible_items(*number, &mut items)?;
            let share =
                |(item, c): (&u32, &sightline_pvs::Contribution)| json!([item, c.mean()[0]]);
            value["shares"] = items.iter().zip(&all).map(share).collect();
        }
        cells.push(value);
    }
    Ok(json!({
        "format": "sightline.manifest", "version": 1, "view_box": pvs.tree().view_box(),
        "objects": objects(pvs), "cells": cells,
    }))
}

/// Returns for each box of `bounds`, by its index, the indices of the neighbours: other boxes of `reached`
/// that share a part of a face with a positive area. A box that `reached` does not contain has no neighbours.
fn neighbours(bounds: &[[[f32; 3]; 2]], reached: &[u32]) -> Vec<BTreeSet<u32>> {
    let mut all = vec![BTreeSet::new(); bounds.len()];
    for axis in 0..3 {
        // The boxes that start at each plane.
        let mut from: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for number in reached {
            from.entry(bounds[*number as usize][0][axis].to_bits())
                .or_default()
                .push(*number);
        }
        for number in reached {
            let cell_box = &bounds[*number as usize];
            for other in from.get(&cell_box[1][axis].to_bits()).into_iter().flatten() {
                let to = &bounds[*other as usize];
                let overlaps =
                    |k: usize| cell_box[0][k].max(to[0][k]) < cell_box[1][k].min(to[1][k]);
                if overlaps((axis + 1) % 3) && overlaps((axis + 2) % 3) {
                    all[*number as usize].insert(*other);
                    all[*other as usize].insert(*number);
                }
            }
        }
    }
    all
}

/// Writes a CSV line for each pair of a cell and an object in its set.
fn csv(pvs: &Pvs, out: &mut dyn Write, to: &dyn Fn(std::io::Error) -> Error) -> Result<(), Error> {
    writeln!(out, "cell,object,name").map_err(to)?;
    let mut ids = Vec::new();
    for number in 0..pvs.cells() {
        if !pvs.is_reached(number)? {
            continue;
        }
        pvs.visible_objects(number, &mut ids)?;
        for id in &ids {
            let name = pvs
                .objects()
                .get(*id as usize)
                .map_or("", |o| o.name.as_str());
            writeln!(out, "{number},{id},{}", quoted(name)).map_err(to)?;
        }
    }
    Ok(())
}

/// Formats a field of CSV (RFC 4180).
fn quoted(name: &str) -> String {
    if name.contains(['"', ',', '\n', '\r']) {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_with_common_edge_are_not_neighbours() {
        let unit_box_at = |x: f32, y: f32| [[x, y, 0.0], [x + 1.0, y + 1.0, 1.0]];
        let all = [
            unit_box_at(0.0, 0.0),
            unit_box_at(1.0, 0.5),
            unit_box_at(1.0, -1.0),
            unit_box_at(3.0, 0.0),
            unit_box_at(0.0, 1.0),
        ];
        let found = neighbours(&all, &[0, 1, 2, 3, 4]);
        assert_eq!(found[0], BTreeSet::from([1, 4]));
        assert_eq!(found[1], BTreeSet::from([0, 4]));
        assert!(found[2].is_empty() && found[3].is_empty());
        assert_eq!(neighbours(&all, &[0, 2])[0], BTreeSet::new());
    }

    #[test]
    fn names_are_quoted_as_csv_fields() {
        assert_eq!(quoted("a \"b\", c"), "\"a \"\"b\"\", c\"");
        assert_eq!(quoted("plain name"), "plain name");
    }
}
