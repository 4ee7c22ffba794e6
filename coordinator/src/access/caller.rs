//! Callers, scopes, and the scope that each call requires.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A permission that a token grants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Permission to read the user's own jobs and to download their results.
    Read,
    /// The permission `Read`, and permission to upload scenes, to submit jobs and to change the user's own
    /// jobs.
    Submit,
    /// Permission to lease tiles, to download their inputs and to upload their results.
    Worker,
    /// Permission for every call, on the jobs and scenes of all users.
    Admin,
}

impl Scope {
    /// All scopes, in ascending order of permission.
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
    /// Creates a set that contains the given scopes.
    pub fn new(scopes: &[Scope]) -> Self {
        Self(scopes.iter().fold(0, |set, scope| set | 1 << *scope as u8))
    }

    /// Returns the scopes in the set.
    pub fn named(self) -> Vec<Scope> {
        Scope::ALL
            .into_iter()
            .filter(|scope| self.0 >> *scope as u8 & 1 == 1)
            .collect()
    }

    /// Returns true if the set grants the permissions of `scope`. `Submit` includes `Read`, and `Admin`
    /// includes all scopes.
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
        Ok(Self::new(&Vec::<Scope>::deserialize(from)?))
    }
}

/// The identity of a caller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Caller {
    /// An anonymous caller, on a coordinator that does not authenticate.
    Nobody,
    /// The user of a token, or a worker that its certificate identifies.
    User {
        /// The user's name.
        name: String,
        /// The scopes that the token grants.
        scopes: Scopes,
    },
}

impl Caller {
    /// Returns the owner of the data that the caller creates. The owner of an anonymous caller is the empty
    /// string.
    pub fn owner(&self) -> &str {
        match self {
            Self::Nobody => "",
            Self::User { name, .. } => name,
        }
    }

    /// Returns true if the caller may read and change all data: without authentication, or with the scope
    /// `Admin`.
    pub fn sees_all(&self) -> bool {
        match self {
            Self::Nobody => true,
            Self::User { scopes, .. } => scopes.include(Scope::Admin),
        }
    }

    /// Returns true if the caller may read the data of `owner`.
    pub fn sees(&self, owner: &str) -> bool {
        self.sees_all() || !owner.is_empty() && owner == self.owner()
    }
}

/// The permission that a call requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// No permission: for the health and the description of the services.
    Nothing,
    /// A scope that the caller must have.
    Scope(Scope),
}

/// Returns the permission that a call requires. `path` is a path such as `/sightline.v1.Jobs/List`. Calls
/// that are not listed require `Admin`.
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
