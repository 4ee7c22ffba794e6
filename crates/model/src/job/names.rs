//! The named values of a job: tracer, method, sampler, superset simplification, error measure.
//!
//! Each parameter is defined here once: its variants, their names on the command line and in results, and
//! their numbers in messages, which the .proto file defines. A new variant needs an entry in the .proto file,
//! an entry here, and the code that implements it.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sightline_proto::v1;

use super::{FieldValue, SpecError, UnknownValue};

/// The numerics profile of jobs that need no tracer. Every worker has this profile, and all workers compute
/// the same bytes for such a job.
pub const NO_PROFILE: &str = "none";

/// A parameter whose value is one of several names.
pub trait NamedValue: Copy + Eq + Send + Sync + 'static {
    /// The parameter's name on the command line, without dashes.
    const PARAMETER: &'static str;
    /// All values, in the order in which help texts list them.
    const ALL: &'static [Self];

    /// Returns the value's name on the command line and in results.
    fn name(self) -> &'static str;

    /// Returns a one-line description of the value, for help texts.
    fn about(self) -> &'static str;

    /// Returns the value with a name.
    ///
    /// # Errors
    /// [`UnknownValue`] if no value has this name.
    fn from_name(name: &str) -> Result<Self, UnknownValue> {
        let found = Self::ALL.iter().copied().find(|c| c.name() == name);
        found.ok_or_else(|| unknown::<Self>(format!("{name:?}")))
    }
}

/// Creates the error of an unknown value of a parameter.
fn unknown<V: NamedValue>(given: String) -> UnknownValue {
    UnknownValue {
        parameter: V::PARAMETER,
        given,
        names: V::ALL.iter().map(|c| c.name()).collect(),
    }
}

/// Defines an enum with the names of its values and its default.
macro_rules! named_values {
    (
        $(#[$about:meta])*
        $choice:ident($parameter:literal) {
            $( $(#[doc = $line:literal])+ $variant:ident = $name:literal ),+ $(,)?
        }
        default $standard:ident
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $choice {
            $( $(#[doc = $line])+ $variant ),+
        }

        impl Default for $choice {
            fn default() -> Self {
                Self::$standard
            }
        }

        impl NamedValue for $choice {
            const PARAMETER: &'static str = $parameter;
            const ALL: &'static [Self] = &[$(Self::$variant),+];

            fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }

            fn about(self) -> &'static str {
                match self { $(Self::$variant => concat!($($line),+).trim_ascii()),+ }
            }
        }

        impl Serialize for $choice {
            fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
                to.serialize_str(self.name())
            }
        }

        impl<'de> Deserialize<'de> for $choice {
            fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
                Self::from_name(&String::deserialize(from)?).map_err(D::Error::custom)
            }
        }

        impl std::fmt::Display for $choice {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

/// Defines the numbers that the values of an enum of `named_values` have in messages.
macro_rules! on_the_wire {
    ($choice:ident as $wire:ident: $($variant:ident),+) => {
        impl FieldValue for $choice {
            type Wire = i32;

            fn from_wire(wire: i32) -> Result<Self, SpecError> {
                let found = Self::ALL.iter().copied().find(|c| c.to_wire() == wire);
                Ok(found.ok_or_else(|| unknown::<Self>(format!("number {wire}")))?)
            }

            fn to_wire(self) -> i32 {
                match self { $(Self::$variant => v1::$wire::$variant),+ }.into()
            }
        }
    };
}

named_values! {
    /// The method that decides the visible sets of cells.
    MethodName("method") {
        /// Only sampling: a triangle in the set was seen; a triangle outside the set may be visible.
        Aggressive = "aggressive",
        /// Sampling, then exact queries for every triangle that sampling did not show.
        Exact = "exact",
        /// Like exact, with lower limits for a single query; for --time-budget.
        Verified = "verified",
        /// No sampling: a triangle that no line through portals reaches is hidden. Any other triangle without
        /// a witness is undecided.
        Portals = "portals",
    }
    default Aggressive
}

named_values! {
    /// The sampler of visibility.
    SamplerName("sampler") {
        /// Sight lines that are shared by all cells they cross and guided by earlier hits.
        Lines = "lines",
        /// Visibility cubes on adaptively split rectangles (Nirenstein and Blake 2004).
        Cubes = "cubes",
        /// A fixed number of guided rays for each cell: the baseline of the benchmarks.
        Guided = "guided",
    }
    default Lines
}

named_values! {
    /// The tracer of rays and renderer of cubes.
    TracerChoice("backend") {
        /// The first worker times every tracer on the scene; the job uses the fastest.
        Auto = "auto",
        /// A GPU or software rasteriser through wgpu.
        Gpu = "gpu",
        /// The processor: the same bytes on every machine.
        Cpu = "cpu",
        /// The library Embree on the processor, for comparison.
        Embree = "embree",
    }
    default Auto
}

named_values! {
    /// The use of superset simplification (Nirenstein and Blake 2004, section 4.2.1).
    ///
    /// A cell's cubes are rendered with only the triangles that the parent cell saw.
    SupersetChoice("superset") {
        /// On for the gpu backend, whose cost grows with the triangles drawn; off for the cpu backend.
        Auto = "auto",
        /// On.
        On = "on",
        /// Off.
        Off = "off",
    }
    default Auto
}

named_values! {
    /// The error measure that determines whether a rectangle is split (Nirenstein and Blake 2004, sections
    /// 3.3 to 3.5).
    ErrorMeasure("error-measure") {
        /// Err″: the sets of the four cubes in the worst of 24 angular strata (equation 3).
        Strata = "strata",
        /// Err: the sets of the four cubes (equation 1).
        Sets = "sets",
        /// Err′: the four cubes pixel by pixel (equation 2).
        Pixels = "pixels",
        /// No comparison: every rectangle is split down to the minimum distance.
        Uniform = "uniform",
    }
    default Strata
}

named_values! {
    /// The items that the sets of a result list.
    Granularity("granularity") {
        /// Triangles.
        Triangles = "triangles",
        /// Clusters of at most 128 neighbouring triangles of one object.
        Clusters = "clusters",
        /// Objects: glTF node and primitive, OBJ group.
        Objects = "objects",
    }
    default Triangles
}

named_values! {
    /// The option to list the pairs of cells that see each other.
    CellToCell("cell-to-cell") {
        /// On for at most 512 cells, otherwise off.
        Auto = "auto",
        /// On; for at most 32768 cells.
        On = "on",
        /// Off.
        Off = "off",
    }
    default Auto
}

named_values! {
    /// The cells that a guided ray credits with the triangles that it meets.
    Crediting("credit") {
        /// Every cell that the free segment of the ray crosses.
        All = "all",
        /// Only the cell of the ray.
        Own = "own",
    }
    default All
}

named_values! {
    /// The completion of sampled sets with likely items that no sight line met.
    Completion("complete") {
        /// Only items that a sight line met, or that meet the cell.
        Off = "off",
        /// With the sampler lines, likely items as undecided, at most one for 20 seen ones.
        Auto = "auto",
    }
    default Auto
}

named_values! {
    /// The cost of a view cell for a viewpoint in it.
    CellCost("cost") {
        /// The number of triangles of the cell's set.
        Triangles = "triangles",
        /// The number of objects with a triangle in the cell's set.
        Objects = "objects",
        /// The size of the coded set, in bytes.
        Bytes = "bytes",
    }
    default Triangles
}

named_values! {
    /// The limits of a single exact query.
    Effort("effort") {
        /// Limits that suffice for nearly every triangle.
        Full = "full",
        /// Lower limits, so that no single query takes long.
        Bounded = "bounded",
    }
    default Full
}

named_values! {
    /// The axis that points up.
    Up("up") {
        /// The y axis, as in glTF.
        Y = "y",
        /// The z axis.
        Z = "z",
    }
    default Y
}

on_the_wire!(TracerChoice as Backend: Auto, Gpu, Cpu, Embree);

impl TracerChoice {
    /// Returns true if a job with this choice can be bound to a numerics profile.
    pub fn accepts(self, profile: &str) -> bool {
        let tracer = profile.split('/').next().unwrap_or_default();
        match self {
            Self::Auto => ["cpu", "gpu"].contains(&tracer),
            choice => tracer == choice.name(),
        }
    }
}

on_the_wire!(SupersetChoice as Superset: Auto, On, Off);
on_the_wire!(ErrorMeasure as ErrorMeasure: Strata, Sets, Pixels, Uniform);
on_the_wire!(Granularity as Granularity: Triangles, Clusters, Objects);
on_the_wire!(CellToCell as CellToCell: Auto, On, Off);
on_the_wire!(Crediting as Crediting: All, Own);
on_the_wire!(Completion as Completion: Off, Auto);
on_the_wire!(CellCost as CellCost: Triangles, Objects, Bytes);
on_the_wire!(Effort as Effort: Full, Bounded);
on_the_wire!(Up as Up: Y, Z);

#[cfg(test)]
mod tests {
    use super::*;

    fn every_name_leads_back<V: NamedValue + std::fmt::Debug>() {
        for value in V::ALL {
            assert_eq!(V::from_name(value.name()), Ok(*value));
            assert!(!value.about().is_empty());
        }
        let unknown = V::from_name("nonsense").unwrap_err().to_string();
        assert!(
            unknown.contains(V::PARAMETER) && unknown.contains(V::ALL[0].name()),
            "{unknown}"
        );
    }

    fn every_number_leads_back<V: NamedValue + FieldValue<Wire = i32> + std::fmt::Debug>() {
        every_name_leads_back::<V>();
        for value in V::ALL {
            assert_eq!(V::from_wire(value.to_wire()).ok(), Some(*value));
        }
        assert_eq!(V::from_wire(99).unwrap_err().option(), Some(V::PARAMETER));
    }

    #[test]
    fn every_value_leads_back_from_its_name_and_number() {
        every_name_leads_back::<MethodName>();
        every_name_leads_back::<SamplerName>();
        every_number_leads_back::<TracerChoice>();
        every_number_leads_back::<SupersetChoice>();
        every_number_leads_back::<ErrorMeasure>();
        every_number_leads_back::<Granularity>();
        every_number_leads_back::<CellToCell>();
        every_number_leads_back::<Crediting>();
        every_number_leads_back::<Completion>();
        every_number_leads_back::<CellCost>();
        every_number_leads_back::<Effort>();
        every_number_leads_back::<Up>();
    }
}
