//! Named values as arguments of a command line, with the names and help lines of [`NamedValue`].

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use sightline_model::NamedValue;

/// Returns the parser of the names of a value.
pub fn named<V: NamedValue>() -> impl TypedValueParser<Value = V> {
    let values = V::ALL
        .iter()
        .map(|v| PossibleValue::new(v.name()).help(v.about()));
    PossibleValuesParser::new(values).try_map(|name| V::from_name(&name))
}
