//! The native part of the Python package: results as numpy arrays, and the commands as functions. What users
//! see is in `python/sightline`, which checks arguments and turns them into flags of the commands.

mod client;
mod errors;
mod mesh;
mod pvs;
mod waiting;
mod work;

use pyo3::prelude::*;

#[pymodule]
fn _sightline(module: &Bound<'_, PyModule>) -> PyResult<()> {
    sightline_cli::calls::say_to(|text| {
        // Nobody listens where this fails: the interpreter is ending, or a handler has raised an error.
        let _ = Python::try_attach(|py| log(py, text));
    });
    module.add_class::<pvs::Pvs>()?;
    module.add_class::<client::Client>()?;
    module.add_function(wrap_pyfunction!(work::bake, module)?)?;
    module.add_function(wrap_pyfunction!(work::measure, module)?)?;
    module.add_function(wrap_pyfunction!(work::verify, module)?)
}

/// Gives a line to Python's logger "sightline".
fn log(py: Python<'_>, text: &str) -> PyResult<()> {
    let logger = py
        .import("logging")?
        .call_method1("getLogger", ("sightline",))?;
    let level = if text.starts_with("warning: ") {
        "warning"
    } else {
        "info"
    };
    let text = text.strip_prefix("warning: ").unwrap_or(text);
    logger.call_method1(level, ("%s", text)).map(drop)
}
