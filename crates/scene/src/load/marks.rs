//! The kinds and sides of triangles that a loader finds, and the user's rules, which have precedence over the
//! file.

use std::borrow::Cow;
use std::collections::BTreeSet;

use globset::{GlobBuilder, GlobMatcher};

use crate::SceneError;
use crate::kinds::{KindRule, Kinds, MAX_TEXT, SurfaceKind};
use crate::masks::Masks;
use crate::sides::{Side, Sides};

/// The reason of triangles whose kind neither the file nor a rule determines.
const DEFAULT: &str = "by default";
/// Minimum Jaro-Winkler similarity (0 to 1) between a glob without a match and a name that the warning lists.
const NEAR: f64 = 0.8;
/// Maximum number of names that a warning lists for a glob without a match.
const MOST_NEAR: usize = 3;

/// The kind of some triangles, and the reason for this kind.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mark {
    pub(super) kind: SurfaceKind,
    pub(super) reason: Cow<'static, str>,
}

impl Mark {
    /// The mark of opaque triangles whose kind neither the file nor a rule determines.
    pub(super) const DEFAULT: Self = Self {
        kind: SurfaceKind::Opaque,
        reason: Cow::Borrowed(DEFAULT),
    };
    /// The mark of triangles that the file hides. No rule changes this kind.
    pub(super) const HIDDEN: Self = Self::new(SurfaceKind::Hidden, "KHR_node_visibility");

    /// Creates the mark of a kind for a reason that the program defines.
    pub(super) const fn new(kind: SurfaceKind, reason: &'static str) -> Self {
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

/// Compiles the matcher of a glob. `*` matches any characters, including `/`, because the names of objects
/// contain `/`.
fn matcher(glob: &str) -> Result<GlobMatcher, String> {
    let built = GlobBuilder::new(glob)
        .literal_separator(false)
        .backslash_escape(true)
        .build();
    built
        .map(|g| g.compile_matcher())
        .map_err(|e| e.kind().to_string())
}

impl KindRule {
    /// Creates the rule that triangles whose object or material matches `glob` have the given kind.
    ///
    /// # Errors
    /// A description of the fault if the glob is invalid.
    pub fn new(kind: SurfaceKind, glob: &str) -> Result<Self, String> {
        if glob.len() > MAX_TEXT {
            return Err(format!("the glob is longer than {MAX_TEXT} bytes"));
        }
        matcher(glob).map(|_| Self {
            kind,
            glob: glob.to_owned(),
        })
    }
}

/// The kinds and the sides of a scene's triangles, which are collected in id order.
pub(super) struct Marks {
    rules: Vec<(KindRule, GlobMatcher, Hit)>,
    /// All names of objects, nodes, meshes and materials, if there are rules. A warning about a glob without
    /// a match lists similar names.
    names: BTreeSet<String>,
    runs: Vec<(u32, Mark)>,
    /// Two flags: true if the textures of masked materials are read, and true if a material requested its
    /// texture.
    alpha: (bool, bool),
    masks: Masks,
    sides: Vec<(u32, Side)>,
    warnings: Vec<String>,
}

impl Marks {
    /// Creates empty marks with the user's rules. `file` appears in errors.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if a rule's glob is invalid.
    pub(super) fn new(
        file: &str,
        rules: &[KindRule],
        alpha_textures: bool,
    ) -> Result<Self, SceneError> {
        let compiled = rules.iter().map(|rule| {
            let matcher = matcher(&rule.glob).map_err(|why| {
                SceneError::bad(
                    file,
                    format!("rule --{} {:?}", rule.kind.name(), rule.glob),
                    why,
                    "correct the glob",
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

    /// Adds the next `count` triangles, whose object, node, mesh and material have these names.
    ///
    /// The triangles get `mark`, the mark of the file, unless a rule matches a name. If several rules match,
    /// the last of these rules applies.
    pub(super) fn push(&mut self, count: u32, names: &[&str], mark: &Mark) {
        let decided = self.decide(names, mark.clone());
        self.add(count, &decided);
    }

    /// Returns the mark of the last rule that matches one of these names, or `mark` if no rule does or the
    /// file hides the triangles.
    pub(super) fn decide(&mut self, names: &[&str], mark: Mark) -> Mark {
        let hidden = mark.kind == SurfaceKind::Hidden;
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

    /// Adds the next `count` triangles with `mark`, without applying the rules.
    pub(super) fn add(&mut self, count: u32, mark: &Mark) {
        match self.runs.last_mut() {
            Some((n, last)) if last == mark => *n += count,
            _ => self.runs.push((count, mark.clone())),
        }
    }

    /// Returns true if the textures of masked materials are read.
    pub(super) fn reads_alpha(&self) -> bool {
        self.alpha.0
    }

    /// Records that a masked material requested its alpha texture.
    pub(super) fn met_alpha(&mut self) {
        self.alpha.1 = true;
    }

    /// Sets the masks of the triangles whose kind is masked.
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

    /// Returns the sides of the scene's `triangles` triangles.
    ///
    /// Formats without double-sided materials and without transforms specify no sides. Lines meet the
    /// triangles of these formats from the side from which the vertices run counter-clockwise.
    pub(super) fn sides(&self, triangles: u32) -> Sides {
        let given: u32 = self.sides.iter().map(|(count, _)| count).sum();
        let others = (triangles.saturating_sub(given), Side::CounterClockwise);
        Sides::from_runs(self.sides.iter().copied().chain([others]))
    }

    /// Adds a warning unless it was added before.
    pub(super) fn warn(&mut self, text: impl Into<String>) {
        let text = text.into();
        if !self.warnings.contains(&text) {
            self.warnings.push(text);
        }
    }

    /// Returns the kinds, the masks of masked triangles, and the warnings.
    pub(super) fn finish(mut self) -> (Kinds, Masks, Vec<String>) {
        if self.alpha == (true, false) {
            self.warnings.push(
                "--alpha-textures has no effect: no triangle has a glTF material with alphaMode \
                 MASK that decides its kind"
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
                        false => format!("; similar names: {}", near.join(", ")),
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

/// Finds the names that are most similar to a glob without its wildcards.
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
    use sightline_numbers::ids::TriangleId;

    fn rule(kind: SurfaceKind, glob: &str) -> KindRule {
        KindRule::new(kind, glob).unwrap()
    }

    #[test]
    fn last_matching_rule_has_precedence_over_file() {
        let rules = [
            rule(SurfaceKind::Opaque, "*"),
            rule(SurfaceKind::SeeThrough, "glass*"),
            rule(SurfaceKind::Moving, "Windw"),
        ];
        let mut marks = Marks::new("test", &rules, false).unwrap();
        marks.push(3, &["hall/window#0", "glass pane"], &Mark::DEFAULT);
        marks.push(
            2,
            &["hall/wall#0", "brick"],
            &Mark::new(SurfaceKind::Moving, "animated node"),
        );
        let (kinds, _, warnings) = marks.finish();
        assert_eq!(
            (0..5)
                .map(|t| kinds.kind(TriangleId(t)) as u8)
                .collect::<Vec<_>>(),
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
    fn glob_without_match_lists_similar_names() {
        let mut marks =
            Marks::new("test", &[rule(SurfaceKind::SeeThrough, "windos*")], false).unwrap();
        marks.push(1, &["windows", "door"], &Mark::DEFAULT);
        assert!(marks.finish().2[0].ends_with("similar names: windows"));
        assert!(KindRule::new(SurfaceKind::Opaque, "a[").is_err());
    }

    #[test]
    fn default_marks_result_in_opaque_kinds() {
        let mut marks = Marks::new("test", &[], false).unwrap();
        marks.push(4, &["a"], &Mark::DEFAULT);
        assert_eq!(marks.finish(), (Kinds::opaque(), Masks::none(), Vec::new()));
    }
}
