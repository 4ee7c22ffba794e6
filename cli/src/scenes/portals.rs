//! `sightline portals`: divides a scene along its walls, and prints numbers and writes a file for viewing.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use sightline::Error;
use sightline::output::{Format, Output};
use sightline::viewpoints::{Walls, refine};
use sightline::words::plural;
use sightline_portals::{Enclosure, Face, LeafId, OUTSIDE, PortalId, Solid, Tree, reached, solids};
use sightline_scene::glb_out::{GlbError, write_glb};
use sightline_scene::{Object, Scene, Triangle};
use sightline_trace::sequence::spread3;

use crate::args::cli::PortalsArgs;
use crate::scenes::read::scene;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// The number of points that the command tries if the arguments contain no point.
const TRIED: usize = 48;
/// Maximum number of enclosed spaces that the command lists, the largest first.
const LISTED: usize = 8;

/// A space that walls enclose, with a point in it.
struct Space {
    point: [f32; 3],
    leaves: Vec<LeafId>,
    volume: f64,
}

/// Divides a scene, and prints the numbers of cells and portals.
pub fn run(args: &PortalsArgs, json: bool) -> Result<(), Error> {
    let output = args
        .output
        .as_ref()
        .map(|path| Output::check(path, Format::Glb, Some(&args.scene)));
    let output = output.transpose()?;
    let scene = scene(&args.scene, &args.kinds)?;
    let outside = |p: &&[f32; 3]| !scene.bounds().contains(Vec3::from(**p));
    if let Some(point) = args.reachable_from.iter().find(outside) {
        let bounds = scene.bounds();
        return Err(Error::input(format!(
            "--reachable-from: {point:?} is outside the scene, which extends from {} to {}; give a point \
             inside",
            bounds.min, bounds.max
        )));
    }
    if args.reachable_from.is_empty() {
        return enclosed_spaces(args, &scene, output.as_ref(), json);
    }
    let walls = Walls::around(&scene, &args.reachable_from, &Terminal::new())?;
    // The space outside the scene's box is not part of the region.
    let inside: Vec<LeafId> = walls
        .reached
        .iter()
        .copied()
        .filter(|leaf| *leaf != OUTSIDE)
        .collect();
    let parts = solids(&walls.tree, &inside);
    let volume: f64 = parts.iter().map(Solid::volume).sum();
    let inner = portals_of(&walls.tree, &inside);
    let detail = inside
        .iter()
        .map(|l| walls.tree.leaf(*l).detail.len())
        .sum::<usize>();
    let is_closed = walls.enclosure == Enclosure::Closed;
    // With a way out, parts extend beyond the scene's box, so their share is undefined.
    let share = is_closed.then_some(volume / volume_of(&scene));
    if let Some(output) = &output {
        draw(args, output, &walls.tree, &parts, &inner, way(&walls))?;
    }
    if json {
        return print(
            &json!({
                "closed": is_closed, "leaves": walls.tree.len() - 1, "reached": inside.len(),
                "portals": inner.len(), "detail": detail, "share": share, "way_out": way_json(&walls),
            })
            .to_string(),
        );
    }
    print(&walls.in_words())?;
    print(&format!(
        "the points reach {} of {}, with {} between them; {} in the reached parts lie in no splitting \
         plane",
        inside.len(),
        plural(walls.tree.len() - 1, "convex part"),
        plural(inner.len(), "opening"),
        plural(detail, "triangle part")
    ))?;
    let use_of_it = match &walls.enclosure {
        Enclosure::Closed => format!(
            "the reached parts fill {:.1} % of the scene's box: `sightline bake --reachable-from` skips \
             the rest",
            100.0 * share.unwrap_or_default()
        ),
        Enclosure::Leak(..) => {
            "`sightline bake --reachable-from` uses walls only after the way out is closed"
                .to_owned()
        }
        Enclosure::Unknown | Enclosure::Stopped => {
            "without known walls, `sightline bake --reachable-from` finds the reached parts of cells with \
             rays".to_owned()
        }
    };
    print(&use_of_it)
}

/// Prints the spaces that walls enclose around sampled points of the scene, if no points are given.
fn enclosed_spaces(
    args: &PortalsArgs,
    scene: &Scene,
    output: Option<&Output>,
    json: bool,
) -> Result<(), Error> {
    let bounds = scene.bounds();
    let terminal = Terminal::new();
    let mut tree = Tree::new(scene, &[]);
    let (mut closed, mut unknown) = (Vec::new(), 0usize);
    for number in 0..TRIED {
        let step = Vec3::from(spread3(number as u64, [0.5; 3]));
        let point = (bounds.min + (bounds.max - bounds.min) * step).to_array();
        let known = |(_, leaves): &([f32; 3], Vec<LeafId>)| {
            tree.leaves_of(point.into())
                .iter()
                .all(|leaf| leaves.binary_search(leaf).is_ok())
        };
        if closed.iter().any(known) {
            continue;
        }
        match refine(&mut tree, &[point], &terminal)? {
            Enclosure::Closed => closed.push((point, reached(&tree, &[point]))),
            Enclosure::Leak(..) => {}
            Enclosure::Unknown | Enclosure::Stopped => unknown += 1,
        }
    }
    // Later points have divided the leaves of earlier points, so the leaves are collected again.
    let mut spaces: Vec<Space> = closed
        .into_iter()
        .map(|(point, _)| {
            let leaves = reached(&tree, &[point]);
            let volume = solids(&tree, &leaves).iter().map(Solid::volume).sum();
            Space {
                point,
                leaves,
                volume,
            }
        })
        .collect();
    spaces.sort_by(|a, b| b.volume.total_cmp(&a.volume));
    spaces.truncate(LISTED);
    let share = |space: &Space| space.volume / volume_of(scene);
    if let Some(output) = output {
        let all: BTreeSet<LeafId> = spaces
            .iter()
            .flat_map(|s| s.leaves.iter().copied())
            .collect();
        let all: Vec<LeafId> = all.into_iter().collect();
        draw(
            args,
            output,
            &tree,
            &solids(&tree, &all),
            &portals_of(&tree, &all),
            None,
        )?;
    }
    if json {
        let listed =
            |s: &Space| json!({"point": s.point, "leaves": s.leaves.len(), "share": share(s)});
        let enclosed: Vec<Value> = spaces.iter().map(listed).collect();
        let value = json!({"leaves": tree.len() - 1, "unknown": unknown, "enclosed": enclosed});
        return print(&value.to_string());
    }
    if unknown > 0 {
        print(&format!(
            "for {unknown} of {TRIED} points, it is unknown if walls enclose them, because the scene has \
             too many walls"
        ))?;
    }
    if spaces.is_empty() {
        return print(&format!(
            "no walls enclose any of {TRIED} points of the scene's box; give --reachable-from a point \
             where a viewpoint can be to print the way out of the scene"
        ));
    }
    print("walls enclose these spaces (the insides of solids are among them):")?;
    for space in &spaces {
        let [x, y, z] = space.point;
        print(&format!(
            "  --reachable-from={x},{y},{z}: {:.2} % of the scene's box, {}",
            100.0 * share(space),
            plural(space.leaves.len(), "convex part")
        ))?;
    }
    Ok(())
}

fn volume_of(scene: &Scene) -> f64 {
    let bounds = scene.bounds();
    let size = (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max(DVec3::splat(f64::MIN_POSITIVE));
    size.x * size.y * size.z
}

/// Returns the portals between two of the given leaves, ascending.
fn portals_of(tree: &Tree, leaves: &[LeafId]) -> Vec<PortalId> {
    let mut all: Vec<PortalId> = leaves
        .iter()
        .flat_map(|l| tree.leaf(*l).portals.iter().copied())
        .collect();
    all.sort_unstable();
    all.dedup();
    all.retain(|p| {
        tree.portal(*p)
            .leaves
            .iter()
            .all(|l| leaves.binary_search(l).is_ok())
    });
    all
}

/// Returns the openings on the way out, or `None` if the walls are closed.
fn way(walls: &Walls) -> Option<Vec<&Face>> {
    let Enclosure::Leak(_, portals) = &walls.enclosure else {
        return None;
    };
    Some(
        portals
            .iter()
            .map(|p| &walls.tree.portal(*p).face)
            .collect(),
    )
}

fn way_json(walls: &Walls) -> Value {
    let Some(way) = way(walls) else {
        return Value::Null;
    };
    let place = |face: &Face| json!({"at": face.middle().to_array(), "width": face.width()});
    json!({
        "openings": way.iter().map(|face| place(face)).collect::<Vec<_>>(),
        "narrowest": walls.narrowest().map(place),
    })
}

/// Writes a GLB file with the cells, the portals and the way out as objects.
fn draw(
    args: &PortalsArgs,
    output: &Output,
    tree: &Tree,
    parts: &[Solid],
    portals: &[PortalId],
    way: Option<Vec<&Face>>,
) -> Result<(), Error> {
    let (mut triangles, mut objects): (Vec<Triangle>, Vec<Object>) = (Vec::new(), Vec::new());
    let mut add = |name: String, faces: &mut dyn Iterator<Item = &Face>| {
        let first = triangles.len() as u32;
        for face in faces {
            let at: Vec<Vec3> = face.corners().iter().map(|c| c.as_vec3()).collect();
            triangles.extend(at.windows(2).skip(1).map(|w| Triangle {
                v: [at[0], w[0], w[1]],
            }));
        }
        let count = triangles.len() as u32 - first;
        if count > 0 {
            objects.push(Object { name, first, count });
        }
    };
    for Solid { leaf, faces } in parts {
        add(format!("cell {}", leaf.0), &mut faces.iter());
    }
    for portal in portals.iter().map(|p| tree.portal(*p)) {
        let [a, b] = portal.leaves;
        add(
            format!("portal {}-{}", a.0, b.0),
            &mut std::iter::once(&portal.face),
        );
    }
    if let Some(way) = way {
        add("way out".to_owned(), &mut way.into_iter());
    }
    if objects.is_empty() {
        say("note: the points reach no cell, so no file was written");
        return Ok(());
    }
    let scene = Scene::new("cells and portals", triangles, objects).map_err(Error::internal)?;
    output.write(|out| {
        write_glb(&scene, out).map_err(|e| match e {
            GlbError::Io(e) => Error::writing(args.output.as_deref().unwrap_or(&args.scene), &e),
            e => Error::internal(e),
        })
    })?;
    say(&format!(
        "wrote {}",
        args.output.as_deref().unwrap_or(&args.scene).display()
    ));
    Ok(())
}
