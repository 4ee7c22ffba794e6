//! The transport of spans to the collector. Spans wait in a bounded queue, and a thread sends them.
//!
//! Callers add spans to the queue without waiting. While the collector does not answer, the thread retries
//! with growing waits, and the queue fills. Spans that do not fit are dropped and counted. The log has a line
//! at the beginning and at the end of such an outage.

use std::fmt;
use std::future::Future;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use opentelemetry_proto::tonic::collector::trace::v1::trace_service_client::TraceServiceClient;
use opentelemetry_proto::tonic::resource::v1::Resource;
use sightline_proto::connection::Credentials;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};

use crate::ids::SpanId;
use crate::span::Span;
use crate::wire;

/// Maximum number of waiting spans. A span has a few hundred bytes.
const MOST_WAITING: usize = 1 << 14;
/// Maximum number of spans per message, which stays far below the 4 MB that collectors accept.
const MOST_AT_ONCE: usize = 512;
/// The time for which a span waits for other spans of the same message.
const LINGER: Duration = Duration::from_millis(500);
/// Timeout for the collector's answer to a message.
const PATIENCE: Duration = Duration::from_secs(5);
/// The minimum and the maximum wait before a message is sent again. The wait doubles after each attempt.
const AGAIN: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(10)];
/// The time for which a message is sent again. A restarting collector returns within this time, and a message
/// that the collector cannot accept does not block later messages.
const KEEP: Duration = Duration::from_secs(60);
/// The minimum time between two log lines about lost spans.
const TELL_AGAIN: Duration = Duration::from_secs(60);
/// Maximum time for which the end of the program waits for the collector.
const FAREWELL: Duration = Duration::from_secs(2);

/// The collector, and the process that sends spans.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The collector's address for OTLP over gRPC, such as `http://127.0.0.1:4317`.
    pub url: String,
    /// The trusted certificates, as PEM, one of which signed the collector's; `None` for the system's
    /// certificates.
    pub ca: Option<Vec<u8>>,
    /// The name of the service: the type of the process.
    pub service: &'static str,
    /// The name of the process among the processes of this service.
    pub instance: String,
}

/// An error that prevents the sending of spans.
#[derive(Debug, thiserror::Error)]
pub enum TracesError {
    /// The address of the collector is invalid.
    #[error(
        "{url} cannot be a collector's address: {reason}; give one such as http://127.0.0.1:4317"
    )]
    Address {
        /// The address, unless it contains a secret.
        url: String,
        /// The description of the fault.
        reason: String,
    },
    /// The system cannot start a thread, or returns no random numbers.
    #[error("traces cannot be sent: {0}")]
    System(String),
}

/// A sender of spans. Clones use the same collector. The default sender discards all spans.
#[derive(Clone, Default)]
pub struct Traces(Option<Arc<SenderHandle>>);

struct SenderHandle {
    queue: mpsc::Sender<Span>,
    lost: Arc<AtomicU64>,
    ids: IdGenerator,
    /// The time until which the end of the program waits for the collector; `None` before the program ends.
    closing: watch::Sender<Option<Instant>>,
    /// The receiver of the notice that the thread has ended.
    ended: Mutex<std::sync::mpsc::Receiver<()>>,
}

/// A generator of random ids, for spans whose ids no other process must know.
#[derive(Clone)]
struct IdGenerator(Arc<AtomicU64>);

impl IdGenerator {
    /// Returns the next id: SplitMix64 (Steele, Lea and Flood 2014, figure 16), started from a random number.
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
    /// Starts sending spans. The collector need not run yet.
    ///
    /// # Errors
    /// A [`TracesError`] if the address is invalid or the thread cannot be started.
    pub fn start(settings: Settings) -> Result<Self, TracesError> {
        let Settings {
            url,
            ca,
            service,
            instance,
        } = settings;
        if url.contains('@') {
            let reason = "the address must not contain a user or a password".to_owned();
            return Err(TracesError::Address {
                url: "the given address".to_owned(),
                reason,
            });
        }
        // Without the coordinator's token, which the collector must not receive.
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
        let ids = IdGenerator(Arc::new(AtomicU64::new(
            getrandom::u64().map_err(|e| system(&e))?,
        )));
        let lost = Arc::new(AtomicU64::new(0));
        let (queue, waiting) = mpsc::channel(MOST_WAITING);
        let (closing, closed) = watch::channel(None);
        let (say_ended, ended) = std::sync::mpsc::channel();
        let sender = SpanSender {
            url,
            resource: wire::resource(service, &instance),
            ids: ids.clone(),
            lost: Arc::clone(&lost),
            closing: closed,
            fails: false,
            reported: (0, None),
        };
        // A separate runtime, because spans are sent while the other runtimes of the process are busy, or
        // end.
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| system(&e))?;
        let thread = move || {
            runtime.block_on(sender.send_all(&endpoint, waiting));
            // A look-up of the collector's name may hang, so do not wait for it.
            runtime.shutdown_background();
            // The send fails if no thread waits for the end.
            let _ = say_ended.send(());
        };
        std::thread::Builder::new()
            .name("traces".to_owned())
            .spawn(thread)
            .map_err(|e| system(&e))?;
        let ended = Mutex::new(ended);
        Ok(Self(Some(Arc::new(SenderHandle {
            queue,
            lost,
            ids,
            closing,
            ended,
        }))))
    }

    /// Returns true if spans are sent.
    pub fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// Returns a new id for a span whose child spans end before the span. If traces are off, the id has no
    /// effect.
    pub fn fresh_id(&self) -> SpanId {
        self.0
            .as_ref()
            .map_or_else(|| SpanId::of_number(0), |handle| handle.ids.next())
    }

    /// Sends a span that has ended. Never waits: if the queue is full, the span is dropped and counted.
    pub fn send(&self, span: Span) {
        if let Some(handle) = &self.0
            && handle.queue.try_send(span).is_err()
        {
            handle.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Returns the number of spans that were lost.
    pub fn lost(&self) -> u64 {
        self.0
            .as_ref()
            .map_or(0, |handle| handle.lost.load(Ordering::Relaxed))
    }

    /// Returns a guard whose drop sends the waiting spans. If the collector does not answer, the drop takes
    /// at most 2.5 s.
    pub fn flush_guard(&self) -> FlushGuard {
        FlushGuard(self.clone())
    }

    fn close(&self) {
        let Some(handle) = &self.0 else { return };
        handle.closing.send_replace(Some(Instant::now() + FAREWELL));
        let ended = handle.ended.lock().unwrap_or_else(PoisonError::into_inner);
        // The thread ends within this time, or hangs in the system.
        let _ = ended.recv_timeout(FAREWELL + Duration::from_millis(500));
    }
}

/// A guard whose drop sends the waiting spans; see [`Traces::flush_guard`].
#[must_use]
pub struct FlushGuard(Traces);

impl Drop for FlushGuard {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// The state of the sending thread.
struct SpanSender {
    url: String,
    resource: Resource,
    ids: IdGenerator,
    lost: Arc<AtomicU64>,
    closing: watch::Receiver<Option<Instant>>,
    /// True if the collector did not accept the last message.
    fails: bool,
    /// The number of lost spans that the log reported last, and the time of that log line.
    reported: (u64, Option<Instant>),
}

impl SpanSender {
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
        if lost > self.reported.0 {
            tracing::warn!("{lost} spans have not reached {} and are lost", self.url);
        }
    }

    /// Returns the next spans, or an empty list at the end.
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

    /// Sends a message until the collector accepts it or a repetition is useless.
    async fn deliver(&mut self, client: &mut TraceServiceClient<Channel>, spans: Vec<Span>) {
        let count = spans.len() as u64;
        // At the end of the program, do not wait for a collector that fails, nor beyond the limit for a
        // silent one.
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
                    self.record_accepted(refused.min(count));
                    return;
                }
                Some(Ok(Err(status))) => (reason(&status), !may_pass(status.code())),
                Some(Err(_)) => (format!("no answer within {PATIENCE:?}"), false),
                None => ("no answer before the end".to_owned(), true),
            };
            if !std::mem::replace(&mut self.fails, true) {
                tracing::warn!(
                    "spans do not reach {}: {reason}; the spans are queued, and spans beyond \
                     the limit are lost",
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

    /// Records that the collector accepted a message, except for `refused` of its spans.
    fn record_accepted(&mut self, refused: u64) {
        let lost = self.lost.fetch_add(refused, Ordering::Relaxed) + refused;
        let again = std::mem::replace(&mut self.fails, false);
        let (known, since) = self.reported;
        let is_news = lost > known && since.is_none_or(|since| since.elapsed() > TELL_AGAIN);
        if again || is_news {
            let now = if again {
                "accepts spans again"
            } else {
                "does not accept all spans"
            };
            tracing::warn!("{} {now}; lost so far: {lost}", self.url);
            self.reported = (lost, Some(Instant::now()));
        }
    }

    /// Returns the result of `work`, or `None` if the program ends before `work` does.
    ///
    /// If `may_delay` is true, `work` may delay the end of the program until the time limit.
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

/// Waits until the program ends, and returns the time until which the end waits for the collector.
async fn ending(closing: &mut watch::Receiver<Option<Instant>>) -> Instant {
    let until = closing.wait_for(Option::is_some).await;
    // The wait fails if all senders of spans were dropped, which also means the end.
    until
        .ok()
        .and_then(|until| *until)
        .unwrap_or_else(Instant::now)
}

/// Returns true if the collector may accept the same message later, by the specification of OTLP.
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
            // A broken connection.
            | Code::Unknown
    )
}

/// Returns the reason why the collector did not accept a message.
fn reason(status: &tonic::Status) -> String {
    let mut source = std::error::Error::source(status);
    let mut text = format!("{:?}: {}", status.code(), status.message());
    // The innermost error contains the system's message.
    while let Some(inner) = source {
        source = inner.source();
        if source.is_none() {
            text = format!("{text}: {inner}");
        }
    }
    text
}
