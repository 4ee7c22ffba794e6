//! Unique object names: the first object with a name keeps it, and later objects get `#2`, `#3`, … appended.

use std::collections::BTreeMap;

/// The names of all objects so far. Each name has the number that was last appended to it, or 1.
#[derive(Default)]
pub(super) struct UniqueNames {
    given: BTreeMap<String, u32>,
}

impl UniqueNames {
    /// Returns `wanted` if no object has this name, otherwise `wanted#n` with the smallest n that makes the
    /// name unique and was not tried before.
    pub(super) fn unique(&mut self, wanted: String) -> String {
        let Some(mut n) = self.given.get(&wanted).copied() else {
            self.given.insert(wanted.clone(), 1);
            return wanted;
        };
        loop {
            n = n.saturating_add(1);
            let candidate = format!("{wanted}#{n}");
            if !self.given.contains_key(&candidate) {
                self.given.insert(candidate.clone(), 1);
                self.given.insert(wanted, n);
                return candidate;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_names_are_numbered_around_taken_ones() {
        let mut n = UniqueNames::default();
        let got: Vec<_> = ["a", "a#2", "a", "a", "b"]
            .map(|s| n.unique(s.into()))
            .into();
        assert_eq!(got, ["a", "a#2", "a#3", "a#4", "b"]);
    }
}
