//! The choices of a job as values of arguments, with the names and help lines of
//! [`sightline_model::Choice`].

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use sightline_model::Choice;

/// A parser of the names of a choice.
pub fn choice<C: Choice>() -> impl TypedValueParser<Value = C> {
    let values = C::ALL
        .iter()
        .map(|c| PossibleValue::new(c.name()).help(c.about()));
    PossibleValuesParser::new(values).try_map(|name| C::from_name(&name))
}
