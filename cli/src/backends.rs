//! Backends on this machine: which work, and opening one for a whole scene.

use std::sync::Arc;

use sightline_model::{NamedValue, TracerChoice};
use sightline_sampling::{Backend, CubeSpec};
use sightline_scene::Scene;
use sightline_worker::{Backends, TracerSelection};

use crate::error::CliError;
use crate::progress::say;

/// Prints a note for each backend that does not work here; an error if none works.
pub fn say_missing(backends: &Backends) -> Result<(), CliError> {
    let missing = backends.missing();
    if backends.profiles().is_empty() {
        return Err(CliError::Internal(format!(
            "no backend can sample on this machine:\n{}",
            missing.join("\n")
        )));
    }
    missing.iter().for_each(|m| say(&format!("note: {m}")));
    Ok(())
}

/// The backend of a job: a choice of a tracer, or none, for jobs that need none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BackendOption(pub Option<TracerChoice>);

impl Default for BackendOption {
    fn default() -> Self {
        Self(Some(TracerChoice::default()))
    }
}

impl NamedValue for BackendOption {
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

impl std::fmt::Display for BackendOption {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Returns the choice of a tracer as the type of the worker crate.
pub fn choice(tracer: TracerChoice) -> TracerSelection {
    match tracer {
        TracerChoice::Auto => TracerSelection::Auto,
        TracerChoice::Gpu => TracerSelection::Gpu,
        TracerChoice::Cpu => TracerSelection::Cpu,
    }
}

/// Says so when a result of one kind of backend, by its profile, is judged with another one.
pub fn say_other(made: &str, judged: &str) {
    let kind = |profile: &str| {
        ["cpu", "gpu"]
            .into_iter()
            .find(|k| profile.split('/').next() == Some(k))
    };
    if let (Some(made), Some(judged)) = (kind(made), kind(judged))
        && made != judged
    {
        say(&format!(
            "note: the result was made on the {made} and is judged on the {judged}; where coplanar triangles \
             overlap, they see different ones. --backend {made} judges as it was made"
        ));
    }
}

/// Opens a backend that draws or traces a whole scene here; also its numerics profile. Embree does that well,
/// so with `auto` the gpu is probed only when Embree is missing.
pub fn open_backend(
    wanted: TracerChoice,
    scene: &Arc<Scene>,
    spec: CubeSpec,
) -> Result<(String, Arc<dyn Backend>), CliError> {
    let probe = |of| sightline_worker::Backends::probe(of, Default::default());
    let mut backends = probe(if wanted == TracerChoice::Auto {
        TracerSelection::Cpu
    } else {
        choice(wanted)
    });
    if wanted == TracerChoice::Auto && backends.profiles().is_empty() {
        backends = probe(TracerSelection::Auto);
    }
    say_missing(&backends)?;
    let profile = backends.profiles().into_iter().next().unwrap_or_default();
    let backend = backends
        .open(&profile, Arc::clone(scene), spec)
        .map_err(CliError::internal)?;
    Ok((profile, backend))
}
