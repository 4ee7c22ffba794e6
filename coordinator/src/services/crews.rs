//! The streams between the coordinator and the members of crews: leaders and helpers.

use std::io::Read;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt as _;
use sightline_numbers::ids::PhaseIndex;
use sightline_proto::chunks;
use sightline_proto::v1;
use sightline_proto::v1::crew_message::Message;
use sightline_records::ids::Lease;
use sightline_store::{MAX_OUTCOME_BYTES, OutcomeHeader};
use tokio::sync::mpsc;
use tonic::{Status, Streaming};

use super::blocking::{blocking, later};
use super::status;
use crate::coordinator::Coordinator;
use crate::quota::Sender;
use crate::telemetry::events::{EventKind, LogEvent};
use crate::uploads::spool::Spool;
use crate::workers::crews::{Assignment, CrewChannel, LeaderMessage};
use crate::workers::{late_outcomes, sessions};

/// Maximum number of items in a message, which exceeds the items of any phase.
const MAX_ITEMS: usize = 1 << 20;

type CrewAnswers = mpsc::Sender<Result<v1::CrewMessage, Status>>;

/// Sends a message to a member. Fails if the member has disconnected.
async fn say(answers: &CrewAnswers, message: Message) -> Result<(), Disconnected> {
    answers
        .send(Ok(v1::CrewMessage {
            message: Some(message),
        }))
        .await
        .map_err(|_| Disconnected)
}

/// The error of a member that has disconnected, or that waits for an outcome that does not exist.
struct Disconnected;

/// Sends an outcome in chunks. Fails if the member has disconnected, or if the outcome no longer exists
/// because the tile is done.
async fn say_outcome(
    c: &Arc<Coordinator>,
    channel: &CrewChannel,
    phase: PhaseIndex,
    answers: &CrewAnswers,
) -> Result<(), Disconnected> {
    let tile = channel.tile();
    let opened = blocking(c, move |c| Ok(c.workers.crews.outcomes.open(tile, phase))).await;
    let Ok(Some((total, mut from))) = opened else {
        return Err(Disconnected);
    };
    let mut offset = 0;
    loop {
        // One chunk is in memory at a time, regardless of the length of the outcome.
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
        .map_err(|_| Disconnected)?;
        from = rest;
        let end = offset + data.len() as u64;
        let is_cut = data.is_empty() && end < total;
        let chunk = Some(chunks::chunk(data, offset, total));
        if is_cut {
            return Err(Disconnected);
        }
        say(
            answers,
            Message::Outcome(v1::CrewOutcome {
                phase: phase.0,
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

/// Serves the leader's stream until it ends. The leader receives the stored outcomes, starting at the phase
/// `from`.
pub(super) async fn lead(
    c: Arc<Coordinator>,
    channel: Arc<CrewChannel>,
    messages: mpsc::Receiver<LeaderMessage>,
    from: u32,
    inbound: Streaming<v1::CrewMessage>,
    answers: CrewAnswers,
) {
    let telling = tokio::spawn(tell(
        Arc::clone(&c),
        Arc::clone(&channel),
        messages,
        from,
        answers.clone(),
    ));
    let heard = hear_leader(&c, &channel, inbound).await;
    later(&c, sessions::crew_ended(&c, &channel));
    if let Err(s) = heard {
        tracing::warn!(
            "the crew of tile {} of job {} ends: {}",
            channel.lease.tile,
            channel.lease.job,
            s.message()
        );
        // The leader may have disconnected already.
        let _ = answers.try_send(Err(s));
    }
    telling.abort();
}

/// Sends the leader the stored outcomes of earlier leaders, and then the messages of its helpers.
async fn tell(
    c: Arc<Coordinator>,
    channel: Arc<CrewChannel>,
    mut messages: mpsc::Receiver<LeaderMessage>,
    from: u32,
    answers: CrewAnswers,
) {
    let mut kept = channel.outcomes.subscribe();
    let count = *kept.borrow_and_update();
    for phase in (from..count).map(PhaseIndex) {
        if say_outcome(&c, &channel, phase, &answers).await.is_err() {
            break;
        }
    }
    let mut next = say(&answers, Message::Ready(v1::CrewReady { phases: count })).await;
    while next.is_ok() {
        let message = tokio::select! {
            message = messages.recv() => match message {
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
            LeaderMessage::Ask { member, phase } => Message::Ask(v1::CrewAsk {
                member,
                phase: phase.0,
            }),
            LeaderMessage::Found {
                member,
                phase,
                items,
                chunk,
            } => Message::Found(v1::CrewFound {
                member,
                phase: phase.0,
                items,
                chunk,
            }),
        };
        next = say(&answers, message).await;
    }
}

/// Handles the leader's messages until it ends the crew or its stream.
async fn hear_leader(
    c: &Arc<Coordinator>,
    channel: &Arc<CrewChannel>,
    mut inbound: Streaming<v1::CrewMessage>,
) -> Result<(), Status> {
    let mut outcome = None;
    let mut over = channel.is_over.subscribe();
    loop {
        let message = tokio::select! {
            message = inbound.next() => message,
            // Another worker now leads the crew.
            () = over.wait_for_true() => return Ok(()),
        };
        let Some(message) = message else {
            return Ok(());
        };
        match message?.message {
            Some(Message::Take(take)) => {
                if take.items.len() > MAX_ITEMS {
                    return Err(Status::invalid_argument(
                        "the items for a helper are more than a phase can have",
                    ));
                }
                channel.pass(
                    take.member,
                    Assignment {
                        phase: PhaseIndex(take.phase),
                        items: take.items,
                    },
                );
            }
            Some(Message::Outcome(mut piece)) => {
                let chunk = piece.chunk.take().unwrap_or_default();
                let arrived = arrived(c, channel.lease, outcome.take(), chunk).await?;
                let Some(spool) = arrived else {
                    // The tile is done, or another worker leases it, so its crew does not need the outcome.
                    tracing::debug!(
                        "an outcome of tile {} arrived after the end of its lease",
                        channel.lease.tile
                    );
                    return Ok(());
                };
                if spool.is_complete() {
                    keep(c, channel, spool, &piece).await?;
                } else {
                    outcome = Some(spool);
                }
            }
            Some(Message::Dismiss(dismiss)) => channel.leave(dismiss.member),
            Some(Message::End(_)) => return Ok(()),
            _ => {
                return Err(Status::invalid_argument(
                    "a leader may send only items, outcomes, dismissals and the end",
                ));
            }
        }
    }
}

/// Stores an outcome that has arrived completely.
async fn keep(
    c: &Arc<Coordinator>,
    channel: &Arc<CrewChannel>,
    mut spool: Spool,
    piece: &v1::CrewOutcome,
) -> Result<(), Status> {
    let (tile, phase, lease) = (channel.tile(), PhaseIndex(piece.phase), channel.lease);
    let profile = c.dispatcher.read(|scheduler| {
        let job = scheduler
            .job(lease.job)
            .filter(|_| scheduler.is_leased(&lease));
        job.map(|job| job.record.profile.clone().unwrap_or_default())
    });
    let Some(profile) = profile else {
        // The tile is done, or another worker leases it. The next message of this leader is rejected without
        // a lease.
        tracing::debug!(
            "an outcome of tile {} arrived after the end of its lease",
            lease.tile
        );
        return Ok(());
    };
    let kept = blocking(c, move |c| {
        let digest = spool.digest().map_err(|e| status::of_spool(&e))?;
        let header = OutcomeHeader {
            length: spool.announced(),
            hash: blake3::Hash::from_bytes(digest),
        };
        let push = |from: &mut dyn Read| {
            c.workers
                .crews
                .outcomes
                .push_from(tile, phase, header, from)
        };
        let is_stored = spool
            .read(&*c.blobs, push)
            .map_err(|e| status::of_blob(&e))?;
        if late_outcomes::remove_if_closed(c, lease.job, lease.tile)
            .map_err(|e| status::of_store(&e))?
        {
            return Ok(false);
        }
        if !is_stored {
            return Err(Status::resource_exhausted(
                "the outcome of a phase could not be stored; see the log of the coordinator",
            ));
        }
        Ok(true)
    });
    // Helpers wait for every outcome, so a failed outcome ends the crew.
    if !kept.await? {
        tracing::debug!("an outcome of tile {} arrived after its output", lease.tile);
        return Ok(());
    }
    c.telemetry
        .metrics
        .phase_done(&profile, Duration::from_micros(piece.micros));
    channel.outcomes.send_replace(phase.0 + 1);
    let text = format!("tile {}: phase {phase} is finished", lease.tile);
    c.record_event(LogEvent::of_lease(EventKind::Round, &lease, text));
    Ok(())
}

/// Adds a chunk to an arriving outcome. Checks the lease and the length before the first byte is stored.
/// Returns `None` if the lease has ended.
async fn arrived(
    c: &Arc<Coordinator>,
    lease: Lease,
    outcome: Option<Spool>,
    chunk: v1::Chunk,
) -> Result<Option<Spool>, Status> {
    blocking(c, move |c| {
        let mut spool = match outcome {
            Some(spool) => spool,
            None if !c.dispatcher.read(|scheduler| scheduler.is_leased(&lease)) => return Ok(None),
            None if chunk.total > MAX_OUTCOME_BYTES => {
                let announced = chunk.total;
                return Err(Status::invalid_argument(format!(
                    "the announced outcome has {announced} bytes, but the maximum of a phase is \
                     {MAX_OUTCOME_BYTES}"
                )));
            }
            None => {
                let (uploads, metrics) = (&c.uploads, &c.telemetry.metrics);
                Spool::begin(uploads, metrics, Sender::Worker, chunk.total)
                    .map_err(|e| status::of_spool(&e))?
            }
        };
        spool
            .push(&*c.blobs, &chunk)
            .map_err(|e| status::of_spool(&e))?;
        Ok(Some(spool))
    })
    .await
}

/// Serves a helper's stream until the stream or the crew ends.
pub(super) async fn help(
    c: Arc<Coordinator>,
    channel: Arc<CrewChannel>,
    inbound: Streaming<v1::CrewMessage>,
    answers: CrewAnswers,
) {
    let (member, assignments) = channel.enter();
    let mut telling = tokio::spawn(tell_helper(
        Arc::clone(&c),
        Arc::clone(&channel),
        assignments,
        answers.clone(),
    ));
    if channel
        .to_leader
        .send(LeaderMessage::Joined(member))
        .await
        .is_err()
    {
        // The leader has disconnected.
        telling.abort();
        return;
    }
    let heard = tokio::select! {
        heard = hear_helper(&channel, member, inbound) => heard,
        // The crew has ended, or the helper no longer reads.
        _ = &mut telling => Ok(()),
    };
    if let Err(s) = heard {
        tracing::warn!(
            "a helper of tile {} of job {} leaves: {}",
            channel.lease.tile,
            channel.lease.job,
            s.message()
        );
        // The helper may have disconnected already.
        let _ = answers.send(Err(s)).await;
    }
    channel.leave(member);
    telling.abort();
    // The leader may have disconnected, too.
    let _ = channel.to_leader.send(LeaderMessage::Left(member)).await;
}

/// Sends a helper the outcomes of all phases, its items, and the end of the crew.
async fn tell_helper(
    c: Arc<Coordinator>,
    channel: Arc<CrewChannel>,
    mut assignments: mpsc::Receiver<Assignment>,
    answers: CrewAnswers,
) {
    let (mut outcomes, mut over) = (channel.outcomes.subscribe(), channel.is_over.subscribe());
    let mut sent = 0;
    loop {
        let there = *outcomes.borrow_and_update();
        while sent < there {
            if say_outcome(&c, &channel, PhaseIndex(sent), &answers)
                .await
                .is_err()
            {
                return;
            }
            sent += 1;
        }
        let message = tokio::select! {
            () = over.wait_for_true() => {
                // If this fails, no member is left to notify.
                let _ = say(&answers, Message::End(v1::CrewEnd {})).await;
                return;
            }
            changed = outcomes.changed() => match changed {
                Ok(()) => continue,
                Err(_) => return,
            },
            assignment = assignments.recv() => match assignment {
                Some(Assignment { phase, items }) => Message::Take(v1::CrewTake {
                    member: 0,
                    phase: phase.0,
                    items,
                }),
                None => return,
            },
        };
        if say(&answers, message).await.is_err() {
            return;
        }
    }
}

/// Forwards a helper's messages to the leader. Waits until the leader accepts each message.
async fn hear_helper(
    channel: &CrewChannel,
    member: u64,
    mut inbound: Streaming<v1::CrewMessage>,
) -> Result<(), Status> {
    while let Some(message) = inbound.next().await {
        let forwarded = match message?.message {
            Some(Message::Ask(ask)) => LeaderMessage::Ask {
                member,
                phase: PhaseIndex(ask.phase),
            },
            Some(Message::Found(v1::CrewFound {
                phase,
                items,
                chunk,
                ..
            })) => {
                if items.len() > MAX_ITEMS {
                    return Err(Status::invalid_argument(
                        "the results of a helper have more items than a phase can have",
                    ));
                }
                LeaderMessage::Found {
                    member,
                    phase: PhaseIndex(phase),
                    items,
                    chunk,
                }
            }
            _ => {
                return Err(Status::invalid_argument(
                    "a helper may send only requests and results of items",
                ));
            }
        };
        if channel.to_leader.send(forwarded).await.is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// A receiver of a flag that can wait until the flag is true.
trait WaitForTrue {
    async fn wait_for_true(&mut self);
}

impl WaitForTrue for tokio::sync::watch::Receiver<bool> {
    async fn wait_for_true(&mut self) {
        // The sender exists as long as the crew's channel. After it is dropped, the crew is over, too.
        let _ = self.wait_for(|over| *over).await;
    }
}
