//! Example program that compares the triangles listed by portals and by exact queries in random buildings.
//!
//! Each building is straight or turned by half a radian. Corners of these walls lie on the edges of other
//! walls, so the turn opens cracks.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "this program's output is its purpose"
)]

#[path = "../tests/common/mod.rs"]
mod common;

fn main() {
    println!(
        "building, angle: parts of space, triangles listed by portals and by exact queries, on average"
    );
    for seed in 0..4 {
        for angle in [0.0, 0.5] {
            let lists = common::lists(seed, angle);
            let [portals, exact] =
                [lists.portals, lists.exact].map(|sum| f64::from(sum as u32) / 12.0);
            println!("{seed}, {angle}: {} {portals:.0} {exact:.0}", lists.leaves);
        }
    }
}
