//! Files on this machine as a web site: browsers load modules over HTTP alone.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;

/// A site that is there until the test ends.
pub struct Site {
    port: u16,
}

impl Site {
    /// Serves files: each entry is the beginning of addresses and the folder they are in, or one address and
    /// its file. Of several that fit, the first counts.
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

    /// The whole address of a path.
    pub fn address(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.port)
    }
}

/// Answers one request. A browser that goes away is no fault.
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
