//! The headings under which `sightline --help` lists the commands.

use std::fmt::Write as _;

use clap::CommandFactory as _;

use super::cli::Cli;

/// The headings with their commands, in the order of `--help`.
const GROUPS: [(&str, &[&str]); 8] = [
    ("Bake", &["bake", "ambient", "plan", "tile", "assemble"]),
    ("Scenes", &["generate", "mesh", "portals", "tetra"]),
    (
        "Results",
        &[
            "info", "dump", "query", "look", "view", "report", "diff", "export", "cells",
        ],
    ),
    ("Checks", &["verify", "measure", "bench"]),
    ("Exact queries", &["sightlines", "stab"]),
    (
        "Jobs",
        &[
            "submit", "watch", "jobs", "show", "fetch", "logs", "cancel", "pause", "resume",
            "retry", "priority", "delete",
        ],
    ),
    (
        "Farm",
        &[
            "coordinator",
            "worker",
            "workers",
            "health",
            "invalidate",
            "store",
            "token",
        ],
    ),
    ("Program", &["completions", "man"]),
];

/// The width of the column of names, in characters.
const NAMES: usize = 13;

/// Returns the command line, with a help that lists the commands under their headings.
pub fn command() -> clap::Command {
    let command = Cli::command();
    let mut list = String::new();
    for (heading, names) in GROUPS {
        // Writing to a string cannot fail.
        let _ = writeln!(list, "{heading}:");
        for name in names {
            let about = command
                .find_subcommand(name)
                .and_then(clap::Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let sentence = about.split(". ").next().unwrap_or_default();
            let _ = writeln!(list, "  {name:NAMES$}{sentence}");
        }
        list.push('\n');
    }
    // The template would interpret braces as tags.
    let list = list.replace(['{', '}'], "");
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}Options:\n{{options}}\n\n{{after-help}}"
    );
    command.help_template(template)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_command_has_one_heading() {
        let listed: Vec<&str> = GROUPS
            .iter()
            .flat_map(|(_, names)| *names)
            .copied()
            .collect();
        let all: BTreeSet<&str> = listed.iter().copied().collect();
        assert_eq!(listed.len(), all.len(), "a command is listed twice");
        let command = Cli::command();
        let commands: BTreeSet<&str> = command.get_subcommands().map(|c| c.get_name()).collect();
        assert_eq!(all, commands);
    }
}
