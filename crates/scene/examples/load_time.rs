//! Prints the triangles, objects and load time of scene files, or of generated files with a million triangles
//! in each format.
//!
//! `cargo run --release -p sightline-scene --example load_time [FILE…]`
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use sightline_scene::{load, load_bytes, write_mesh_ply};

fn main() {
    let files: Vec<String> = std::env::args().skip(1).collect();
    for f in &files {
        let start = Instant::now();
        match load(Path::new(f)) {
            Ok(s) => {
                println!(
                    "{f}: {} triangles, {} objects, {:.2?}",
                    s.len(),
                    s.objects().len(),
                    start.elapsed()
                )
            }
            Err(e) => println!("{e}"),
        }
    }
    if files.is_empty() {
        let obj = grid_obj(1000, 500);
        let scene = timed("grid.obj", obj.as_bytes());
        let mut ply = Vec::new();
        write_mesh_ply(&scene, &mut ply).unwrap();
        timed("grid.ply", &ply);
        timed("grid_ascii.ply", grid_ascii_ply(1000, 500).as_bytes());
        timed("grid.glb", &grid_glb(1000, 500));
    }
}

fn timed(name: &str, bytes: &[u8]) -> sightline_scene::Scene {
    let start = Instant::now();
    let scene = load_bytes(name, bytes, None).unwrap();
    println!(
        "{name}: {} bytes, {} triangles, {:.2?}",
        bytes.len(),
        scene.len(),
        start.elapsed()
    );
    scene
}

fn points(w: u32, h: u32) -> impl Iterator<Item = [f32; 3]> {
    (0..=h).flat_map(move |y| {
        (0..=w).map(move |x| {
            [
                x as f32 * 0.37,
                y as f32 * 0.41,
                ((x * y) % 17) as f32 * 0.013,
            ]
        })
    })
}

fn faces(w: u32, h: u32) -> impl Iterator<Item = [u32; 3]> {
    (0..h)
        .flat_map(move |y| (0..w).map(move |x| y * (w + 1) + x))
        .flat_map(move |a| [[a, a + 1, a + w + 1], [a + 1, a + w + 2, a + w + 1]])
}

fn grid_obj(w: u32, h: u32) -> String {
    let mut s = String::new();
    points(w, h).for_each(|[x, y, z]| writeln!(s, "v {x} {y} {z}").unwrap());
    faces(w, h)
        .for_each(|[a, b, c]| writeln!(s, "f {}/1/1 {}/2/2 {}/3/3", a + 1, b + 1, c + 1).unwrap());
    s
}

fn grid_ascii_ply(w: u32, h: u32) -> String {
    let mut s = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        (w + 1) * (h + 1),
        2 * w * h
    );
    points(w, h).for_each(|[x, y, z]| writeln!(s, "{x} {y} {z}").unwrap());
    faces(w, h).for_each(|[a, b, c]| writeln!(s, "3 {a} {b} {c}").unwrap());
    s
}

fn grid_glb(w: u32, h: u32) -> Vec<u8> {
    let mut bin: Vec<u8> = points(w, h).flatten().flat_map(f32::to_le_bytes).collect();
    let vertices = bin.len();
    bin.extend(faces(w, h).flatten().flat_map(u32::to_le_bytes));
    let mut json = format!(
        r#"{{"asset":{{"version":"2.0"}},
"buffers":[{{"byteLength":{}}}],
"bufferViews":[{{"buffer":0,"byteLength":{vertices}}},{{"buffer":0,"byteOffset":{vertices},"byteLength":{}}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":{},"type":"VEC3"}},
{{"bufferView":1,"componentType":5125,"count":{},"type":"SCALAR"}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
"nodes":[{{"mesh":0,"scale":[2,2,2]}}]}}"#,
        bin.len(),
        bin.len() - vertices,
        (w + 1) * (h + 1),
        6 * w * h
    );
    while json.len() % 4 != 0 {
        json.push(' ');
    }
    let mut out = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + 8 + bin.len();
    for n in [2, total as u32, json.len() as u32] {
        out.extend(n.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(json.as_bytes());
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(bin);
    out
}
