//! Runs the example of this crate.

#![allow(clippy::panic, clippy::print_stderr, reason = "a test")]

#[path = "../examples/bake_in_process.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod bake_in_process;

#[test]
fn the_example_bakes_cells_that_see_something() {
    let cells = match bake_in_process::bake() {
        Ok(sets) => sets.cells,
        Err(e) if e.to_string().contains("Embree") && std::env::var_os("CI").is_none() => {
            eprintln!("not run: {e}");
            return;
        }
        Err(e) => panic!("{e}"),
    };
    assert_eq!(cells.len(), 32);
    assert!(
        cells
            .iter()
            .all(|c| c.visible.is_sorted() && !c.visible.is_empty())
    );
}
