//! Bodies of requests that are read only while memory for their messages is available.

use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use futures::future::BoxFuture;
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Sleep;
use tonic::Status;
use tonic::body::Body;

use crate::access::{Caller, Scope};
use crate::quota::{Intake, RequestMemory};

/// Maximum size of a message or a body, in bytes.
pub(super) const MAX_MESSAGE: u64 = 4 << 20;
/// Maximum size of a message that needs no reservation, in bytes. A part of a body has the same size.
const SMALL: u64 = 16 << 10;
/// The memory that a decoded message can need, as a multiple of its size. An empty element of a list has two
/// bytes in a message and up to 48 in memory.
const GROWTH: u64 = 24;
/// The calls whose messages contain chunks, which do not grow, from the second message on.
const CHUNKS: [&str; 3] = ["PutSceneFile", "PutResult", "Crew"];
/// The call whose messages all contain chunks.
const ONLY_CHUNKS: &str = "PutChunks";
/// Maximum time in which a message with a reservation may arrive. Afterwards, its memory is available to
/// others.
pub(super) const MESSAGE_TIME: Duration = Duration::from_secs(120);

/// The reserved memory of a call's last message, which outlives the request's body.
pub(super) type LastRoom = Arc<Mutex<Option<RequestMemory>>>;

/// Returns the name of the caller if the limit of a user applies to it, and an empty name otherwise.
pub(super) fn bounded(caller: Option<&Caller>) -> &str {
    match caller {
        Some(Caller::User { name, scopes }) if !scopes.include(Scope::Worker) => name,
        _ => "",
    }
}

/// Returns the memory that a JSON body can need, from its announced length in bytes.
pub(super) fn needed_by_json(announced: u64) -> u64 {
    announced.min(MAX_MESSAGE) * GROWTH
}

/// A request's body whose messages are read only while memory for them is available.
pub(super) struct Metered {
    body: Body,
    intake: Arc<Intake>,
    user: String,
    /// The growth factor of the next message.
    growth: u64,
    /// The growth factor of the messages after the first one.
    later_growth: u64,
    framing: Framing,
    room: LastRoom,
    waiting: Option<BoxFuture<'static, Result<RequestMemory, Status>>>,
    /// The length of the messages that have memory and were not decoded yet, in bytes.
    begun: u64,
    /// The time at which the message with a reservation must be complete.
    deadline: Option<Pin<Box<Sleep>>>,
}

impl Metered {
    /// Limits the memory for the body of a call. `path` is the path of the call.
    pub(super) fn new(
        body: Body,
        intake: &Arc<Intake>,
        user: &str,
        path: &str,
    ) -> (Self, LastRoom) {
        let room = LastRoom::default();
        let method = path.rsplit('/').next().unwrap_or_default();
        let is_chunks = method == ONLY_CHUNKS;
        let this = Self {
            body,
            intake: Arc::clone(intake),
            user: user.to_owned(),
            growth: if is_chunks { 1 } else { GROWTH },
            later_growth: if is_chunks || CHUNKS.contains(&method) {
                1
            } else {
                GROWTH
            },
            framing: Framing::default(),
            room: Arc::clone(&room),
            waiting: None,
            begun: 0,
            deadline: None,
        };
        (this, room)
    }
}

impl HttpBody for Metered {
    type Data = bytes::Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        if let Some(waiting) = &mut self.waiting {
            let room = ready!(waiting.as_mut().poll(context));
            self.waiting = None;
            match room {
                Ok(room) => {
                    *lock(&self.room) = Some(room);
                    if self.framing.rest > 0 {
                        self.deadline = Some(Box::pin(tokio::time::sleep(MESSAGE_TIME)));
                    }
                }
                Err(status) => return Poll::Ready(Some(Err(status))),
            }
        }
        // The server continues to read after it has decoded a message. The handlers limit the lengths of
        // lists.
        if self.framing.rest == 0 && self.begun > 0 {
            let begun = std::mem::take(&mut self.begun);
            if let Some(room) = &mut *lock(&self.room) {
                room.shrink(begun);
            }
        }
        let frame = Pin::new(&mut self.body).poll_frame(context);
        if frame.is_pending()
            && let Some(deadline) = &mut self.deadline
            && deadline.as_mut().poll(context).is_ready()
        {
            let text =
                format!("a message did not arrive within {MESSAGE_TIME:?}; send the request again");
            return Poll::Ready(Some(Err(Status::deadline_exceeded(text))));
        }
        let frame = ready!(frame);
        if let Some(Ok(frame)) = &frame
            && let Some(data) = frame.data_ref()
            && let Some(MessageLengths { first, rest }) = self.framing.announced(data)
        {
            // The previous messages have been decoded. The new messages wait for their own memory.
            *lock(&self.room) = None;
            self.deadline = None;
            let later = self.later_growth;
            let growth = std::mem::replace(&mut self.growth, later);
            self.begun = first + rest;
            if self.begun > SMALL {
                let (intake, user) = (Arc::clone(&self.intake), self.user.clone());
                let bytes = first
                    .saturating_mul(growth)
                    .saturating_add(rest.saturating_mul(later));
                self.waiting = Some(Box::pin(async move {
                    intake.room(&user, bytes).await.map_err(|_| {
                        Status::unavailable(
                            "the coordinator is stopping; try again after its restart",
                        )
                    })
                }));
            }
        }
        if self.framing.rest == 0 {
            self.deadline = None;
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A parser of gRPC frames in a body: one byte, the length of a message in four bytes, and the message.
#[derive(Debug, Default)]
struct Framing {
    head: Vec<u8>,
    /// The number of missing bytes of the current message.
    rest: u64,
}

/// The lengths of the messages that start in a part of a body, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct MessageLengths {
    /// The length of the first message.
    first: u64,
    /// The length of the other messages together.
    rest: u64,
}

impl Framing {
    /// Reads the next part of a body. Returns the lengths of the messages that start in the part, if any. A
    /// message that is too long counts with the maximum length; its reader rejects it.
    fn announced(&mut self, mut part: &[u8]) -> Option<MessageLengths> {
        let mut begun = None;
        while !part.is_empty() {
            let skipped = usize::try_from(self.rest)
                .unwrap_or(usize::MAX)
                .min(part.len());
            self.rest -= skipped as u64;
            part = &part[skipped..];
            let missing = (5 - self.head.len()).min(part.len());
            if self.rest == 0 && missing > 0 {
                self.head.extend_from_slice(&part[..missing]);
                part = &part[missing..];
                if let [_, a, b, c, d] = self.head[..] {
                    self.rest = u32::from_be_bytes([a, b, c, d]).into();
                    self.head.clear();
                    let length = self.rest.min(MAX_MESSAGE);
                    begun = Some(match begun {
                        None => MessageLengths {
                            first: length,
                            rest: 0,
                        },
                        Some(MessageLengths { first, rest }) => MessageLengths {
                            first,
                            rest: rest + length,
                        },
                    });
                }
            }
        }
        begun
    }
}

/// Locks a mutex whose changes are complete before a panic can occur.
fn lock<T>(what: &Mutex<T>) -> MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use futures::FutureExt as _;
    use tokio::sync::mpsc;

    use super::*;

    /// Returns a message with its frame header.
    fn message(length: u32) -> Vec<u8> {
        [&[0], &length.to_be_bytes()[..], &vec![7; length as usize]].concat()
    }

    #[test]
    fn framing_finds_messages_in_any_split_of_body() {
        let lengths = [0, 3, 70_000, 0, 0, 1];
        let body: Vec<u8> = lengths.iter().flat_map(|n| message(*n)).collect();
        for size in [1, 2, 3, 4, 5, 6, 7, 100, 16_384, body.len()] {
            let mut framing = Framing::default();
            let begun: Vec<MessageLengths> = body
                .chunks(size)
                .filter_map(|part| framing.announced(part))
                .collect();
            assert_eq!(
                begun.iter().map(|b| b.first + b.rest).sum::<u64>(),
                70_004,
                "parts of {size} bytes"
            );
            assert_eq!((framing.rest, framing.head.len()), (0, 0));
        }
        let mut framing = Framing::default();
        let longest = Some(MessageLengths {
            first: MAX_MESSAGE,
            rest: 0,
        });
        assert_eq!(framing.announced(&[0, 0xff, 0xff, 0xff, 0xff, 9]), longest);
        // A part with the header of a result and its first chunk.
        let part = [message(40), message(1 << 20)].concat();
        assert_eq!(
            Framing::default().announced(&part),
            Some(MessageLengths {
                first: 40,
                rest: 1 << 20
            })
        );
    }

    /// A call in progress: the sender of its body's parts, and its body.
    struct Sent {
        parts: mpsc::Sender<Result<bytes::Bytes, Status>>,
        body: Metered,
        _room: LastRoom,
    }

    impl Sent {
        fn new(intake: &Arc<Intake>, user: &str, path: &str) -> Self {
            let (parts, read) = mpsc::channel(4);
            let read = tokio_stream::wrappers::ReceiverStream::new(read);
            let body = Body::new(axum::body::Body::from_stream(read));
            let (body, _room) = Metered::new(body, intake, user, path);
            Self { parts, body, _room }
        }

        /// Sends a part. Returns true if the body reads the part immediately.
        async fn takes(&mut self, part: Vec<u8>) -> bool {
            self.parts.send(Ok(part.into())).await.unwrap();
            self.reads()
        }

        /// Returns true if the body returns a part immediately.
        fn reads(&mut self) -> bool {
            let next = std::future::poll_fn(|context| Pin::new(&mut self.body).poll_frame(context));
            next.now_or_never()
                .is_some_and(|frame| frame.unwrap().is_ok())
        }
    }

    #[tokio::test]
    async fn messages_wait_for_memory_before_their_bytes_are_read() {
        let intake = Arc::new(Intake::default());
        let head = |length: u64| [&[0], &(length as u32).to_be_bytes()[..]].concat();
        let submit = || Sent::new(&intake, "", "/sightline.v1.Jobs/Submit");
        let mut calls = Vec::new();
        let mut next = loop {
            let mut call = submit();
            assert!(call.takes(head(MAX_MESSAGE)).await);
            if !call.takes(vec![7; 9]).await {
                break call;
            }
            calls.push(call);
            assert!(calls.len() < 100, "messages of 400 MB have room");
        };
        // Small messages do not wait, and neither does another message with a chunk.
        let mut small = Sent::new(&intake, "", "/sightline.v1.Workers/Work");
        assert!(small.takes(message(100)).await && small.takes(message(100)).await);
        drop(calls.pop());
        // The waiting part is read now.
        assert!(next.reads());
        // A decoded message keeps the memory for its length.
        assert!(!submit_fits(&intake).await);
        assert!(
            next.takes(vec![7; MAX_MESSAGE as usize - 9]).await && next.takes(message(1)).await
        );
        assert!(submit_fits(&intake).await);
    }

    #[tokio::test]
    async fn chunks_after_header_reserve_their_length() {
        let intake = Arc::new(Intake::default());
        let mut calls = Vec::new();
        // If each chunk reserved the memory of a list, ten calls would fill the intake.
        for _ in 0..20 {
            let mut call = Sent::new(&intake, "", "/sightline.v1.Workers/PutResult");
            assert!(call.takes([message(40), message(1 << 20)].concat()).await);
            // The call reserves the memory when its body is read again.
            assert!(call.takes(vec![7]).await, "{} calls", calls.len());
            calls.push(call);
        }
    }

    /// Returns true if memory for the longest message is available.
    async fn submit_fits(intake: &Arc<Intake>) -> bool {
        let mut call = Sent::new(intake, "", "/sightline.v1.Jobs/Submit");
        let head = [&[0], &(MAX_MESSAGE as u32).to_be_bytes()[..]].concat();
        call.takes(head).await && call.takes(vec![7; 9]).await
    }
}
