//! The effect of triangles on sight lines: a triangle can block sight lines, and sight lines can show it.
//!
//! Every triangle has a [`SurfaceKind`]. A sight line ends at the first triangle that blocks. The sight line
//! shows each triangle on the line whose kind shows, including the blocking triangle at the end. A scene
//! stores the kinds as runs over its ids, each with the reason for the kind, and the user's rules that
//! determined some of them. Loaders determine the kinds ([`mod@crate::load`]); this module does not depend on
//! files.

use sightline_numbers::ids::TriangleId;

use crate::SceneError;

/// The effect of a triangle on sight lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum SurfaceKind {
    /// A triangle that blocks and shows: a wall.
    #[default]
    Opaque = 0,
    /// A triangle that shows and does not block: glass, or a mask with holes.
    SeeThrough = 1,
    /// A triangle that blocks and does not show: the proxy mesh of an engine's occlusion culling.
    OccluderOnly = 2,
    /// A triangle that neither blocks nor shows, because its position at run time is unknown: a character, or
    /// a door without `--doors`.
    Moving = 3,
    /// A triangle that blocks and shows at opaque texels of its alpha mask, and does neither at other texels
    /// ([`crate::masks`]): a fence, a leaf.
    Masked = 4,
    /// A triangle of a door, which neither blocks nor shows, like a moving triangle. The door can close an
    /// opening at run time.
    Door = 5,
    /// A triangle that neither blocks nor shows, because the file hides its node and viewers do not draw it.
    Hidden = 6,
}

impl SurfaceKind {
    /// The list of all kinds. The index of a kind is its number in files.
    pub const ALL: [Self; 7] = [
        Self::Opaque,
        Self::SeeThrough,
        Self::OccluderOnly,
        Self::Moving,
        Self::Masked,
        Self::Door,
        Self::Hidden,
    ];

    /// Returns the kind that blocks all sight lines or none, and that sets contain or do not contain.
    pub const fn new(blocks: bool, shows: bool) -> Self {
        match (blocks, shows) {
            (true, true) => Self::Opaque,
            (false, true) => Self::SeeThrough,
            (true, false) => Self::OccluderOnly,
            (false, false) => Self::Moving,
        }
    }

    /// Returns true if every sight line ends at a triangle of this kind. At a masked triangle only some sight
    /// lines end, so the result is false.
    pub const fn blocks(self) -> bool {
        matches!(self, Self::Opaque | Self::OccluderOnly)
    }

    /// Returns true if a triangle of this kind can be in a visibility set.
    pub const fn shows(self) -> bool {
        matches!(self, Self::Opaque | Self::SeeThrough | Self::Masked)
    }

    /// Returns the name of the kind in messages and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Opaque => "opaque",
            Self::SeeThrough => "see-through",
            Self::OccluderOnly => "occluder-only",
            Self::Moving => "moving",
            Self::Masked => "masked",
            Self::Door => "doors",
            Self::Hidden => "hidden",
        }
    }

    /// Returns the kind with the given name, or `None` if no kind has this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.name() == name)
    }
}

/// A rule of the user: objects and materials whose name matches a glob have the given kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KindRule {
    /// The kind of the matching triangles.
    pub kind: SurfaceKind,
    /// The glob with which the names of objects and materials are compared.
    pub glob: String,
}

/// A run of consecutive triangles of one kind, for one reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct KindRun {
    pub(crate) count: u32,
    pub(crate) kind: SurfaceKind,
    /// The index of the reason in [`Kinds::reasons`].
    pub(crate) reason: u32,
}

/// The number of triangles that have a kind for one reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KindCount {
    /// The kind of the triangles.
    pub kind: SurfaceKind,
    /// The reason, such as `alphaMode BLEND`.
    pub reason: String,
    /// The number of triangles with the kind and the reason.
    pub triangles: u64,
}

/// The kinds of all triangles of a scene, with their reasons.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kinds {
    /// The kind of each triangle, by id. Empty if all triangles are opaque.
    by_triangle: Vec<SurfaceKind>,
    pub(crate) runs: Vec<KindRun>,
    pub(crate) reasons: Vec<String>,
    pub(crate) rules: Vec<KindRule>,
    /// True if alpha textures determined the kinds of some triangles.
    pub(crate) alpha_textures: bool,
}

/// Maximum length of a reason or a glob, in bytes.
pub(crate) const MAX_TEXT: usize = 4096;

impl Kinds {
    /// Creates the kinds of a scene whose triangles are all opaque by default.
    pub fn opaque() -> Self {
        Self::default()
    }

    /// Creates kinds from runs of (number of triangles, kind, reason) in id order, and from the rules that
    /// determined some of these kinds.
    ///
    /// Adjacent runs of one kind and reason are joined. Without a rule, runs that are all opaque result in
    /// [`Kinds::opaque`].
    pub fn from_runs<R: AsRef<str>>(
        parts: impl IntoIterator<Item = (u32, SurfaceKind, R)>,
        rules: Vec<KindRule>,
    ) -> Self {
        Self::collect(parts, rules, false)
    }

    /// Creates kinds as [`Kinds::from_runs`] does, for a scene in which alpha textures determined some kinds.
    /// These triangles are masked, or their textures are uniform.
    pub fn from_textures<R: AsRef<str>>(
        parts: impl IntoIterator<Item = (u32, SurfaceKind, R)>,
        rules: Vec<KindRule>,
    ) -> Self {
        Self::collect(parts, rules, true)
    }

    fn collect<R: AsRef<str>>(
        parts: impl IntoIterator<Item = (u32, SurfaceKind, R)>,
        rules: Vec<KindRule>,
        alpha_textures: bool,
    ) -> Self {
        let mut runs: Vec<KindRun> = Vec::new();
        let mut reasons: Vec<String> = Vec::new();
        for (count, kind, reason) in parts.into_iter().filter(|p| p.0 > 0) {
            // A linear search is fast enough, because there are few reasons.
            let known = reasons.iter().position(|r| r == reason.as_ref());
            let reason = known.unwrap_or_else(|| {
                reasons.push(reason.as_ref().to_owned());
                reasons.len() - 1
            }) as u32;
            match runs.last_mut() {
                Some(last) if (last.kind, last.reason) == (kind, reason) => last.count += count,
                _ => runs.push(KindRun {
                    count,
                    kind,
                    reason,
                }),
            }
        }
        if rules.is_empty() && !alpha_textures && runs.iter().all(|r| r.kind == SurfaceKind::Opaque)
        {
            return Self::opaque();
        }
        Self {
            by_triangle: expanded(&runs),
            runs,
            reasons,
            rules,
            alpha_textures,
        }
    }

    /// Returns the kind of a triangle. Ids that the kinds do not cover are opaque.
    pub fn kind(&self, triangle: TriangleId) -> SurfaceKind {
        self.by_triangle
            .get(triangle.at())
            .copied()
            .unwrap_or_default()
    }

    /// Returns true if every triangle is opaque.
    pub fn all_opaque(&self) -> bool {
        self.by_triangle.is_empty()
    }

    /// Returns the kind of each triangle, by id. The slice is empty if all triangles are opaque.
    pub fn by_triangle(&self) -> &[SurfaceKind] {
        &self.by_triangle
    }

    /// Returns true if at least one triangle is masked, so that its texture determines the points that block.
    pub fn any_masked(&self) -> bool {
        self.runs.iter().any(|r| r.kind == SurfaceKind::Masked)
    }

    /// Returns true if alpha textures determined the kinds of some triangles.
    pub fn alpha_textures(&self) -> bool {
        self.alpha_textures
    }

    /// Returns the masked triangles as ascending ranges (first id, number of triangles). Adjacent ranges are
    /// joined.
    pub(crate) fn masked(&self) -> Vec<(u64, u64)> {
        let mut ranges: Vec<(u64, u64)> = Vec::new();
        let mut at = 0;
        for run in &self.runs {
            let count = u64::from(run.count);
            match ranges.last_mut() {
                _ if run.kind != SurfaceKind::Masked => {}
                Some((first, n)) if *first + *n == at => *n += count,
                _ => ranges.push((at, count)),
            }
            at += count;
        }
        ranges
    }

    /// Returns the user's rules that were applied, in order.
    pub fn rules(&self) -> &[KindRule] {
        &self.rules
    }

    /// Counts the triangles by kind and reason, sorted by kind, then in the order of the file. The result is
    /// empty if all triangles are opaque by default.
    pub fn counts(&self) -> Vec<KindCount> {
        let mut counts: Vec<KindCount> = Vec::new();
        for run in &self.runs {
            let reason = &self.reasons[run.reason as usize];
            match counts
                .iter_mut()
                .find(|c| c.kind == run.kind && c.reason == *reason)
            {
                Some(c) => c.triangles += u64::from(run.count),
                None => counts.push(KindCount {
                    kind: run.kind,
                    reason: reason.clone(),
                    triangles: u64::from(run.count),
                }),
            }
        }
        counts.sort_by_key(|c| c.kind);
        counts
    }

    /// Checks that the runs cover `triangles` ids, that each rule has a permitted kind, and that texts are
    /// short.
    pub(crate) fn check(&self, file: &str, triangles: u32) -> Result<(), SceneError> {
        let bad = |reason: String| {
            SceneError::bad(
                file,
                "kinds",
                reason,
                "upload the scene again with this version of the program",
            )
        };
        let covered: u64 = self.runs.iter().map(|r| u64::from(r.count)).sum();
        if !self.runs.is_empty() && covered != u64::from(triangles) {
            return Err(bad(format!(
                "the kinds cover {covered} triangles, but the scene has {triangles}"
            )));
        }
        if self.any_masked() && !self.alpha_textures {
            return Err(bad(
                "some triangles are masked, but no alpha texture was read".to_owned(),
            ));
        }
        if let Some(rule) = self
            .rules
            .iter()
            .find(|r| matches!(r.kind, SurfaceKind::Masked | SurfaceKind::Hidden))
        {
            let kind = rule.kind.name();
            return Err(bad(format!(
                "a rule sets the kind {kind}, which only a scene file can set"
            )));
        }
        let mut texts = self
            .reasons
            .iter()
            .chain(self.rules.iter().map(|r| &r.glob));
        if texts.any(|t| t.len() > MAX_TEXT) {
            return Err(bad(format!(
                "the reason for a kind, or the glob of a rule, is longer than {MAX_TEXT} bytes"
            )));
        }
        Ok(())
    }
}

/// Expands the runs to one kind for each triangle. The result is empty if all triangles are opaque.
fn expanded(runs: &[KindRun]) -> Vec<SurfaceKind> {
    if runs.iter().all(|r| r.kind == SurfaceKind::Opaque) {
        return Vec::new();
    }
    let mut kinds = Vec::with_capacity(runs.iter().map(|r| r.count as usize).sum());
    runs.iter()
        .for_each(|r| kinds.resize(kinds.len() + r.count as usize, r.kind));
    kinds
}

/// Appends the section of a scene's canonical bytes that contains the kinds. Little-endian: u32 R, then R
/// rules of (u8 kind, text); u32 S, then S reasons as texts; u32 K, then K runs of (u32 count, u8 kind, u32
/// index of the reason). A text is a u32 length in bytes and its UTF-8.
pub(crate) fn write(kinds: &Kinds, out: &mut Vec<u8>) {
    let text = |out: &mut Vec<u8>, t: &str| {
        out.extend_from_slice(&(t.len() as u32).to_le_bytes());
        out.extend_from_slice(t.as_bytes());
    };
    out.extend_from_slice(&(kinds.rules.len() as u32).to_le_bytes());
    for rule in &kinds.rules {
        out.push(rule.kind as u8);
        text(out, &rule.glob);
    }
    out.extend_from_slice(&(kinds.reasons.len() as u32).to_le_bytes());
    kinds.reasons.iter().for_each(|r| text(out, r));
    out.extend_from_slice(&(kinds.runs.len() as u32).to_le_bytes());
    for run in &kinds.runs {
        out.extend_from_slice(&run.count.to_le_bytes());
        out.push(run.kind as u8);
        out.extend_from_slice(&run.reason.to_le_bytes());
    }
}

/// Reads the section that [`write`] appends, and returns the kinds and the remaining bytes. `triangles` is
/// the number of triangles that the runs must cover.
pub(crate) fn read(
    bytes: &[u8],
    triangles: u32,
    alpha_textures: bool,
) -> Result<(Kinds, &[u8]), &'static str> {
    let mut r = KindsReader(bytes);
    let mut rules = Vec::new();
    for _ in 0..r.count(5)? {
        rules.push(KindRule {
            kind: r.kind()?,
            glob: r.text()?,
        });
    }
    let mut reasons = Vec::new();
    for _ in 0..r.count(4)? {
        reasons.push(r.text()?);
    }
    let mut runs = Vec::new();
    let mut covered = 0u64;
    for _ in 0..r.count(9)? {
        let run = KindRun {
            count: r.u32()?,
            kind: r.kind()?,
            reason: r.u32()?,
        };
        covered += u64::from(run.count);
        if run.count == 0 || covered > u64::from(triangles) {
            return Err("a run of kinds is empty or reaches beyond the triangles");
        }
        if run.reason as usize >= reasons.len() {
            return Err("a run of kinds refers to a reason that does not exist");
        }
        runs.push(run);
    }
    if covered != u64::from(triangles) {
        return Err("the kinds do not cover all triangles");
    }
    // Each scene has one encoding: no run is split, every reason is used, and opaque scenes have no kinds.
    let parts = runs
        .iter()
        .map(|r| (r.count, r.kind, &reasons[r.reason as usize]));
    let kinds = Kinds::collect(parts, rules, alpha_textures);
    if kinds.runs != runs || kinds.reasons != reasons {
        return Err("the kinds are not in their canonical form");
    }
    Ok((kinds, r.0))
}

/// A reader of numbers and texts, which checks every count against the remaining bytes.
struct KindsReader<'a>(&'a [u8]);

impl KindsReader<'_> {
    fn u32(&mut self) -> Result<u32, &'static str> {
        let (head, rest) = self
            .0
            .split_first_chunk::<4>()
            .ok_or("the kinds are cut short")?;
        self.0 = rest;
        Ok(u32::from_le_bytes(*head))
    }

    /// Reads the number of the following elements, which have at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, &'static str> {
        let n = self.u32()? as usize;
        if n > self.0.len() / least {
            Err("the kinds announce more elements than the remaining bytes can contain")
        } else {
            Ok(n)
        }
    }

    fn kind(&mut self) -> Result<SurfaceKind, &'static str> {
        let (number, rest) = self.0.split_first().ok_or("the kinds are cut short")?;
        self.0 = rest;
        SurfaceKind::ALL
            .get(usize::from(*number))
            .copied()
            .ok_or("the number of a kind is above 6")
    }

    fn text(&mut self) -> Result<String, &'static str> {
        let n = self.count(1)?;
        if n > MAX_TEXT {
            return Err("the reason for a kind, or the glob of a rule, is too long");
        }
        let (text, rest) = self.0.split_at(n);
        self.0 = rest;
        String::from_utf8(text.to_vec())
            .map_err(|_| "the reason for a kind, or the glob of a rule, is not UTF-8")
    }
}

#[cfg(test)]
#[path = "kinds_tests.rs"]
mod tests;
