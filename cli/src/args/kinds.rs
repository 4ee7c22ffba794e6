//! The flags that set the kinds of triangles and the culling of back faces. The order of the rules is the
//! order of the flags.

use std::ffi::OsString;
use std::path::Path;

use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use sightline::LoadOptions;
use sightline_scene::kinds::{KindRule, SurfaceKind};

/// The name of the flag that reads alpha textures, without dashes.
const ALPHA: &str = "alpha-textures";
const CULL: &str = "cull-back-faces";

/// The flags about kinds and sides of triangles.
#[derive(Clone, Debug, Default)]
pub struct KindArgs {
    /// The options for reading a scene.
    pub options: LoadOptions,
}

/// The heading of these flags in `--help`.
const HEADING: &str = "Kinds of surfaces";

const FLAGS: [(SurfaceKind, &str); 5] = [
    (
        SurfaceKind::SeeThrough,
        "Objects and materials whose name matches are see-through: a sight line passes through them, and \
         they are visible. By default, materials with transmission or with alphaMode MASK or BLEND (OBJ: d, \
         Tr, map_d, illum) are see-through; the flags override the file. If several flags match a name, the \
         last one applies. * matches any text",
    ),
    (
        SurfaceKind::OccluderOnly,
        "Objects and materials whose name matches block sight lines and are in no set, such as the proxy \
         meshes of an engine",
    ),
    (
        SurfaceKind::Moving,
        "Objects and materials whose name matches move at run time, so they neither block sight lines nor \
         are in a set. By default, animated nodes and skinned meshes are moving",
    ),
    (
        SurfaceKind::Door,
        "Objects and materials whose name matches are doors: they neither block sight lines nor are in a \
         set. With --method portals (or exact and --reachable-from), the area of a wall that a door covers \
         is an opening with the name of the object, and `look` can shut the opening",
    ),
    (
        SurfaceKind::Opaque,
        "Objects and materials whose name matches are opaque: they block sight lines and are visible. \
         Without a glob: all objects and materials. The name of a file after the flag is not used as its \
         glob",
    ),
];

/// The extensions of the files that commands accept.
const FILES: [&str; 6] = [".obj", ".ply", ".gltf", ".glb", ".pvs", ".tets"];

/// Returns the arguments with `--opaque` separated from a file that follows it. `--opaque` needs no glob, so
/// clap would otherwise use the file as its glob.
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
                 through texels below alphaCutoff and ends at other texels. Needs --method aggressive. \
                 Without the flag, such materials are see-through as a whole, so that no visible triangle is \
                 missing",
        );
        let command = FLAGS.into_iter().fold(command, |command, (kind, help)| {
            let arg = Arg::new(kind.name())
                .long(kind.name())
                .value_name("GLOB")
                .action(ArgAction::Append)
                .value_parser(move |glob: &str| KindRule::new(kind, glob))
                .help_heading(HEADING)
                .help(help);
            // `--opaque` without a glob applies to all triangles.
            let all = kind == SurfaceKind::Opaque;
            command.arg(if all {
                arg.num_args(0..=1).default_missing_value("*")
            } else {
                arg.num_args(1)
            })
        });
        command.arg(alpha).arg(
            Arg::new(CULL).long(CULL).action(ArgAction::SetTrue).help_heading(HEADING).help(
                "Ignore triangles whose back faces the viewpoint: they neither block sight lines nor are \
                     visible. On the front, the vertices are in counter-clockwise order, in glTF after the \
                     transforms of the nodes. Materials with doubleSided have two front sides. Needs \
                     --method aggressive",
            ),
        )
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for KindArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut rules: Vec<(usize, KindRule)> = Vec::new();
        for (kind, _) in FLAGS {
            let given = matches
                .get_many::<KindRule>(kind.name())
                .unwrap_or_default();
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
    fn rules_keep_order_of_flags() {
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
        let rules: Vec<(SurfaceKind, String)> = line
            .kinds
            .options
            .rules
            .into_iter()
            .map(|r| (r.kind, r.glob))
            .collect();
        let expected = [
            (SurfaceKind::SeeThrough, "glass*"),
            (SurfaceKind::Opaque, "*"),
            (SurfaceKind::SeeThrough, "*pane"),
            (SurfaceKind::Moving, "door"),
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
