//! Connections of clients and workers to a coordinator: address, trusted certificates and credentials.

use std::error::Error as _;
use std::fmt;
use std::net::IpAddr;
use std::time::Duration;

use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Status};

/// A channel whose requests carry the token, if there is one.
pub type Connection = InterceptedService<Channel, Bearer>;

/// The trusted certificates and the credentials of a client. By default, the client trusts the system's
/// certificates and has no credentials.
#[derive(Clone, Default)]
pub struct Credentials {
    /// The trusted certificates, as PEM, one of which signed the coordinator's; `None` for the system's
    /// certificates.
    pub ca: Option<Vec<u8>>,
    /// The client's certificate and key, as PEM.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
    /// The token that is added to every request.
    pub token: Option<Bearer>,
}

/// An interceptor that adds a token to requests. The debug output does not contain the token.
#[derive(Clone, Default)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl Bearer {
    /// Creates the interceptor from a token.
    ///
    /// # Errors
    /// A sentence that describes the fault of the token, without its text.
    pub fn parse(token: &str) -> Result<Self, String> {
        let token = token.trim();
        if token.is_empty() || !token.bytes().all(|b| b.is_ascii_graphic()) {
            return Err("the token must be one line of visible ASCII characters".to_owned());
        }
        let mut value: MetadataValue<Ascii> = format!("Bearer {token}")
            .parse()
            .map_err(|_| "the token cannot be sent".to_owned())?;
        value.set_sensitive(true);
        Ok(Self(Some(value)))
    }
}

impl fmt::Debug for Bearer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() {
            "a token"
        } else {
            "no token"
        })
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request
                .metadata_mut()
                .insert("authorization", value.clone());
        }
        Ok(request)
    }
}

impl Credentials {
    /// Returns the endpoint of a coordinator at `url`. The connection timeout is 5 s, and Nagle's algorithm
    /// is off.
    ///
    /// # Errors
    /// A sentence that describes the fault of the address or the certificates.
    pub fn endpoint(&self, url: &str) -> Result<Endpoint, String> {
        let mut endpoint = Endpoint::from_shared(url.to_owned()).map_err(|e| e.to_string())?;
        let host = endpoint.uri().host().unwrap_or_default().to_owned();
        match endpoint.uri().scheme_str() {
            Some("http" | "https") if host.is_empty() => {
                return Err("the address names no host".to_owned());
            }
            Some("http") => {
                if self.token.is_some() && !is_loopback(&host) {
                    return Err("the token would be sent unencrypted; use https://".to_owned());
                }
                if self.ca.is_some() || self.identity.is_some() {
                    return Err("certificates require an address with https://".to_owned());
                }
            }
            Some("https") => {
                endpoint = endpoint.tls_config(self.tls()).map_err(|e| {
                    let reason = e.source().map_or_else(String::new, |s| format!(": {s}"));
                    format!("the certificates cannot be used{reason}")
                })?;
            }
            _ => {
                return Err("the address must begin with http:// or https:// and a host".to_owned());
            }
        }
        Ok(endpoint
            .connect_timeout(Duration::from_secs(5))
            .tcp_nodelay(true))
    }

    fn tls(&self) -> ClientTlsConfig {
        let tls = match &self.ca {
            Some(pem) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)),
            None => ClientTlsConfig::new().with_native_roots(),
        };
        match &self.identity {
            Some((certificate, key)) => tls.identity(Identity::from_pem(certificate, key)),
            None => tls,
        }
    }

    /// Returns a channel that adds the token to its requests.
    pub fn over(&self, channel: Channel) -> Connection {
        InterceptedService::new(channel, self.token.clone().unwrap_or_default())
    }
}

/// Returns the reason why the connection of a call broke, with a remedy if one is known.
///
/// Returns `None` if the status is an answer of the coordinator. The status of a broken connection only
/// reports a transport error, so the reason comes from the innermost error.
pub fn broken(status: &Status) -> Option<String> {
    let mut cause = status.source()?;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    let text = cause.to_string();
    // These are texts of rustls and of HTTP/2 frames; no other data distinguishes the cases.
    let remedy = if text.contains("fatal alert") {
        "; the coordinator rejected the encryption of the connection: with --client-ca, it accepts \
         only certificates that this authority has signed (--cert, --key)"
    } else if text.contains("http2 error") || text.contains("invalid size") {
        "; if the coordinator has a certificate, use an address with https://"
    } else {
        ""
    };
    Some(format!("{text}{remedy}"))
}

/// Returns true if a host is `localhost` or a loopback address.
fn is_loopback(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::{Bearer, Credentials, broken};

    #[test]
    fn endpoint_requires_scheme_and_host() {
        let none = Credentials::default();
        for good in [
            "http://127.0.0.1:7600",
            "http://coordinator:7600/",
            "http://[::1]:7600",
        ] {
            assert!(none.endpoint(good).is_ok(), "{good}");
        }
        for bad in ["foo", "", "127.0.0.1:7600", "ftp://a", "http:///x", "a b"] {
            assert!(none.endpoint(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn answer_is_not_a_broken_connection() {
        assert_eq!(broken(&tonic::Status::not_found("no job 7")), None);
        let alert = std::io::Error::other("received fatal alert: UnknownCA");
        let status = tonic::Status::from_error(Box::new(alert));
        assert!(broken(&status).unwrap().contains("--client-ca"));
    }

    #[test]
    fn token_is_neither_shown_nor_sent_unencrypted() {
        let token = Some(Bearer::parse(" slt_secret\n").unwrap());
        assert_eq!(format!("{token:?}"), "Some(a token)");
        let with = Credentials {
            token,
            ..Credentials::default()
        };
        for near in [
            "http://127.0.0.1:7600",
            "http://localhost:7600",
            "http://[::1]:7600",
        ] {
            assert!(with.endpoint(near).is_ok(), "{near}");
        }
        assert!(
            with.endpoint("http://coordinator:7600")
                .unwrap_err()
                .contains("unencrypted")
        );
        for bad in ["", "two words", "caf\u{e9}"] {
            assert!(Bearer::parse(bad).is_err(), "{bad:?}");
        }
    }
}
