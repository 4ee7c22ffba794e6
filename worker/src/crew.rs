//! The streams of a crew on the worker's side: of a leader, which holds the tile's lease, and of a helper.
//!
//! A leader whose stream cannot be opened, or breaks, goes on alone: its tile needs nobody.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt as _;
use sightline_proto::chunks::CHUNK_BYTES;
use sightline_proto::v1;
use sightline_proto::v1::crew_message::Message;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_sampling::crew::{FromHelper, FromLeader, Helper, Leader, Member, ToHelper, ToLeader};
use tokio::sync::mpsc;
use tonic::Streaming;
use tonic::transport::Channel;

use crate::held::Held;
use crate::status::describe;

/// Messages that wait for the network.
const WAITING: usize = 16;
/// How long a leader waits for the outcomes of an earlier one to begin to come, and then for each next one.
const PATIENCE: Duration = Duration::from_secs(10);
/// Most bytes of an outcome or of finds.
const MAX_BYTES: usize = 1 << 30;

type Client = WorkersClient<Channel>;

/// Opens a stream to the other members.
async fn enter(
    mut client: Client,
    lease: v1::Lease,
    leads: bool,
) -> Result<(mpsc::Sender<v1::CrewMessage>, Streaming<v1::CrewMessage>), String> {
    let (out, receiver) = mpsc::channel(WAITING);
    let enter = Message::Enter(v1::CrewEnter { lease: Some(lease), leads });
    // There is room: nothing else was sent.
    let _ = out.try_send(v1::CrewMessage { message: Some(enter) });
    let stream = tokio_stream::wrappers::ReceiverStream::new(receiver);
    let inbound = client.crew(stream).await.map_err(|s| describe(&s))?.into_inner();
    Ok((out, inbound))
}

/// Cuts data into pieces; each call of `message` gets one, and whether more follow.
async fn send_pieces(
    out: &mpsc::Sender<v1::CrewMessage>,
    bytes: &[u8],
    mut message: impl FnMut(Vec<u8>, bool) -> Message,
) -> Result<(), mpsc::error::SendError<v1::CrewMessage>> {
    let mut pieces = bytes.chunks(CHUNK_BYTES).peekable();
    loop {
        let data = pieces.next().unwrap_or_default().to_vec();
        let more = pieces.peek().is_some();
        out.send(v1::CrewMessage { message: Some(message(data, more)) }).await?;
        if !more {
            return Ok(());
        }
    }
}

/// Data that arrives in pieces.
#[derive(Default)]
struct Pieces(Vec<u8>);

impl Pieces {
    /// Adds a piece; gives the whole when it was the last.
    fn push(&mut self, data: &[u8], more: bool) -> Result<Option<Vec<u8>>, String> {
        if self.0.len().saturating_add(data.len()) > MAX_BYTES {
            return Err("a message of a crew is larger than is accepted".to_owned());
        }
        self.0.extend_from_slice(data);
        Ok((!more).then(|| std::mem::take(&mut self.0)))
    }
}

/// A leader with a stream to its helpers; without one, if there cannot be one, a leader without helpers.
pub async fn lead(client: Client, lease: v1::Lease, held: &Arc<Held>) -> Arc<Leader> {
    match open(client, lease, held).await {
        Ok(leader) => leader,
        Err(e) => {
            tracing::warn!("tile {} of job {} has no crew: {e}", lease.tile, lease.job);
            Arc::new(Leader::new(Vec::new(), Arc::clone(held) as _, drop))
        }
    }
}

async fn open(client: Client, lease: v1::Lease, held: &Arc<Held>) -> Result<Arc<Leader>, String> {
    let opened = tokio::time::timeout(PATIENCE, enter(client, lease, true)).await;
    let (out, mut inbound) = opened.map_err(|_| "the coordinator does not answer".to_owned())??;
    let (mut outcomes, mut pieces) = (Vec::new(), Pieces::default());
    loop {
        let next = tokio::time::timeout(PATIENCE, inbound.next()).await;
        let next = next.map_err(|_| "the coordinator does not answer".to_owned())?;
        let message = next.ok_or("the coordinator closed the stream")?.map_err(|s| describe(&s))?;
        match message.message {
            Some(Message::Outcome(piece)) => outcomes.extend(pieces.push(&piece.data, piece.more)?),
            Some(Message::Ready(_)) => break,
            _ => return Err("the coordinator sent something else than outcomes".to_owned()),
        }
    }
    if !outcomes.is_empty() {
        tracing::info!(
            "tile {} of job {} goes on after {} phases of an earlier worker",
            lease.tile,
            lease.job,
            outcomes.len()
        );
    }
    let (say, said) = mpsc::unbounded_channel();
    let leader = Leader::new(outcomes, Arc::clone(held) as _, move |message| {
        // Fails when the stream has broken; the leader then goes on alone.
        let _ = say.send(message);
    });
    let leader = Arc::new(leader);
    tokio::spawn(send_leader(said, out));
    tokio::spawn(hear_leader(Arc::downgrade(&leader), inbound));
    Ok(leader)
}

/// Sends what the leader says until the crew ends.
async fn send_leader(mut said: mpsc::UnboundedReceiver<FromLeader>, out: mpsc::Sender<v1::CrewMessage>) {
    while let Some(message) = said.recv().await {
        let sent = match message {
            FromLeader::Take { member, phase, items } => {
                let take = Message::Take(v1::CrewTake { member, phase, items });
                out.send(v1::CrewMessage { message: Some(take) }).await
            }
            FromLeader::Outcome { phase, bytes } => {
                let outcome = |data, more| Message::Outcome(v1::CrewOutcome { phase, data, more });
                send_pieces(&out, &bytes, outcome).await
            }
            FromLeader::End => {
                let end = Message::End(v1::CrewEnd {});
                // The last message; nobody waits for it when this fails.
                let _ = out.send(v1::CrewMessage { message: Some(end) }).await;
                return;
            }
        };
        if sent.is_err() {
            return;
        }
    }
}

/// Tells the leader what comes, until its tile is done or the stream breaks.
async fn hear_leader(leader: std::sync::Weak<Leader>, mut inbound: Streaming<v1::CrewMessage>) {
    let (mut members, mut pieces) = (BTreeSet::<Member>::new(), std::collections::BTreeMap::new());
    while let Some(Ok(message)) = inbound.next().await {
        let Some(leader) = leader.upgrade() else { return };
        match message.message {
            Some(Message::Joined(v1::CrewJoined { member })) => {
                members.insert(member);
                leader.hear(ToLeader::Joined(member));
            }
            Some(Message::Left(v1::CrewLeft { member })) => {
                members.remove(&member);
                pieces.remove(&member);
                leader.hear(ToLeader::Left(member));
            }
            Some(Message::Ask(v1::CrewAsk { member, phase })) => {
                leader.hear(ToLeader::Ask { member, phase });
            }
            Some(Message::Found(found)) => {
                let v1::CrewFound { member, phase, items, data, more } = found;
                let (first, so_far) = pieces.entry(member).or_insert_with(|| (items, Pieces::default()));
                match so_far.push(&data, more) {
                    Ok(None) => {}
                    Ok(Some(finds)) => {
                        let items = std::mem::take(first);
                        pieces.remove(&member);
                        leader.hear(ToLeader::Found { member, phase, items, finds });
                    }
                    Err(e) => {
                        tracing::warn!("helper {member} is dismissed: {e}");
                        pieces.remove(&member);
                        leader.hear(ToLeader::Left(member));
                    }
                }
            }
            _ => {}
        }
    }
    let Some(leader) = leader.upgrade() else { return };
    members.into_iter().for_each(|member| leader.hear(ToLeader::Left(member)));
}

/// A helper of the leader that holds `lease`.
///
/// # Errors
/// The reason, when the crew has ended or cannot be reached.
pub async fn help(client: Client, lease: v1::Lease, held: &Arc<Held>) -> Result<Arc<Helper>, String> {
    let opened = tokio::time::timeout(PATIENCE, enter(client, lease, false)).await;
    let (out, inbound) = opened.map_err(|_| "the coordinator does not answer".to_owned())??;
    let (say, said) = mpsc::unbounded_channel();
    let helper = Helper::new(Arc::clone(held) as _, move |message| {
        // Fails when the stream has broken; the helper is then told that the crew has ended.
        let _ = say.send(message);
    });
    let helper = Arc::new(helper);
    tokio::spawn(send_helper(said, out));
    // When the helper has ended, nobody says anything more, and the stream ends.
    tokio::spawn(hear_helper(Arc::downgrade(&helper), inbound));
    Ok(helper)
}

/// Sends what the helper says.
async fn send_helper(mut said: mpsc::UnboundedReceiver<FromHelper>, out: mpsc::Sender<v1::CrewMessage>) {
    while let Some(message) = said.recv().await {
        let sent = match message {
            FromHelper::Ask { phase } => {
                let ask = Message::Ask(v1::CrewAsk { member: 0, phase });
                out.send(v1::CrewMessage { message: Some(ask) }).await
            }
            FromHelper::Found { phase, items, finds } => {
                let mut items = Some(items);
                let found = |data, more| {
                    let items = items.take().unwrap_or_default();
                    Message::Found(v1::CrewFound { member: 0, phase, items, data, more })
                };
                send_pieces(&out, &finds, found).await
            }
        };
        if sent.is_err() {
            return;
        }
    }
}

/// Tells the helper what comes; the end of the stream is the end of the crew.
async fn hear_helper(helper: std::sync::Weak<Helper>, mut inbound: Streaming<v1::CrewMessage>) {
    let mut pieces = Pieces::default();
    while let Some(Ok(message)) = inbound.next().await {
        let Some(helper) = helper.upgrade() else { return };
        match message.message {
            Some(Message::Take(v1::CrewTake { phase, items, .. })) => {
                helper.hear(ToHelper::Take { phase, items });
            }
            Some(Message::Outcome(v1::CrewOutcome { phase, data, more })) => match pieces.push(&data, more) {
                Ok(None) => {}
                Ok(Some(bytes)) => helper.hear(ToHelper::Outcome { phase, bytes }),
                Err(e) => {
                    tracing::warn!("{e}");
                    break;
                }
            },
            Some(Message::End(_)) => break,
            _ => {}
        }
    }
    if let Some(helper) = helper.upgrade() {
        helper.hear(ToHelper::End);
    }
}
