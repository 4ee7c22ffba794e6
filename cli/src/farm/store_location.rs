//! The location of a coordinator's records, as given by `--store`.

use std::path::{Path, PathBuf};

use sightline::Error;
use sightline_store::DatabaseAddress;

use crate::args::serve::StoreArgs;
use crate::terminal::stderr::say;

/// The environment variable with the password of the database, as in PostgreSQL's own programs.
const PASSWORD: &str = "PGPASSWORD";

/// A location of records.
#[derive(Debug)]
pub enum StorePlace {
    /// The data directory.
    Default,
    /// The given directory.
    Sled(PathBuf),
    /// The memory of the process. The records are lost at its end.
    Memory,
    /// The given database.
    Database(Box<DatabaseAddress>),
}

impl StorePlace {
    /// Returns the location in the arguments. Error texts omit the address, which may contain a password.
    ///
    /// # Errors
    /// An error of the kind [`sightline::ErrorKind::Usage`] if the location or another option is invalid.
    pub fn from_args(args: &StoreArgs) -> Result<Self, Error> {
        let place = match args.store.as_deref().filter(|text| !text.is_empty()) {
            None => Self::Default,
            Some(text) => Self::parse(text, args.store_ca.as_deref())?,
        };
        let given = [
            ("--advertise", args.advertise.is_some()),
            ("--peer-ca", args.peer_ca.is_some()),
        ];
        if let Some((option, _)) = given.iter().find(|(_, is_given)| *is_given)
            && !matches!(place, Self::Database(_))
        {
            return Err(Error::usage(format!(
                "{option} is only for coordinators that share a database; give --store \
                 postgres://USER@HOST/DATABASE, or omit {option}"
            )));
        }
        Ok(place)
    }

    /// Parses a location. `ca` is the path of the authority of a database's certificate.
    ///
    /// # Errors
    /// An error of the kind [`sightline::ErrorKind::Usage`] if the text is not a valid location.
    pub fn parse(text: &str, ca: Option<&Path>) -> Result<Self, Error> {
        match text.split_once(':') {
            Some(("memory", "")) => Ok(Self::Memory),
            Some(("sled", directory)) if !directory.is_empty() => Ok(Self::Sled(directory.into())),
            Some(("postgres" | "postgresql", _)) => {
                if std::env::args().any(|argument| argument.contains(text)) && has_password(text) {
                    say(
                        "every user of this machine can read the password in the arguments; put \
                         the address into SIGHTLINE_STORE, or the password into PGPASSWORD",
                    );
                }
                let password = std::env::var(PASSWORD).ok().filter(|text| !text.is_empty());
                let address = DatabaseAddress::parse(text, password.as_deref(), ca);
                address
                    .map(|address| Self::Database(Box::new(address)))
                    .map_err(|e| Error::usage(e.to_string()))
            }
            _ => Err(Error::usage(
                "--store must be sled:DIR, memory: or postgres://USER@HOST/DATABASE".to_owned(),
            )),
        }
    }
}

/// Returns true if an address contains a password, between its user and its host or among its options.
fn has_password(text: &str) -> bool {
    let rest = text.split_once("://").map_or(text, |(_, rest)| rest);
    let authority = rest.split(['/', '?']).next().unwrap_or_default();
    authority
        .rsplit_once('@')
        .is_some_and(|(user, _)| user.contains(':'))
        || rest.contains("password=")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed_place(text: &str) -> Result<StorePlace, String> {
        let store = Some(text.to_owned());
        let args = StoreArgs {
            store,
            store_ca: None,
            advertise: None,
            peer_ca: None,
        };
        StorePlace::from_args(&args).map_err(|e| e.to_string())
    }

    #[test]
    fn locations_are_parsed_and_errors_contain_no_password() {
        assert!(matches!(parsed_place(""), Ok(StorePlace::Default)));
        assert!(matches!(parsed_place("memory:"), Ok(StorePlace::Memory)));
        assert!(
            matches!(parsed_place("sled:/a/b"), Ok(StorePlace::Sled(path)) if path == Path::new("/a/b"))
        );
        assert!(matches!(
            parsed_place("postgres://u:secret@127.0.0.1/d"),
            Ok(StorePlace::Database(_))
        ));
        for wrong in [
            "sled:",
            "memory:x",
            "secret",
            "mysql://u:secret@h/d",
            "postgres://u:secret@h:x/d",
        ] {
            let error = parsed_place(wrong).unwrap_err();
            assert!(
                !error.contains("secret") && error.contains("--store"),
                "{error}"
            );
        }
    }

    #[test]
    fn database_options_are_rejected_without_database() {
        let with = |store: &str| {
            let advertise = Some("https://one:7600".to_owned());
            StorePlace::from_args(&StoreArgs {
                store: Some(store.to_owned()),
                store_ca: None,
                advertise,
                peer_ca: None,
            })
        };
        assert!(with("postgres://u@127.0.0.1/d").is_ok());
        for store in ["", "memory:", "sled:/a"] {
            assert!(
                with(store).unwrap_err().to_string().contains("--advertise"),
                "{store}"
            );
        }
    }

    #[test]
    fn passwords_in_addresses_are_detected() {
        assert!(has_password("postgres://u:p@h/d") && has_password("postgres://u@h/d?password=p"));
        assert!(!has_password("postgres://u@h:5432/d"));
    }
}
