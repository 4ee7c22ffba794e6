//! A balancer of TCP connections: each connection goes to the first of its addresses that accepts the
//! connection.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// A running balancer, which ends with its test. An open connection ends with its server.
pub struct Balancer {
    address: String,
    to: Arc<Mutex<Vec<String>>>,
    over: Arc<AtomicBool>,
}

impl Balancer {
    /// Starts a balancer on a free port of loopback, in front of these addresses.
    pub fn before(addresses: &[String]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let to = Arc::new(Mutex::new(addresses.to_vec()));
        let over = Arc::new(AtomicBool::new(false));
        let (all, ended) = (Arc::clone(&to), Arc::clone(&over));
        std::thread::spawn(move || {
            for (turn, stream) in listener.incoming().enumerate() {
                if ended.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(stream) = stream else { continue };
                // Connections start at different addresses in turn, so that all of them are used.
                let addresses = all.lock().unwrap().clone();
                let order = (0..addresses.len()).map(|i| &addresses[(turn + i) % addresses.len()]);
                if let Some(other) = order
                    .into_iter()
                    .find_map(|address| TcpStream::connect(address).ok())
                {
                    join(&stream, &other);
                    join(&other, &stream);
                }
            }
        });
        Self { address, to, over }
    }

    /// Returns the address of the balancer, such as `http://127.0.0.1:41234`.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Sends new connections to these addresses from now on.
    pub fn lead_to(&self, addresses: &[String]) {
        *self.to.lock().unwrap() = addresses.to_vec();
    }
}

impl Drop for Balancer {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        // The connection wakes the thread that waits for connections.
        drop(TcpStream::connect(&self.address));
    }
}

/// Copies the bytes of one stream to the other until one of them ends.
fn join(from: &TcpStream, to: &TcpStream) {
    let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
    to.set_nodelay(true).unwrap();
    std::thread::spawn(move || {
        let mut part = [0; 1 << 14];
        while let Ok(1..) = from
            .read(&mut part)
            .and_then(|n| to.write_all(&part[..n]).map(|()| n))
        {}
        // The stream may have ended already.
        let _ = to.shutdown(Shutdown::Both);
        let _ = from.shutdown(Shutdown::Both);
    });
}
