//! Requests over HTTP, without a client.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;

/// Sends a request with these header lines. Returns the status and the body.
pub fn ask(pages: &str, request: &str, headers: &str, body: impl AsRef<[u8]>) -> (u32, Vec<u8>) {
    let (status, _, body) = ask_with_head(pages, request, headers, body);
    (status, body)
}

/// Sends a request with these header lines. Returns the status, the head of the answer, and the body.
pub fn ask_with_head(
    pages: &str,
    request: &str,
    headers: &str,
    body: impl AsRef<[u8]>,
) -> (u32, String, Vec<u8>) {
    let host = pages.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(host).unwrap();
    let own = if headers.contains("Host:") {
        String::new()
    } else {
        format!("Host: {host}\r\n")
    };
    let (body, close) = (body.as_ref(), "Connection: close\r\n");
    write!(
        stream,
        "{request} HTTP/1.1\r\n{own}{headers}{close}Content-Length: {}\r\n\r\n",
        body.len()
    )
    .unwrap();
    // The server may reject the request by its head and not read the body.
    drop(stream.write_all(body));
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    let head = String::from_utf8(answer[..end].to_vec()).unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    let body = answer.split_off(end + 4);
    let is_chunked = head
        .to_ascii_lowercase()
        .contains("transfer-encoding: chunked");
    (status, head, if is_chunked { joined(&body) } else { body })
}

/// Joins the bytes of a chunked body.
fn joined(mut body: &[u8]) -> Vec<u8> {
    let mut whole = Vec::new();
    loop {
        let end = body.windows(2).position(|w| w == b"\r\n").unwrap();
        let length = usize::from_str_radix(std::str::from_utf8(&body[..end]).unwrap(), 16).unwrap();
        if length == 0 {
            return whole;
        }
        whole.extend(&body[end + 2..end + 2 + length]);
        body = &body[end + 4 + length..];
    }
}
