//! The arguments of `sightline token`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use sightline_coordinator::access::Scope;

#[derive(Args, Debug)]
pub struct TokenArgs {
    /// The file of tokens, which `sightline coordinator --tokens` reads.
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
    /// Make a token, and print it. The file keeps a digest of it alone.
    New {
        /// Whose jobs and scenes it opens.
        #[arg(long, value_name = "NAME")]
        user: String,
        /// What it allows, one or more with commas: read (see one's own jobs and fetch results), submit
        /// (that, and send scenes and jobs), worker (take tiles), admin (everything, on the jobs of all
        /// users).
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
        /// Its id, as `list` shows it: the eight digits after slt_.
        id: String,
    },
}
