//! Tests of the store in a real database. They run the suite of all stores, leaderships that end during a
//! write, and lost connections and servers.

use std::time::{Duration, Instant};

use proptest::collection::vec;
use proptest::test_runner::{Config, TestRunner};
use sightline_records::CommitOutcome;
use sightline_records::ids::{JobId, TileIndex};
use sightline_tests::Postgres;

use super::*;
use crate::Store;
use crate::api::Queries as _;
use crate::conformance::{Model, Op, everything, op, perform, result, step};

/// Returns the address of a server's database.
fn address(server: &Postgres) -> DatabaseAddress {
    DatabaseAddress::parse(&server.url(), None, None).unwrap()
}

fn join(server: &Postgres, name: &str) -> Replica {
    Replica::join(&address(server), name, &format!("http://{name}:7600")).unwrap()
}

/// Waits until a replica leads. Returns its epoch.
pub(super) fn leads(replica: &Replica) -> i64 {
    let mut role = replica.role();
    let leading = role.wait_for(|role| !matches!(role, Role::StandsBy(_)));
    match block_on(leading).map(|role| role.clone()) {
        Ok(Role::Leads(epoch)) => epoch,
        other => panic!("{other:?}"),
    }
}

/// Waits until a replica neither leads nor stands by. Returns the reason.
fn ended(replica: &Replica) -> StoreError {
    let mut role = replica.role();
    match block_on(role.wait_for(|role| matches!(role, Role::Ended(_)))).map(|role| role.clone()) {
        Ok(Role::Ended(why)) => why,
        other => panic!("{other:?}"),
    }
}

fn leading(server: &Postgres, name: &str) -> (Replica, PostgresStore) {
    let replica = join(server, name);
    let epoch = leads(&replica);
    let store = replica.store(epoch).unwrap();
    (replica, store)
}

fn resign(replica: &Replica) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(replica.resign());
}

/// Ends the leadership, as if its time had passed.
fn expire(server: &Postgres) {
    server.sql(
        "sightline",
        "UPDATE sightline.leader SET until = '-infinity'",
    );
}

/// Creates a job with this many tiles.
pub(super) fn begin_job(store: &dyn Store, tiles: u32) {
    perform(store, &Op::Scene(0, 10));
    perform(
        store,
        &Op::Submit {
            key: 1,
            request: 1,
            scene: 0,
            tiles,
        },
    );
}

#[test]
fn store_in_database_matches_model_through_leader_changes() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let config = Config {
        failure_persistence: None,
        max_shrink_iters: 20,
        ..Config::with_cases(12)
    };
    let rounds = vec(vec(op(), 1..30), 1..4);
    TestRunner::new(config)
        .run(&rounds, |rounds| {
            server.sql("sightline", "DROP SCHEMA IF EXISTS sightline CASCADE");
            let mut model = Model::default();
            for ops in &rounds {
                let (replica, store) = leading(&server, "one");
                assert_eq!(everything(&store), model.everything());
                for op in ops {
                    step(&store, &mut model, op);
                }
                assert_eq!(everything(&store), model.everything());
                resign(&replica);
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn concurrent_commands_are_executed_once() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let (_replica, store) = leading(&server, "one");
    begin_job(&store, 40);
    let committed: usize = std::thread::scope(|scope| {
        let one = |n: u8| {
            let store = &store;
            scope.spawn(move || {
                let mine = (0..40).map(|tile| {
                    store
                        .commit_tile(JobId(1), TileIndex(tile), result(n))
                        .unwrap()
                });
                mine.filter(|outcome| *outcome == CommitOutcome::Committed)
                    .count()
            })
        };
        let threads: Vec<_> = (0..8).map(one).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .sum()
    });
    assert_eq!(committed, 40);
    assert!(
        store
            .tiles(JobId(1))
            .unwrap()
            .iter()
            .all(|tile| tile.conflicts == 7)
    );
}

#[test]
fn commands_of_earlier_leader_are_rejected() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let (old, stale) = leading(&server, "old");
    begin_job(&stale, 4);
    let first = leads(&old);
    expire(&server);
    let (new, store) = leading(&server, "new");
    assert_eq!(leads(&new), first + 1);
    let before = everything(&store);
    // The command fails whether or not the old leader knows about its end.
    let refused = stale.commit_tile(JobId(1), TileIndex(0), result(1));
    assert!(
        matches!(refused, Err(StoreError::Fenced { epoch }) if epoch == first),
        "{refused:?}"
    );
    assert!(matches!(ended(&old), StoreError::Fenced { .. }));
    assert!(matches!(
        stale.begin_epoch(),
        Err(StoreError::Fenced { .. })
    ));
    assert_eq!(everything(&store), before);
    assert_eq!(
        store
            .commit_tile(JobId(1), TileIndex(0), result(2))
            .unwrap(),
        CommitOutcome::Committed
    );
}

/// Checks a take-over during a transaction of the previous leader.
///
/// The take-over waits until the transaction has ended. Changes that were not committed before the take-over
/// are not committed after it.
#[test]
fn take_over_waits_for_transactions_of_previous_leader() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let (old, stale) = leading(&server, "old");
    // The tiles last until the take-over, also if `psql` starts late.
    let tiles = 10_000;
    begin_job(&stale, tiles);
    let stale = &stale;
    std::thread::scope(|scope| {
        let writing = scope.spawn(|| {
            let mut done = 0;
            for tile in 0..tiles {
                match stale.commit_tile(JobId(1), TileIndex(tile), result(1)) {
                    Ok(_) => done += 1,
                    Err(StoreError::Fenced { .. }) => return done,
                    Err(e) => panic!("{e}"),
                }
            }
            panic!("it was never fenced");
        });
        while server
            .sql("sightline", "SELECT count(*) < 20 FROM sightline.entries")
            .trim()
            == "t"
        {}
        expire(&server);
        let (_new, store) = leading(&server, "new");
        let seen = store.tiles(JobId(1)).unwrap();
        let seen = seen
            .iter()
            .filter(|t| t.state != sightline_records::TileState::Open)
            .count();
        let acknowledged: usize = writing.join().unwrap();
        assert_eq!(seen, acknowledged);
        assert!(matches!(ended(&old), StoreError::Fenced { .. }));
    });
}

#[test]
fn standby_knows_leader_and_follows_resignation_at_once() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let first = join(&server, "first");
    leads(&first);
    let second = join(&server, "second");
    let mut role = second.role();
    let knows = role.wait_for(|role| matches!(role, Role::StandsBy(Some(_))));
    let known = block_on(knows).unwrap().clone();
    let Role::StandsBy(Some(leader)) = known else {
        panic!("{known:?}")
    };
    assert_eq!(
        (leader.holder.as_str(), leader.address.as_str()),
        ("first", "http://first:7600")
    );
    resign(&first);
    assert_eq!(leads(&second), leader.epoch + 1);
    assert!(matches!(ended(&first), StoreError::Fenced { .. }));
}

/// Checks commands while the server repeatedly ends sessions. Connections are lost at any point of a
/// transaction.
///
/// Every command is answered, and every acknowledged change exists exactly once.
#[test]
fn lost_connections_neither_lose_nor_repeat_commands() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let (_replica, store) = leading(&server, "one");
    begin_job(&store, 300);
    let store = &store;
    std::thread::scope(|scope| {
        let writing = scope.spawn(|| {
            let mut epochs = 0;
            for tile in 0..300 {
                let tile = TileIndex(tile);
                // An error means that the command had no effect.
                while let Err(e) = store.commit_tile(JobId(1), tile, result(1)) {
                    assert!(matches!(e, StoreError::Unreachable { .. }), "{e:?}");
                }
                if let Ok(epoch) = store.begin_epoch() {
                    epochs += 1;
                    assert_eq!(
                        epoch, epochs,
                        "a command was carried out twice, or not at all"
                    );
                }
            }
            epochs
        });
        while !writing.is_finished() {
            let end = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity \
                       WHERE application_name = 'sightline' AND query NOT LIKE '%leader%'";
            server.sql("sightline", end);
            std::thread::sleep(Duration::from_millis(3));
        }
        assert_eq!(store.epoch().unwrap(), writing.join().unwrap());
    });
    assert!(
        store
            .tiles(JobId(1))
            .unwrap()
            .iter()
            .all(|tile| tile.conflicts == 0)
    );
}

#[test]
fn store_continues_after_killed_server_restarts() {
    let Some(mut server) = Postgres::start_with("-c fsync=on") else {
        return;
    };
    let (replica, store) = leading(&server, "one");
    begin_job(&store, 3);
    store
        .commit_tile(JobId(1), TileIndex(0), result(1))
        .unwrap();
    let begun = Instant::now();
    server.stop();
    server.begin();
    let again = store.commit_tile(JobId(1), TileIndex(1), result(1));
    if begun.elapsed() < Duration::from_secs(2) {
        assert_eq!(again.unwrap(), CommitOutcome::Committed);
        leads(&replica);
    }
    drop((replica, store));
    expire(&server);
    let (_other, store) = leading(&server, "other");
    let tile = store.tile(JobId(1), TileIndex(0)).unwrap();
    assert!(matches!(
        tile.state,
        sightline_records::TileState::Done { .. }
    ));
}

#[test]
fn leader_without_database_ends() {
    let Some(mut server) = Postgres::start() else {
        return;
    };
    let (replica, store) = leading(&server, "one");
    server.stop();
    assert!(matches!(ended(&replica), StoreError::NotRenewed { .. }));
    assert!(matches!(
        store.begin_epoch(),
        Err(StoreError::Fenced { .. })
    ));
    let unreachable = Replica::join(&address(&server), "two", "").err();
    assert!(
        matches!(unreachable, Some(StoreError::Unreachable { .. })),
        "{unreachable:?}"
    );
}

#[test]
fn wrong_password_and_newer_tables_are_rejected() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let on_loopback = |password| {
        let address = DatabaseAddress::parse(&server.url_on_loopback(), password, None).unwrap();
        Replica::join(&address, "one", "")
            .map(|_| ())
            .map_err(|e| e.to_string())
    };
    for wrong in [None, Some("wrong")] {
        let refused = on_loopback(wrong).unwrap_err();
        assert!(
            refused.contains("rejects the login") && refused.contains("PGPASSWORD"),
            "{refused}"
        );
    }
    on_loopback(Some(server.password())).unwrap();
    let with = DatabaseAddress::parse(&server.url_with_password(), None, None).unwrap();
    Replica::join(&with, "one", "").map(|_| ()).unwrap();
    server.sql(
        "sightline",
        "INSERT INTO sightline.migrations VALUES (7, now())",
    );
    let newer = on_loopback(Some(server.password())).unwrap_err();
    assert!(
        newer.contains("version 7") && newer.contains("up to 1"),
        "{newer}"
    );
}

#[test]
fn damaged_entries_are_reported() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let (_replica, store) = leading(&server, "one");
    begin_job(&store, 3);
    server.sql(
        "sightline",
        "UPDATE sightline.entries SET value = 'nonsense' WHERE key = 'n'",
    );
    let damaged = store.jobs_before(JobId(u64::MAX), 9);
    assert!(
        matches!(damaged, Err(StoreError::Damaged { .. })),
        "{damaged:?}"
    );
}

#[test]
fn trust_commands_work_in_database() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let (replica, store) = leading(&server, "a");
    crate::conformance_trust::trust(&store);
    drop(store);
    resign(&replica);
}
