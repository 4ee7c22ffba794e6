//! The choice of the numerics profile that a job is bound to.

use sightline_model::{NO_PROFILE, TracerChoice};

use super::messages::ProfileTime;

/// The factor by which another backend must be faster than the cpu backend for `auto` to choose it.
pub(super) const CLEARLY: f64 = 2.0;

/// Returns the fastest profile. A profile other than the cpu's must be [`CLEARLY`] times as fast as the
/// cpu's.
///
/// Profiles without a valid time are ignored, and so are software rasterisers if the cpu was timed.
///
/// Two runs of one bake give the same bytes only on the same profile, so noise in the timing must not decide
/// between two profiles of nearly the same speed.
pub(super) fn fastest(times: &[ProfileTime]) -> Option<&ProfileTime> {
    let software = |t: &ProfileTime| is_software(&t.profile);
    let is_cpu = |t: &ProfileTime| t.profile.starts_with("cpu/");
    let cpu = times
        .iter()
        .any(|t| is_cpu(t) && t.seconds_per_cube.is_finite());
    let cost = |t: &ProfileTime| t.seconds_per_cube * if is_cpu(t) { 1.0 } else { CLEARLY };
    times
        .iter()
        .filter(|t| {
            t.seconds_per_cube.is_finite() && t.seconds_per_cube >= 0.0 && !(cpu && software(t))
        })
        .min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

/// Returns true if a profile belongs to a software rasteriser.
///
/// A software rasteriser uses the same cores as the cpu backend, and serves machines without that backend.
fn is_software(profile: &str) -> bool {
    ["llvmpipe", "lavapipe", "SwiftShader"]
        .iter()
        .any(|s| profile.contains(s))
}

/// The next step for a job that has no profile yet.
pub(super) enum Binding {
    /// Bind the job to this profile.
    Bind(String),
    /// Let a worker time its backends.
    Time,
    /// This worker has no suitable backend.
    Cannot,
}

/// Returns the next step for a job without a profile if a worker with `profiles` is available.
pub(super) fn profile_for(choice: Option<TracerChoice>, profiles: &[String]) -> Binding {
    let named = match choice {
        None => profiles.iter().find(|p| *p == NO_PROFILE).cloned(),
        Some(TracerChoice::Auto) => {
            let cpu = profiles.iter().any(|p| TracerChoice::Cpu.accepts(p));
            let mut worth = profiles
                .iter()
                .filter(|p| TracerChoice::Auto.accepts(p) && !(cpu && is_software(p)));
            match (worth.next(), worth.next()) {
                (Some(only), None) => Some(only.clone()),
                (Some(_), Some(_)) => return Binding::Time,
                (None, _) => None,
            }
        }
        Some(choice) => profiles.iter().find(|p| choice.accepts(p)).cloned(),
    };
    named.map_or(Binding::Cannot, Binding::Bind)
}

/// Chooses the numerics profile of a job on a machine with `profiles`, or returns `None` if none suits.
///
/// The scheduler makes the same choice if that machine is the first to take the job. `time` measures the
/// profiles, each in seconds per cube. It is called only if several profiles are candidates.
pub fn choose_profile(
    choice: Option<TracerChoice>,
    profiles: &[String],
    time: impl FnOnce() -> Vec<(String, f64)>,
) -> Option<String> {
    let own = match choice {
        // Every machine supports this profile.
        None => &[NO_PROFILE.to_owned()][..],
        Some(_) => profiles,
    };
    match profile_for(choice, own) {
        Binding::Bind(profile) => Some(profile),
        Binding::Time => {
            let times = time()
                .into_iter()
                .map(|(profile, seconds_per_cube)| ProfileTime {
                    profile,
                    seconds_per_cube,
                });
            fastest(&times.collect::<Vec<_>>()).map(|time| time.profile.clone())
        }
        Binding::Cannot => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(profile: &str, seconds_per_cube: f64) -> ProfileTime {
        ProfileTime {
            profile: profile.to_owned(),
            seconds_per_cube,
        }
    }

    #[test]
    fn only_clearly_faster_gpu_displaces_cpu() {
        let chosen = |times: &[ProfileTime]| fastest(times).map(|t| t.profile.clone());
        assert_eq!(
            chosen(&[time("cpu/a", 1.0), time("gpu/b", 0.6)]).as_deref(),
            Some("cpu/a")
        );
        assert_eq!(
            chosen(&[time("cpu/a", 1.0), time("gpu/b", 0.4)]).as_deref(),
            Some("gpu/b")
        );
        assert_eq!(chosen(&[time("gpu/b", 9.0)]).as_deref(), Some("gpu/b"));
        assert_eq!(
            chosen(&[time("cpu/a", f64::NAN), time("gpu/b", 9.0)]).as_deref(),
            Some("gpu/b")
        );
        let lavapipe = "gpu/wgpu-30/vulkan/llvmpipe (LLVM 15.0.6, 256 bits)";
        assert_eq!(
            chosen(&[time("cpu/a", 1.0), time(lavapipe, 0.1)]).as_deref(),
            Some("cpu/a")
        );
        assert_eq!(chosen(&[time(lavapipe, 0.1)]).as_deref(), Some(lavapipe));
        assert_eq!(chosen(&[]), None);
    }

    #[test]
    fn backends_are_timed_only_when_there_are_several() {
        let bound = |profiles: &[&str]| {
            let profiles: Vec<String> = profiles.iter().map(|p| (*p).to_owned()).collect();
            match profile_for(Some(TracerChoice::Auto), &profiles) {
                Binding::Bind(profile) => profile,
                Binding::Time => "timed".to_owned(),
                Binding::Cannot => "none".to_owned(),
            }
        };
        assert_eq!(bound(&["cpu/a", "gpu/llvmpipe"]), "cpu/a");
        assert_eq!(bound(&["gpu/llvmpipe"]), "gpu/llvmpipe");
        assert_eq!(bound(&["cpu/a", "gpu/real"]), "timed");
        assert_eq!(bound(&[]), "none");
        assert_eq!(bound(&["cpu/a", NO_PROFILE]), "cpu/a");
        let without = |profiles: &[&str]| {
            let profiles: Vec<String> = profiles.iter().map(|p| (*p).to_owned()).collect();
            matches!(profile_for(None, &profiles), Binding::Bind(p) if p == NO_PROFILE)
        };
        assert!(without(&["cpu/a", NO_PROFILE]) && !without(&["cpu/a"]));
    }

    #[test]
    fn profiles_are_chosen_as_for_first_worker() {
        let all = ["cpu/a".to_owned(), "gpu/real".to_owned()];
        let times = |gpu| move || vec![("cpu/a".to_owned(), 1.0), ("gpu/real".to_owned(), gpu)];
        let chosen = |choice, gpu| choose_profile(choice, &all, times(gpu));
        assert_eq!(
            chosen(Some(TracerChoice::Auto), 0.4).as_deref(),
            Some("gpu/real")
        );
        assert_eq!(
            chosen(Some(TracerChoice::Auto), 0.6).as_deref(),
            Some("cpu/a")
        );
        assert_eq!(
            chosen(Some(TracerChoice::Gpu), 9.0).as_deref(),
            Some("gpu/real")
        );
        assert_eq!(chosen(None, 9.0).as_deref(), Some(NO_PROFILE));
        assert_eq!(
            choose_profile(Some(TracerChoice::Gpu), &all[..1], times(1.0)),
            None
        );
    }
}
