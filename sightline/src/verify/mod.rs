//! Verification of a result: every witness and every certificate, with the independent checker.

mod hidden;
mod verdict;

use glam::Vec3;
use serde::{Deserialize, Serialize};
use sightline_certificate::checker::Kinds;
use sightline_certificate::{Sample, VerifyError};
use sightline_model::{MethodName, NamedValue as _};
use sightline_viewcells::CellIndex;

pub use self::verdict::{CertificateReport, HiddenReport, Rejection, Verdict};
use crate::error::Error;
use crate::observer::Observer;
use crate::process::{threads, use_threads};
use crate::progress::Counter;
use crate::result::NamedResult;
use crate::scene::{LoadOptions, SceneSource, read_scene_of};

/// The options of a verification, which correspond to the options of `sightline verify`.
///
/// ```
/// use sightline::VerifyOptions;
///
/// let options = VerifyOptions { sample: Some(1000), ..Default::default() };
/// assert_eq!(options.seed, 1);
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VerifyOptions {
    /// The options for reading the scene. Default: the options of the bake.
    pub scene: LoadOptions,
    /// The number of random pairs of a cell and a triangle whose claims are checked. Default: all claims.
    pub sample: Option<u64>,
    /// The seed of the sample. Default: 1.
    pub seed: u64,
}

impl Default for VerifyOptions {
    /// Returns the default options: all claims, and the seed 1 for samples.
    fn default() -> Self {
        Self {
            scene: LoadOptions::default(),
            sample: None,
            seed: 1,
        }
    }
}

/// Verifies a result against its scene. A checker that shares no code with the bake checks every witness and
/// every certificate. A result of the method portals has no certificates: with a sample, exact queries check
/// the pairs that the result calls hidden.
///
/// ```no_run
/// use sightline::{NamedResult, SceneSource, Silent, VerifyOptions};
///
/// let path = "level.pvs".as_ref();
/// let pvs = sightline::open(path)?;
/// let source = SceneSource::File("level.glb".into());
/// let result = NamedResult::new(&pvs, path);
/// let verdict = sightline::verify(&source, result, &VerifyOptions::default(), &Silent)?;
/// assert!(verdict.is_accepted(), "{verdict}");
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the result has no certificates or the scene is not the scene of the result,
/// or [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn verify(
    source: &SceneSource,
    result: NamedResult<'_>,
    options: &VerifyOptions,
    observer: &dyn Observer,
) -> Result<Verdict, Error> {
    use_threads(threads(None))?;
    let (pvs, name) = (result.pvs, result.name);
    let scene = read_scene_of(source, &options.scene, result, observer)?;
    if !scene.sides().are_both() {
        return Err(Error::input(format!(
            "back faces of {} are culled for {}, but certificates use both sides of triangles; \
             verify a result of a bake without --cull-back-faces",
            source.path().display(),
            name.display()
        )));
    }
    if pvs.method() == MethodName::Portals.name() {
        let Some(wanted) = options.sample else {
            return Err(Error::input(format!(
                "{} has no certificates, because results of --method portals contain no proofs. \
                 --sample N runs exact queries for N pairs that the result calls hidden",
                name.display()
            ))
            .about("sample"));
        };
        return hidden::verify(result, &scene, wanted, options.seed, observer);
    }
    let triangles: Vec<[Vec3; 3]> = scene.triangles().iter().map(|t| t.v).collect();
    // The digest of the scene in the result covers the kinds.
    let (blocks, shows): (Vec<bool>, Vec<bool>) = scene
        .kinds()
        .by_triangle()
        .iter()
        .map(|k| (k.blocks(), k.shows()))
        .unzip();
    let counter = Counter::new("cells", observer);
    let report = sightline_certificate::verify(
        &triangles,
        pvs,
        &sightline_certificate::VerifyOptions {
            kinds: Kinds {
                blocks: &blocks,
                shows: &shows,
            },
            sample: options.sample.map(|pairs| Sample {
                pairs,
                seed: options.seed,
            }),
            progress: Some(&|done, cells| counter.show(u64::from(done), u64::from(cells))),
            cancelled: Some(&|| observer.is_cancelled()),
        },
    );
    match report {
        Ok(report) => Ok(Verdict::Accepted(CertificateReport::new(
            &report,
            pvs,
            options.sample.map(|pairs| (pairs, options.seed)),
        ))),
        Err(VerifyError::Refused(refused)) => Ok(Verdict::rejected(
            refused.cell.map(CellIndex),
            &refused.reason,
            name,
        )),
        Err(VerifyError::Cancelled { verified, cells }) => Err(Error::cancelled(format!(
            "interrupted; {verified} of {cells} cells verified so far, all accepted"
        ))),
        Err(VerifyError::NoCertificates { .. }) => Err(no_certificates(result)),
        Err(e @ VerifyError::OtherScene { .. }) => Err(Error::input(e.to_string())),
    }
}

fn no_certificates(result: NamedResult<'_>) -> Error {
    let method = result.pvs.method();
    Error::input(format!(
        "{} has no certificates (method {method}), so there is nothing to verify; bake it with \
         {}--certificates",
        result.name.display(),
        if method == MethodName::Aggressive.name() {
            "--method exact "
        } else {
            ""
        }
    ))
}
