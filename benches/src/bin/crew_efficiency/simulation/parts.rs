//! Workers, tiles, and what they hear.

use std::collections::{BTreeSet, VecDeque};

use sightline_sampling::crew::{Member, Queue};

/// What takes a worker's core for a while.
#[derive(Clone, Debug)]
pub enum Task {
    /// Checks and parses the scene.
    Parse,
    /// Neighbours, orders, the hierarchy.
    Facts,
    /// The table of a tile.
    Begin,
    /// Lists of candidates.
    Prepare,
    /// An item.
    Item(u32),
    /// The leader adds a piece of a helper.
    AddPiece(Vec<u32>),
    /// The leader encodes an outcome.
    Encode,
    /// A helper takes out the finds of a piece.
    Take(Vec<u32>),
    /// A helper adds an outcome.
    AddOutcome,
    /// What lies between this phase and the next.
    Gap,
    /// The end of the tile.
    End,
}

/// What tasks are for; the report's columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum For {
    /// The scene and its facts.
    Scene,
    /// The parts of a tile that every member does: its table, barriers, the end.
    Serial,
    /// Lists of candidates.
    Lists,
    /// Items.
    Items,
    /// Encoding and decoding.
    Coding,
}

/// Number of purposes.
pub const PURPOSES: usize = 5;

impl Task {
    /// What it is for.
    pub fn purpose(&self) -> For {
        match self {
            Self::Parse | Self::Facts => For::Scene,
            Self::Begin | Self::Gap | Self::End => For::Serial,
            Self::Prepare => For::Lists,
            Self::Item(_) => For::Items,
            Self::AddPiece(_) | Self::Encode | Self::Take(_) | Self::AddOutcome => For::Coding,
        }
    }
}

/// A message to a worker.
#[derive(Clone, Debug)]
pub enum ToWorker {
    /// Lead a tile.
    Grant(usize),
    /// Help with a tile.
    Help(usize),
    /// The scene.
    Scene,
    /// To a helper: items of a phase.
    Take(u32, Vec<u32>),
    /// To a helper: an outcome.
    Outcome(u32),
    /// To a helper: the crew has ended.
    Over,
    /// To a leader: a helper has come.
    Joined(Member),
    /// To a leader: a helper is ready for items of a phase.
    Ask(Member, u32),
    /// To a leader: finds.
    Found(u32, Vec<u32>),
}

/// A message to the coordinator.
#[derive(Clone, Debug)]
pub enum ToCoordinator {
    /// The scene is needed.
    Fetch,
    /// A member is in its room.
    Enter,
    /// From a helper to the leader.
    Ask(u32),
    /// From a helper to the leader.
    Found(u32, Vec<u32>),
    /// From the leader to a helper.
    Take(Member, u32, Vec<u32>),
    /// From the leader: an outcome.
    Outcome(u32),
    /// From the leader: the crew has ended.
    Over,
    /// From a helper: it is free.
    Free,
    /// From the leader: the tile's output.
    Output,
}

/// A worker.
#[derive(Debug, Default)]
pub struct Worker {
    /// Whether it has the scene and its facts.
    pub has_scene: bool,
    pub has_facts: bool,
    /// The tile that it leads or helps with.
    pub tile: usize,
    /// The phase in work.
    pub phase: u32,
    pub role: Role,
    /// What its core does.
    pub task: Option<Task>,
}

/// What a worker is.
#[derive(Debug, Default)]
pub enum Role {
    /// Without a tile.
    #[default]
    Idle,
    /// The leader of a tile.
    Leads(Leads),
    /// A helper.
    Helps(Helps),
}

/// The state of a leader, as in `crates/sampling/src/crew/leader.rs`.
#[derive(Debug, Default)]
pub struct Leads {
    pub number: u32,
    pub queue: Option<Queue>,
    /// Items of the phase that have their answers.
    pub answered: Vec<bool>,
    pub helpers: BTreeSet<Member>,
    pub ready: BTreeSet<Member>,
    pub asking: VecDeque<(Member, u32)>,
    pub done: VecDeque<Vec<u32>>,
    pub kept: Vec<u32>,
    pub handed_over: Option<u64>,
}

/// The state of a helper, as in `crates/sampling/src/crew/helper.rs`.
#[derive(Debug, Default)]
pub struct Helps {
    pub outcomes: BTreeSet<u32>,
    pub pieces: VecDeque<(u32, Vec<u32>)>,
    /// The piece in work, and the number of its items that are done.
    pub piece: Option<(Vec<u32>, usize)>,
    pub is_over: bool,
    pub has_asked: bool,
    pub waits: bool,
}

/// A tile.
#[derive(Debug, Default)]
pub struct Tile {
    pub leader: usize,
    /// Whether its leader can use helpers.
    pub is_open: bool,
    /// Workers that were sent to help.
    pub sent: usize,
    /// Helpers that are here.
    pub helpers: Vec<usize>,
    /// Outcomes that are here.
    pub outcomes: u32,
    pub is_done: bool,
}
