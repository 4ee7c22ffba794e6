//! debug
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "an example")]
use glam::DVec3;
use sightline_ambient::blockers::Blockers;
use sightline_ambient::receivers::Receiver;
use sightline_ambient::solve::{Options, solve};
use sightline_scene::load;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let scene = load(std::path::Path::new(&args[1])).unwrap();
    let f: Vec<f64> = args[2..].iter().map(|a| a.parse().unwrap()).collect();
    let blockers = Blockers::new(&scene, true).unwrap();
    let r = Receiver { point: DVec3::new(f[1], f[2], f[3]), normal: DVec3::new(f[4], f[5], f[6]), triangle: Some(f[7] as u32) };
    println!("{:?}", solve(&blockers, &[r], &Options::new(f[0])));
}
