//! A web site from files on this machine, because browsers load modules only over HTTP.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;

/// A running web site, which exists until the test ends.
pub struct Site {
    port: u16,
}

impl Site {
    /// Serves files. Each entry is an address prefix with its folder, or one address with its file. The first
    /// matching entry counts.
    pub fn start(entries: &[(&str, PathBuf)]) -> Self {
        let entries: Arc<[(String, PathBuf)]> = entries
            .iter()
            .map(|(from, to)| ((*from).to_owned(), to.clone()))
            .collect();
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let entries = entries.clone();
                std::thread::spawn(move || answer(stream, &entries));
            }
        });
        Self { port }
    }

    /// Returns the complete address of a path.
    pub fn address(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.port)
    }
}

/// Answers one request. A browser that disconnects is not a failure.
fn answer(mut stream: TcpStream, entries: &[(String, PathBuf)]) -> Option<()> {
    let mut lines = BufReader::new(stream.try_clone().ok()?)
        .lines()
        .map_while(Result::ok);
    let first = lines.next()?;
    let _rest: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
    let path = first.split(' ').nth(1)?.split('?').next()?.to_owned();
    let file = entries
        .iter()
        .find_map(|(from, to)| match path.strip_prefix(from.as_str())? {
            "" => Some(to.clone()),
            rest => from.ends_with('/').then(|| to.join(rest)),
        });
    let (status, body) = match file.and_then(|file| std::fs::read(file).ok()) {
        Some(body) => ("200 OK", body),
        None => ("404 Not Found", Vec::new()),
    };
    let kind = match path.rsplit('.').next()? {
        "html" => "text/html",
        "js" | "mjs" => "text/javascript",
        _ => "application/octet-stream",
    };
    let length = body.len();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
    )
    .ok()?;
    stream.write_all(&body).ok()
}
