//! What lines show to the cells of other blocks: counted, or given to these blocks between rounds.
//!
//! The sampler knows nothing of this. A tracer notes what each traced line shows beyond the block that casts
//! it, and a crew with one member (see `sightline_sampling::crew`) adds what other blocks have shown to the
//! finds of the last phase of a round.

use std::sync::atomic::{AtomicU8, AtomicU32, Ordering::Relaxed};
use std::sync::{Barrier, Mutex, PoisonError, RwLock};

use glam::Vec3;
use sightline_numbers::varint;
use sightline_sampling::crew::{Alone, Crew, Phase};
use sightline_sampling::lines::bits::SeenBits;
use sightline_sampling::lines::grid::{CellGrid, Crossed};
use sightline_sampling::packet::{LineTracer, Packet};
use sightline_sampling::{BackendError, SKY, TileError};

/// Who has cast a line.
#[derive(Clone, Copy)]
pub enum Caster {
    /// The block with this number.
    Block(u32),
    /// The block that the origin of the line is in; all blocks during seeds, which every block has.
    Origin,
}

/// What casting is for at the moment.
const SEARCH: u8 = 0;
const SEEDS: u8 = 1;
const NOTHING: u8 = 2;

/// The words of a block's table in the table of the whole division.
pub struct Map {
    /// By word of the whole: the block, and the word of its table.
    words: Vec<(u32, u32)>,
    /// By block: the number of words.
    sizes: Vec<u32>,
    /// By block: its corners.
    boxes: Vec<(Vec3, Vec3)>,
}

impl Map {
    /// The map of `blocks`, each with its first cell. Every word must be a word of one block.
    pub fn new(whole: &CellGrid, blocks: &[([u32; 3], CellGrid)]) -> Result<Self, &'static str> {
        let mut words = vec![(u32::MAX, 0); whole.words()];
        for (number, (first, grid)) in blocks.iter().enumerate() {
            for at in grid.each() {
                let (own, all) = (
                    grid.slot(at),
                    whole.slot([0, 1, 2].map(|a| first[a] + at[a])),
                );
                let word = &mut words[all.word as usize];
                let here = (number as u32, own.word);
                if own.bit != all.bit || (word.0 != u32::MAX && *word != here) {
                    return Err("blocks need sides of a multiple of four cells");
                }
                *word = here;
            }
        }
        let sizes = blocks.iter().map(|(_, grid)| grid.words() as u32).collect();
        Ok(Self {
            words,
            sizes,
            boxes: blocks.iter().map(|(_, grid)| grid.bounds()).collect(),
        })
    }
}

/// What was shown: to cells of the caster's block, and to cells of others.
struct Tables {
    own: SeenBits,
    others: SeenBits,
}

/// How many pairs of a triangle and a cell were found, how many of them by other blocks alone, and the bytes
/// of everything that blocks have shown to others, packed.
#[derive(Clone, Copy, Default)]
pub struct Counts {
    pub all: u64,
    pub by_others: u64,
    pub bytes: u64,
}

/// The finds of the blocks of a division that are sampled in step.
pub struct Exchange {
    whole: CellGrid,
    map: Map,
    tables: RwLock<Tables>,
    barrier: Barrier,
    /// By block: places in its table, and bits.
    parcels: Vec<Mutex<Vec<(usize, u64)>>>,
    /// By the number of the merge.
    counts: Mutex<Vec<Counts>>,
    /// Whether finds are counted, for which lines are walked within their own block as well.
    counts_finds: bool,
}

impl Exchange {
    /// Nothing is found yet. `members` blocks take part in every merge.
    pub fn new(whole: CellGrid, map: Map, rows: usize, members: usize, counts_finds: bool) -> Self {
        let table = |rows| SeenBits::new(rows, whole.words());
        let own = table(if counts_finds { rows } else { 0 });
        Self {
            tables: RwLock::new(Tables {
                own,
                others: table(rows),
            }),
            counts_finds,
            barrier: Barrier::new(members),
            parcels: map.sizes.iter().map(|_| Mutex::default()).collect(),
            counts: Mutex::default(),
            whole,
            map,
        }
    }

    /// Notes what the cells of a block see from the start.
    pub fn begin(&self, block: Option<u32>, bits: &SeenBits, rows: usize) {
        if !self.counts_finds {
            return;
        }
        let tables = self.tables.read().unwrap_or_else(PoisonError::into_inner);
        for row in 0..rows as u32 {
            let from = bits.row(row);
            for (word, (owner, local)) in self.map.words.iter().enumerate() {
                let seen = match block {
                    Some(block) if block != *owner => 0,
                    Some(_) => from[*local as usize],
                    None => from[word],
                };
                if seen != 0 {
                    tables
                        .own
                        .add(row as usize * self.map.words.len() + word, seen);
                }
            }
        }
    }

    /// Waits for all blocks, counts what has been found since the last merge, and makes parcels of what other
    /// blocks have found alone.
    fn merge(&self) {
        if self.barrier.wait().is_leader() {
            let mut tables = self.tables.write().unwrap_or_else(PoisonError::into_inner);
            let Tables { own, others } = &mut *tables;
            let mut counts = Counts::default();
            own.each_new(|_, bits| counts.all += u64::from(bits.count_ones()));
            own.publish();
            let mut sent = vec![Vec::new(); self.parcels.len()];
            let mut parcels = sent.clone();
            let words = self.map.words.len();
            others.each_new(|at, bits| {
                let (row, word) = (at / words, at % words);
                let (block, local) = self.map.words[word];
                let place = row * self.map.sizes[block as usize] as usize + local as usize;
                sent[block as usize].push((place, bits));
                if !self.counts_finds {
                    return;
                }
                let alone = bits & !own.row(row as u32)[word];
                if alone != 0 {
                    counts.by_others += u64::from(alone.count_ones());
                    parcels[block as usize].push((place, alone));
                    own.add(at, alone);
                }
            });
            counts.all += counts.by_others;
            if self.counts_finds {
                counts.bytes = sent
                    .iter()
                    .map(|parcel| finds(0, parcel).len() as u64)
                    .sum();
            } else {
                parcels = sent;
            }
            own.publish();
            others.publish();
            for (place, parcel) in self.parcels.iter().zip(parcels) {
                *place.lock().unwrap_or_else(PoisonError::into_inner) = parcel;
            }
            self.counts
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(counts);
        }
        self.barrier.wait();
    }

    /// The counts of all merges.
    pub fn counts(&self) -> Vec<Counts> {
        self.counts
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Notes what the line of a lane shows; `step` is that of the block.
    fn note(
        &self,
        tables: &Tables,
        (caster, is_seed): (Caster, bool),
        line: Line<'_>,
        out: &mut Crossed,
    ) {
        let Line {
            ahead,
            behind,
            lane,
            step,
        } = line;
        let ends = [ahead.triangle[lane], behind.triangle[lane]];
        if ends == [SKY; 2] {
            return;
        }
        let (origin, direction) = ahead.ray(lane);
        let (from, to) = ahead.free(behind, lane, step);
        if let (false, Caster::Block(block)) = (self.counts_finds, caster) {
            let (enters, leaves) = through(self.map.boxes[block as usize], origin, direction);
            for (from, to) in [(from, to.min(enters)), (from.max(leaves), to)] {
                if from < to {
                    self.whole.walk(origin, direction, from, to, out);
                    ends.into_iter()
                        .filter(|t| *t != SKY)
                        .for_each(|t| tables.others.credit(t, out));
                }
            }
            return;
        }
        self.whole.walk(origin, direction, from, to, out);
        let block = match caster {
            Caster::Block(block) => block,
            Caster::Origin => {
                let slot = self.whole.slot(self.whole.cell_at(origin.into()));
                self.map.words[slot.word as usize].0
            }
        };
        for crossed in out.iter() {
            let is_own = self.map.words[crossed.0 as usize].0 == block;
            let is_own = is_own || is_seed && matches!(caster, Caster::Origin);
            let table = if is_own { &tables.own } else { &tables.others };
            for triangle in ends.into_iter().filter(|t| *t != SKY) {
                table.credit(triangle, std::slice::from_ref(crossed));
            }
        }
    }
}

/// Where a line enters and leaves a box. If it misses the box, it enters at infinity.
fn through((min, max): (Vec3, Vec3), origin: [f32; 3], direction: [f32; 3]) -> (f32, f32) {
    let (mut enters, mut leaves) = (f32::NEG_INFINITY, f32::INFINITY);
    for a in 0..3 {
        let (u, v) = (
            (min[a] - origin[a]) / direction[a],
            (max[a] - origin[a]) / direction[a],
        );
        enters = enters.max(u.min(v));
        leaves = leaves.min(u.max(v));
    }
    if enters < leaves {
        (enters, leaves)
    } else {
        (f32::INFINITY, f32::INFINITY)
    }
}

/// A traced line.
struct Line<'a> {
    ahead: &'a Packet,
    behind: &'a Packet,
    lane: usize,
    step: f32,
}

/// A member of the exchange: a block, or the one block of everything.
pub struct Member<'a> {
    exchange: &'a Exchange,
    caster: Caster,
    step: f32,
    state: AtomicU8,
    phases: AtomicU32,
    /// Rounds, from 1, after which finds are exchanged; `None` when every phase ends with a merge that only
    /// counts.
    rounds: Option<&'a [u32]>,
    merges: AtomicU32,
}

impl<'a> Member<'a> {
    /// A member whose block has the least step `step`.
    pub fn new(
        exchange: &'a Exchange,
        caster: Caster,
        step: f32,
        rounds: Option<&'a [u32]>,
    ) -> Self {
        Self {
            exchange,
            caster,
            step,
            state: AtomicU8::new(SEARCH),
            phases: AtomicU32::new(0),
            rounds,
            merges: AtomicU32::new(0),
        }
    }

    /// Takes part in the merges that are left, and waits for the last block.
    pub fn leave(&self) {
        self.state.store(NOTHING, Relaxed);
        let merges = self.rounds.map_or(0, <[u32]>::len) as u32;
        (self.merges.load(Relaxed)..merges).for_each(|_| self.exchange.merge());
        self.exchange.barrier.wait();
    }

    fn parcel(&self) -> Vec<(usize, u64)> {
        let Caster::Block(block) = self.caster else {
            return Vec::new();
        };
        let mut parcel = self.exchange.parcels[block as usize]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut *parcel)
    }
}

/// The round, from 1, that a phase ends. The phases are uniform lines and candidates by turns, and seeds
/// after the second uniform lines.
pub fn round_of(phase: u32) -> Option<u32> {
    match phase {
        1 => Some(1),
        n => (n >= 4 && n.is_multiple_of(2)).then_some(n / 2),
    }
}

impl Crew for Member<'_> {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        if self.state.load(Relaxed) == NOTHING {
            return Alone.run(phase);
        }
        let number = self.phases.fetch_add(1, Relaxed);
        self.state
            .store(if number == 3 { SEEDS } else { SEARCH }, Relaxed);
        Alone.run(phase)?;
        let Some(rounds) = self.rounds else {
            self.exchange.merge();
            return Ok(());
        };
        if round_of(number).is_some_and(|round| rounds.contains(&round)) {
            self.merges.fetch_add(1, Relaxed);
            self.exchange.merge();
            let added = phase.add(&finds(phase.items(), &self.parcel()));
            added.map_err(|_| TileError::Cancelled)?;
        }
        Ok(())
    }

    fn end(&self) -> Result<(), TileError> {
        Ok(())
    }
}

/// The bytes of finds without answers (`crates/sampling/src/lines/finds.rs`).
fn finds(items: usize, words: &[(usize, u64)]) -> Vec<u8> {
    let mut raw = Vec::new();
    for n in [items, 0, words.len()] {
        varint::write(&mut raw, n as u64);
    }
    let mut next = 0;
    for (at, word) in words {
        varint::write(&mut raw, (at - next) as u64);
        raw.extend(word.to_le_bytes());
        next = at + 1;
    }
    varint::write(&mut raw, 0);
    zstd::stream::encode_all(raw.as_slice(), 1).unwrap_or_default()
}

/// A tracer that notes what lines show.
pub struct Noting<'a> {
    pub tracer: Box<dyn LineTracer + 'a>,
    pub member: &'a Member<'a>,
}

impl Noting<'_> {
    fn note(&self, packets: &[Packet]) {
        let state = self.member.state.load(Relaxed);
        if state == NOTHING || packets.len() < 2 {
            return;
        }
        let tables = self
            .member
            .exchange
            .tables
            .read()
            .unwrap_or_else(PoisonError::into_inner);
        // Either each packet comes before its reverse, or all packets come before all reverses.
        let opposite =
            |a: &Packet, b: &Packet| (0..3).all(|k| a.direction[k][0] == -b.direction[k][0]);
        let pairs = packets.len() / 2;
        let by_turns = opposite(&packets[0], &packets[1]);
        let mut crossed = Crossed::new();
        for k in 0..pairs {
            let [a, b] = if by_turns {
                [2 * k, 2 * k + 1]
            } else {
                [k, k + pairs]
            };
            let (ahead, behind) = (&packets[a], &packets[b]);
            for lane in 0..ahead.count {
                let line = Line {
                    ahead,
                    behind,
                    lane,
                    step: self.member.step,
                };
                let caster = (self.member.caster, state == SEEDS);
                self.member
                    .exchange
                    .note(&tables, caster, line, &mut crossed);
            }
        }
    }
}

impl LineTracer for Noting<'_> {
    fn trace(&self, packets: &mut [Packet]) -> Result<(), BackendError> {
        self.tracer.trace(packets)?;
        self.note(packets);
        Ok(())
    }

    fn trace_each(&self, packets: &mut [Packet]) -> Result<(), BackendError> {
        self.tracer.trace_each(packets)?;
        self.note(packets);
        Ok(())
    }

    fn batch(&self) -> usize {
        self.tracer.batch()
    }
}
