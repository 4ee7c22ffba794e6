//! A crew in virtual time: workers that run the real queue of items, a coordinator, and a network between
//! them. A run is a function of the trace and the settings.
//!
//! Simulated are the orders of `coordinator/src/scheduler/crews.rs` (a worker without a tile helps the crew
//! with the fewest helpers) and the programs of `crates/sampling/src/crew/` (`Leader`, `Helper`) with one
//! thread each. Left out are second leases, lost workers, and the processor time of sending: streams are
//! taken to cost a worker nothing beside encoding and decoding.

mod coordinator;
mod helper;
mod leader;
mod network;
mod parts;
mod processors;
mod world;

pub use self::network::Network;
pub use self::parts::PURPOSES;
pub use self::world::{Job, Outcome, Settings, run};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::{BlockTrace, ItemTrace, PhaseTrace, SceneTrace};

    const SECOND: u64 = 1_000_000_000;

    fn block(phases: usize) -> BlockTrace {
        let item = ItemTrace {
            compute: SECOND / 100,
            take: 0,
            bytes: 100,
            add: 0,
        };
        let phase = PhaseTrace {
            prepare: 0,
            costs: vec![1; 400],
            items: vec![item; 400],
            encode: 0,
            outcome: 20_000,
            add: 0,
            gap: SECOND / 10,
        };
        BlockTrace {
            cells: 1,
            begin: 0,
            phases: vec![phase; phases],
            end: 0,
            output: 1,
            assemble: 0,
        }
    }

    fn simulate(blocks: &[BlockTrace], workers: usize, cores: Option<u64>) -> Outcome {
        let scene = SceneTrace {
            load: 0,
            bytes: 0,
            parse: 0,
            facts: 0,
        };
        let network = Network {
            latency: 1000,
            worker: 1e10,
            coordinator: 1e11,
        };
        let job = Job {
            scene: &scene,
            tiles: blocks.iter().collect(),
        };
        run(
            &job,
            Settings {
                workers,
                cores,
                most_helpers: 31,
                network,
                is_warm: true,
            },
        )
    }

    #[test]
    fn workers_divide_the_items_and_repeat_what_lies_between_phases() {
        let blocks = [block(3)];
        let near = |time: u64, seconds: f64| (time as f64 / SECOND as f64 - seconds).abs() < 0.1;
        assert!(near(simulate(&blocks, 1, None).sampled, 3.0 * 4.1));
        assert!(near(simulate(&blocks, 4, None).sampled, 3.0 * 1.1));
        assert_eq!(simulate(&blocks, 1, None).repeated, 0);
        // Four on two cores are as fast as two on two, but for what they do twice.
        let shared = simulate(&blocks, 4, Some(2));
        assert!(near(shared.sampled, 3.0 * 2.2), "{shared:?}");
    }

    #[test]
    fn workers_lead_tiles_and_then_help() {
        let blocks = [block(2), block(2), block(2)];
        let two = simulate(&blocks, 2, None).sampled;
        // Two tiles side by side, and then one by both.
        assert!(two > 12 * SECOND && two < 14 * SECOND, "{two}");
        assert_eq!(two, simulate(&blocks, 2, None).sampled);
    }
}
