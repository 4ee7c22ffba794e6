//! The choices of a job as values of arguments, with the names and help lines of
//! [`sightline_model::NamedValue`].

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use sightline_model::NamedValue;

/// A parser of the names of a choice.
pub fn choice<C: NamedValue>() -> impl TypedValueParser<Value = C> {
    let values = C::ALL
        .iter()
        .map(|c| PossibleValue::new(c.name()).help(c.about()));
    PossibleValuesParser::new(values).try_map(|name| C::from_name(&name))
}
