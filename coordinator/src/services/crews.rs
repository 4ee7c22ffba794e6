//! The streams of crews: the leader's and the helpers'.

use std::io::Read;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt as _;
use sightline_proto::chunks;
use sightline_proto::v1;
use sightline_proto::v1::crew_message::Message;
use sightline_records::TileState;
use sightline_records::ids::Lease;
use sightline_store::MAX_OUTCOME_BYTES;
use tokio::sync::mpsc;
use tonic::{Status, Streaming};

use super::blocking::{blocking, later};
use super::status;
use crate::quota::Sender;
use crate::state::Coordinator;
use crate::telemetry::events::{Kind, LogEvent};
use crate::uploads::spool::Spool;
use crate::workers::crews::{Assignment, CrewChannel, LeaderMessage};
use crate::workers::sessions;

/// Most items in a message: more than a phase has.
const MAX_ITEMS: usize = 1 << 20;

type CrewAnswers = mpsc::Sender<Result<v1::CrewMessage, Status>>;

/// Sends a message; fails when the member has gone.
async fn say(out: &CrewAnswers, message: Message) -> Result<(), Gone> {
    out.send(Ok(v1::CrewMessage {
        message: Some(message),
    }))
    .await
    .map_err(|_| Gone)
}

/// A member reads no more.
struct Gone;

/// Sends an outcome in pieces. Ends quietly when it is not there any more: the tile is done then.
async fn say_outcome(
    c: &Arc<Coordinator>,
    room: &CrewChannel,
    phase: u32,
    out: &CrewAnswers,
) -> Result<(), Gone> {
    let tile = room.tile();
    let opened = blocking(c, move |c| Ok(c.crews.outcomes.open(tile, phase))).await;
    let Ok(Some((total, mut from))) = opened else {
        return Err(Gone);
    };
    let mut offset = 0;
    loop {
        // One chunk is in memory at a time, whatever the length of the outcome.
        let (data, rest) = blocking(c, move |_| {
            let mut data = Vec::new();
            let read = from
                .by_ref()
                .take(chunks::CHUNK_BYTES as u64)
                .read_to_end(&mut data);
            read.map_err(|e| Status::data_loss(format!("an outcome cannot be read: {e}")))?;
            Ok((data, from))
        })
        .await
        .map_err(|_| Gone)?;
        from = rest;
        let end = offset + data.len() as u64;
        let is_cut = data.is_empty() && end < total;
        let chunk = Some(chunks::chunk(data, offset, total));
        if is_cut {
            return Err(Gone);
        }
        say(
            out,
            Message::Outcome(v1::CrewOutcome {
                phase,
                chunk,
                micros: 0,
            }),
        )
        .await?;
        if end >= total {
            return Ok(());
        }
        offset = end;
    }
}

/// The leader's stream, until it ends. It is sent the outcomes that are there from phase `from` on.
pub(super) async fn lead(
    c: Arc<Coordinator>,
    room: Arc<CrewChannel>,
    told: mpsc::Receiver<LeaderMessage>,
    from: u32,
    inbound: Streaming<v1::CrewMessage>,
    out: CrewAnswers,
) {
    let telling = tokio::spawn(tell(
        Arc::clone(&c),
        Arc::clone(&room),
        told,
        from,
        out.clone(),
    ));
    let heard = hear_leader(&c, &room, inbound).await;
    later(&c, sessions::crew_ended(&c, &room));
    if let Err(s) = heard {
        tracing::warn!(
            "the crew of tile {} of job {} ends: {}",
            room.lease.tile,
            room.lease.job,
            s.message()
        );
        // The leader may have gone already.
        let _ = out.try_send(Err(s));
    }
    telling.abort();
}

/// Sends the leader the outcomes of earlier leaders, and then what it is told.
async fn tell(
    c: Arc<Coordinator>,
    room: Arc<CrewChannel>,
    mut told: mpsc::Receiver<LeaderMessage>,
    from: u32,
    out: CrewAnswers,
) {
    let mut kept = room.outcomes.subscribe();
    let count = *kept.borrow_and_update();
    for phase in from..count {
        if say_outcome(&c, &room, phase, &out).await.is_err() {
            break;
        }
    }
    let mut next = say(&out, Message::Ready(v1::CrewReady { phases: count })).await;
    while next.is_ok() {
        let message = tokio::select! {
            message = told.recv() => match message {
                Some(message) => message,
                None => return,
            },
            changed = kept.changed() => match changed {
                Ok(()) => LeaderMessage::Kept(*kept.borrow_and_update()),
                Err(_) => return,
            },
        };
        let message = match message {
            LeaderMessage::Joined(member) => Message::Joined(v1::CrewJoined { member }),
            LeaderMessage::Left(member) => Message::Left(v1::CrewLeft { member }),
            LeaderMessage::Kept(phases) => Message::Kept(v1::CrewKept { phases }),
            LeaderMessage::Ask { member, phase } => Message::Ask(v1::CrewAsk { member, phase }),
            LeaderMessage::Found {
                member,
                phase,
                items,
                chunk,
            } => Message::Found(v1::CrewFound {
                member,
                phase,
                items,
                chunk,
            }),
        };
        next = say(&out, message).await;
    }
}

/// Acts on what the leader says, until it ends the crew or its stream.
async fn hear_leader(
    c: &Arc<Coordinator>,
    room: &Arc<CrewChannel>,
    mut inbound: Streaming<v1::CrewMessage>,
) -> Result<(), Status> {
    let mut outcome = None;
    let mut over = room.is_over.subscribe();
    loop {
        let message = tokio::select! {
            message = inbound.next() => message,
            // Another leader has come.
            () = over.wait_for_true() => return Ok(()),
        };
        let Some(message) = message else {
            return Ok(());
        };
        match message?.message {
            Some(Message::Take(take)) => {
                if take.items.len() > MAX_ITEMS {
                    return Err(Status::invalid_argument(
                        "a piece has more items than a phase can have",
                    ));
                }
                room.pass(
                    take.member,
                    Assignment {
                        phase: take.phase,
                        items: take.items,
                    },
                );
            }
            Some(Message::Outcome(mut piece)) => {
                let chunk = piece.chunk.take().unwrap_or_default();
                let arrived = arrived(c, room.lease, outcome.take(), chunk).await?;
                let Some(spool) = arrived else {
                    // The tile is done, or another worker's; its crew has no more use.
                    tracing::debug!(
                        "an outcome of tile {} came after its lease",
                        room.lease.tile
                    );
                    return Ok(());
                };
                if spool.is_complete() {
                    keep(c, room, spool, &piece).await?;
                } else {
                    outcome = Some(spool);
                }
            }
            Some(Message::Dismiss(dismiss)) => room.leave(dismiss.member),
            Some(Message::End(_)) => return Ok(()),
            _ => {
                return Err(Status::invalid_argument(
                    "a leader sends items, outcomes, dismissals and the end",
                ));
            }
        }
    }
}

/// Stores an outcome that has arrived.
async fn keep(
    c: &Arc<Coordinator>,
    room: &Arc<CrewChannel>,
    mut spool: Spool,
    piece: &v1::CrewOutcome,
) -> Result<(), Status> {
    let (tile, phase, lease) = (room.tile(), piece.phase, room.lease);
    let profile = {
        let scheduling = c.lock();
        let job = scheduling
            .scheduler
            .job(lease.job)
            .filter(|_| scheduling.scheduler.is_leased(&lease));
        job.map(|job| job.record.profile.clone().unwrap_or_default())
    };
    let Some(profile) = profile else {
        // The tile is done, or another worker's; the next message of its leader finds no lease.
        tracing::debug!("an outcome of tile {} came after its lease", lease.tile);
        return Ok(());
    };
    let kept = blocking(c, move |c| {
        let digest = spool.digest().map_err(|e| status::of_spool(&e))?;
        let length_and_hash = (spool.announced(), blake3::Hash::from_bytes(digest));
        let push = |from: &mut dyn Read| {
            c.crews
                .outcomes
                .push_from(tile, phase, length_and_hash, from)
        };
        if spool.read(c, push).map_err(|e| status::of_blob(&e))? {
            return Ok(true);
        }
        // The commit of a tile removes its outcomes while a late one may be under way.
        let tile = c
            .store
            .tile(lease.job, lease.tile)
            .map_err(|e| status::of_store(&e))?;
        match tile.state {
            TileState::Open => Err(Status::resource_exhausted("an outcome could not be kept")),
            TileState::Done { .. } | TileState::SetAside { .. } => Ok(false),
        }
    });
    // Helpers wait for every outcome, so the crew ends without one that failed.
    if !kept.await? {
        tracing::debug!("an outcome of tile {} came after its output", lease.tile);
        return Ok(());
    }
    c.metrics
        .phase_done(&profile, Duration::from_micros(piece.micros));
    room.outcomes.send_replace(phase + 1);
    let text = format!("tile {}: phase {phase} is finished", lease.tile);
    c.happened(LogEvent::of_lease(Kind::Round, &lease, text));
    Ok(())
}

/// Adds a chunk to an outcome that arrives. The lease and the length are checked before the first byte is
/// kept; `None` when the lease has ended.
async fn arrived(
    c: &Arc<Coordinator>,
    lease: Lease,
    outcome: Option<Spool>,
    chunk: v1::Chunk,
) -> Result<Option<Spool>, Status> {
    blocking(c, move |c| {
        let mut spool = match outcome {
            Some(spool) => spool,
            None if !c.lock().scheduler.is_leased(&lease) => return Ok(None),
            None if chunk.total > MAX_OUTCOME_BYTES => {
                let announced = chunk.total;
                return Err(Status::invalid_argument(format!(
                    "an outcome of {announced} bytes was announced; a phase has at most {MAX_OUTCOME_BYTES}"
                )));
            }
            None => Spool::begin(c, Sender::Worker, chunk.total).map_err(|e| status::of_spool(&e))?,
        };
        spool.push(c, &chunk).map_err(|e| status::of_spool(&e))?;
        Ok(Some(spool))
    })
    .await
}

/// A helper's stream, until it ends or the crew does.
pub(super) async fn help(
    c: Arc<Coordinator>,
    room: Arc<CrewChannel>,
    inbound: Streaming<v1::CrewMessage>,
    out: CrewAnswers,
) {
    let (member, takes) = room.enter();
    let mut telling = tokio::spawn(tell_helper(
        Arc::clone(&c),
        Arc::clone(&room),
        takes,
        out.clone(),
    ));
    if room
        .to_leader
        .send(LeaderMessage::Joined(member))
        .await
        .is_err()
    {
        // The leader has gone.
        telling.abort();
        return;
    }
    let heard = tokio::select! {
        heard = hear_helper(&room, member, inbound) => heard,
        // The crew has ended, or the helper reads no more.
        _ = &mut telling => Ok(()),
    };
    if let Err(s) = heard {
        tracing::warn!(
            "a helper of tile {} of job {} goes: {}",
            room.lease.tile,
            room.lease.job,
            s.message()
        );
        // The helper may have gone already.
        let _ = out.send(Err(s)).await;
    }
    room.leave(member);
    telling.abort();
    // Fails when the leader has gone, too.
    let _ = room.to_leader.send(LeaderMessage::Left(member)).await;
}

/// Sends a helper the outcomes of all phases, the items for it, and the end.
async fn tell_helper(
    c: Arc<Coordinator>,
    room: Arc<CrewChannel>,
    mut takes: mpsc::Receiver<Assignment>,
    out: CrewAnswers,
) {
    let (mut outcomes, mut over) = (room.outcomes.subscribe(), room.is_over.subscribe());
    let mut sent = 0;
    loop {
        let there = *outcomes.borrow_and_update();
        while sent < there {
            if say_outcome(&c, &room, sent, &out).await.is_err() {
                return;
            }
            sent += 1;
        }
        let message = tokio::select! {
            () = over.wait_for_true() => {
                // Nobody is left to be told when this fails.
                let _ = say(&out, Message::End(v1::CrewEnd {})).await;
                return;
            }
            changed = outcomes.changed() => match changed {
                Ok(()) => continue,
                Err(_) => return,
            },
            take = takes.recv() => match take {
                Some(Assignment { phase, items }) => Message::Take(v1::CrewTake { member: 0, phase, items }),
                None => return,
            },
        };
        if say(&out, message).await.is_err() {
            return;
        }
    }
}

/// Passes what a helper says to the leader, which sets the pace.
async fn hear_helper(
    room: &CrewChannel,
    member: u64,
    mut inbound: Streaming<v1::CrewMessage>,
) -> Result<(), Status> {
    while let Some(message) = inbound.next().await {
        let told = match message?.message {
            Some(Message::Ask(ask)) => LeaderMessage::Ask {
                member,
                phase: ask.phase,
            },
            Some(Message::Found(v1::CrewFound {
                phase,
                items,
                chunk,
                ..
            })) => {
                if items.len() > MAX_ITEMS {
                    return Err(Status::invalid_argument(
                        "finds have more items than a phase can have",
                    ));
                }
                LeaderMessage::Found {
                    member,
                    phase,
                    items,
                    chunk,
                }
            }
            _ => {
                return Err(Status::invalid_argument(
                    "a helper sends questions and finds",
                ));
            }
        };
        if room.to_leader.send(told).await.is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// Waits until a flag is set.
trait WaitForTrue {
    async fn wait_for_true(&mut self);
}

impl WaitForTrue for tokio::sync::watch::Receiver<bool> {
    async fn wait_for_true(&mut self) {
        // The sender lives as long as the crew's room; when it is gone, the crew is over as well.
        let _ = self.wait_for(|over| *over).await;
    }
}
