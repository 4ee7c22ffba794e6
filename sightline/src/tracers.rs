//! Tracers of this machine: the usable ones, and opening one for a whole scene.

use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sightline_model::{NamedValue, TracerChoice};
use sightline_scene::Scene;
use sightline_trace::{Backend, CubeSpec};
use sightline_worker::{Backends, TracerSelection};

use crate::error::Error;
use crate::observer::{Observer, note};

/// Notes each tracer that does not work here.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] if none works.
pub fn note_missing(backends: &Backends, observer: &dyn Observer) -> Result<(), Error> {
    let missing = backends.missing();
    if backends.profiles().is_empty() {
        return Err(Error::internal(format!(
            "no backend can sample on this machine:\n{}",
            missing.join("\n")
        )));
    }
    for line in missing {
        note(observer, format!("note: {line}"));
    }
    Ok(())
}

/// The tracer of a job: a choice, or none, for jobs that need none.
///
/// ```
/// use sightline::TracerOption;
///
/// assert_eq!(TracerOption::default().to_string(), "auto");
/// assert_eq!(TracerOption(None).to_string(), "none");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TracerOption(pub Option<TracerChoice>);

impl Default for TracerOption {
    fn default() -> Self {
        Self(Some(TracerChoice::default()))
    }
}

impl NamedValue for TracerOption {
    const PARAMETER: &'static str = TracerChoice::PARAMETER;
    const ALL: &'static [Self] = &[
        Self(Some(TracerChoice::Auto)),
        Self(Some(TracerChoice::Gpu)),
        Self(Some(TracerChoice::Cpu)),
        Self(None),
    ];

    fn name(self) -> &'static str {
        self.0.map_or("none", TracerChoice::name)
    }

    fn about(self) -> &'static str {
        self.0.map_or(
            "None: the method portals needs no backend.",
            TracerChoice::about,
        )
    }
}

impl std::fmt::Display for TracerOption {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for TracerOption {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for TracerOption {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let name = String::deserialize(from)?;
        Self::from_name(&name).map_err(serde::de::Error::custom)
    }
}

/// Returns the choice of a tracer as the type of the worker crate.
pub fn selection(tracer: TracerChoice) -> TracerSelection {
    match tracer {
        TracerChoice::Auto => TracerSelection::Auto,
        TracerChoice::Gpu => TracerSelection::Gpu,
        TracerChoice::Cpu => TracerSelection::Cpu,
    }
}

/// Notes that a result of one kind of tracer, by its numerics profile, is measured with another kind.
pub fn note_other(made: &str, measured: &str, observer: &dyn Observer) {
    let kind = |profile: &str| {
        ["cpu", "gpu"]
            .into_iter()
            .find(|k| profile.split('/').next() == Some(k))
    };
    if let (Some(made), Some(measured)) = (kind(made), kind(measured))
        && made != measured
    {
        note(
            observer,
            format!(
                "note: the result was made on the {made} and is judged on the {measured}; where coplanar \
                 triangles overlap, they see different ones. --backend {made} judges as it was made"
            ),
        );
    }
}

/// Opens a tracer that renders or traces a whole scene on this machine; also returns its numerics profile.
/// Embree does both well, so with `auto` the GPU is probed only if Embree is missing.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] if no tracer of the choice works here.
pub fn open_tracer(
    choice: TracerChoice,
    scene: &Arc<Scene>,
    spec: CubeSpec,
    observer: &dyn Observer,
) -> Result<(String, Arc<dyn Backend>), Error> {
    let probe = |selection| Backends::probe(selection, Default::default());
    let mut backends = probe(match choice {
        TracerChoice::Auto => TracerSelection::Cpu,
        choice => selection(choice),
    });
    if choice == TracerChoice::Auto && backends.profiles().is_empty() {
        backends = probe(TracerSelection::Auto);
    }
    note_missing(&backends, observer)?;
    let profile = backends.profiles().into_iter().next().unwrap_or_default();
    let backend = backends
        .open(&profile, Arc::clone(scene), spec)
        .map_err(Error::internal)?;
    Ok((profile, backend))
}
