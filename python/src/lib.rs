//! The native part of the Python package: results as numpy arrays, and the functions of the library.
//!
//! The public part is in `python/sightline`. The public part checks the types of arguments and passes the
//! arguments to the native part as JSON.

mod client;
mod errors;
mod mesh;
mod pvs;
mod runner;
mod work;

use pyo3::prelude::*;

#[pymodule]
fn _sightline(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<pvs::Pvs>()?;
    module.add_class::<client::Client>()?;
    module.add_function(wrap_pyfunction!(work::bake, module)?)?;
    module.add_function(wrap_pyfunction!(work::plan, module)?)?;
    module.add_function(wrap_pyfunction!(work::tile, module)?)?;
    module.add_function(wrap_pyfunction!(work::assemble, module)?)?;
    module.add_function(wrap_pyfunction!(work::cells, module)?)?;
    module.add_function(wrap_pyfunction!(work::unite, module)?)?;
    module.add_function(wrap_pyfunction!(work::measure, module)?)?;
    module.add_function(wrap_pyfunction!(work::verify, module)?)
}
