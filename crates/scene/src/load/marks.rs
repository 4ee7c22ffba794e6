//! The kinds and sides of triangles that a loader finds, and the rules of the user, which go before the file.

use std::borrow::Cow;
use std::collections::BTreeSet;

use globset::{GlobBuilder, GlobMatcher};

use crate::SceneError;
use crate::kinds::{Kind, Kinds, MAX_TEXT, Rule};
use crate::masks::Masks;
use crate::sides::{Side, Sides};

/// The reason of triangles about which neither file nor rule says anything.
const DEFAULT: &str = "by default";
/// A name is near a glob when at most this part of the letters differ (Jaro-Winkler).
const NEAR: f64 = 0.8;
/// Most names listed beside a glob that matches nothing.
const MOST_NEAR: usize = 3;

/// A kind with its reason.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mark {
    pub(super) kind: Kind,
    pub(super) reason: Cow<'static, str>,
}

impl Mark {
    /// Opaque, because nothing says otherwise.
    pub(super) const DEFAULT: Self = Self {
        kind: Kind::Opaque,
        reason: Cow::Borrowed(DEFAULT),
    };
    /// Hidden by the file. No rule changes this kind.
    pub(super) const HIDDEN: Self = Self::of(Kind::Hidden, "KHR_node_visibility");

    /// A kind for a reason that the program knows.
    pub(super) const fn of(kind: Kind, reason: &'static str) -> Self {
        Self {
            kind,
            reason: Cow::Borrowed(reason),
        }
    }
}

/// The names that a rule has matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Hit {
    /// The rule has matched no name.
    Nothing,
    /// The rule has matched names of hidden triangles only, which it does not change.
    Hidden,
    /// The rule has matched names of other triangles.
    Shown,
}

/// The matcher of a glob. `*` matches any characters, `/` included, since names of objects contain it.
fn matcher(glob: &str) -> Result<GlobMatcher, String> {
    let built = GlobBuilder::new(glob)
        .literal_separator(false)
        .backslash_escape(true)
        .build();
    built
        .map(|g| g.compile_matcher())
        .map_err(|e| e.kind().to_string())
}

impl Rule {
    /// A rule, if the glob is one.
    ///
    /// # Errors
    /// The fault of the glob in words.
    pub fn new(kind: Kind, glob: &str) -> Result<Self, String> {
        if glob.len() > MAX_TEXT {
            return Err(format!("a glob has at most {MAX_TEXT} bytes"));
        }
        matcher(glob).map(|_| Self {
            kind,
            glob: glob.to_owned(),
        })
    }
}

/// Collects the kinds and the sides of a scene's triangles, in id order.
pub(super) struct Marks {
    rules: Vec<(Rule, GlobMatcher, Hit)>,
    /// All names, when there are rules: for the names near a glob that matches nothing.
    names: BTreeSet<String>,
    runs: Vec<(u32, Mark)>,
    /// Whether the textures of masked materials are read, and whether a material asked for that.
    alpha: (bool, bool),
    masks: Masks,
    sides: Vec<(u32, Side)>,
    warnings: Vec<String>,
}

impl Marks {
    /// # Errors
    /// [`SceneError::Bad`] when a rule's glob is none.
    pub(super) fn new(
        file: &str,
        rules: &[Rule],
        alpha_textures: bool,
    ) -> Result<Self, SceneError> {
        let compiled = rules.iter().map(|rule| {
            let matcher = matcher(&rule.glob).map_err(|why| {
                SceneError::bad(
                    file,
                    format!("rule --{} {:?}", rule.kind.name(), rule.glob),
                    why,
                    "mend the glob",
                )
            })?;
            Ok((rule.clone(), matcher, Hit::Nothing))
        });
        Ok(Self {
            rules: compiled.collect::<Result<_, SceneError>>()?,
            names: BTreeSet::new(),
            runs: Vec::new(),
            alpha: (alpha_textures, false),
            masks: Masks::none(),
            sides: Vec::new(),
            warnings: Vec::new(),
        })
    }

    /// Adds the next `count` triangles, which have these names (object, node, mesh, material), and the mark
    /// of the file unless a rule matches a name. Of several rules the last one counts.
    pub(super) fn push(&mut self, count: u32, names: &[&str], mark: &Mark) {
        let decided = self.decide(names, mark.clone());
        self.add(count, &decided);
    }

    /// Returns the mark of the last rule that matches one of these names, or `mark` if no rule does or the
    /// file hides the triangles.
    pub(super) fn decide(&mut self, names: &[&str], mark: Mark) -> Mark {
        let hidden = mark.kind == Kind::Hidden;
        let mut decided: Option<usize> = None;
        if !self.rules.is_empty() {
            for name in names.iter().copied().filter(|n| !n.is_empty()) {
                for (at, (_, matcher, hit)) in self.rules.iter_mut().enumerate() {
                    if matcher.is_match(name) {
                        *hit = (*hit).max(if hidden { Hit::Hidden } else { Hit::Shown });
                        decided = decided.max(Some(at));
                    }
                }
                if !self.names.contains(name) {
                    self.names.insert(name.to_owned());
                }
            }
        }
        match decided.filter(|_| !hidden) {
            None => mark,
            Some(at) => {
                let rule = &self.rules[at].0;
                Mark {
                    kind: rule.kind,
                    reason: format!("--{} {}", rule.kind.name(), rule.glob).into(),
                }
            }
        }
    }

    /// Adds the next `count` triangles with a mark.
    pub(super) fn add(&mut self, count: u32, mark: &Mark) {
        match self.runs.last_mut() {
            Some((n, last)) if last == mark => *n += count,
            _ => self.runs.push((count, mark.clone())),
        }
    }

    /// Whether the textures of masked materials are read.
    pub(super) fn reads_alpha(&self) -> bool {
        self.alpha.0
    }

    /// Notes that a material's mask was asked for.
    pub(super) fn met_alpha(&mut self) {
        self.alpha.1 = true;
    }

    /// The masks of the triangles that are marked as masked.
    pub(super) fn set_masks(&mut self, masks: Masks) {
        self.masks = masks;
    }

    /// Adds the side of the next `count` triangles.
    pub(super) fn push_side(&mut self, count: u32, side: Side) {
        match self.sides.last_mut() {
            Some((n, last)) if *last == side => *n += count,
            _ => self.sides.push((count, side)),
        }
    }

    /// The sides of the scene's `triangles` triangles. Formats without materials of two sides and without
    /// transforms give none; their triangles are all met from where their vertices run counter-clockwise.
    pub(super) fn sides(&self, triangles: u32) -> Sides {
        let given: u32 = self.sides.iter().map(|(count, _)| count).sum();
        let others = (triangles.saturating_sub(given), Side::CounterClockwise);
        Sides::from_runs(self.sides.iter().copied().chain([others]))
    }

    /// Adds a warning, once.
    pub(super) fn warn(&mut self, text: impl Into<String>) {
        let text = text.into();
        if !self.warnings.contains(&text) {
            self.warnings.push(text);
        }
    }

    /// The kinds, the masks of masked triangles, and the warnings.
    pub(super) fn finish(mut self) -> (Kinds, Masks, Vec<String>) {
        if self.alpha == (true, false) {
            self.warnings.push(
                "--alpha-textures changes nothing: no triangle has a glTF material with alphaMode MASK that \
                 decides its kind"
                    .to_owned(),
            );
        }
        for (rule, _, hit) in &self.rules {
            let flag = format!("--{} {:?}", rule.kind.name(), rule.glob);
            match hit {
                Hit::Shown => {}
                Hit::Hidden => self.warnings.push(format!(
                    "{flag} matches hidden nodes only, which neither block nor show; make them visible in \
                     the file (KHR_node_visibility)"
                )),
                Hit::Nothing => {
                    let near = near(&rule.glob, &self.names);
                    let near = match near.is_empty() {
                        true => String::new(),
                        false => format!("; names like it: {}", near.join(", ")),
                    };
                    self.warnings.push(format!("{flag} matches no object and no material{near}"));
                }
            }
        }
        let rules = self.rules.into_iter().map(|(rule, ..)| rule).collect();
        let runs = self
            .runs
            .iter()
            .map(|(count, mark)| (*count, mark.kind, &mark.reason));
        let kinds = if self.alpha.1 {
            Kinds::from_textures(runs, rules)
        } else {
            Kinds::from_runs(runs, rules)
        };
        (kinds, self.masks, self.warnings)
    }
}

/// The names most like a glob without its wildcards.
fn near(glob: &str, names: &BTreeSet<String>) -> Vec<String> {
    let plain = glob.replace(['*', '?'], "").to_lowercase();
    let mut rated: Vec<(f64, &String)> = names
        .iter()
        .map(|n| (strsim::jaro_winkler(&plain, &n.to_lowercase()), n))
        .collect();
    rated.retain(|(similarity, _)| *similarity >= NEAR);
    rated.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
    rated
        .into_iter()
        .take(MOST_NEAR)
        .map(|(_, n)| n.chars().take(80).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(kind: Kind, glob: &str) -> Rule {
        Rule::new(kind, glob).unwrap()
    }

    #[test]
    fn the_last_rule_that_matches_a_name_goes_before_the_file() {
        let rules = [
            rule(Kind::Opaque, "*"),
            rule(Kind::SeeThrough, "glass*"),
            rule(Kind::Moving, "Windw"),
        ];
        let mut marks = Marks::new("test", &rules, false).unwrap();
        marks.push(3, &["hall/window#0", "glass pane"], &Mark::DEFAULT);
        marks.push(
            2,
            &["hall/wall#0", "brick"],
            &Mark::of(Kind::Moving, "animated node"),
        );
        let (kinds, _, warnings) = marks.finish();
        assert_eq!(
            (0..5).map(|t| kinds.kind(t) as u8).collect::<Vec<_>>(),
            [1, 1, 1, 0, 0]
        );
        assert_eq!(kinds.counts()[1].reason, "--see-through glass*");
        assert_eq!(kinds.rules(), rules);
        assert_eq!(warnings.len(), 1);
        assert!(
            warnings[0].starts_with("--moving \"Windw\" matches no object"),
            "{warnings:?}"
        );
    }

    #[test]
    fn a_glob_that_matches_nothing_is_answered_with_names_like_it() {
        let mut marks = Marks::new("test", &[rule(Kind::SeeThrough, "windos*")], false).unwrap();
        marks.push(1, &["windows", "door"], &Mark::DEFAULT);
        assert!(marks.finish().2[0].ends_with("names like it: windows"));
        assert!(Rule::new(Kind::Opaque, "a[").is_err());
    }

    #[test]
    fn without_marks_all_triangles_are_opaque_and_no_kind_is_kept() {
        let mut marks = Marks::new("test", &[], false).unwrap();
        marks.push(4, &["a"], &Mark::DEFAULT);
        assert_eq!(marks.finish(), (Kinds::opaque(), Masks::none(), Vec::new()));
    }
}
