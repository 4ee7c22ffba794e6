//! Tests with connections that are lost during a commit: before and after the server receives it. A proxy
//! between the store and the server detects the commits of the writer thread.

use std::collections::VecDeque;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

use sightline_records::CommitOutcome;
use sightline_records::ids::{JobId, TileIndex};
use sightline_tests::Postgres;

use super::tests::{begin_job, leads};
use super::*;
use crate::Store;
use crate::api::Queries as _;
use crate::conformance::result;

/// The fate of a commit.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fate {
    /// The proxy forwards the commit and its answer.
    Kept,
    /// The connection is lost before the server receives the commit.
    Unheard,
    /// The server commits, and the connection is lost before the answer.
    Unanswered,
}

/// The message with which a client commits.
const COMMIT: &[u8] = b"Q\0\0\0\x0bCOMMIT\0";

/// Starts a proxy before a port of the loopback interface, and returns its own port.
///
/// `fates` contains the fates of the writer's commits, in order. Further commits are kept.
fn proxy(port: u16, fates: Arc<Mutex<VecDeque<Fate>>>) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let own = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for client in listener.incoming() {
            let client = client.unwrap();
            let Ok(server) = TcpStream::connect(("127.0.0.1", port)) else {
                continue;
            };
            let (mut from, mut to) = (server.try_clone().unwrap(), client.try_clone().unwrap());
            std::thread::spawn(move || {
                // The copy ends when either side closes.
                let _ = std::io::copy(&mut from, &mut to);
                let _ = to.shutdown(Shutdown::Both);
            });
            let fates = Arc::clone(&fates);
            std::thread::spawn(move || pass_on(client, server, &fates));
        }
    });
    own
}

fn pass_on(mut client: TcpStream, mut server: TcpStream, fates: &Mutex<VecDeque<Fate>>) {
    let (mut part, mut writes) = (vec![0; 1 << 16], false);
    while let Ok(n @ 1..) = client.read(&mut part) {
        let part = &part[..n];
        writes |= part.windows(12).any(|w| w == b"SERIALIZABLE");
        let fate = match part.starts_with(COMMIT) && writes {
            true => fates.lock().unwrap().pop_front().unwrap_or(Fate::Kept),
            false => Fate::Kept,
        };
        match fate {
            Fate::Kept => server.write_all(part).unwrap(),
            Fate::Unheard => break,
            Fate::Unanswered => {
                // Close the other direction first, so that the client receives no answer.
                client.shutdown(Shutdown::Both).unwrap();
                server.write_all(part).unwrap();
                // The server closes the connection after the termination message that follows the commit.
                server.write_all(b"X\0\0\0\x04").unwrap();
                break;
            }
        }
    }
    let _ = client.shutdown(Shutdown::Both);
    if let Ok(server) = server.try_clone() {
        let _ = server.shutdown(Shutdown::Write);
    }
}

#[test]
fn commits_with_lost_connection_are_executed_once() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let direct = server.url_on_loopback();
    let port = direct
        .rsplit_once(':')
        .unwrap()
        .1
        .split_once('/')
        .unwrap()
        .0
        .parse()
        .unwrap();
    let fates = Arc::new(Mutex::new(VecDeque::new()));
    let through = direct.replace(
        &format!(":{port}/"),
        &format!(":{}/", proxy(port, Arc::clone(&fates))),
    );
    let address = DatabaseAddress::parse(&through, Some(server.password()), None).unwrap();
    let replica = Replica::join(&address, "one", "http://one:7600").unwrap();
    let epoch = leads(&replica);
    let store = replica.store(epoch).unwrap();
    begin_job(&store, 64);
    let orders = [
        vec![Fate::Unanswered],
        vec![Fate::Unheard],
        vec![Fate::Unheard, Fate::Unanswered],
        vec![Fate::Unheard, Fate::Unheard, Fate::Unheard],
    ];
    for (tile, order) in (0..).zip(orders.into_iter().cycle().take(16)) {
        fates.lock().unwrap().extend(order.iter().copied());
        let committed = store
            .commit_tile(JobId(1), TileIndex(tile), result(1))
            .unwrap();
        assert_eq!(committed, CommitOutcome::Committed, "{order:?}");
        assert!(
            fates.lock().unwrap().is_empty(),
            "{order:?}: the connection was not lost"
        );
        // A command that was executed twice would count twice.
        fates.lock().unwrap().extend(order.iter().copied());
        assert_eq!(
            store.begin_epoch().unwrap(),
            u64::from(tile) + 1,
            "{order:?}"
        );
        assert!(
            fates.lock().unwrap().is_empty(),
            "{order:?}: the connection was not lost"
        );
    }
    assert_eq!(store.epoch().unwrap(), 16);
    assert!(
        store
            .tiles(JobId(1))
            .unwrap()
            .iter()
            .all(|tile| tile.conflicts == 0)
    );
}
