//! Where blobs are, as an operator says it: `dir:PATH` or `s3://BUCKET/PREFIX?OPTION=VALUE&…`.

use std::path::PathBuf;
use std::str::FromStr;

/// Bytes of checked blobs that are kept on the coordinator's disk unless `cache` says otherwise.
const CACHE: u64 = 8 << 30;
/// Longest prefix in bytes; a key may have 1024.
const MAX_PREFIX: usize = 512;

/// Where blobs are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BlobPlace {
    /// A directory of this machine.
    Directory(PathBuf),
    /// A bucket of an S3-compatible store.
    Bucket(Box<BucketPlace>),
}

/// How workers get at the blobs of a bucket.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Ways {
    /// Through the coordinator alone.
    #[default]
    Coordinator,
    /// By themselves, where the coordinator does.
    Endpoint,
    /// By themselves, at an address of the store that the coordinator does not use.
    Address(String),
}

/// A bucket of an S3-compatible store, and how to reach it. Has no keys: they come from the environment or
/// from a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BucketPlace {
    /// The name of the bucket.
    pub bucket: String,
    /// What all keys begin with; empty for nothing.
    pub prefix: String,
    /// The address of the store; `None` for Amazon's, or the one in `AWS_ENDPOINT_URL`.
    pub endpoint: Option<String>,
    /// The region; `None` for the one in `AWS_REGION`.
    pub region: Option<String>,
    /// The authority of the store's certificate as PEM, beside those that the system trusts.
    pub ca: Option<PathBuf>,
    /// A file with the keys, as the tools of Amazon write it; `None` for the environment.
    pub keys: Option<PathBuf>,
    /// Most bytes of checked blobs that are kept on the coordinator's disk.
    pub cache: u64,
    /// How workers get at the blobs.
    pub direct: Ways,
    /// Whether an address without encryption may be beyond this machine.
    pub allow_plaintext: bool,
}

/// A place that cannot be understood. Never has the text of an option's value, which may be a secret.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
pub enum PlaceError {
    /// It begins with neither of the two.
    #[error("blobs are at dir:PATH or at s3://BUCKET/PREFIX; this is neither")]
    Scheme,
    /// The name of the bucket cannot be one.
    #[error(
        "a bucket's name has 3 to 63 letters, digits, dots, hyphens and underscores; correct s3://BUCKET"
    )]
    Bucket,
    /// The prefix cannot be one.
    #[error(
        "a prefix has at most {MAX_PREFIX} letters, digits and -_.=/ and no empty part; correct \
         s3://BUCKET/PREFIX"
    )]
    Prefix,
    /// An option that does not exist.
    #[error(
        "there is no option '{0}' of s3://; there are endpoint, region, ca, keys, cache and direct. Keys are \
         read from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or from the file that keys= names"
    )]
    Option(String),
    /// An option without a value, or given twice.
    #[error("give the option '{0}' of s3:// once, as {0}=VALUE")]
    Value(&'static str),
    /// The address is not one.
    #[error("the endpoint of s3:// must be https://HOST or https://HOST:PORT, without a path")]
    Endpoint,
    /// An address without encryption beyond this machine.
    #[error(
        "the endpoint of s3:// is not encrypted, and is not on this machine; give one with https://, or \
         --allow-plaintext where the network is private"
    )]
    Plaintext,
    /// How workers get at blobs is not said.
    #[error(
        "direct= of s3:// is yes, no, or the address of the store for workers, such as https://HOST:PORT"
    )]
    Direct,
    /// The bound of the cache is not one.
    #[error(
        "cache= of s3:// is a number of bytes, or one with K, M, G or T behind it, such as 20G"
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
                // Whatever stands where a name should be may be anything.
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
        // What kind of address it is, is looked at with the endpoint.
        _ => text.contains("://").then(|| Ways::Address(text.to_owned())),
    }
}

/// A number of bytes with or without a letter behind it.
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
    /// The place without its options, for messages.
    pub(super) fn name(&self) -> String {
        let slash = if self.prefix.is_empty() { "" } else { "/" };
        format!("s3://{}{slash}{}", self.bucket, self.prefix)
    }

    /// Checks an address of a store.
    ///
    /// # Errors
    /// When it is not one, or goes over a network without encryption where that is not allowed.
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
    fn places_are_read() {
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
    fn other_places_are_refused_without_their_values() {
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
    fn an_address_without_encryption_stays_on_this_machine() {
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
