//! Submits a scene to a coordinator, waits for the job and downloads the result:
//! `cargo run --release -p sightline --example submit -- http://127.0.0.1:7600 SCENE OUT.pvs`.
#![allow(clippy::print_stdout, reason = "an example")]

use std::path::Path;

use sightline::{
    Cells, Client, Endpoint, Error, Job, JobOptions, LoadOptions, SceneSource, Silent, Submission,
    read_scene,
};

/// Bakes a scene file on the farm of the coordinator at `url`. Returns the job.
pub fn bake_at(url: &str, scene: &Path, output: &Path) -> Result<Job, Error> {
    let source = SceneSource::File(scene.to_owned());
    let scene = read_scene(&source, &LoadOptions::default(), &Silent)?;
    let options = JobOptions {
        cells: Some(Cells::Grid([4, 2, 4])),
        ..JobOptions::default()
    };
    let job = options.resolve(&scene, &Silent)?;
    let client = Client::new(Endpoint::new(url))?;
    let submission = Submission {
        name: "example".to_owned(),
        ..Submission::default()
    };
    let mut handle = client.submit(&scene, &job, &submission, &Silent)?;
    handle.wait(&Silent)?;
    handle.fetch(output, &Silent)?;
    Ok(handle.job().clone())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, url, scene, output] = arguments.as_slice() else {
        return Err("usage: submit URL SCENE OUT.pvs".into());
    };
    let job = bake_at(url, Path::new(scene), Path::new(output))?;
    println!("{}", serde_json::to_string_pretty(&job)?);
    Ok(())
}
