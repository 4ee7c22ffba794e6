//! Tracers of this machine: the list of usable ones, and the opening of one for a whole scene.

use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sightline_model::{NamedValue, TracerChoice};
use sightline_scene::Scene;
use sightline_trace::{CubeSpec, Tracer};
use sightline_worker::{Backends, TracerSelection};

use crate::error::Error;
use crate::observer::{Observer, note};

/// Passes the observer a note for each tracer that does not work on this machine.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] if no tracer works.
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

/// The tracer of a job, or none for jobs that do not need one.
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
        Self(Some(TracerChoice::Embree)),
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

/// Converts the choice of a tracer into the type of the worker crate.
pub fn selection(tracer: TracerChoice) -> TracerSelection {
    match tracer {
        TracerChoice::Auto => TracerSelection::Auto,
        TracerChoice::Gpu => TracerSelection::Gpu,
        TracerChoice::Cpu => TracerSelection::Cpu,
        TracerChoice::Embree => TracerSelection::Embree,
    }
}

/// Passes the observer a note if the bake and the measurement of a result use different kinds of tracers.
/// `made` and `measured` are their numerics profiles, which begin with `cpu`, `embree` or `gpu`.
pub fn note_other(made: &str, measured: &str, observer: &dyn Observer) {
    let kind = |profile: &str| {
        ["cpu", "embree", "gpu"]
            .into_iter()
            .find(|k| profile.split('/').next() == Some(k))
    };
    if let (Some(made), Some(measured)) = (kind(made), kind(measured))
        && made != measured
    {
        note(
            observer,
            format!(
                "note: the result was baked with the backend {made}, but is measured with {measured}; where \
                 coplanar triangles overlap, the two may show different triangles. --backend {made} \
                 measures like the bake"
            ),
        );
    }
}

/// Opens a tracer that renders or traces a whole scene on this machine. Returns the tracer and its numerics
/// profile. The cpu backend does both well, so `auto` selects it without a probe of the GPU.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] if no tracer of the choice works here.
pub fn open_tracer(
    choice: TracerChoice,
    scene: &Arc<Scene>,
    spec: CubeSpec,
    observer: &dyn Observer,
) -> Result<(String, Arc<dyn Tracer>), Error> {
    let backends = Backends::probe(
        match choice {
            TracerChoice::Auto => TracerSelection::Cpu,
            choice => selection(choice),
        },
        Default::default(),
    );
    note_missing(&backends, observer)?;
    let profile = backends.profiles().into_iter().next().unwrap_or_default();
    let backend = backends
        .open(&profile, Arc::clone(scene), spec)
        .map_err(Error::internal)?;
    Ok((profile, backend))
}
