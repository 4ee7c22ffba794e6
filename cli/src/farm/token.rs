//! `sightline token`: creates, lists and revokes tokens in the token file of a coordinator.

use std::path::Path;

use sightline::Error;
use sightline_coordinator::access::{Scope, Token, TokenFile, TokenLock};

use crate::args::token::{TokenArgs, TokenCommand};
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Creates, lists or revokes tokens in the token file.
pub fn run(args: &TokenArgs, json: bool) -> Result<(), Error> {
    let input = |e: &dyn std::fmt::Display| Error::input(e.to_string());
    let path = &args.file;
    match &args.command {
        TokenCommand::New { user, scopes } => {
            let _turn = TokenLock::take(path).map_err(|e| input(&e))?;
            let mut file = if path.exists() {
                read(path)?
            } else {
                TokenFile::default()
            };
            let mut random = [0; 36];
            getrandom::fill(&mut random).map_err(Error::internal)?;
            let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
            let now = now.map_or(0, |since| since.as_millis() as u64);
            let text = file
                .add(user, scopes, now, random)
                .map_err(|e| Error::usage(e.to_string()))?;
            file.write(path).map_err(|e| input(&e))?;
            say(&format!(
                "a token of {user} for {}; it is printed only once: store it in a file that only \
                 its user can read",
                listed(scopes)
            ));
            print(&text)
        }
        TokenCommand::List => {
            let file = read(path)?;
            if json {
                let to_json = |t: &Token| {
                    let (id, user, scopes) = (&t.id, &t.user, &t.scopes);
                    serde_json::json!({"id": id, "user": user, "scopes": scopes, "made_at_ms": t.made_at_ms})
                };
                return print(
                    &serde_json::Value::from_iter(file.tokens.iter().map(to_json)).to_string(),
                );
            }
            let lines = file
                .tokens
                .iter()
                .map(|t| format!("{}  {}  {}", t.id, listed(&t.scopes.named()), t.user));
            lines.into_iter().try_for_each(|line| print(&line))
        }
        TokenCommand::Revoke { id } => {
            let _turn = TokenLock::take(path).map_err(|e| input(&e))?;
            let mut file = read(path)?;
            if !file.revoke(id) {
                return Err(Error::input(format!(
                    "{} has no token {id}; `sightline token list` lists the ids",
                    path.display()
                )));
            }
            file.write(path).map_err(|e| input(&e))?;
            say(
                "revoked the token; coordinators reject it within two seconds, and running calls continue",
            );
            Ok(())
        }
    }
}

fn read(path: &Path) -> Result<TokenFile, Error> {
    TokenFile::read(path).map_err(|e| Error::input(e.to_string()))
}

fn listed(scopes: &[Scope]) -> String {
    scopes
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(",")
}
