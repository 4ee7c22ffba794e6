//! The location of blobs, as an operator configures it: `dir:PATH` or `s3://BUCKET/PREFIX?OPTION=VALUE&…`.

use std::path::PathBuf;
use std::str::FromStr;

/// Default size of the cache of checked blobs on the coordinator's disk, in bytes.
const CACHE: u64 = 8 << 30;
/// Maximum length of a prefix, in bytes. A key may have 1024 bytes.
const MAX_PREFIX: usize = 512;

/// The location of blobs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BlobPlace {
    /// A directory on this machine.
    Directory(PathBuf),
    /// A bucket of an S3-compatible store.
    Bucket(Box<BucketPlace>),
}

/// The way in which workers access the blobs of a bucket.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Ways {
    /// Workers access blobs only through the coordinator.
    #[default]
    Coordinator,
    /// Workers access the store directly, at the coordinator's endpoint.
    Endpoint,
    /// Workers access the store directly, at an address that the coordinator does not use.
    Address(String),
}

/// A bucket of an S3-compatible store and its connection settings, without keys. The keys come from the
/// environment or from a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BucketPlace {
    /// The name of the bucket.
    pub bucket: String,
    /// The prefix of all keys; may be empty.
    pub prefix: String,
    /// The address of the store; `None` for the address in `AWS_ENDPOINT_URL`, or else Amazon's.
    pub endpoint: Option<String>,
    /// The region; `None` for the region in `AWS_REGION`.
    pub region: Option<String>,
    /// A PEM file with the authority of the store's certificate, trusted in addition to the system's
    /// authorities.
    pub ca: Option<PathBuf>,
    /// A file with the keys, in the format of Amazon's tools; `None` for the environment.
    pub keys: Option<PathBuf>,
    /// Maximum number of bytes of checked blobs in the cache on the coordinator's disk.
    pub cache: u64,
    /// The way in which workers access the blobs.
    pub direct: Ways,
    /// True if an unencrypted address may lead to another machine.
    pub allow_plaintext: bool,
}

/// An error in a location. It never contains the value of an option, which may be a secret.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
pub enum PlaceError {
    /// The text begins with neither `dir:` nor `s3://`.
    #[error(
        "the location of blobs is neither dir:PATH nor s3://BUCKET/PREFIX; give one of these forms"
    )]
    Scheme,
    /// The name of the bucket is invalid.
    #[error(
        "a bucket's name has 3 to 63 letters, digits, dots, hyphens and underscores; correct \
         s3://BUCKET"
    )]
    Bucket,
    /// The prefix is invalid.
    #[error(
        "a prefix has at most {MAX_PREFIX} letters, digits and -_.=/ and no empty part; correct \
         s3://BUCKET/PREFIX"
    )]
    Prefix,
    /// The option does not exist.
    #[error(
        "the option '{0}' of s3:// does not exist; the options are endpoint, region, ca, keys, \
         cache and direct. Keys are read from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or from \
         the file of keys="
    )]
    Option(String),
    /// The option has no value or occurs twice.
    #[error("give the option '{0}' of s3:// once, as {0}=VALUE")]
    Value(&'static str),
    /// The endpoint is not a valid address.
    #[error("the endpoint of s3:// must be https://HOST or https://HOST:PORT, without a path")]
    Endpoint,
    /// The endpoint is unencrypted and on another machine.
    #[error(
        "the endpoint of s3:// is not encrypted, and is not on this machine; use https://, or add \
         --allow-plaintext on a private network"
    )]
    Plaintext,
    /// The value of the option `direct` is invalid.
    #[error(
        "direct= of s3:// must be yes, no, or the address of the store for workers, such as \
         https://HOST:PORT"
    )]
    Direct,
    /// The size of the cache is invalid.
    #[error(
        "cache= of s3:// must be a number of bytes, with K, M, G or T behind it if needed, such as 20G"
    )]
    Cache,
}

impl FromStr for BlobPlace {
    type Err = PlaceError;

    fn from_str(text: &str) -> Result<Self, PlaceError> {
        if let Some(path) = text.strip_prefix("dir:").filter(|path| !path.is_empty()) {
            return Ok(Self::Directory(path.into()));
        }
        let rest = text.strip_prefix("s3://").ok_or(PlaceError::Scheme)?;
        let (path, options) = rest.split_once('?').unwrap_or((rest, ""));
        let (bucket, prefix) = path.split_once('/').unwrap_or((path, ""));
        let prefix = prefix.strip_suffix('/').unwrap_or(prefix);
        let plain = |s: &str, more: &str| {
            s.chars()
                .all(|c| c.is_ascii_alphanumeric() || more.contains(c))
        };
        if !(3..=63).contains(&bucket.len()) || !plain(bucket, "-._") {
            return Err(PlaceError::Bucket);
        }
        let part = |part: &str| !["", ".", ".."].contains(&part) && plain(part, "-_.=");
        if prefix.len() > MAX_PREFIX || !prefix.is_empty() && !prefix.split('/').all(part) {
            return Err(PlaceError::Prefix);
        }
        let (bucket, prefix) = (bucket.to_owned(), prefix.to_owned());
        let mut place = BucketPlace {
            bucket,
            prefix,
            endpoint: None,
            region: None,
            ca: None,
            keys: None,
            cache: CACHE,
            direct: Ways::Coordinator,
            allow_plaintext: false,
        };
        let (mut cache, mut direct) = (None, None);
        for option in options.split('&').filter(|option| !option.is_empty()) {
            let (name, value) = option.split_once('=').unwrap_or((option, ""));
            match name {
                "endpoint" => set(&mut place.endpoint, "endpoint", value, value.to_owned())?,
                "region" => set(&mut place.region, "region", value, value.to_owned())?,
                "ca" => set(&mut place.ca, "ca", value, value.into())?,
                "keys" => set(&mut place.keys, "keys", value, value.into())?,
                "cache" => set(
                    &mut cache,
                    "cache",
                    value,
                    bytes(value).ok_or(PlaceError::Cache)?,
                )?,
                "direct" => set(
                    &mut direct,
                    "direct",
                    value,
                    ways(value).ok_or(PlaceError::Direct)?,
                )?,
                // The text in place of an option name may be a secret, so show only plausible names.
                _ if plain(name, "-_") && name.len() <= 32 => {
                    return Err(PlaceError::Option(name.to_owned()));
                }
                _ => return Err(PlaceError::Option("…".to_owned())),
            }
        }
        (place.cache, place.direct) = (cache.unwrap_or(CACHE), direct.unwrap_or_default());
        Ok(Self::Bucket(Box::new(place)))
    }
}

fn set<T>(
    slot: &mut Option<T>,
    name: &'static str,
    text: &str,
    value: T,
) -> Result<(), PlaceError> {
    let is_new = slot.replace(value).is_none();
    if is_new && !text.is_empty() {
        Ok(())
    } else {
        Err(PlaceError::Value(name))
    }
}

fn ways(text: &str) -> Option<Ways> {
    match text {
        "yes" => Some(Ways::Endpoint),
        "no" => Some(Ways::Coordinator),
        // The endpoint check validates the address.
        _ => text.contains("://").then(|| Ways::Address(text.to_owned())),
    }
}

/// Parses a number of bytes with an optional suffix K, M, G or T (powers of 1024).
fn bytes(text: &str) -> Option<u64> {
    let split = text
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(text.len());
    let (number, letter) = text.split_at(split);
    let shift = match letter {
        "" => 0,
        "K" => 10,
        "M" => 20,
        "G" => 30,
        "T" => 40,
        _ => return None,
    };
    number.parse::<u64>().ok()?.checked_mul(1 << shift)
}

impl BucketPlace {
    /// Returns the location without its options, for messages.
    pub(super) fn name(&self) -> String {
        let slash = if self.prefix.is_empty() { "" } else { "/" };
        format!("s3://{}{slash}{}", self.bucket, self.prefix)
    }

    /// Checks an address of a store.
    ///
    /// # Errors
    /// An error if the address is invalid, or if it is unencrypted on a network where that is not allowed.
    pub(super) fn check(&self, endpoint: &str) -> Result<(), PlaceError> {
        let uri: sightline_http::Uri = endpoint.parse().map_err(|_| PlaceError::Endpoint)?;
        let authority = uri
            .authority()
            .filter(|a| !a.as_str().contains('@'))
            .ok_or(PlaceError::Endpoint)?;
        if !matches!(uri.path(), "" | "/") || uri.query().is_some() {
            return Err(PlaceError::Endpoint);
        }
        let host = authority.host();
        let is_here = host == "localhost"
            || host
                .trim_matches(['[', ']'])
                .parse()
                .is_ok_and(|a: std::net::IpAddr| a.is_loopback());
        match uri.scheme_str() {
            Some("https") => Ok(()),
            Some("http") if is_here || self.allow_plaintext => Ok(()),
            Some("http") => Err(PlaceError::Plaintext),
            _ => Err(PlaceError::Endpoint),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bucket(text: &str) -> BucketPlace {
        match text.parse() {
            Ok(BlobPlace::Bucket(place)) => *place,
            other => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn places_are_parsed() {
        assert_eq!(
            "dir:/var/blobs".parse(),
            Ok(BlobPlace::Directory("/var/blobs".into()))
        );
        let plain = bucket("s3://farm-blobs");
        assert_eq!(
            (plain.name().as_str(), plain.cache),
            ("s3://farm-blobs", CACHE)
        );
        let full = bucket(
            "s3://farm.blobs/a/b=1/?endpoint=https://s3.example:9000&region=eu-1&ca=/etc/ca.pem&keys=k\
             &cache=20G&direct=https://public.example",
        );
        assert_eq!(
            full.direct,
            Ways::Address("https://public.example".to_owned())
        );
        assert_eq!(bucket("s3://farm?direct=yes").direct, Ways::Endpoint);
        assert_eq!(
            (bucket("s3://farm?direct=no").direct, &plain.direct),
            (Ways::Coordinator, &Ways::Coordinator)
        );
        assert_eq!(full.name(), "s3://farm.blobs/a/b=1");
        assert_eq!(full.endpoint.as_deref(), Some("https://s3.example:9000"));
        assert_eq!(
            (full.region.as_deref(), full.cache),
            (Some("eu-1"), 20 << 30)
        );
        assert_eq!(
            (full.ca, full.keys),
            (Some("/etc/ca.pem".into()), Some("k".into()))
        );
        assert_eq!(bucket("s3://farm?cache=0").cache, 0);
    }

    #[test]
    fn invalid_places_are_rejected_without_their_values() {
        for (text, error) in [
            ("", PlaceError::Scheme),
            ("dir:", PlaceError::Scheme),
            ("/var/blobs", PlaceError::Scheme),
            ("s3://", PlaceError::Bucket),
            ("s3://key:secret@farm/blobs", PlaceError::Bucket),
            ("s3://farm/a//b", PlaceError::Prefix),
            ("s3://farm/a/../b", PlaceError::Prefix),
            ("s3://farm/a%2fb", PlaceError::Prefix),
            ("s3://farm?region", PlaceError::Value("region")),
            ("s3://farm?region=a&region=b", PlaceError::Value("region")),
            ("s3://farm?cache=much", PlaceError::Cache),
            ("s3://farm?cache=99999999999T", PlaceError::Cache),
            ("s3://farm?direct=maybe", PlaceError::Direct),
            (
                "s3://farm?secret_access_key=hush",
                PlaceError::Option("secret_access_key".to_owned()),
            ),
            ("s3://farm?hush+/hush", PlaceError::Option("…".to_owned())),
        ] {
            let found = text.parse::<BlobPlace>().unwrap_err();
            assert_eq!(found, error, "{text}");
            assert!(!found.to_string().contains("hush"), "{found}");
        }
    }

    #[test]
    fn unencrypted_address_must_be_on_this_machine() {
        let mut place = bucket("s3://farm");
        for here in [
            "http://127.0.0.1:9000",
            "http://[::1]:9000",
            "http://localhost",
            "https://s3.example",
        ] {
            assert_eq!(place.check(here), Ok(()), "{here}");
        }
        assert_eq!(
            place.check("http://10.0.0.7:9000"),
            Err(PlaceError::Plaintext)
        );
        assert_eq!(
            place.check("http://localhost.example"),
            Err(PlaceError::Plaintext)
        );
        for wrong in [
            "s3.example",
            "ftp://s3.example",
            "https://a@s3.example",
            "https://s3.example/bucket",
        ] {
            assert_eq!(place.check(wrong), Err(PlaceError::Endpoint), "{wrong}");
        }
        place.allow_plaintext = true;
        assert_eq!(place.check("http://10.0.0.7:9000"), Ok(()));
    }
}
