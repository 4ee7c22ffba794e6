//! The choices of a job as values of arguments. Their names and help lines are those of
//! [`sightline_model::Choice`].

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use sightline_model::Choice;

/// Reads the name of a choice.
pub fn choice<C: Choice>() -> impl TypedValueParser<Value = C> {
    let values = C::ALL.iter().map(|c| PossibleValue::new(c.name()).help(c.about()));
    PossibleValuesParser::new(values).try_map(|name| C::from_name(&name))
}
