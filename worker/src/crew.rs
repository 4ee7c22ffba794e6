//! The streams of a crew on the worker's side: of a leader, which holds the tile's lease, and of a helper.
//!
//! A leader whose stream cannot be opened, or breaks, goes on alone, because its tile needs nobody, and tries
//! to open another one.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use sightline_proto::chunks::{self, Blobs};
use sightline_proto::connecting::Connection;
use sightline_proto::v1;
use sightline_proto::v1::crew_message::Message;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_sample::Watcher as _;
use sightline_sample::crew::{FromHelper, FromLeader, Helper, Leader, Member, ToHelper, ToLeader};
use tokio::sync::mpsc;
use tonic::Streaming;

use crate::leased_tile::LeasedTile;
use crate::status::describe;

/// Messages that wait for the network.
const WAITING: usize = 16;
/// A stream of a leader that lasted this long was of use, and the first wait after it is short again.
const STEADY: Duration = Duration::from_secs(5);
/// How long a leader waits for the outcomes of an earlier one to begin to come, and then for each next one.
const PATIENCE: Duration = Duration::from_secs(10);
/// The waits after a leader's stream has broken: the first, and late ones; they double in between.
const AGAIN: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];
/// Most bytes of an outcome or of finds.
const MAX_BYTES: u64 = 1 << 30;

type Client = WorkersClient<Connection>;

/// Opens a stream to the other members.
async fn enter(
    mut client: Client,
    lease: v1::Lease,
    (leads, phases): (bool, u32),
) -> Result<(mpsc::Sender<v1::CrewMessage>, Streaming<v1::CrewMessage>), String> {
    let (out, receiver) = mpsc::channel(WAITING);
    let enter = Message::Enter(v1::CrewEnter {
        lease: Some(lease),
        leads,
        phases,
    });
    // There is room: nothing else was sent.
    let _ = out.try_send(v1::CrewMessage {
        message: Some(enter),
    });
    let stream = tokio_stream::wrappers::ReceiverStream::new(receiver);
    let inbound = client
        .crew(stream)
        .await
        .map_err(|s| describe(&s))?
        .into_inner();
    Ok((out, inbound))
}

/// Where the leader's messages go: to its present stream, if it has one.
#[derive(Clone, Default)]
struct LeaderLink(Arc<Mutex<Option<mpsc::UnboundedSender<FromLeader>>>>);

impl LeaderLink {
    /// From now on messages go to another stream, or nowhere.
    fn turn(&self, to: Option<mpsc::UnboundedSender<FromLeader>>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = to;
    }

    fn say(&self, message: FromLeader) {
        let way = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // Fails when the stream has broken. The leader keeps its outcomes for the next stream.
        let _ = way.iter().try_for_each(|way| way.send(message.clone()));
    }
}

/// A leader with a stream to its helpers; without one, if there cannot be one, a leader without helpers.
pub async fn lead(client: Client, lease: v1::Lease, held: &Arc<LeasedTile>) -> Arc<Leader> {
    let way = LeaderLink::default();
    let (opened, outcomes) = match open(&client, lease, 0).await {
        Ok((out, inbound, outcomes, _)) => (Ok((out, inbound)), outcomes),
        Err(e) => (Err(e), Vec::new()),
    };
    if !outcomes.is_empty() {
        tracing::info!(
            "tile {} of job {} goes on after {} phases of an earlier worker",
            lease.tile,
            lease.job,
            outcomes.len()
        );
    }
    tracing::info!("leads tile {} of job {}", lease.tile, lease.job);
    let say = way.clone();
    let leader = Leader::new(outcomes, Arc::clone(held) as _, move |message| {
        say.say(message)
    });
    let leader = Arc::new(leader);
    let inbound = match opened {
        Ok((out, inbound)) => {
            let (to, said) = mpsc::unbounded_channel();
            way.turn(Some(to));
            tokio::spawn(send(said, out, of_leader));
            Some(inbound)
        }
        Err(e) => {
            tracing::warn!(
                "tile {} of job {} has no crew for now: {e}",
                lease.tile,
                lease.job
            );
            None
        }
    };
    tokio::spawn(keep_leading(
        client,
        lease,
        Arc::clone(held),
        Arc::downgrade(&leader),
        way,
        inbound,
    ));
    leader
}

/// Opens a leader's stream: the way out, what comes in, the outcomes from phase `from` on that an earlier
/// stream has left, and the number of phases whose outcomes are there.
async fn open(
    client: &Client,
    lease: v1::Lease,
    from: u32,
) -> Result<
    (
        mpsc::Sender<v1::CrewMessage>,
        Streaming<v1::CrewMessage>,
        Vec<Vec<u8>>,
        u32,
    ),
    String,
> {
    let opened = tokio::time::timeout(PATIENCE, enter(client.clone(), lease, (true, from))).await;
    let (out, mut inbound) = opened.map_err(|_| "the coordinator does not answer".to_owned())??;
    let (mut outcomes, mut blobs) = (Vec::new(), Blobs::new(MAX_BYTES));
    loop {
        let next = tokio::time::timeout(PATIENCE, inbound.next()).await;
        let next = next.map_err(|_| "the coordinator does not answer".to_owned())?;
        let message = next
            .ok_or("the coordinator closed the stream")?
            .map_err(|s| describe(&s))?;
        match message.message {
            Some(Message::Outcome(piece)) => {
                outcomes.extend(
                    blobs
                        .push(&piece.chunk.unwrap_or_default())
                        .map_err(|e| e.to_string())?,
                );
            }
            Some(Message::Ready(v1::CrewReady { phases })) => {
                return Ok((out, inbound, outcomes, phases));
            }
            _ => return Err("the coordinator sent something else than outcomes".to_owned()),
        }
    }
}

/// Tells the leader what comes, and opens another stream when one breaks, until its tile is done or its lease
/// has ended.
async fn keep_leading(
    client: Client,
    lease: v1::Lease,
    held: Arc<LeasedTile>,
    leader: Weak<Leader>,
    way: LeaderLink,
    mut inbound: Option<Streaming<v1::CrewMessage>>,
) {
    // Without a stream so far, the outcomes of an earlier leader are not known either.
    let mut knows_earlier = inbound.is_some();
    let mut wait = AGAIN[0];
    loop {
        if let Some(inbound) = inbound.take() {
            let since = Instant::now();
            hear_leader(leader.clone(), &way, inbound).await;
            if since.elapsed() >= STEADY {
                wait = AGAIN[0];
            }
        }
        way.turn(None);
        inbound = Some(loop {
            tokio::time::sleep(wait).await;
            wait = (wait * 2).min(AGAIN[1]);
            let use_for_helpers = leader.upgrade().filter(|leader| !leader.has_ended());
            let Some(from) = use_for_helpers.map(|leader| leader.phase()) else {
                return;
            };
            if held.cancelled() {
                return;
            }
            let from = if knows_earlier { u32::MAX } else { from };
            let Ok((out, inbound, outcomes, there)) = open(&client, lease, from).await else {
                continue;
            };
            let Some(leader) = leader.upgrade() else {
                return;
            };
            if !std::mem::replace(&mut knows_earlier, true) {
                leader.learn(from, outcomes);
            }
            let (to, said) = mpsc::unbounded_channel();
            if leader.reopened(there, || way.turn(Some(to))) {
                tracing::info!("tile {} of job {} has a crew again", lease.tile, lease.job);
                tokio::spawn(send(said, out, of_leader));
                break inbound;
            }
            tracing::warn!(
                "tile {} of job {} goes on without helpers: the coordinator has lost its earlier phases",
                lease.tile,
                lease.job
            );
            return;
        });
    }
}

/// Sends what a member says, as one or several messages each, until it has ended or the stream has broken.
async fn send<T>(
    mut said: mpsc::UnboundedReceiver<T>,
    out: mpsc::Sender<v1::CrewMessage>,
    messages: impl Fn(T) -> Vec<Message>,
) {
    while let Some(message) = said.recv().await {
        for message in messages(message) {
            if out
                .send(v1::CrewMessage {
                    message: Some(message),
                })
                .await
                .is_err()
            {
                return;
            }
        }
    }
}

fn of_leader(said: FromLeader) -> Vec<Message> {
    match said {
        FromLeader::Take {
            member,
            phase,
            items,
        } => {
            vec![Message::Take(v1::CrewTake {
                member,
                phase,
                items,
            })]
        }
        FromLeader::Outcome { phase, bytes, time } => {
            // Nobody's phases last for 584 000 years.
            let micros = time.as_micros().max(1) as u64;
            chunks::cut(&bytes)
                .map(|chunk| {
                    Message::Outcome(v1::CrewOutcome {
                        phase,
                        chunk: Some(chunk),
                        micros,
                    })
                })
                .collect()
        }
        FromLeader::Dismiss(member) => vec![Message::Dismiss(v1::CrewDismiss { member })],
        FromLeader::End => vec![Message::End(v1::CrewEnd {})],
    }
}

fn of_helper(said: FromHelper) -> Vec<Message> {
    // The coordinator numbers helpers.
    let member = 0;
    match said {
        FromHelper::Ask { phase } => vec![Message::Ask(v1::CrewAsk { member, phase })],
        FromHelper::Found {
            phase,
            mut items,
            finds,
        } => chunks::cut(&finds)
            .map(|chunk| {
                let items = std::mem::take(&mut items);
                Message::Found(v1::CrewFound {
                    member,
                    phase,
                    items,
                    chunk: Some(chunk),
                })
            })
            .collect(),
    }
}

/// Tells the leader what comes, until its tile is done or the stream breaks.
async fn hear_leader(
    leader: Weak<Leader>,
    way: &LeaderLink,
    mut inbound: Streaming<v1::CrewMessage>,
) {
    // The helpers, with the items of the finds that arrive.
    let mut members: BTreeMap<Member, (Vec<u32>, Blobs)> = BTreeMap::new();
    while let Some(Ok(message)) = inbound.next().await {
        let Some(leader) = leader.upgrade() else {
            return;
        };
        match message.message {
            Some(Message::Joined(v1::CrewJoined { member })) => {
                members.insert(member, (Vec::new(), Blobs::new(MAX_BYTES)));
                leader.hear(ToLeader::Joined(member));
            }
            Some(Message::Kept(v1::CrewKept { phases })) => leader.hear(ToLeader::Kept(phases)),
            Some(Message::Left(v1::CrewLeft { member })) => {
                members.remove(&member);
                leader.hear(ToLeader::Left(member));
            }
            Some(Message::Ask(v1::CrewAsk { member, phase })) => {
                leader.hear(ToLeader::Ask { member, phase });
            }
            Some(Message::Found(found)) => {
                let v1::CrewFound {
                    member,
                    phase,
                    items,
                    chunk,
                } = found;
                let Some((of, finds)) = members.get_mut(&member) else {
                    continue;
                };
                if !items.is_empty() {
                    *of = items;
                }
                match finds.push(&chunk.unwrap_or_default()) {
                    Ok(None) => {}
                    Ok(Some(finds)) => {
                        let items = std::mem::take(of);
                        leader.hear(ToLeader::Found {
                            member,
                            phase,
                            items,
                            finds,
                        });
                    }
                    Err(e) => {
                        tracing::warn!("helper {member} is dismissed: {e}");
                        members.remove(&member);
                        leader.hear(ToLeader::Left(member));
                        way.say(FromLeader::Dismiss(member));
                    }
                }
            }
            _ => {}
        }
    }
    let Some(leader) = leader.upgrade() else {
        return;
    };
    members
        .into_keys()
        .for_each(|member| leader.hear(ToLeader::Left(member)));
}

/// A helper of the leader that holds `lease`.
///
/// # Errors
/// The reason, when the crew has ended or cannot be reached.
pub async fn help(
    client: Client,
    lease: v1::Lease,
    held: &Arc<LeasedTile>,
) -> Result<Arc<Helper>, String> {
    let opened = tokio::time::timeout(PATIENCE, enter(client, lease, (false, 0))).await;
    let (out, inbound) = opened.map_err(|_| "the coordinator does not answer".to_owned())??;
    let (say, said) = mpsc::unbounded_channel();
    let helper = Helper::new(Arc::clone(held) as _, move |message| {
        // Fails when the stream has broken; the helper is then told that the crew has ended.
        let _ = say.send(message);
    });
    let helper = Arc::new(helper);
    tokio::spawn(send(said, out, of_helper));
    // When the helper has ended, nobody says anything more, and the stream ends.
    tokio::spawn(hear_helper(Arc::downgrade(&helper), inbound));
    Ok(helper)
}

/// Tells the helper what comes; the end of the stream is the end of the crew.
async fn hear_helper(helper: Weak<Helper>, mut inbound: Streaming<v1::CrewMessage>) {
    let mut outcomes = Blobs::new(MAX_BYTES);
    while let Some(Ok(message)) = inbound.next().await {
        let Some(helper) = helper.upgrade() else {
            return;
        };
        match message.message {
            Some(Message::Take(v1::CrewTake { phase, items, .. })) => {
                helper.hear(ToHelper::Take { phase, items });
            }
            Some(Message::Outcome(v1::CrewOutcome { phase, chunk, .. })) => {
                match outcomes.push(&chunk.unwrap_or_default()) {
                    Ok(None) => {}
                    Ok(Some(bytes)) => helper.hear(ToHelper::Outcome { phase, bytes }),
                    Err(e) => {
                        tracing::warn!("this worker stops helping: {e}");
                        break;
                    }
                }
            }
            Some(Message::End(_)) => break,
            _ => {}
        }
    }
    if let Some(helper) = helper.upgrade() {
        helper.hear(ToHelper::End);
    }
}
