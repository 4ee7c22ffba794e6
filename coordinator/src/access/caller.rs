//! Callers, their scopes, and the scope that each call needs.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// What a token allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// To see one's own jobs and fetch their results.
    Read,
    /// That, and to send scenes, to submit jobs and to change one's own.
    Submit,
    /// To take tiles, to fetch what they need and to send their results.
    Worker,
    /// Everything, on the jobs and scenes of all users.
    Admin,
}

impl Scope {
    /// All, from the least.
    pub const ALL: [Self; 4] = [Self::Read, Self::Submit, Self::Worker, Self::Admin];
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Read => "read",
            Self::Submit => "submit",
            Self::Worker => "worker",
            Self::Admin => "admin",
        })
    }
}

impl FromStr for Scope {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let named = Self::ALL
            .into_iter()
            .find(|scope| scope.to_string() == text);
        named.ok_or_else(|| "a scope is read, submit, worker or admin".to_owned())
    }
}

/// A set of scopes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scopes(u8);

impl Scopes {
    /// The set of these.
    pub fn of(scopes: &[Scope]) -> Self {
        Self(scopes.iter().fold(0, |set, scope| set | 1 << *scope as u8))
    }

    /// Those that the set names.
    pub fn named(self) -> Vec<Scope> {
        Scope::ALL
            .into_iter()
            .filter(|scope| self.0 >> *scope as u8 & 1 == 1)
            .collect()
    }

    /// Whether the set allows what a scope allows: who may submit may read, and `admin` may everything.
    pub fn include(self, scope: Scope) -> bool {
        let has = |scope: Scope| self.0 >> scope as u8 & 1 == 1;
        has(scope) || has(Scope::Admin) || scope == Scope::Read && has(Scope::Submit)
    }
}

impl Serialize for Scopes {
    fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.named().serialize(to)
    }
}

impl<'de> Deserialize<'de> for Scopes {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Ok(Self::of(&Vec::<Scope>::deserialize(from)?))
    }
}

/// Who makes a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Caller {
    /// Somebody, where nobody is asked who they are.
    Nobody,
    /// The user of a token, or a worker by its certificate.
    User {
        /// The user's name.
        name: String,
        /// What the token allows.
        scopes: Scopes,
    },
}

impl Caller {
    /// The owner of what the caller makes: nobody where nobody is asked.
    pub fn owner(&self) -> &str {
        match self {
            Self::Nobody => "",
            Self::User { name, .. } => name,
        }
    }

    /// Whether the caller may see and change everything: where nobody is asked, and with the scope `admin`.
    pub fn sees_all(&self) -> bool {
        match self {
            Self::Nobody => true,
            Self::User { scopes, .. } => scopes.include(Scope::Admin),
        }
    }

    /// Whether the caller may see what somebody owns.
    pub fn sees(&self, owner: &str) -> bool {
        self.sees_all() || !owner.is_empty() && owner == self.owner()
    }
}

/// What a call needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Nothing: the health and the description of the services.
    Nothing,
    /// A scope.
    Scope(Scope),
}

/// What a call needs, by its path, such as `/sightline.v1.Jobs/List`. Calls that are not listed need `admin`.
pub fn needed(path: &str) -> Need {
    let mut parts = path.trim_start_matches('/').splitn(2, '/');
    let (service, method) = (
        parts.next().unwrap_or_default(),
        parts.next().unwrap_or_default(),
    );
    Need::Scope(match (service, method) {
        ("grpc.health.v1.Health", _) => return Need::Nothing,
        ("grpc.reflection.v1.ServerReflection" | "grpc.reflection.v1alpha.ServerReflection", _) => {
            return Need::Nothing;
        }
        ("sightline.v1.Jobs", "List" | "Show" | "Watch" | "Fetch" | "FetchPartial") => Scope::Read,
        (
            "sightline.v1.Jobs",
            "MissingChunks" | "PutChunks" | "PutScene" | "PutSceneFile" | "PutReceivers" | "Submit"
            | "Estimate" | "Cancel" | "Pause" | "Resume" | "Prioritize" | "Retry" | "Delete",
        ) => Scope::Submit,
        ("sightline.v1.Results", "Query" | "Why" | "Measure") => Scope::Read,
        ("sightline.v1.Farm", "ListTiles" | "Events") => Scope::Read,
        ("sightline.v1.Workers", _) => Scope::Worker,
        _ => Scope::Admin,
    })
}
