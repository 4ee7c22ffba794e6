//! The worker's side of a crew's streams. The worker is the leader, which holds the tile's lease, or a
//! helper.
//!
//! If the stream of a leader cannot be opened or breaks, the leader continues without helpers, and tries to
//! open another stream.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use sightline_proto::chunks::{self, Blobs};
use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::crew_message::Message;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_sample::crew::{FromHelper, FromLeader, Helper, Leader, Member, ToHelper, ToLeader};
use sightline_sample::{PhaseIndex, Watcher as _};
use tokio::sync::mpsc;
use tonic::Streaming;

use crate::leased_tile::LeasedTile;
use crate::status::describe;

/// Maximum number of messages that wait for the network.
const WAITING: usize = 16;
/// The duration after which a leader's stream counts as stable, so that the next wait is short again.
const STEADY: Duration = Duration::from_secs(5);
/// Timeout for a leader's wait for the first outcome of an earlier leader, and for each further one.
const PATIENCE: Duration = Duration::from_secs(10);
/// The minimum and the maximum wait after a leader's stream has broken. The wait doubles each time.
const AGAIN: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];
/// Maximum length of an outcome, or of the results that a helper sends, in bytes.
const MAX_BYTES: u64 = 1 << 30;

type Client = WorkersClient<Connection>;

/// Opens a stream to the other members of a crew.
async fn enter(
    mut client: Client,
    lease: v1::Lease,
    leads: bool,
    phases: u32,
) -> Result<(mpsc::Sender<v1::CrewMessage>, Streaming<v1::CrewMessage>), String> {
    let (out, receiver) = mpsc::channel(WAITING);
    let enter = Message::Enter(v1::CrewEnter {
        lease: Some(lease),
        leads,
        phases,
    });
    // The channel has room, because this is the first message.
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

/// The path of the leader's messages: the current stream, or none.
#[derive(Clone, Default)]
struct LeaderLink(Arc<Mutex<Option<mpsc::UnboundedSender<FromLeader>>>>);

impl LeaderLink {
    /// Sets the stream for later messages, or `None` to drop them.
    fn set_stream(&self, to: Option<mpsc::UnboundedSender<FromLeader>>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = to;
    }

    fn say(&self, message: FromLeader) {
        let link = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // The send fails if the stream has broken. The leader keeps its outcomes for the next stream.
        let _ = link.iter().try_for_each(|link| link.send(message.clone()));
    }
}

/// Creates a leader with a stream to its helpers, or without helpers if the stream cannot be opened.
pub async fn lead(client: Client, lease: v1::Lease, leased: &Arc<LeasedTile>) -> Arc<Leader> {
    let link = LeaderLink::default();
    let (opened, outcomes) = match open(&client, lease, 0).await {
        Ok((out, inbound, outcomes, _)) => (Ok((out, inbound)), outcomes),
        Err(e) => (Err(e), Vec::new()),
    };
    if !outcomes.is_empty() {
        tracing::info!(
            "tile {} of job {} continues after {} phases of an earlier worker",
            lease.tile,
            lease.job,
            outcomes.len()
        );
    }
    tracing::info!("this worker leads tile {} of job {}", lease.tile, lease.job);
    let say = link.clone();
    let leader = Leader::new(outcomes, Arc::clone(leased) as _, move |message| {
        say.say(message)
    });
    let leader = Arc::new(leader);
    let inbound = match opened {
        Ok((out, inbound)) => {
            let (to, said) = mpsc::unbounded_channel();
            link.set_stream(Some(to));
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
        Arc::clone(leased),
        Arc::downgrade(&leader),
        link,
        inbound,
    ));
    leader
}

/// Opens a leader's stream. Returns the outgoing channel, the incoming messages, the outcomes of earlier
/// leaders from phase `from` on, and the number of phases whose outcomes the coordinator has.
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
    let opened = tokio::time::timeout(PATIENCE, enter(client.clone(), lease, true, from)).await;
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
            _ => {
                return Err(
                    "the coordinator sent another message in place of an outcome".to_owned(),
                );
            }
        }
    }
}

/// Passes incoming messages to the leader, and opens another stream if the stream breaks. Ends when the tile
/// is done or the lease has ended.
async fn keep_leading(
    client: Client,
    lease: v1::Lease,
    leased: Arc<LeasedTile>,
    leader: Weak<Leader>,
    link: LeaderLink,
    mut inbound: Option<Streaming<v1::CrewMessage>>,
) {
    // Without a stream so far, the outcomes of an earlier leader are not known either.
    let mut knows_earlier = inbound.is_some();
    let mut wait = AGAIN[0];
    loop {
        if let Some(inbound) = inbound.take() {
            let since = Instant::now();
            pass_to_leader(leader.clone(), &link, inbound).await;
            if since.elapsed() >= STEADY {
                wait = AGAIN[0];
            }
        }
        link.set_stream(None);
        inbound = Some(loop {
            tokio::time::sleep(wait).await;
            wait = (wait * 2).min(AGAIN[1]);
            let use_for_helpers = leader.upgrade().filter(|leader| !leader.has_ended());
            let Some(from) = use_for_helpers.map(|leader| leader.phase().0) else {
                return;
            };
            if leased.cancelled() {
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
                leader.learn(PhaseIndex(from), outcomes);
            }
            let (to, said) = mpsc::unbounded_channel();
            if leader.reopened(there, || link.set_stream(Some(to))) {
                tracing::info!("tile {} of job {} has a crew again", lease.tile, lease.job);
                tokio::spawn(send(said, out, of_leader));
                break inbound;
            }
            tracing::warn!(
                "tile {} of job {} continues without helpers: the coordinator has lost its earlier \
                 phases",
                lease.tile,
                lease.job
            );
            return;
        });
    }
}

/// Sends the messages of a member until the member has ended or the stream has broken. `messages` converts a
/// message to one or more messages of the stream.
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
                phase: phase.0,
                items,
            })]
        }
        FromLeader::Outcome { phase, bytes, time } => {
            // No phase lasts for 584,000 years.
            let micros = time.as_micros().max(1) as u64;
            chunks::cut(&bytes)
                .map(|chunk| {
                    Message::Outcome(v1::CrewOutcome {
                        phase: phase.0,
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
    // The coordinator assigns the numbers of helpers.
    let member = 0;
    match said {
        FromHelper::Ask { phase } => vec![Message::Ask(v1::CrewAsk {
            member,
            phase: phase.0,
        })],
        FromHelper::Found {
            phase,
            mut items,
            finds,
        } => chunks::cut(&finds)
            .map(|chunk| {
                let items = std::mem::take(&mut items);
                Message::Found(v1::CrewFound {
                    member,
                    phase: phase.0,
                    items,
                    chunk: Some(chunk),
                })
            })
            .collect(),
    }
}

/// Passes incoming messages to the leader until its tile is done or the stream breaks.
async fn pass_to_leader(
    leader: Weak<Leader>,
    link: &LeaderLink,
    mut inbound: Streaming<v1::CrewMessage>,
) {
    // The helpers, with the items whose results are being received.
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
                let phase = PhaseIndex(phase);
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
                            phase: PhaseIndex(phase),
                            items,
                            finds,
                        });
                    }
                    Err(e) => {
                        tracing::warn!("this worker dismisses helper {member} of its tile: {e}");
                        members.remove(&member);
                        leader.hear(ToLeader::Left(member));
                        link.say(FromLeader::Dismiss(member));
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

/// Creates a helper of the leader that holds `lease`.
///
/// # Errors
/// The reason, if the crew has ended or cannot be reached.
pub async fn help(
    client: Client,
    lease: v1::Lease,
    leased: &Arc<LeasedTile>,
) -> Result<Arc<Helper>, String> {
    let opened = tokio::time::timeout(PATIENCE, enter(client, lease, false, 0)).await;
    let (out, inbound) = opened.map_err(|_| "the coordinator does not answer".to_owned())??;
    let (say, said) = mpsc::unbounded_channel();
    let helper = Helper::new(Arc::clone(leased) as _, move |message| {
        // The send fails if the stream has broken; the helper is then notified that the crew has ended.
        let _ = say.send(message);
    });
    let helper = Arc::new(helper);
    tokio::spawn(send(said, out, of_helper));
    // After the helper has ended, no task sends further messages, and the stream ends.
    tokio::spawn(pass_to_helper(Arc::downgrade(&helper), inbound));
    Ok(helper)
}

/// Passes incoming messages to the helper. The end of the stream is the end of the crew.
async fn pass_to_helper(helper: Weak<Helper>, mut inbound: Streaming<v1::CrewMessage>) {
    let mut outcomes = Blobs::new(MAX_BYTES);
    while let Some(Ok(message)) = inbound.next().await {
        let Some(helper) = helper.upgrade() else {
            return;
        };
        match message.message {
            Some(Message::Take(v1::CrewTake { phase, items, .. })) => {
                let phase = PhaseIndex(phase);
                helper.hear(ToHelper::Take { phase, items });
            }
            Some(Message::Outcome(v1::CrewOutcome { phase, chunk, .. })) => {
                let phase = PhaseIndex(phase);
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
