//! A test that runs the example of this crate.

#[path = "../examples/bake_in_process.rs"]
#[allow(dead_code, reason = "the example's main function")]
mod bake_in_process;

#[test]
fn example_bakes_cells_with_visible_triangles() {
    let cells = bake_in_process::bake().unwrap().cells;
    assert_eq!(cells.len(), 32);
    assert!(
        cells
            .iter()
            .all(|c| c.visible.is_sorted() && !c.visible.is_empty())
    );
}
