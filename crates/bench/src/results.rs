//! The results page: the machine, the command line and the tables.

use std::path::Path;

use crate::curves::SceneCurves;
use crate::growth::{self, Grown};
use crate::ladder::Shows;
use crate::load::Load;
use crate::machine::{Machine, command_line};
use crate::options::Options;
use crate::percent::percent;
use crate::points;
use crate::table;

/// How times are measured, for whoever reads a table.
const TIMES: &str = "Every time is that of a whole command, from start to exit. CPU seconds are those of all \
    its threads, user and system, until it reports. ";

/// The page as Markdown, to be put at `page`.
pub fn markdown(
    args: &Options,
    machine: &Machine,
    load: Load,
    scenes: &[SceneCurves],
    growth: &[Grown],
    page: &Path,
) -> String {
    let Machine {
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
            1 => "Each point was run once, so nothing is known of its spread.".to_owned(),
            n => format!(
                "Each point was run {n} times in a row: times are medians, and the spread is how far the \
                 slowest run is from the fastest, as a part of the median."
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
                "\n`--method verified`, {} cells, stopped by a time budget. The command may end sooner, or \
                 later by what reading the scene and writing the result take. Undecided is the share of all \
                 pairs of a cell and a triangle that were neither seen nor proved hidden; these triangles \
                 are drawn.\n\n{}",
                grid(args),
                points::undecided(scene).markdown()
            );
        }
        if !scene.showing(Shows::CellTime).is_empty() {
            text += &format!(
                "\n`--method exact`, blocks of cells in the middle of a grid of {}. The time of a cell is \
                 its part of the whole command, preparing the scene included; cells of a block share \
                 work.\n\n{}",
                grid(args),
                points::cell_times(scene).markdown()
            );
        }
    }
    if !growth.is_empty() {
        text += &format!(
            "\n## Growth\n\nBakes with `{}`; one thing grows, the rest stays.\n\n",
            growth::sampling(args).join(" ")
        );
        text += &table::growth(growth).markdown();
    }
    text
}

/// What others took of the machine while bakes were timed.
fn others(load: Load) -> String {
    let warning = if load.is_busy() {
        "; **the machine was busy**, so times are too long"
    } else {
        ""
    };
    load.share().map_or("not known here".to_owned(), |share| {
        format!(
            "other processes took {} of the time of all cores (`/proc/stat`){warning}",
            percent(share)
        )
    })
}

fn grid(args: &Options) -> String {
    args.cells.map(|n| n.to_string()).join("×")
}

/// The picture, where a link stays right when page and picture are moved together.
fn picture(args: &Options, page: &Path) -> String {
    let folder = page.parent().unwrap_or(Path::new(""));
    args.out.strip_prefix(folder).map_or(String::new(), |out| {
        let link = out.join("curves.svg").to_string_lossy().replace(' ', "%20");
        format!("\n![Curves]({link})\n")
    })
}

/// Time against error, all scenes.
fn errors(args: &Options, scenes: &[SceneCurves], page: &Path) -> String {
    format!(
        "\n## Time against error\n\nSeconds of the whole command `sightline bake --backend cpu`, from an \
         empty store, until the mean error is that of the row: interpolated on logarithmic axes between \
         measured points, never beyond them. `≤` stands before the time of a sampler's fastest point where \
         that is better already (or of a point without any error), `>` before that of its slowest where no \
         point is that good; a ratio of such times is a bound, and so is a mean with it (`≥`), or `-` where \
         they bound nothing. The error is the mean share of wrong pixels over {} random viewpoints (seed \
         {}), each a cube of {} pixels a side; {} cells.\n\n{}{}",
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
            &Machine::here(),
            load,
            scenes,
            &[],
            Path::new("a/RESULTS.md"),
        )
    }

    #[test]
    fn the_page_has_a_table_for_each_kind_of_curve_and_says_how_often_it_was_run() {
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
            text.contains("(b/curves.svg)") && text.contains("other work: not known here"),
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
