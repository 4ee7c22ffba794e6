//! The arguments of `sightline token`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use sightline_coordinator::access::Scope;

#[derive(Args, Debug)]
pub struct TokenArgs {
    /// The file of tokens that `sightline coordinator --tokens` reads.
    #[arg(
        long = "tokens",
        value_name = "FILE",
        global = true,
        default_value = "sightline-tokens.json"
    )]
    pub file: PathBuf,
    #[command(subcommand)]
    pub command: TokenCommand,
}

#[derive(Subcommand, Debug)]
pub enum TokenCommand {
    /// Create a token and print it. The file stores only a digest of the token.
    New {
        /// The user whose jobs and scenes the token gives access to.
        #[arg(long, value_name = "NAME")]
        user: String,
        /// The permissions of the token, separated by commas: read (see and download the user's own jobs),
        /// submit (read, and upload scenes and submit jobs), worker (compute tiles), admin (every call, on
        /// the jobs of all users).
        #[arg(
            long = "scope",
            value_name = "SCOPES",
            required = true,
            value_delimiter = ','
        )]
        scopes: Vec<Scope>,
    },
    /// List the tokens: id, scopes, user.
    List,
    /// Revoke a token.
    Revoke {
        /// The id of the token, as `list` prints it: the eight hexadecimal digits after slt_.
        id: String,
    },
}
