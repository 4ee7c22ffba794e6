//! What chooses an adapter, and what is told about one.

/// Which adapter to use.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// A GPU; software rasterisers do not count.
    Hardware,
    /// A GPU if there is one, else a software rasteriser such as lavapipe.
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
    /// Its name, as the driver gives it.
    pub name: String,
    /// Name and version of the driver.
    pub driver: String,
    /// The graphics interface of the driver, for example `vulkan`.
    pub interface: String,
    /// Whether it rasterises on the CPU.
    pub software: bool,
    /// The numerics profile a backend on it would have.
    pub profile: String,
}
