//! The results page: the machine, the command line and the tables.

use std::path::Path;

use crate::curves::SceneCurves;
use crate::growth::{self, Grown};
use crate::machine::{Machine, command_line};
use crate::options::Options;
use crate::table;

/// The page as Markdown, to be put at `page`.
pub fn markdown(
    args: &Options,
    machine: &Machine,
    scenes: &[SceneCurves],
    growth: &[Grown],
    page: &Path,
) -> String {
    let Machine { cpu, cores, memory, os, numerics_profile, version, date } = machine;
    let mut text = format!(
        "# Results\n\nWritten by `sightline bench`; the next run with the same `--results` replaces it.\n\n\
         - processor: {cpu}, {cores} cores\n- memory: {memory}\n- system: {os}\n\
         - numerics profile: {numerics_profile}\n- program: sightline {version}\n- date: {date}\n\n\
         ```sh\n{}\n```\n",
        command_line()
    );
    if !scenes.is_empty() {
        text += &format!(
            "\n## Time against error\n\nSeconds of the whole command `sightline bake --backend cpu`, from \
                an empty store, \
             until the mean error is that of the row: interpolated on logarithmic axes between measured \
             points, never \
             beyond them. `≤` stands before the time of a sampler's fastest point where that is better \
             already (or of \
             a point without any error), `>` before that of its slowest where no point is that good; a \
             ratio of such times is \
             a bound, and so is a mean with it (`≥`), or `-` where they bound nothing. The error is the \
             mean share of \
             wrong pixels over {} random viewpoints (seed {}), each a cube of {} pixels a side; {} \
             cells.\n\n",
            args.viewpoints,
            args.seed,
            args.resolution,
            args.cells.map(|n| n.to_string()).join("×")
        );
        text += &table::needed(scenes).markdown();
        // A link only where it stays right when both are moved together.
        let folder = page.parent().unwrap_or(Path::new(""));
        if let Ok(out) = args.out.strip_prefix(folder) {
            let link = out.join("curves.svg").to_string_lossy().replace(' ', "%20");
            text += &format!("\n![Time against error]({link})\n");
        }
        for scene in scenes {
            text += &format!("\n### {}\n\n{} triangles.\n\n", scene.scene, scene.triangles);
            text += &table::points(scene).markdown();
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
