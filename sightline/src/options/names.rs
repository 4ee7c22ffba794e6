//! The names of the options, as the command line spells them.

/// The names of all options, without dashes.
const NAMES: [&str; 39] = [
    "method",
    "certificates",
    "cells",
    "cell-size",
    "triangle-budget",
    "max-depth",
    "cell-budget",
    "byte-budget",
    "fine",
    "cost",
    "sampler",
    "target-error",
    "max-error",
    "time-budget",
    "block-cells",
    "rays",
    "credit",
    "granularity",
    "complete",
    "min-share",
    "contributions",
    "far",
    "cell-to-cell",
    "view-box",
    "view-mesh",
    "eye-heights",
    "viewpoints",
    "reach",
    "reachable-from",
    "up",
    "resolution",
    "error-threshold",
    "interior-threshold",
    "error-measure",
    "min-distance",
    "no-solids",
    "superset",
    "backend",
    "seed",
];

/// Returns the option whose name in JSON is `json`, or `None` for an unknown name.
pub(super) fn option_named(json: &str) -> Option<&'static str> {
    NAMES
        .into_iter()
        .find(|option| option.replace('-', "_") == json)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::JobOptions;

    #[test]
    fn fields_have_option_names() {
        let fields = serde_json::to_value(JobOptions::default()).unwrap();
        let fields = fields.as_object().unwrap();
        assert_eq!(fields.len(), NAMES.len());
        for field in fields.keys() {
            assert!(option_named(field).is_some(), "{field}");
        }
    }

    #[test]
    fn wrong_options_are_named() {
        for (json, option) in [
            (serde_json::json!({"cells": [8, 8]}), Some("cells")),
            (serde_json::json!({"method": "guess"}), Some("method")),
            (
                serde_json::json!({"time_budget": "soon"}),
                Some("time-budget"),
            ),
            (serde_json::json!({"seeds": 1}), None),
        ] {
            let error = JobOptions::from_json(&json).unwrap_err();
            assert_eq!(error.option(), option, "{error}");
        }
    }
}
