//! Tests of sending spans while the collector does not answer.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which may")]

use std::time::{Duration, Instant};

use sightline_tests::{Collector, wait_for};
use sightline_traces::{Settings, Span, SpanTime, TraceId, Traces};

fn traces(url: &str) -> Traces {
    let settings = Settings {
        url: url.to_owned(),
        ca: None,
        service: "test",
        instance: "one".to_owned(),
    };
    Traces::start(settings).unwrap()
}

fn span(number: u64) -> Span {
    let trace = TraceId::of_job(&[7; 32], 1, 2);
    let span = Span::new(trace, "wait", SpanTime::now()).below(trace.job());
    span.number("sightline.tile", number)
        .name("sightline.worker", "ada")
        .end()
}

#[test]
fn spans_wait_for_late_collector() {
    let address = Collector::new().address().to_owned();
    let traces = traces(&format!("http://{address}"));
    let guard = traces.flush_guard();
    (0..1000).for_each(|number| traces.send(span(number)));
    std::thread::sleep(Duration::from_millis(300));
    let collector = Collector::at(&address);
    wait_for("all spans", || {
        (collector.taken().len() == 1000).then_some(())
    });
    traces.send(span(1000));
    drop(guard);
    let mut tiles: Vec<u64> = collector
        .taken()
        .iter()
        .map(|span| span.attributes["sightline.tile"].parse().unwrap())
        .collect();
    tiles.sort_unstable();
    assert_eq!(tiles, (0..=1000).collect::<Vec<_>>());
    assert_eq!(traces.lost(), 0);
}

#[test]
fn full_queue_counts_lost_spans_without_waiting() {
    let silent = Collector::silent();
    let traces = traces(silent.url());
    let guard = traces.flush_guard();
    let began = Instant::now();
    (0..100_000).for_each(|number| traces.send(span(number)));
    assert!(
        began.elapsed() < Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
    assert!(traces.lost() >= 100_000 - 20_000, "{}", traces.lost());
    let began = Instant::now();
    drop(guard);
    assert!(
        began.elapsed() < Duration::from_secs(4),
        "{:?}",
        began.elapsed()
    );
    assert_eq!(traces.lost(), 100_000, "none has reached anybody");
}

#[test]
fn end_does_not_wait_for_missing_collector() {
    let traces = traces(Collector::new().url());
    let guard = traces.flush_guard();
    (0..10).for_each(|number| traces.send(span(number)));
    let began = Instant::now();
    drop(guard);
    assert!(
        began.elapsed() < Duration::from_millis(1500),
        "{:?}",
        began.elapsed()
    );
    assert_eq!(traces.lost(), 10);
}
