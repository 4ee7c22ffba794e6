//! Tables for people: the job, its phases, and a line for each number of workers.

use crate::simulation::{Job, Outcome, PURPOSES, Settings, run};
use crate::trace::Trace;

fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

/// Simulates and prints.
pub fn print(
    trace: &Trace,
    job: &Job<'_>,
    workers: &[usize],
    settings: impl Fn(usize, bool) -> Settings,
) {
    let scene = job.scene;
    let sampling: u64 = job.tiles.iter().map(|t| t.alone()).sum();
    let assemble: u64 = job.tiles.iter().map(|t| t.assemble).sum();
    let whole = scene.load + scene.facts + sampling + assemble;
    println!(
        "{} cells in {} tiles, {} measured; one process with one thread: {:.2} s",
        trace.cells,
        job.tiles.len(),
        trace.blocks.len(),
        seconds(whole)
    );
    println!(
        "of that: load {:.2} s, facts {:.2} s, sampling {:.2} s, assembly {:.2} s; a worker parses {:.1} MB \
         in \
         {:.2} s",
        seconds(scene.load),
        seconds(scene.facts),
        seconds(sampling),
        seconds(assemble),
        scene.bytes as f64 / 1e6,
        seconds(scene.parse)
    );
    blocks(trace);
    println!();
    println!(
        "| workers | whole job | efficiency | sampling | efficiency | items | repeated | lists | serial | \
         coding | scene | waiting | MB through the coordinator | bytes a cell |"
    );
    println!("|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|");
    for &count in workers {
        let simulate = |is_warm| run(job, settings(count, is_warm));
        let (cold, warm) = (simulate(false), simulate(true));
        line(count, (&cold, whole), (&warm, sampling), trace.cells);
    }
}

/// A line of the table. The parts are those of the whole job.
fn line(workers: usize, cold: (&Outcome, u64), warm: (&Outcome, u64), cells: u64) {
    let efficiency = |time: u64, work: u64| 100.0 * work as f64 / (workers as f64 * time as f64);
    let (job, sampling) = (cold.0, warm.0);
    // As parts of what the workers' cores could do in the sampling of a known scene.
    let all = workers as f64 * sampling.sampled as f64;
    let part = |ns: u64| 100.0 * ns as f64 / all;
    let [scene, serial, lists, items, coding] = sampling.spent;
    let busy: u64 = sampling.spent.iter().sum();
    println!(
        "| {workers} | {:.2} s | {:.0} % | {:.2} s | {:.0} % | {:.0} % | {:.0} % | {:.0} % | \
         {:.0} % | {:.0} % | \
         {:.0} % | {:.0} % | {:.1} | {:.0} |",
        seconds(job.wall),
        efficiency(job.wall, cold.1),
        seconds(sampling.sampled),
        efficiency(sampling.sampled, warm.1),
        part(items - sampling.repeated),
        part(sampling.repeated),
        part(lists),
        part(serial),
        part(coding),
        part(scene),
        100.0 - part(busy),
        job.bytes as f64 / 1e6,
        job.bytes as f64 / cells as f64
    );
    const { assert!(PURPOSES == 5, "a column for each purpose") };
}

/// What every member does, and the longest items: no number of workers is faster.
fn blocks(trace: &Trace) {
    for (number, block) in trace.blocks.iter().enumerate() {
        let phases = &block.phases;
        let sum = |of: fn(&crate::trace::PhaseTrace) -> u64| phases.iter().map(of).sum::<u64>();
        let longest = sum(|p| p.items.iter().map(|i| i.compute).max().unwrap_or(0));
        let gaps = block.begin + block.end + sum(|p| p.gap);
        println!(
            "tile {number}: {} phases, {} items, {:.2} s of items; every member: {:.2} s of table and \
             barriers, \
             {:.2} s of lists; outcomes {:.2} MB, encoded in {:.2} s, added in {:.2} s; longest items of the \
             phases {:.2} s; output {:.2} MB",
            phases.len(),
            phases.iter().map(|p| p.items.len()).sum::<usize>(),
            seconds(sum(|p| p.work())),
            seconds(gaps),
            seconds(sum(|p| p.prepare)),
            sum(|p| p.outcome) as f64 / 1e6,
            seconds(sum(|p| p.encode)),
            seconds(sum(|p| p.add)),
            seconds(longest),
            block.output as f64 / 1e6
        );
    }
}
