//! Parsers of named values in command lines, with the names and help lines of [`NamedValue`].

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use sightline_model::NamedValue;

/// Returns a clap parser that accepts the names of all values of `V`.
pub fn named<V: NamedValue>() -> impl TypedValueParser<Value = V> {
    let values = V::ALL
        .iter()
        .map(|v| PossibleValue::new(v.name()).help(v.about()));
    PossibleValuesParser::new(values).try_map(|name| V::from_name(&name))
}
