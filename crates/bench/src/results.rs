//! The results page: the machine, the command line and the tables.

use std::path::Path;

use crate::curves::SceneCurves;
use crate::growth::{self, Grown};
use crate::ladder::Shows;
use crate::load::Load;
use crate::machine::{MachineFacts, command_line};
use crate::options::Options;
use crate::percent::percent;
use crate::points;
use crate::table;

/// The explanation of the measured times, for readers of a table.
const TIMES: &str = "Every time is the time of a whole command, from start to exit. CPU seconds are the \
    user and system time of all threads of the command, until the command prints its report. ";

/// Returns the page as Markdown, to be written to `page`.
pub fn markdown(
    args: &Options,
    machine: &MachineFacts,
    load: Load,
    scenes: &[SceneCurves],
    growth: &[Grown],
    page: &Path,
) -> String {
    let MachineFacts {
        cpu,
        cores,
        memory,
        os,
        numerics_profile,
        version,
        date,
    } = machine;
    let mut text = format!(
        "# Results\n\nWritten by `sightline bench`; the next run with the same `--results` replaces it.\n\n\
         - processor: {cpu}, {cores} cores\n- memory: {memory}\n- system: {os}\n\
         - numerics profile: {numerics_profile}\n- program: sightline {version}\n- date: {date}\n\
         - other work: {}\n\n```sh\n{}\n```\n\n{TIMES}{}\n",
        others(load),
        command_line(),
        match args.repeat {
            1 => "Each point was run once, so the spread is unknown.".to_owned(),
            n => format!(
                "Each point was run {n} times in a row: times are medians. The spread is the \
                 difference of the slowest and the fastest run, as a fraction of the median."
            ),
        }
    );
    if table::has_errors(scenes) {
        text += &errors(args, scenes, page);
    } else if !scenes.is_empty() {
        text += &picture(args, page);
    }
    for scene in scenes {
        text += &format!("\n### {}\n\n{} triangles.\n", scene.scene, scene.triangles);
        if !scene.showing(Shows::Error).is_empty() {
            text += &format!("\n{}", points::errors(scene).markdown());
        }
        if !scene.showing(Shows::Undecided).is_empty() {
            text += &format!(
                "\n`--method verified`, {} cells, stopped by a time budget. The command may end \
                 earlier, or later by the time for reading the scene and writing the result. Undecided is \
                 the share of all pairs of a cell and a triangle that were neither seen nor proved hidden; \
                 these triangles are drawn.\n\n{}",
                grid(args),
                points::undecided(scene).markdown()
            );
        }
        if !scene.showing(Shows::CellTime).is_empty() {
            text += &format!(
                "\n`--method exact`, blocks of cells in the middle of a grid of {}. The time per \
                 cell is the time of the whole command, including the preparation of the scene, divided by \
                 the number of cells. The cells of a block share work.\n\n{}",
                grid(args),
                points::cell_times(scene).markdown()
            );
        }
    }
    if !growth.is_empty() {
        text += &format!(
            "\n## Growth\n\nBakes with `{}`; one quantity grows, and the others are constant.\n\n",
            growth::sampling(args).join(" ")
        );
        text += &table::growth(growth).markdown();
    }
    text
}

/// Returns a text about the load by other processes during timed bakes.
fn others(load: Load) -> String {
    let warning = if load.is_busy() {
        "; **the machine was busy**, so times are too long"
    } else {
        ""
    };
    load.share()
        .map_or("unknown on this system".to_owned(), |share| {
            format!(
                "other processes used {} of the time of all cores (`/proc/stat`){warning}",
                percent(share)
            )
        })
}

fn grid(args: &Options) -> String {
    args.cells.map(|n| n.to_string()).join("×")
}

/// Returns a link to the picture of the curves. Returns an empty text if the link would break when a user
/// moves page and picture together.
fn picture(args: &Options, page: &Path) -> String {
    let folder = page.parent().unwrap_or(Path::new(""));
    args.out.strip_prefix(folder).map_or(String::new(), |out| {
        let link = out.join("curves.svg").to_string_lossy().replace(' ', "%20");
        format!("\n![Curves]({link})\n")
    })
}

/// Returns the section on time against error, for all scenes.
fn errors(args: &Options, scenes: &[SceneCurves], page: &Path) -> String {
    format!(
        "\n## Time against error\n\nSeconds of the whole command `sightline bake --backend cpu`, from an \
         empty store, until the mean error of the row is reached. Times are interpolated on logarithmic \
         axes between measured points, and never extrapolated. `≤` marks the time of a point with a lower \
         error, if no point with a higher error was measured or the error is 0. `>` marks the time of the \
         sampler's slowest point, if no point reaches the error. A ratio of such times is a lower bound \
         (`≥`), or `-` if no bound is known; a mean of ratios likewise. The error is the mean fraction of \
         wrong pixels over {} random viewpoints (seed {}), each a cube with faces of {} pixels per side; \
         {} cells.\n\n{}{}",
        args.viewpoints,
        args.seed,
        args.resolution,
        grid(args),
        table::needed(scenes).markdown(),
        picture(args, page)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curves::tests::example;
    use crate::ladder::Sampler;

    fn page(repeat: u32, load: Load, scenes: &[SceneCurves]) -> String {
        let args = Options {
            repeat,
            out: "a/b".into(),
            ..Options::default()
        };
        markdown(
            &args,
            &MachineFacts::here(),
            load,
            scenes,
            &[],
            Path::new("a/RESULTS.md"),
        )
    }

    #[test]
    fn page_has_table_per_kind_of_curve_and_number_of_runs() {
        let text = page(3, Load::default(), &[example("level")]);
        for part in [
            "## Time against error",
            "--method verified`, 8×8×8",
            "--method exact`",
            "run 3 times",
        ] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
        assert!(
            text.contains("(b/curves.svg)") && text.contains("other work: unknown on this system"),
            "{text}"
        );
        let mut scene = example("level");
        scene.samplers = vec![Sampler::Exact];
        scene.points.retain(|p| p.sampler == Sampler::Exact);
        let text = page(1, Load::default(), &[scene]);
        assert!(
            !text.contains("Time against error") && text.contains("run once"),
            "{text}"
        );
    }
}
