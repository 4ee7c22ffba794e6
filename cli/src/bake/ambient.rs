//! `sightline ambient`: computes the openness of points, texels or vertices.

use sightline::Error;

use crate::args::ambient::AmbientArgs;
use crate::bake::ambient_file;
use crate::bake::ambient_points;

/// Computes the openness of the points of a file, or writes a copy of the scene's file with the occlusion.
pub fn run(args: &AmbientArgs, json: bool) -> Result<(), Error> {
    if args.points.is_none() && (args.fragments || args.lights.is_some() || args.threads.is_some())
    {
        return Err(Error::usage(
            "--fragments, --lights and --threads need --points; omit them, or give --points"
                .to_owned(),
        ));
    }
    if args.kinds.options.cull_back_faces {
        return Err(Error::usage(
            "ambient occlusion uses both sides of triangles; omit --cull-back-faces".to_owned(),
        ));
    }
    match (&args.points, &args.output) {
        (Some(_), Some(_)) => Err(Error::usage(
            "--points prints answers and -o writes a file; give one of the two".to_owned(),
        )),
        (Some(points), None) => ambient_points::run(args, points),
        (None, Some(output)) => ambient_file::run(args, output, json),
        (None, None) => Err(Error::usage(
            "give --points P.jsonl or -o OUT.glb".to_owned(),
        )),
    }
}
