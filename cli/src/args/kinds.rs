//! The flags that decide what blocks and what shows: rules in the order in which they are given, and the
//! culling of back faces.

use std::ffi::OsString;
use std::path::Path;

use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use sightline::LoadOptions;
use sightline_scene::kinds::{Kind, Rule};

/// The names of the flags below.
const ALPHA: &str = "alpha-textures";
const CULL: &str = "cull-back-faces";

/// The flags about kinds and sides.
#[derive(Clone, Debug, Default)]
pub struct KindArgs {
    /// The options of reading a scene.
    pub options: LoadOptions,
}

/// The heading of these flags in `--help`.
const HEADING: &str = "What blocks and what shows";

const FLAGS: [(Kind, &str); 5] = [
    (
        Kind::SeeThrough,
        "Objects and materials whose name matches are see-through: a sight line passes them and shows them. \
         Goes before the file, which makes materials with transmission or with alphaMode MASK or BLEND \
         see-through (OBJ: d, Tr, map_d, illum). Of several flags about a name the last counts. * stands for \
         any text",
    ),
    (
        Kind::OccluderOnly,
        "Objects and materials whose name matches block sight lines and are in no set, like an engine's \
         proxy meshes",
    ),
    (
        Kind::Moving,
        "Objects and materials whose name matches neither block nor show, because they move at run time. The \
         file makes animated nodes and skinned meshes moving",
    ),
    (
        Kind::Door,
        "Objects and materials whose name matches are doors: they neither block nor show, and with --method \
         portals (or exact and --reachable-from) what they cover in a wall is an opening of the object's \
         name that `look` can shut",
    ),
    (
        Kind::Opaque,
        "Objects and materials whose name matches block and show. Without a glob: all of them. A file \
         that follows is not taken as the glob",
    ),
];

/// Endings of the files that commands take.
const FILES: [&str; 6] = [".obj", ".ply", ".gltf", ".glb", ".pvs", ".tets"];

/// The arguments of the command line, where a file that follows `--opaque` is not taken as its glob: the
/// flags go before the file, and `--opaque` needs no glob.
pub fn with_opaque_alone(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.collect();
    let is_file = |text: &OsString| {
        let lower = text.to_string_lossy().to_ascii_lowercase();
        FILES.iter().any(|end| lower.ends_with(end)) || Path::new(text).is_file()
    };
    for at in 1..arguments.len() {
        if arguments[at - 1] == "--opaque" && is_file(&arguments[at]) {
            arguments[at - 1] = "--opaque=*".into();
        }
    }
    arguments
}

impl Args for KindArgs {
    fn augment_args(command: Command) -> Command {
        let alpha = Arg::new(ALPHA).long(ALPHA).action(ArgAction::SetTrue).help_heading(HEADING).help(
            "Read the PNG and JPEG textures of glTF materials with alphaMode MASK: a sight line passes \
                 where the texel is below alphaCutoff, and ends where it is not. Needs --method aggressive. \
                 Without the flag such materials are see-through as a whole, which loses nothing",
        );
        let command = FLAGS.into_iter().fold(command, |command, (kind, help)| {
            let arg = Arg::new(kind.name())
                .long(kind.name())
                .value_name("GLOB")
                .action(ArgAction::Append)
                .value_parser(move |glob: &str| Rule::new(kind, glob))
                .help_heading(HEADING)
                .help(help);
            // `--opaque` alone is about everything.
            let all = kind == Kind::Opaque;
            command.arg(if all {
                arg.num_args(0..=1).default_missing_value("*")
            } else {
                arg.num_args(1)
            })
        });
        command.arg(alpha).arg(
            Arg::new(CULL).long(CULL).action(ArgAction::SetTrue).help_heading(HEADING).help(
                "Triangles neither show nor block from behind. The front is where the vertices run \
                     counter-clockwise, in glTF after the transforms of the nodes. Materials with \
                     doubleSided keep both sides. Needs --method aggressive",
            ),
        )
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for KindArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut rules: Vec<(usize, Rule)> = Vec::new();
        for (kind, _) in FLAGS {
            let given = matches.get_many::<Rule>(kind.name()).unwrap_or_default();
            rules.extend(
                matches
                    .indices_of(kind.name())
                    .unwrap_or_default()
                    .zip(given.cloned()),
            );
        }
        rules.sort_by_key(|(at, _)| *at);
        let rules = rules.into_iter().map(|(_, rule)| rule).collect();
        let [alpha_textures, cull_back_faces] = [ALPHA, CULL].map(|flag| matches.get_flag(flag));
        Ok(Self {
            options: LoadOptions {
                rules,
                alpha_textures,
                cull_back_faces,
            },
        })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        scene: String,
        #[command(flatten)]
        kinds: KindArgs,
    }

    #[test]
    fn rules_keep_the_order_of_the_flags() {
        let line = [
            "x",
            "a.glb",
            "--see-through",
            "glass*",
            "--opaque",
            "--see-through=*pane",
            "--moving",
            "door",
        ];
        let line = Line::try_parse_from(line).unwrap();
        let rules: Vec<(Kind, String)> = line
            .kinds
            .options
            .rules
            .into_iter()
            .map(|r| (r.kind, r.glob))
            .collect();
        let expected = [
            (Kind::SeeThrough, "glass*"),
            (Kind::Opaque, "*"),
            (Kind::SeeThrough, "*pane"),
            (Kind::Moving, "door"),
        ];
        assert_eq!(rules, expected.map(|(k, g)| (k, g.to_owned())));
        assert_eq!(line.scene, "a.glb");
        assert!(!line.kinds.options.cull_back_faces);
        let culled = Line::try_parse_from(["x", "a.glb", "--cull-back-faces"])
            .unwrap()
            .kinds
            .options;
        assert!(culled.cull_back_faces && culled.rules.is_empty() && !culled.is_empty());
        assert!(Line::try_parse_from(["x", "a.glb", "--moving", "a["]).is_err());
        for (given, glob) in [
            (&["x", "--opaque", "a.GLB"][..], "*"),
            (&["x", "--opaque", "wall*", "a.GLB"], "wall*"),
        ] {
            let line = with_opaque_alone(given.iter().map(OsString::from));
            let line = Line::try_parse_from(line).unwrap();
            assert_eq!(
                (
                    line.scene.as_str(),
                    line.kinds.options.rules[0].glob.as_str()
                ),
                ("a.GLB", glob)
            );
        }
        let line = Line::try_parse_from(["x", "--alpha-textures", "a.glb"]).unwrap();
        let kinds = line.kinds.options;
        assert!(kinds.alpha_textures && !kinds.is_empty() && kinds.rules.is_empty());
    }
}
