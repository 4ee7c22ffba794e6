//! The choice of an adapter, and the description of an adapter.

/// The choice of an adapter.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// A GPU. Software rasterisers are excluded.
    Hardware,
    /// A GPU if the machine has one, otherwise a software rasteriser such as lavapipe.
    #[default]
    AllowSoftware,
    /// The first adapter whose name contains this text, ignoring case.
    Named(String),
}

impl AdapterChoice {
    pub(super) fn fits(&self, adapter: &AdapterSummary) -> bool {
        match self {
            Self::Hardware => !adapter.software,
            Self::AllowSoftware => true,
            Self::Named(part) => adapter.name.to_lowercase().contains(&part.to_lowercase()),
        }
    }
}

/// An adapter of this machine, for diagnostics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterSummary {
    /// The name of the adapter, as the driver reports it.
    pub name: String,
    /// The name and version of the driver.
    pub driver: String,
    /// The graphics interface of the driver, for example `vulkan`.
    pub interface: String,
    /// True if the adapter rasterises on the CPU.
    pub software: bool,
    /// The numerics profile of a backend on this adapter.
    pub profile: String,
}
