//! The way of spans to the collector: a bounded queue, and a thread that sends what is in it.
//!
//! Whoever has a span puts it into the queue and goes on. While the collector is away the thread tries again
//! with growing waits, the queue fills, and what does not fit is counted and lost. The log has a line when
//! that begins and one when it ends.

use std::fmt;
use std::future::Future;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use opentelemetry_proto::tonic::collector::trace::v1::trace_service_client::TraceServiceClient;
use opentelemetry_proto::tonic::resource::v1::Resource;
use sightline_proto::connecting::Credentials;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};

use crate::ids::SpanId;
use crate::span::Span;
use crate::wire;

/// Spans that wait. One has some hundred bytes.
const MOST_WAITING: usize = 1 << 14;
/// Spans of one message, which stays far below the four megabytes that collectors take.
const MOST_AT_ONCE: usize = 512;
/// How long a span waits for others to go with.
const LINGER: Duration = Duration::from_millis(500);
/// How long the collector may take for a message.
const PATIENCE: Duration = Duration::from_secs(5);
/// The waits before a message is sent again: the first, and late ones; they double in between.
const AGAIN: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(10)];
/// How long a message is sent again. A collector that restarts is back by then, and one message that it
/// cannot take does not stop all others.
const KEEP: Duration = Duration::from_secs(60);
/// Losses are told of again after this time.
const TELL_AGAIN: Duration = Duration::from_secs(60);
/// How long the end of the program waits at most for a collector.
const FAREWELL: Duration = Duration::from_secs(2);

/// Where spans go, and from whom.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The collector's address for OTLP over gRPC, such as `http://127.0.0.1:4317`.
    pub url: String,
    /// Certificates, as PEM, of which one must have signed the collector's; `None` for those of the system.
    pub ca: Option<Vec<u8>>,
    /// The kind of process.
    pub service: &'static str,
    /// The name of the process among those of its kind.
    pub instance: String,
}

/// Why traces cannot be begun.
#[derive(Debug, thiserror::Error)]
pub enum TracesError {
    /// The address is none.
    #[error(
        "{url} cannot be a collector's address: {reason}; give one such as http://127.0.0.1:4317"
    )]
    Address {
        /// The address, unless it holds what must not be shown.
        url: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The system has no thread, or no random numbers.
    #[error("traces cannot be sent: {0}")]
    System(String),
}

/// Where spans go. Copies lead to the same place; the default is nowhere.
#[derive(Clone, Default)]
pub struct Traces(Option<Arc<Inside>>);

struct Inside {
    queue: mpsc::Sender<Span>,
    lost: Arc<AtomicU64>,
    ids: Ids,
    /// Once the program ends, until when it waits.
    closing: watch::Sender<Option<Instant>>,
    /// Gets the news that the thread has ended.
    ended: Mutex<std::sync::mpsc::Receiver<()>>,
}

/// Random ids for spans that no other process has to know.
#[derive(Clone)]
struct Ids(Arc<AtomicU64>);

impl Ids {
    /// SplitMix64 (Steele, Lea and Flood 2014, figure 16), from a random number on.
    fn next(&self) -> SpanId {
        const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
        let mut z = self.0.fetch_add(STEP, Ordering::Relaxed).wrapping_add(STEP);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        SpanId::of_number(z ^ (z >> 31))
    }
}

impl fmt::Debug for Traces {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.is_on() { "traces" } else { "no traces" })
    }
}

impl Traces {
    /// Begins to send spans. The collector need not be there.
    ///
    /// # Errors
    /// [`TracesError`].
    pub fn start(settings: Settings) -> Result<Self, TracesError> {
        let Settings {
            url,
            ca,
            service,
            instance,
        } = settings;
        if url.contains('@') {
            let reason = "it must not hold a user or a password".to_owned();
            return Err(TracesError::Address {
                url: "what was given".to_owned(),
                reason,
            });
        }
        // Without the coordinator's token, which is none of the collector's business.
        let endpoint = Credentials {
            ca,
            ..Credentials::default()
        }
        .endpoint(&url);
        let endpoint = endpoint.map_err(|reason| TracesError::Address {
            url: url.clone(),
            reason,
        })?;
        let system = |e: &dyn fmt::Display| TracesError::System(e.to_string());
        let ids = Ids(Arc::new(AtomicU64::new(
            getrandom::u64().map_err(|e| system(&e))?,
        )));
        let lost = Arc::new(AtomicU64::new(0));
        let (queue, waiting) = mpsc::channel(MOST_WAITING);
        let (closing, closed) = watch::channel(None);
        let (say_ended, ended) = std::sync::mpsc::channel();
        let sender = Sender {
            url,
            resource: wire::resource(service, &instance),
            ids: ids.clone(),
            lost: Arc::clone(&lost),
            closing: closed,
            fails: false,
            told: (0, None),
        };
        // A runtime of its own: spans are sent while the others of the process are busy, or end.
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| system(&e))?;
        let thread = move || {
            runtime.block_on(sender.send_all(&endpoint, waiting));
            // A look-up of the collector's name may hang; nobody waits for it.
            runtime.shutdown_background();
            // Fails when nobody waits for the end.
            let _ = say_ended.send(());
        };
        std::thread::Builder::new()
            .name("traces".to_owned())
            .spawn(thread)
            .map_err(|e| system(&e))?;
        let ended = Mutex::new(ended);
        Ok(Self(Some(Arc::new(Inside {
            queue,
            lost,
            ids,
            closing,
            ended,
        }))))
    }

    /// Whether spans go anywhere.
    pub fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// A span's id, for spans below it that end before it. Nothing is sent where traces are off, whatever the
    /// id.
    pub fn fresh_id(&self) -> SpanId {
        self.0
            .as_ref()
            .map_or_else(|| SpanId::of_number(0), |inside| inside.ids.next())
    }

    /// Sends a span that has ended. Never waits: without room it is lost, and counted.
    pub fn send(&self, span: Span) {
        if let Some(inside) = &self.0
            && inside.queue.try_send(span).is_err()
        {
            inside.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Spans that have reached nobody and will not.
    pub fn lost(&self) -> u64 {
        self.0
            .as_ref()
            .map_or(0, |inside| inside.lost.load(Ordering::Relaxed))
    }

    /// Sends what waits when the value is dropped. A collector that does not answer delays that by two
    /// seconds at most.
    pub fn closing(&self) -> Closing {
        Closing(self.clone())
    }

    fn close(&self) {
        let Some(inside) = &self.0 else { return };
        inside.closing.send_replace(Some(Instant::now() + FAREWELL));
        let ended = inside.ended.lock().unwrap_or_else(PoisonError::into_inner);
        // It ends by itself in this time, or hangs in the system.
        let _ = ended.recv_timeout(FAREWELL + Duration::from_millis(500));
    }
}

/// Sends what waits when it is dropped; see [`Traces::closing`].
#[must_use]
pub struct Closing(Traces);

impl Drop for Closing {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// The thread that sends.
struct Sender {
    url: String,
    resource: Resource,
    ids: Ids,
    lost: Arc<AtomicU64>,
    closing: watch::Receiver<Option<Instant>>,
    /// Whether the last message was not taken.
    fails: bool,
    /// Lost spans that the log knows of, and since when.
    told: (u64, Option<Instant>),
}

impl Sender {
    async fn send_all(mut self, endpoint: &Endpoint, mut waiting: mpsc::Receiver<Span>) {
        let mut client = TraceServiceClient::new(endpoint.connect_lazy());
        loop {
            let spans = self.next(&mut waiting).await;
            if spans.is_empty() {
                break;
            }
            self.deliver(&mut client, spans).await;
        }
        let lost = self.lost.load(Ordering::Relaxed);
        if lost > self.told.0 {
            tracing::warn!("{lost} spans have not reached {} and are lost", self.url);
        }
    }

    /// The next spans; none after the end.
    async fn next(&mut self, waiting: &mut mpsc::Receiver<Span>) -> Vec<Span> {
        let mut spans = Vec::new();
        let mut closing = self.closing.clone();
        tokio::select! {
            _ = waiting.recv_many(&mut spans, MOST_AT_ONCE) => {}
            _ = ending(&mut closing) => {}
        }
        let enough = Instant::now() + LINGER;
        while !spans.is_empty() && spans.len() < MOST_AT_ONCE && self.closing.borrow().is_none() {
            let room = MOST_AT_ONCE - spans.len();
            tokio::select! {
                more = waiting.recv_many(&mut spans, room) => if more == 0 { break },
                () = tokio::time::sleep_until(enough) => break,
                _ = ending(&mut closing) => {}
            }
        }
        if self.closing.borrow().is_some() {
            while spans.len() < MOST_AT_ONCE
                && let Ok(span) = waiting.try_recv()
            {
                spans.push(span);
            }
        }
        spans
    }

    /// Sends a message until it is taken, or there is no point in sending it again.
    async fn deliver(&mut self, client: &mut TraceServiceClient<Channel>, spans: Vec<Span>) {
        let count = spans.len() as u64;
        // Nobody waits at the end for a collector that is away, nor longer than said for one that is silent.
        let until = *self.closing.borrow();
        if until.is_some_and(|until| self.fails || Instant::now() >= until) {
            self.lost.fetch_add(count, Ordering::Relaxed);
            return;
        }
        let request = wire::request(&self.resource, spans, || self.ids.next());
        let (mut wait, keep_until) = (AGAIN[0], Instant::now() + KEEP);
        loop {
            let answer = tokio::time::timeout(PATIENCE, client.export(request.clone()));
            let (reason, is_final) = match self.before_the_end(true, answer).await {
                Some(Ok(Ok(answer))) => {
                    let refused = answer.into_inner().partial_success;
                    let refused = refused.map_or(0, |refused| refused.rejected_spans.max(0) as u64);
                    self.taken(refused.min(count));
                    return;
                }
                Some(Ok(Err(status))) => (reason(&status), !may_pass(status.code())),
                Some(Err(_)) => (format!("no answer within {PATIENCE:?}"), false),
                None => ("no answer before the end".to_owned(), true),
            };
            if !std::mem::replace(&mut self.fails, true) {
                tracing::warn!(
                    "spans do not reach {}: {reason}; they wait, and those that do not fit are lost",
                    self.url
                );
            }
            let over = is_final || Instant::now() + wait > keep_until;
            let over = over
                || self
                    .before_the_end(false, tokio::time::sleep(wait))
                    .await
                    .is_none();
            if over {
                self.lost.fetch_add(count, Ordering::Relaxed);
                return;
            }
            wait = (wait * 2).min(AGAIN[1]);
        }
    }

    /// Notes that a message was taken, but for some of its spans.
    fn taken(&mut self, refused: u64) {
        let lost = self.lost.fetch_add(refused, Ordering::Relaxed) + refused;
        let again = std::mem::replace(&mut self.fails, false);
        let (known, since) = self.told;
        let is_news = lost > known && since.is_none_or(|since| since.elapsed() > TELL_AGAIN);
        if again || is_news {
            let now = if again {
                "takes spans again"
            } else {
                "does not take all spans"
            };
            tracing::warn!("{} {now}; lost so far: {lost}", self.url);
            self.told = (lost, Some(Instant::now()));
        }
    }

    /// What comes of `work`; `None` when the program ends before. If it `may_delay` the end, it has the time
    /// that the end has.
    async fn before_the_end<T>(&self, may_delay: bool, work: impl Future<Output = T>) -> Option<T> {
        let mut closing = self.closing.clone();
        tokio::select! {
            done = work => Some(done),
            () = async {
                let until = ending(&mut closing).await;
                if may_delay {
                    tokio::time::sleep_until(until).await;
                }
            } => None,
        }
    }
}

/// Resolves once the program ends, with the moment until which it waits.
async fn ending(closing: &mut watch::Receiver<Option<Instant>>) -> Instant {
    let until = closing.wait_for(Option::is_some).await;
    // Fails when there is nobody any more who could send a span: the same.
    until
        .ok()
        .and_then(|until| *until)
        .unwrap_or_else(Instant::now)
}

/// Whether the same message may be taken later, as the specification of OTLP has it.
fn may_pass(code: Code) -> bool {
    matches!(
        code,
        Code::Cancelled
            | Code::DeadlineExceeded
            | Code::Aborted
            | Code::OutOfRange
            | Code::Unavailable
            | Code::DataLoss
            | Code::ResourceExhausted
            // A connection that broke.
            | Code::Unknown
    )
}

/// Why a message was not taken.
fn reason(status: &tonic::Status) -> String {
    let mut source = std::error::Error::source(status);
    let mut text = format!("{:?}: {}", status.code(), status.message());
    // The innermost says what the system says.
    while let Some(inner) = source {
        source = inner.source();
        if source.is_none() {
            text = format!("{text}: {inner}");
        }
    }
    text
}
