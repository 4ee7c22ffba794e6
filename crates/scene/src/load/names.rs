//! Unique object names: the first object of a name keeps it, later ones get `#2`, `#3`, … appended.

use std::collections::BTreeMap;

/// Names given so far, each with the number last appended to it.
#[derive(Default)]
pub(super) struct Names {
    given: BTreeMap<String, u32>,
}

impl Names {
    /// `wanted` itself if it is free, else `wanted#n` for the least free n not tried before.
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
        let mut n = Names::default();
        let got: Vec<_> = ["a", "a#2", "a", "a", "b"]
            .map(|s| n.unique(s.into()))
            .into();
        assert_eq!(got, ["a", "a#2", "a#3", "a#4", "b"]);
    }
}
