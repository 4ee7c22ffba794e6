//! Assembly: the outputs of tiles become the sections of a result.

pub(crate) mod columns;
pub(crate) mod openness;
pub(crate) mod pairs;
pub(crate) mod result;
