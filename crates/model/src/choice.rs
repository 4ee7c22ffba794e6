//! The choices of a job: backend, sampler, method, superset simplification, error measure.
//!
//! Each choice is defined here once: its variants, their names on the command line and in results, and their
//! numbers on the wire, which are those of the .proto file. A new variant needs an entry in the .proto file,
//! an entry here, and the code that acts on it.

use serde::{Deserialize, Serialize};
use sightline_proto::v1;

/// The numerics profile of jobs that need no backend. Every worker has it, and all give the same bytes.
pub const NO_PROFILE: &str = "none";

/// A parameter whose value is one of a few names.
pub trait Choice: Copy + Eq + Send + Sync + 'static {
    /// The parameter's name on the command line, without dashes.
    const PARAMETER: &'static str;
    /// Every value, in the order in which help texts list them.
    const ALL: &'static [Self];

    /// The value's name on the command line and in results.
    fn name(self) -> &'static str;

    /// One line about the value, for help texts.
    fn about(self) -> &'static str;

    /// The value's number on the wire.
    fn to_wire(self) -> i32;

    /// The value with a number on the wire.
    ///
    /// # Errors
    /// [`UnknownChoice`] when this program knows no value with that number.
    fn from_wire(number: i32) -> Result<Self, UnknownChoice> {
        let found = Self::ALL.iter().copied().find(|c| c.to_wire() == number);
        found.ok_or_else(|| UnknownChoice::new::<Self>(format!("number {number}")))
    }

    /// The value with a name.
    ///
    /// # Errors
    /// [`UnknownChoice`] when no value has that name.
    fn from_name(name: &str) -> Result<Self, UnknownChoice> {
        let found = Self::ALL.iter().copied().find(|c| c.name() == name);
        found.ok_or_else(|| UnknownChoice::new::<Self>(format!("{name:?}")))
    }
}

/// A name or number that a [`Choice`] does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("this program knows no {parameter} {given}; give {}", one_of(names))]
pub struct UnknownChoice {
    /// The parameter's name.
    pub parameter: &'static str,
    /// The unknown value, as text.
    pub given: String,
    /// The names there are.
    pub names: Vec<&'static str>,
}

impl UnknownChoice {
    fn new<C: Choice>(given: String) -> Self {
        Self {
            parameter: C::PARAMETER,
            given,
            names: C::ALL.iter().map(|c| c.name()).collect(),
        }
    }
}

fn one_of(names: &[&str]) -> String {
    match names {
        [all @ .., last] if !all.is_empty() => format!("{} or {last}", all.join(", ")),
        names => names.join(", "),
    }
}

/// Defines one choice: an enum, its names, its numbers on the wire and its default.
macro_rules! choice {
    (
        $(#[$about:meta])*
        $choice:ident($parameter:literal) {
            $( $(#[doc = $line:literal])+ $variant:ident = $name:literal ),+ $(,)?
        }
        wire $wire:ident, default $standard:ident
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum $choice {
            $( $(#[doc = $line])+ $variant ),+
        }

        impl Default for $choice {
            fn default() -> Self {
                Self::$standard
            }
        }

        impl Choice for $choice {
            const PARAMETER: &'static str = $parameter;
            const ALL: &'static [Self] = &[$(Self::$variant),+];

            fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }

            fn about(self) -> &'static str {
                match self { $(Self::$variant => concat!($($line),+).trim_ascii()),+ }
            }

            fn to_wire(self) -> i32 {
                match self { $(Self::$variant => v1::$wire::$variant),+ }.into()
            }
        }

        impl std::fmt::Display for $choice {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

choice! {
    /// How much of a cell's visibility is decided, and by which means.
    Method("method") {
        /// Sampling alone: a triangle in the set was seen; a triangle outside it may be visible.
        Aggressive = "aggressive",
        /// Sampling, then exact queries for every triangle that sampling did not show.
        Exact = "exact",
        /// Like exact, with lower limits for a single query; meant for a time budget.
        Verified = "verified",
        /// No sampling: what is behind walls is hidden, as the portals between the parts of the scene show. A
        /// triangle without a witness is undecided.
        Portals = "portals",
    }
    wire Method, default Aggressive
}

choice! {
    /// How visibility is sampled.
    Sampler("sampler") {
        /// Sight lines that are shared by all cells they cross and guided by earlier finds.
        Lines = "lines",
        /// Visibility cubes on adaptively split rectangles (Nirenstein and Blake 2004).
        Cubes = "cubes",
        /// A fixed number of guided rays for each cell alone: the baseline of the benchmarks.
        Guided = "guided",
    }
    wire Sampler, default Lines
}

choice! {
    /// Where rays are traced and cubes rendered.
    BackendChoice("backend") {
        /// The first worker times every backend on the scene; the job takes the faster one.
        Auto = "auto",
        /// A GPU or software rasteriser through wgpu.
        Gpu = "gpu",
        /// Embree.
        Cpu = "cpu",
        /// None: the method portals needs no backend.
        None = "none",
    }
    wire Backend, default Auto
}

choice! {
    /// Whether a cell's cubes are rendered with only the triangles that the parent cell saw: superset
    /// simplification (Nirenstein and Blake 2004, section 4.2.1).
    SupersetChoice("superset") {
        /// On for the gpu backend, whose cost grows with the triangles drawn; off for the cpu backend.
        Auto = "auto",
        /// Always.
        On = "on",
        /// Never.
        Off = "off",
    }
    wire Superset, default Auto
}

choice! {
    /// The error measure that decides whether a rectangle is split (Nirenstein and Blake 2004, sections 3.3
    /// to 3.5).
    ErrorMeasure("error-measure") {
        /// Err″: the sets in each of 24 angular strata, the worst of them (equation 3).
        Strata = "strata",
        /// Err: the sets of the four cubes (equation 1).
        Sets = "sets",
        /// Err′: the four cubes pixel by pixel (equation 2).
        Pixels = "pixels",
        /// No comparison: every rectangle is split down to the minimum distance.
        Uniform = "uniform",
    }
    wire ErrorMeasure, default Strata
}

choice! {
    /// What the sets of a result name.
    Granularity("granularity") {
        /// Triangles.
        Triangles = "triangles",
        /// Clusters of at most 128 neighbouring triangles of one object.
        Clusters = "clusters",
        /// Objects: glTF node and primitive, OBJ group.
        Objects = "objects",
    }
    wire Granularity, default Triangles
}

choice! {
    /// Whether the result says which cells see which.
    CellToCell("cell-to-cell") {
        /// On with at most 512 cells.
        Auto = "auto",
        /// On; with at most 32768 cells.
        On = "on",
        /// Off.
        Off = "off",
    }
    wire CellToCell, default Auto
}

choice! {
    /// The axis that points up.
    Up("up") {
        /// The y axis, as in glTF.
        Y = "y",
        /// The z axis.
        Z = "z",
    }
    wire Up, default Y
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names_and_numbers_lead_back<C: Choice + std::fmt::Debug>() {
        for choice in C::ALL {
            assert_eq!(C::from_name(choice.name()), Ok(*choice));
            assert_eq!(C::from_wire(choice.to_wire()), Ok(*choice));
            assert!(!choice.about().is_empty());
        }
        let unknown = C::from_wire(99).unwrap_err().to_string();
        assert!(
            unknown.contains(C::PARAMETER) && unknown.contains(C::ALL[0].name()),
            "{unknown}"
        );
        assert!(C::from_name("nonsense").is_err());
    }

    #[test]
    fn every_choice_leads_back_from_its_name_and_number() {
        names_and_numbers_lead_back::<Method>();
        names_and_numbers_lead_back::<Sampler>();
        names_and_numbers_lead_back::<BackendChoice>();
        names_and_numbers_lead_back::<SupersetChoice>();
        names_and_numbers_lead_back::<ErrorMeasure>();
        names_and_numbers_lead_back::<Granularity>();
        names_and_numbers_lead_back::<CellToCell>();
        names_and_numbers_lead_back::<Up>();
    }
}
