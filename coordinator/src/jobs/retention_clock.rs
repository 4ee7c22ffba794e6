//! The clock of retention, which decides which recorded times are certainly older than an age.
//!
//! An *age* is the duration after which retention deletes data, such as `--keep` ([`Ages`]). A step of the
//! wall clock does not affect the decision.
//!
//! Ends of jobs and blobs have times of the wall clock, which can step by years. Two other measures check the
//! wall clock: the monotonic clock of this process, and the *run time*. The run time is the monotonic time
//! for which coordinators have run on the store. The store contains the run time in a stamp
//! ([`RetentionStamp`]), with the wall clock of the same moment.
//!
//! A *trusted span* is a span of run time up to now in which the wall clock and the monotonic clock agree. A
//! step of the wall clock starts another span. Only the wall clock measures downtime, so downtime is added to
//! the *doubt* of the span. If a span has too much doubt, the *next* span starts. The next span replaces the
//! first span as soon as the next span is as long as the age. A time is old ([`Age::Old`]) if both conditions
//! hold:
//!
//! - The trusted span is as long as the age. So any record from before the span is older than the age,
//!   regardless of its time.
//! - The wall clock has advanced since the record by the age, the doubt, and twice the largest disagreement
//!   in this process. So a record from inside the span is older than the age, too.
//!
//! A time in the future is from before the span if neither doubt nor a lost stamp explains it. After the last
//! step, retention is late by at most `longest_delay` of run time.

use std::collections::BTreeMap;
use std::time::Duration;

use sightline_records::ids::Digest;
use sightline_records::{NextSpan, RetentionStamp, TrustedSpan};

use crate::clock::Moment;

/// Maximum tolerated disagreement of a process's two clocks, in milliseconds. A well-running time daemon
/// corrects less at once, and one minute does not delay deletions noticeably.
const MAX_DRIFT_MS: u64 = 60_000;
/// Minimum tolerated disagreement, in milliseconds, because the two clocks are read one after the other.
const MIN_DRIFT_MS: u64 = 1000;
/// Maximum time between two stamps, in milliseconds.
const STAMP_MS: u64 = 5 * 60_000;
/// Minimum time between two stamps, in milliseconds.
const MIN_STAMP_MS: u64 = 1000;
/// The time after which a stamp that was not recorded is tried again, in milliseconds.
const RETRY_MS: u64 = 10_000;
/// Maximum run time after a stamp in which ends of jobs are recorded, in milliseconds.
const MAX_UNSTAMPED_MS: u64 = 2 * STAMP_MS;

/// The use of a trusted span.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum SpanUse {
    /// The ages of ended jobs, and of scenes without jobs.
    Jobs,
    /// The ages of unreferenced blobs.
    Blobs,
}

/// The ages at which retention deletes data. `None` disables the deletion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Ages {
    /// The age of ended jobs and of scenes.
    pub(crate) jobs: Option<Duration>,
    /// The age of blobs.
    pub(crate) blobs: Option<Duration>,
}

/// The age of a recorded time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Age {
    /// An age that cannot be determined yet, because the trusted span is too short.
    Unknown,
    /// An age that may be lower than the limit.
    Young,
    /// An age that exceeds the limit.
    Old,
    /// A time in the future. A record of this coordinator with such a time is older than the limit. The time
    /// of another machine, such as a bucket's, may be wrong by more.
    Future,
}

/// A pause or a delay of deletions, for the log and for users.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Pause {
    /// The use of the span whose deletions pause.
    pub(crate) span_use: SpanUse,
    /// The advance of the wall clock compared with the monotonic clock, or with the last stamp, in
    /// milliseconds.
    pub(crate) jump_ms: i64,
    /// True if no coordinator ran during the advance, which may be downtime. Then deletions are late by the
    /// same time, and do not pause.
    pub(crate) at_start: bool,
    /// The time for which coordinators must still run until the pause or the delay of deletions ends, in
    /// milliseconds.
    pub(crate) lasts_ms: u64,
}

/// A difference between the wall clock and the other clocks.
#[derive(Clone, Copy, Debug)]
struct Jump {
    /// The difference in milliseconds, positive if the wall clock is ahead.
    by_ms: i64,
    /// True if the difference appeared at the start of a coordinator.
    at_start: bool,
}

/// The two clocks at one moment, in milliseconds.
#[derive(Clone, Copy, Debug, Default)]
struct Reading {
    wall_ms: u64,
    /// The run time, in milliseconds.
    ran_ms: u64,
}

/// A trusted span in this process.
#[derive(Clone, Copy, Debug)]
struct Span {
    stored: TrustedSpan,
    /// The reading that later readings are compared with.
    base: Reading,
    /// The largest disagreement of the clocks since `base`, in milliseconds.
    drift_ms: u64,
    /// The last report, which still holds.
    reported: Reported,
}

/// A report about the deletions, in ascending order of severity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Reported {
    Nothing,
    Delay,
    Pause,
}

/// The clock of retention in a running coordinator.
#[derive(Debug)]
pub(crate) struct RetentionClock {
    started: Moment,
    ran_before_ms: u64,
    jobs: Span,
    blobs: Span,
    pauses: Vec<Pause>,
    /// The run time of the last recorded stamp, in milliseconds. `None` while a change of a span is not
    /// recorded.
    stamped_ms: Option<u64>,
    /// The run time of the last stamp that the store did not record, in milliseconds.
    failed_ms: Option<u64>,
}

impl RetentionClock {
    /// Starts from the last stamp of a store. The caller records [`Self::stamp`] before any other change.
    pub(crate) fn new(last: Option<RetentionStamp>, ages: Ages, now: Moment) -> Self {
        let last_stamp = last.unwrap_or_default();
        let base = Reading {
            wall_ms: now.unix_ms,
            ran_ms: last_stamp.ran_ms,
        };
        let span = |stored| Span {
            stored,
            base,
            drift_ms: 0,
            reported: Reported::Nothing,
        };
        let (jobs, blobs) = (span(last_stamp.jobs), span(last_stamp.blobs));
        let ran_before_ms = base.ran_ms;
        let mut this = Self {
            started: now,
            ran_before_ms,
            jobs,
            blobs,
            pauses: Vec::new(),
            stamped_ms: None,
            failed_ms: None,
        };
        if let Some(last) = last {
            let gap = difference(now.unix_ms, last.wall_ms);
            this.jobs
                .add_gap(gap, SpanUse::Jobs, ages.jobs, &mut this.pauses);
            this.blobs
                .add_gap(gap, SpanUse::Blobs, ages.blobs, &mut this.pauses);
        }
        this
    }

    /// Compares the clocks at `now`. The caller has to observe each time before it writes the time to a
    /// record.
    pub(crate) fn observe(&mut self, now: Moment, ages: Ages) {
        let reading = self.reading(now);
        for (span_use, age) in [(SpanUse::Jobs, ages.jobs), (SpanUse::Blobs, ages.blobs)] {
            let span = match span_use {
                SpanUse::Jobs => &mut self.jobs,
                SpanUse::Blobs => &mut self.blobs,
            };
            if span.observe(reading, span_use, age, &mut self.pauses) {
                self.stamped_ms = None;
            }
        }
    }

    /// Compares a recorded time of the wall clock with the limit `age`.
    pub(crate) fn age(
        &self,
        span_use: SpanUse,
        recorded_ms: u64,
        age: Duration,
        now: Moment,
    ) -> Age {
        let (span, now, age) = (self.span(span_use), self.reading(now), milliseconds(age));
        if now.ran_ms.saturating_sub(span.stored.begun_ms) < age {
            return Age::Unknown;
        }
        let slack = span.doubt();
        // The process that wrote the record may have run for a while after its last stamp.
        if recorded_ms
            > now
                .wall_ms
                .saturating_add(slack)
                .saturating_add(MAX_UNSTAMPED_MS)
        {
            Age::Future
        } else if now.wall_ms.saturating_sub(recorded_ms) >= age.saturating_add(slack) {
            Age::Old
        } else {
            Age::Young
        }
    }

    /// Returns the run time, in milliseconds.
    pub(crate) fn ran_ms(&self, now: Moment) -> u64 {
        self.reading(now).ran_ms
    }

    /// Returns true if a stamp has to be recorded before the next end of a job. This is so if a change of a
    /// span is not in the store yet, or the last stamp is too old.
    pub(crate) fn is_unrecorded(&self, now: Moment) -> bool {
        let ran = self.ran_ms(now);
        self.stamped_ms
            .is_none_or(|at| ran.saturating_sub(at) >= MAX_UNSTAMPED_MS)
    }

    /// Returns true if a stamp is due.
    pub(crate) fn is_due(&self, now: Moment, ages: Ages) -> bool {
        let shortest = ages
            .jobs
            .into_iter()
            .chain(ages.blobs)
            .map(milliseconds)
            .min()
            .unwrap_or(u64::MAX);
        let every = (shortest / 32).clamp(MIN_STAMP_MS, STAMP_MS);
        let ran = self.ran_ms(now);
        let waits = self
            .failed_ms
            .is_some_and(|at| ran.saturating_sub(at) < RETRY_MS);
        !waits
            && self
                .stamped_ms
                .is_none_or(|at| ran.saturating_sub(at) >= every)
    }

    /// Records that the store did not record a stamp.
    pub(crate) fn failed(&mut self, now: Moment) {
        self.failed_ms = Some(self.ran_ms(now));
    }

    /// Returns the stamp for the store to record.
    pub(crate) fn stamp(&self, now: Moment) -> RetentionStamp {
        let Reading { wall_ms, ran_ms } = self.reading(now);
        let stored = |span: &Span| {
            let next = |next: NextSpan| NextSpan {
                doubt_ms: span.with_drift(next.doubt_ms),
                ..next
            };
            TrustedSpan {
                doubt_ms: span.doubt(),
                next: span.stored.next.map(next),
                ..span.stored
            }
        };
        RetentionStamp {
            wall_ms,
            ran_ms,
            jobs: stored(&self.jobs),
            blobs: stored(&self.blobs),
        }
    }

    /// Records that the store has recorded this stamp.
    pub(crate) fn recorded(&mut self, stamp: &RetentionStamp) {
        // A step after the stamp is part of a later stamp.
        let begun = |span: &TrustedSpan| (span.begun_ms, span.next.map(|next| next.begun_ms));
        let is_same = |span: &Span, stamped: &TrustedSpan| begun(&span.stored) == begun(stamped);
        if is_same(&self.jobs, &stamp.jobs) && is_same(&self.blobs, &stamp.blobs) {
            self.stamped_ms = Some(stamp.ran_ms);
            self.failed_ms = None;
        }
    }

    /// Removes and returns the pauses that started since the last call.
    pub(crate) fn take_pauses(&mut self) -> Vec<Pause> {
        std::mem::take(&mut self.pauses)
    }

    fn span(&self, span_use: SpanUse) -> &Span {
        match span_use {
            SpanUse::Jobs => &self.jobs,
            SpanUse::Blobs => &self.blobs,
        }
    }

    fn reading(&self, now: Moment) -> Reading {
        let since = milliseconds(now.at.saturating_duration_since(self.started.at));
        Reading {
            wall_ms: now.unix_ms,
            ran_ms: self.ran_before_ms.saturating_add(since),
        }
    }
}

impl Span {
    /// Returns the disagreement that ages have to allow for, in milliseconds. Each record and the current
    /// time can be wrong by the largest disagreement in this process.
    fn doubt(&self) -> u64 {
        self.with_drift(self.stored.doubt_ms)
    }

    fn with_drift(&self, doubt_ms: u64) -> u64 {
        doubt_ms.saturating_add(self.drift_ms.saturating_mul(2))
    }

    /// Adds the difference between the wall clock at a start and the last stamp to the doubt.
    fn add_gap(
        &mut self,
        gap_ms: i64,
        span_use: SpanUse,
        age: Option<Duration>,
        pauses: &mut Vec<Pause>,
    ) {
        // The clocks of the previous process may have disagreed by the maximum after its last stamp.
        let doubt = gap_ms.unsigned_abs().saturating_add(max_drift(age));
        self.stored.doubt_ms = self.stored.doubt_ms.saturating_add(doubt);
        match (&mut self.stored.next, age) {
            (Some(next), _) => next.doubt_ms = next.doubt_ms.saturating_add(doubt),
            (next, Some(age)) if self.stored.doubt_ms > max_doubt(age) => {
                *next = Some(NextSpan {
                    begun_ms: self.base.ran_ms,
                    doubt_ms: 0,
                });
                let jump = Jump {
                    by_ms: gap_ms,
                    at_start: true,
                };
                self.report(jump, span_use, age, pauses);
            }
            (None, _) => {}
        }
    }

    /// Replaces the span by its next span if the next span is as long as the age. Returns true if it was
    /// replaced.
    fn advance(&mut self, ran_ms: u64, age: Option<Duration>) -> bool {
        let (Some(next), Some(age)) = (self.stored.next, age) else {
            return false;
        };
        if ran_ms.saturating_sub(next.begun_ms) < milliseconds(age) {
            return false;
        }
        let NextSpan { begun_ms, doubt_ms } = next;
        let has_doubt = self.with_drift(doubt_ms) > max_doubt(age);
        let next = has_doubt.then_some(NextSpan {
            begun_ms: ran_ms,
            doubt_ms: 0,
        });
        self.stored = TrustedSpan {
            begun_ms,
            doubt_ms,
            next,
        };
        true
    }

    /// Compares the clocks at `now`. Returns true if another span starts.
    fn observe(
        &mut self,
        now: Reading,
        span_use: SpanUse,
        age: Option<Duration>,
        pauses: &mut Vec<Pause>,
    ) -> bool {
        let wall = difference(now.wall_ms, self.base.wall_ms);
        let drift = wall.saturating_sub_unsigned(now.ran_ms.saturating_sub(self.base.ran_ms));
        let begins = drift.unsigned_abs() > max_drift(age);
        if begins {
            let jump = Jump {
                by_ms: drift,
                at_start: false,
            };
            self.restart(now, jump, span_use, age, pauses);
        } else {
            self.drift_ms = self.drift_ms.max(drift.unsigned_abs());
        }
        let is_replaced = self.advance(now.ran_ms, age);
        let length = now.ran_ms.saturating_sub(self.stored.begun_ms);
        let is_paused = age.is_some_and(|age| length < milliseconds(age));
        let most = match (is_paused, self.stored.next) {
            (true, _) => Reported::Pause,
            (false, Some(_)) => Reported::Delay,
            (false, None) => Reported::Nothing,
        };
        self.reported = self.reported.min(most);
        begins || is_replaced
    }

    fn restart(
        &mut self,
        now: Reading,
        jump: Jump,
        span_use: SpanUse,
        age: Option<Duration>,
        pauses: &mut Vec<Pause>,
    ) {
        let stored = TrustedSpan {
            begun_ms: now.ran_ms,
            ..TrustedSpan::default()
        };
        *self = Self {
            stored,
            base: now,
            drift_ms: 0,
            ..*self
        };
        match age {
            Some(age) => self.report(jump, span_use, age, pauses),
            None => self.reported = Reported::Nothing,
        }
    }

    /// Reports a pause or a delay, unless a report of the same severity still holds. A clock can step every
    /// minute, so reports have to be limited.
    fn report(&mut self, jump: Jump, span_use: SpanUse, age: Duration, pauses: &mut Vec<Pause>) {
        let Jump {
            by_ms: jump_ms,
            at_start,
        } = jump;
        let report = if at_start {
            Reported::Delay
        } else {
            Reported::Pause
        };
        if self.reported < report {
            self.reported = report;
            pauses.push(Pause {
                span_use,
                jump_ms,
                at_start,
                lasts_ms: milliseconds(age),
            });
        }
    }
}

/// The blobs with times in the future. Each has the run time of the first look at it, and the pass of the
/// last look.
#[derive(Debug, Default)]
pub(crate) struct FutureBlobs {
    looks: BTreeMap<(SpanUse, Digest), (u64, u64)>,
    pass: u64,
}

impl FutureBlobs {
    /// Returns true if the first look at the blob was longer ago than `age`.
    pub(crate) fn is_old(
        &mut self,
        span_use: SpanUse,
        blob: Digest,
        age: Duration,
        ran_ms: u64,
    ) -> bool {
        let (first, pass) = self.looks.entry((span_use, blob)).or_insert((ran_ms, 0));
        *pass = self.pass;
        ran_ms.saturating_sub(*first) >= milliseconds(age)
    }

    /// Ends a pass over all blobs, and removes the blobs that this pass did not look at.
    pub(crate) fn end_pass(&mut self) {
        let current = self.pass;
        self.looks.retain(|_, (_, pass)| *pass == current);
        self.pass = current.wrapping_add(1);
    }
}

/// Returns the maximum tolerated disagreement of a process's two clocks for an age, in milliseconds.
fn max_drift(age: Option<Duration>) -> u64 {
    age.map_or(MAX_DRIFT_MS, |age| {
        (milliseconds(age) / 16).clamp(MIN_DRIFT_MS, MAX_DRIFT_MS)
    })
}

/// Returns the maximum doubt of a trusted span for an age, in milliseconds: an eighth of the age.
fn max_doubt(age: Duration) -> u64 {
    milliseconds(age) / 8
}

/// Returns the longest run time until a record counts as old, without a further step and without a restart.
/// The sum contains the age for the span, the age and its doubt for the record, and the doubt for a time in
/// the future.
#[cfg(test)]
fn longest_delay(age: Duration) -> Duration {
    age * 5 / 2 + Duration::from_millis(4 * MAX_DRIFT_MS + MAX_UNSTAMPED_MS)
}

fn milliseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}

/// Returns `a - b`, limited to the range of `i64`.
fn difference(a: u64, b: u64) -> i64 {
    i64::try_from(i128::from(a) - i128::from(b)).unwrap_or(if a > b { i64::MAX } else { i64::MIN })
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use proptest::prelude::*;

    use super::*;

    const HOUR: u64 = 3_600_000;
    const YEARS: i64 = 10 * 365 * 24 * HOUR as i64;
    /// The wall clock at the start, in milliseconds since 1970: a time in 2023.
    const START: u64 = 1_700_000_000_000;

    /// A simulated coordinator with its store and the true time.
    struct World {
        origin: Instant,
        true_ms: u64,
        /// The error of the wall clock, in milliseconds.
        error_ms: i64,
        age: Duration,
        clock: RetentionClock,
        stored: RetentionStamp,
        /// The recorded and the true times of the ends of jobs, in milliseconds.
        ends: Vec<(u64, u64)>,
    }

    impl World {
        fn new(age: Duration) -> Self {
            let ages = Ages {
                jobs: Some(age),
                blobs: None,
            };
            let origin = Instant::now();
            let clock = RetentionClock::new(
                None,
                ages,
                Moment {
                    at: origin,
                    unix_ms: START,
                },
            );
            let stored = RetentionStamp::default();
            let mut this = Self {
                origin,
                true_ms: 0,
                error_ms: 0,
                age,
                clock,
                stored,
                ends: Vec::new(),
            };
            this.record();
            this
        }

        fn ages(&self) -> Ages {
            Ages {
                jobs: Some(self.age),
                blobs: None,
            }
        }

        fn now(&mut self) -> Moment {
            let at = self.origin + Duration::from_millis(self.true_ms);
            let now = Moment {
                at,
                unix_ms: (START + self.true_ms).saturating_add_signed(self.error_ms),
            };
            let ages = self.ages();
            self.clock.observe(now, ages);
            now
        }

        fn record(&mut self) {
            let now = self.now();
            self.stored = self.clock.stamp(now);
            self.clock.recorded(&self.stored);
        }

        fn tick(&mut self) {
            let (now, ages) = (self.now(), self.ages());
            if self.clock.is_due(now, ages) {
                self.record();
            }
        }

        /// Ends a job now.
        fn end(&mut self) {
            let now = self.now();
            if self.clock.is_unrecorded(now) {
                self.record();
            }
            self.ends.push((now.unix_ms, self.true_ms));
        }

        /// Starts another process on the store.
        fn restart(&mut self, downtime_ms: u64) {
            self.true_ms += downtime_ms;
            let at = self.origin + Duration::from_millis(self.true_ms);
            let unix_ms = (START + self.true_ms).saturating_add_signed(self.error_ms);
            self.clock =
                RetentionClock::new(Some(self.stored), self.ages(), Moment { at, unix_ms });
            self.record();
        }

        /// Deletes old jobs. Returns the smallest true age of a deleted job.
        fn pass(&mut self) -> Option<Duration> {
            let (now, age, true_ms) = (self.now(), self.age, self.true_ms);
            let mut youngest = None;
            let clock = &self.clock;
            self.ends.retain(|&(recorded, ended)| {
                let stays = matches!(
                    clock.age(SpanUse::Jobs, recorded, age, now),
                    Age::Unknown | Age::Young
                );
                if !stays {
                    let age = Duration::from_millis(true_ms - ended);
                    youngest = Some(youngest.map_or(age, |youngest: Duration| youngest.min(age)));
                }
                stays
            });
            youngest
        }

        /// Runs for `ms` milliseconds in 64 steps, and deletes old jobs after each. Returns the smallest true
        /// age of a deleted job.
        fn run(&mut self, ms: u64) -> Option<Duration> {
            let mut youngest = None;
            for step in 0..64 {
                self.true_ms += (ms * (step + 1) / 64) - (ms * step / 64);
                self.tick();
                youngest = youngest.into_iter().chain(self.pass()).min();
            }
            youngest
        }
    }

    fn day() -> Duration {
        Duration::from_millis(24 * HOUR)
    }

    #[test]
    fn job_is_deleted_soon_after_reaching_age() {
        let mut world = World::new(day());
        world.run(100 * HOUR);
        world.end();
        assert_eq!(world.run(24 * HOUR - 64), None);
        assert_eq!(
            world.run(64 * 2000),
            Some(day() + Duration::from_millis(2000 - 64))
        );
    }

    #[test]
    fn step_of_wall_clock_pauses_deletion_and_is_reported_once() {
        for step in [-YEARS, -2 * 24 * HOUR as i64, 2 * 24 * HOUR as i64, YEARS] {
            let mut world = World::new(day());
            world.run(30 * HOUR);
            world.end();
            world.true_ms += 1000;
            world.error_ms = step;
            assert_eq!(world.pass(), None);
            let lasts_ms = 24 * HOUR;
            let pause = Pause {
                span_use: SpanUse::Jobs,
                jump_ms: step,
                at_start: false,
                lasts_ms,
            };
            assert_eq!(world.clock.take_pauses(), [pause]);
            // The coordinator does not report a second step during the pause.
            world.error_ms = 0;
            assert_eq!(world.run(23 * HOUR), None);
            assert_eq!(world.clock.take_pauses(), []);
            assert!(world.run(3 * HOUR) >= Some(day()));
            assert!(world.ends.is_empty());
        }
    }

    #[test]
    fn restart_with_stepped_clock_pauses_deletion() {
        for step in [-YEARS, -4 * HOUR as i64, 4 * HOUR as i64, YEARS] {
            let mut world = World::new(day());
            world.run(30 * HOUR);
            world.end();
            world.error_ms = step;
            world.restart(1000);
            let pauses = world.clock.take_pauses();
            assert!(
                matches!(pauses[..], [Pause { at_start: true, .. }]),
                "{pauses:?}"
            );
            assert_eq!(world.run(24 * HOUR - 64), None);
            world.run(2 * u64::try_from(longest_delay(day()).as_millis()).unwrap());
            assert!(world.ends.is_empty());
        }
    }

    #[test]
    fn short_downtime_adds_doubt_and_does_not_pause() {
        let mut world = World::new(day());
        world.run(30 * HOUR);
        world.end();
        let stamped = world.stored.wall_ms;
        world.restart(HOUR);
        assert_eq!(world.clock.take_pauses(), []);
        let doubt = world.stored.wall_ms - stamped + MAX_DRIFT_MS;
        assert_eq!(world.stored.jobs.doubt_ms, doubt);
        assert_eq!(world.run(23 * HOUR + doubt - 64), None);
        assert!(world.run(64).is_some());
    }

    #[test]
    fn coordinator_that_runs_a_part_of_each_day_deletes() {
        let mut world = World::new(day());
        world.end();
        let mut youngest = None;
        for _ in 0..4 {
            assert!(youngest.is_none());
            youngest = world.run(8 * HOUR);
            world.restart(16 * HOUR);
        }
        assert!(youngest >= Some(day()) && world.ends.is_empty());
        // The coordinator reports the pause when it starts and not at each restart.
        assert_eq!(world.clock.take_pauses(), []);
        // The ages of later records are unknown, too.
        world.end();
        for _ in 0..9 {
            youngest = world.run(8 * HOUR).or(youngest);
            world.restart(16 * HOUR);
        }
        assert!(youngest >= Some(day()) && world.ends.is_empty());
    }

    #[test]
    fn small_disagreements_never_shorten_an_age() {
        let mut world = World::new(day());
        world.run(30 * HOUR);
        world.error_ms = -30_000;
        world.end();
        world.error_ms = 30_000;
        assert_eq!(world.run(24 * HOUR - 1), None);
        assert_eq!(world.run(64), Some(day()));
        assert_eq!(world.clock.take_pauses(), []);
    }

    #[test]
    fn step_before_crash_is_known_after_restart() {
        let mut world = World::new(day());
        world.run(30 * HOUR);
        // The wall clock is wrong only at the end of the job, and the process ends immediately afterwards.
        world.error_ms = -YEARS;
        world.end();
        world.error_ms = 0;
        world.restart(1000);
        assert_eq!(world.run(23 * HOUR), None);
    }

    #[test]
    fn end_soon_after_stamp_is_not_from_the_future() {
        let mut world = World::new(day());
        world.run(30 * HOUR);
        world.record();
        world.true_ms += STAMP_MS;
        world.end();
        // The wall clock goes back by the time between the stamp and the end.
        world.error_ms -= STAMP_MS as i64;
        world.restart(0);
        assert_eq!(world.pass(), None);
    }

    #[test]
    fn first_start_waits_for_full_age() {
        let mut world = World::new(day());
        world.ends.push((START - 2 * YEARS as u64, 0));
        assert_eq!(world.run(24 * HOUR - 64), None);
        assert!(world.run(64).is_some());
        assert_eq!(world.clock.take_pauses(), []);
    }

    #[test]
    fn future_blob_ages_from_first_look() {
        let mut blobs = FutureBlobs::default();
        assert!(!blobs.is_old(SpanUse::Blobs, [1; 32], day(), 5));
        blobs.end_pass();
        assert!(!blobs.is_old(SpanUse::Blobs, [1; 32], day(), 4 + 24 * HOUR));
        assert!(blobs.is_old(SpanUse::Blobs, [1; 32], day(), 5 + 24 * HOUR));
        blobs.end_pass();
        // This pass does not look at the blob, because the blob no longer exists.
        blobs.end_pass();
        assert!(blobs.looks.is_empty());
    }

    #[derive(Clone, Debug)]
    enum Act {
        Run(u64),
        Step(i64),
        Tick,
        End,
        Pass,
        Restart(u64),
    }

    /// Returns a strategy for actions in units of a 64th of the age.
    fn act() -> impl Strategy<Value = Act> {
        let step = prop_oneof![
            -3..4i64,
            -40..40i64,
            Just(-YEARS),
            Just(YEARS),
            -YEARS..YEARS
        ];
        prop_oneof![
            4 => (0..80u64).prop_map(Act::Run),
            2 => step.prop_map(Act::Step),
            3 => Just(Act::Tick),
            4 => Just(Act::End),
            4 => Just(Act::Pass),
            1 => (0..20u64).prop_map(Act::Restart),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

        #[test]
        fn only_old_jobs_are_deleted_and_without_excess_delay(
            age_ms in prop_oneof![Just(60_000), Just(HOUR), Just(24 * HOUR), Just(720 * HOUR)],
            acts in proptest::collection::vec((act(), 0..60_000i64), 1..60),
        ) {
            let age = Duration::from_millis(age_ms);
            let mut world = World::new(age);
            let unit = age_ms / 64;
            for (act, fine) in acts {
                match act {
                    Act::Run(units) => world.true_ms += units * unit + fine as u64,
                    // Steps of years are taken as they are. Smaller steps are in units, or finer.
                    Act::Step(units) if units.abs() < 50 => world.error_ms += units * (fine + 1),
                    Act::Step(ms) => world.error_ms = ms,
                    Act::Tick => world.tick(),
                    Act::End => world.end(),
                    Act::Pass => {
                        let youngest = world.pass();
                        prop_assert!(youngest.is_none_or(|youngest| youngest >= age), "{youngest:?}");
                    }
                    Act::Restart(units) => world.restart(units * unit + fine as u64),
                }
            }
            let bound = u64::try_from(longest_delay(age).as_millis()).unwrap();
            let youngest = world.run(bound + 64);
            prop_assert!(youngest.is_none_or(|youngest| youngest >= age), "{youngest:?}");
            prop_assert!(world.ends.is_empty(), "{:?} are left", world.ends);
        }
    }
}
