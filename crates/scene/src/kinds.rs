//! What a triangle does to sight lines: whether it blocks them, and whether they show it.
//!
//! Every triangle has a [`Kind`]. A sight line ends at the first triangle that blocks, and shows each
//! triangle on it that shows, the blocking one at its end included. A scene keeps the kinds as runs over its
//! ids, each with the reason for the kind, and the rules of the user that decided some of them. Loaders find
//! the kinds ([`mod@crate::load`]); this module knows nothing of files.

use crate::SceneError;

/// What a triangle does to sight lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Kind {
    /// Blocks and shows: a wall.
    #[default]
    Opaque = 0,
    /// Shows and does not block: glass, or a mask with holes.
    SeeThrough = 1,
    /// Blocks and does not show: the proxy mesh of an engine's occlusion culling.
    OccluderOnly = 2,
    /// Neither blocks nor shows, because its place at run time is unknown: a door, a character.
    Moving = 3,
    /// Shows, and blocks where the texel of its alpha mask does ([`crate::masks`]): a fence, a leaf.
    Masked = 4,
    /// Neither blocks nor shows, as what moves, and its place is an opening that can be shut at run time.
    Door = 5,
    /// Neither blocks nor shows, because the file hides its node, and viewers do not draw it.
    Hidden = 6,
}

impl Kind {
    /// All kinds, by number.
    pub const ALL: [Self; 7] = [
        Self::Opaque,
        Self::SeeThrough,
        Self::OccluderOnly,
        Self::Moving,
        Self::Masked,
        Self::Door,
        Self::Hidden,
    ];

    /// The kind that blocks and shows as given, everywhere.
    pub const fn of(blocks: bool, shows: bool) -> Self {
        match (blocks, shows) {
            (true, true) => Self::Opaque,
            (false, true) => Self::SeeThrough,
            (true, false) => Self::OccluderOnly,
            (false, false) => Self::Moving,
        }
    }

    /// Whether every sight line ends at the triangle. Of a masked triangle only some do.
    pub const fn blocks(self) -> bool {
        matches!(self, Self::Opaque | Self::OccluderOnly)
    }

    /// Whether the triangle can be in a visibility set.
    pub const fn shows(self) -> bool {
        matches!(self, Self::Opaque | Self::SeeThrough | Self::Masked)
    }

    /// The name in messages and files.
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

    /// The kind with a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.name() == name)
    }
}

/// A rule of the user: objects and materials whose name matches a glob have a kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rule {
    /// The kind.
    pub kind: Kind,
    /// The glob.
    pub glob: String,
}

/// Consecutive triangles of one kind, for one reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Run {
    pub(crate) count: u32,
    pub(crate) kind: Kind,
    /// Index in [`Kinds::reasons`].
    pub(crate) reason: u32,
}

/// How many triangles have a kind for one reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KindCount {
    /// The kind.
    pub kind: Kind,
    /// The reason, such as `alphaMode BLEND`.
    pub reason: String,
    /// Number of triangles.
    pub triangles: u64,
}

/// The kinds of all triangles of a scene, with their reasons.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kinds {
    /// By triangle; empty when all triangles are opaque.
    of: Vec<Kind>,
    pub(crate) runs: Vec<Run>,
    pub(crate) reasons: Vec<String>,
    pub(crate) rules: Vec<Rule>,
    /// Whether alpha textures decided about some triangles.
    pub(crate) alpha_textures: bool,
}

/// Most bytes of a reason or a glob.
pub(crate) const MAX_TEXT: usize = 4096;

impl Kinds {
    /// All triangles opaque, as no file or rule says otherwise.
    pub fn opaque() -> Self {
        Self::default()
    }

    /// The kinds given by runs of (number of triangles, kind, reason) in id order, and the rules that decided
    /// some of them.
    ///
    /// Adjacent runs of one kind and reason are joined. Without a rule, runs that are all opaque give
    /// [`Kinds::opaque`].
    pub fn from_runs<R: AsRef<str>>(
        parts: impl IntoIterator<Item = (u32, Kind, R)>,
        rules: Vec<Rule>,
    ) -> Self {
        Self::collect(parts, rules, false)
    }

    /// The same where alpha textures decided about some triangles, be they masked or alike everywhere.
    pub fn from_textures<R: AsRef<str>>(
        parts: impl IntoIterator<Item = (u32, Kind, R)>,
        rules: Vec<Rule>,
    ) -> Self {
        Self::collect(parts, rules, true)
    }

    fn collect<R: AsRef<str>>(
        parts: impl IntoIterator<Item = (u32, Kind, R)>,
        rules: Vec<Rule>,
        alpha_textures: bool,
    ) -> Self {
        let mut runs: Vec<Run> = Vec::new();
        let mut reasons: Vec<String> = Vec::new();
        for (count, kind, reason) in parts.into_iter().filter(|p| p.0 > 0) {
            // There are few reasons.
            let known = reasons.iter().position(|r| r == reason.as_ref());
            let reason = known.unwrap_or_else(|| {
                reasons.push(reason.as_ref().to_owned());
                reasons.len() - 1
            }) as u32;
            match runs.last_mut() {
                Some(last) if (last.kind, last.reason) == (kind, reason) => last.count += count,
                _ => runs.push(Run {
                    count,
                    kind,
                    reason,
                }),
            }
        }
        if rules.is_empty() && !alpha_textures && runs.iter().all(|r| r.kind == Kind::Opaque) {
            return Self::opaque();
        }
        Self {
            of: expanded(&runs),
            runs,
            reasons,
            rules,
            alpha_textures,
        }
    }

    /// The kind of a triangle.
    pub fn kind(&self, triangle: u32) -> Kind {
        self.of.get(triangle as usize).copied().unwrap_or_default()
    }

    /// Whether every triangle is opaque.
    pub fn all_opaque(&self) -> bool {
        self.of.is_empty()
    }

    /// The kinds by triangle; empty when all triangles are opaque.
    pub fn by_triangle(&self) -> &[Kind] {
        &self.of
    }

    /// Whether a triangle is masked, so that only its texture says where it blocks.
    pub fn any_masked(&self) -> bool {
        self.runs.iter().any(|r| r.kind == Kind::Masked)
    }

    /// Whether alpha textures decided about some triangles.
    pub fn alpha_textures(&self) -> bool {
        self.alpha_textures
    }

    /// The masked triangles as ranges (first, count), ascending; adjacent ranges are joined.
    pub(crate) fn masked(&self) -> Vec<(u64, u64)> {
        let mut ranges: Vec<(u64, u64)> = Vec::new();
        let mut at = 0;
        for run in &self.runs {
            let count = u64::from(run.count);
            match ranges.last_mut() {
                _ if run.kind != Kind::Masked => {}
                Some((first, n)) if *first + *n == at => *n += count,
                _ => ranges.push((at, count)),
            }
            at += count;
        }
        ranges
    }

    /// The rules of the user that were applied, in order.
    pub fn rules(&self) -> &[Rule] {
        &self.rules
    }

    /// How many triangles have which kind for which reason, by kind, then in the order of the file. Empty
    /// when nothing but the default makes the triangles opaque.
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

    /// Checks that the runs cover `triangles` ids and that texts are short.
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
                "they are given for {covered} triangles of {triangles}"
            )));
        }
        if self.any_masked() && !self.alpha_textures {
            return Err(bad(
                "triangles are masked, but no texture was read".to_owned()
            ));
        }
        if let Some(rule) = self
            .rules
            .iter()
            .find(|r| matches!(r.kind, Kind::Masked | Kind::Hidden))
        {
            let kind = rule.kind.name();
            return Err(bad(format!(
                "a rule makes triangles {kind}, which only a file does"
            )));
        }
        let mut texts = self
            .reasons
            .iter()
            .chain(self.rules.iter().map(|r| &r.glob));
        if texts.any(|t| t.len() > MAX_TEXT) {
            return Err(bad(format!(
                "a reason or a glob is longer than {MAX_TEXT} bytes"
            )));
        }
        Ok(())
    }
}

/// The runs as one kind for each triangle; empty when all are opaque.
fn expanded(runs: &[Run]) -> Vec<Kind> {
    if runs.iter().all(|r| r.kind == Kind::Opaque) {
        return Vec::new();
    }
    let mut kinds = Vec::with_capacity(runs.iter().map(|r| r.count as usize).sum());
    runs.iter()
        .for_each(|r| kinds.resize(kinds.len() + r.count as usize, r.kind));
    kinds
}

/// Appends the section of a scene's canonical bytes. Little-endian: u32 R, then R rules of (u8 kind, text);
/// u32 S, then S reasons as texts; u32 K, then K runs of (u32 count, u8 kind, u32 reason). A text is a u32
/// length and its UTF-8.
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

/// Reads the section that [`write`] appends, and returns the bytes after it. `triangles` bounds the runs.
pub(crate) fn read(
    bytes: &[u8],
    triangles: u32,
    alpha_textures: bool,
) -> Result<(Kinds, &[u8]), &'static str> {
    let mut r = KindsReader(bytes);
    let mut rules = Vec::new();
    for _ in 0..r.count(5)? {
        rules.push(Rule {
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
        let run = Run {
            count: r.u32()?,
            kind: r.kind()?,
            reason: r.u32()?,
        };
        covered += u64::from(run.count);
        if run.count == 0 || covered > u64::from(triangles) {
            return Err("a run of kinds is empty or reaches beyond the triangles");
        }
        if run.reason as usize >= reasons.len() {
            return Err("a run of kinds names a reason that is not there");
        }
        runs.push(run);
    }
    if covered != u64::from(triangles) {
        return Err("the kinds do not cover all triangles");
    }
    // One scene has one encoding: no run is split, no reason unused, and opaque scenes have no kinds.
    let parts = runs
        .iter()
        .map(|r| (r.count, r.kind, &reasons[r.reason as usize]));
    let kinds = Kinds::collect(parts, rules, alpha_textures);
    if kinds.runs != runs || kinds.reasons != reasons {
        return Err("the kinds are not in their canonical form");
    }
    Ok((kinds, r.0))
}

/// Reads numbers and texts; every count is checked against the remaining bytes.
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

    /// A count of elements of at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, &'static str> {
        let n = self.u32()? as usize;
        if n > self.0.len() / least {
            Err("the kinds count more than there is")
        } else {
            Ok(n)
        }
    }

    fn kind(&mut self) -> Result<Kind, &'static str> {
        let (number, rest) = self.0.split_first().ok_or("the kinds are cut short")?;
        self.0 = rest;
        Kind::ALL
            .get(usize::from(*number))
            .copied()
            .ok_or("a kind is unknown")
    }

    fn text(&mut self) -> Result<String, &'static str> {
        let n = self.count(1)?;
        if n > MAX_TEXT {
            return Err("a reason or a glob is too long");
        }
        let (text, rest) = self.0.split_at(n);
        self.0 = rest;
        String::from_utf8(text.to_vec()).map_err(|_| "a reason or a glob is not UTF-8")
    }
}

#[cfg(test)]
#[path = "kinds_tests.rs"]
mod tests;
