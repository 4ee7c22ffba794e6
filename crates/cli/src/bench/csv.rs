//! The measurements as CSV (RFC 4180, but with plain line ends).

use crate::bench::curves::SceneCurves;
use crate::bench::growth::Grown;

/// A field, quoted where it has to be.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn line(fields: &[String]) -> String {
    let fields: Vec<_> = fields.iter().map(|f| field(f)).collect();
    format!("{}\n", fields.join(","))
}

/// Empty where nothing is known.
fn optional(n: Option<impl ToString>) -> String {
    n.map_or(String::new(), |n| n.to_string())
}

/// All points; errors are fractions.
pub fn curves(scenes: &[SceneCurves]) -> String {
    let mut text =
        "scene,sampler,parameter,seconds,mean_error,p99_error,max_error,peak_mb,bytes_per_cell,samples,\
                    mean_visible\n"
            .to_owned();
    for scene in scenes {
        for p in &scene.points {
            text += &line(&[
                scene.scene.clone(),
                p.sampler.name().to_owned(),
                p.parameter.clone(),
                p.seconds.to_string(),
                p.mean_error.to_string(),
                p.p99_error.to_string(),
                p.max_error.to_string(),
                optional(p.peak_mb),
                p.bytes_per_cell.to_string(),
                p.samples.to_string(),
                p.mean_visible.to_string(),
            ]);
        }
    }
    text
}

/// How time and memory grow.
pub fn growth(rows: &[Grown]) -> String {
    let mut text = "grows,scene,triangles,cells,workers,seconds,peak_mb,bytes_per_cell\n".to_owned();
    for g in rows {
        text += &line(&[
            g.grows.name().to_owned(),
            g.scene.clone(),
            g.triangles.to_string(),
            g.cells.to_string(),
            optional(g.workers),
            g.seconds.to_string(),
            optional(g.peak_mb),
            g.bytes_per_cell.to_string(),
        ]);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_quoted_where_they_have_to_be() {
        assert_eq!(field("plain name"), "plain name");
        assert_eq!(field("a,b"), "\"a,b\"");
        assert_eq!(field("the \"big\" one"), "\"the \"\"big\"\" one\"");
        assert_eq!(field("two\nlines"), "\"two\nlines\"");
        assert_eq!(line(&["a,b".to_owned(), String::new(), "c".to_owned()]), "\"a,b\",,c\n");
    }

    #[test]
    fn rows_have_as_many_fields_as_the_header() {
        let scenes = [crate::bench::svg::tests::example("a,b")];
        let text = curves(&scenes);
        let commas = |l: &str| l.replace("\"a,b\"", "").matches(',').count();
        let header = commas(text.lines().next().unwrap());
        assert_eq!(text.lines().count(), 1 + scenes[0].points.len());
        assert!(text.lines().all(|l| commas(l) == header), "{text}");
    }
}
