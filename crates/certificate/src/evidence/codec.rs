//! Evidence in bytes: numbers of seven bits a byte, floats as they are, then zstd.
//!
//! Equal evidence gives equal bytes. Reading trusts nothing: every count is held against the bytes that are left before
//! anything is allocated for it, and ids against the scene.

use std::io::Read as _;

use dashu_int::{IBig, Sign};
use glam::Vec3;
use sightline_numbers::varint::{self, VarintError, write as put};

use super::{Evidence, Hidden, Shared, Target, Witness};
use crate::proof::{Proof, Step, Which};

/// zstd's own default: higher ones take longer than they save.
const LEVEL: i32 = 3;
/// Most bytes the evidence of one cell may unpack to: hundreds of times that of a hard cell.
const MOST: u64 = 256 << 20;
/// Most memory it may take once it is read; a step takes a byte or more in a file and a good thirty in memory.
const MOST_MEMORY: usize = 4 << 30;

/// Bytes that are no evidence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a cell's certificates cannot be read: {0}; they were damaged or written by another version")]
pub struct EvidenceError(&'static str);

/// Writes evidence.
///
/// # Errors
/// When it is larger than can be read again, or zstd's.
pub fn encode(evidence: &Evidence) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    put(&mut out, evidence.seen.len() as u64);
    let mut last = 0;
    for (id, witness) in &evidence.seen {
        put(&mut out, u64::from(id.wrapping_sub(last)));
        last = *id;
        match witness {
            Witness::Floats(ends) => {
                out.push(0);
                ends.iter().for_each(|e| put_point(&mut out, *e));
            }
            Witness::Exact(ends) => {
                out.push(1);
                ends.iter().flatten().for_each(|c| put_integer(&mut out, c));
            }
        }
    }
    put_hidden(&mut out, &evidence.hidden);
    // A cell that has nothing in common with others ends here.
    if evidence.shared.is_some() || evidence.above.is_some() {
        put(&mut out, evidence.above.map_or(0, |back| u64::from(back) + 1));
        if let Some(shared) = &evidence.shared {
            shared.bounds.iter().for_each(|c| put_point(&mut out, *c));
            put_hidden(&mut out, &shared.hidden);
        }
    }
    if out.len() as u64 > MOST {
        return Err(std::io::Error::other(
            "the certificates of a cell are larger than 256 MiB; bake smaller cells, or fewer together (--block-cells)",
        ));
    }
    zstd::stream::encode_all(out.as_slice(), LEVEL)
}

/// Reads what [`encode`] wrote for a scene of so many triangles.
///
/// # Errors
/// [`EvidenceError`].
pub fn decode(bytes: &[u8], triangles: u32) -> Result<Evidence, EvidenceError> {
    let mut raw = Vec::new();
    zstd::stream::Decoder::new(bytes)
        .and_then(|d| d.take(MOST + 1).read_to_end(&mut raw))
        .map_err(|_| EvidenceError("they do not unpack"))?;
    if raw.len() as u64 > MOST {
        return Err(EvidenceError("they unpack to more than 256 MiB"));
    }
    decode_raw(&raw, triangles)
}

/// The same without compression.
///
/// # Errors
/// [`EvidenceError`].
pub fn decode_raw(raw: &[u8], triangles: u32) -> Result<Evidence, EvidenceError> {
    let mut from = Reader { rest: raw, triangles, memory: MOST_MEMORY };
    let mut evidence = Evidence::default();
    let mut last = 0u32;
    for k in 0..from.count(2)? {
        from.take::<(u32, Witness)>()?;
        let step = from.small()?;
        if k > 0 && step == 0 {
            return Err(EvidenceError("a triangle has two witnesses"));
        }
        last = last.checked_add(step).ok_or(EvidenceError("an id is out of range"))?;
        let witness = match from.byte()? {
            0 => Witness::Floats([from.point()?, from.point()?]),
            1 => {
                from.take::<[[IBig; 4]; 2]>()?;
                let mut next = || -> Result<[IBig; 4], EvidenceError> {
                    Ok([from.integer()?, from.integer()?, from.integer()?, from.integer()?])
                };
                Witness::Exact(Box::new([next()?, next()?]))
            }
            _ => return Err(EvidenceError("a witness is of no kind there is")),
        };
        evidence.seen.push((from.id(last)?, witness));
    }
    evidence.hidden = from.hidden()?;
    if !from.rest.is_empty() {
        evidence.above = match from.number()? {
            0 => None,
            next => Some(u32::try_from(next - 1).map_err(|_| EvidenceError("a number is too large"))?),
        };
        if !from.rest.is_empty() {
            from.take::<Shared>()?;
            let shared = Shared { bounds: [from.point()?, from.point()?], hidden: from.hidden()? };
            if shared.hidden.is_empty() {
                return Err(EvidenceError("nothing is hidden from a box"));
            }
            evidence.shared = Some(shared);
        }
        if evidence.shared.is_none() && evidence.above.is_none() {
            return Err(EvidenceError("they name nothing in common with other cells"));
        }
    }
    if from.rest.is_empty() { Ok(evidence) } else { Err(EvidenceError("something follows them")) }
}

fn put_hidden(out: &mut Vec<u8>, hidden: &[Hidden]) {
    put(out, hidden.len() as u64);
    for h in hidden {
        match &h.target {
            Target::Triangle => out.push(0),
            Target::Surfaces => out.push(2),
            Target::Half => out.push(3),
            Target::Polygon(corners) => {
                out.push(4);
                put(out, corners.len() as u64);
                corners.iter().for_each(|c| put_point(out, *c));
            }
            Target::Box(corners) => {
                out.push(1);
                corners.iter().for_each(|c| put_point(out, *c));
            }
        }
        put_ids(out, &h.triangles);
        put(out, h.proofs.len() as u64);
        h.proofs.iter().for_each(|p| put_proof(out, p));
    }
}

fn put_point(out: &mut Vec<u8>, p: Vec3) {
    p.to_array().iter().for_each(|c| out.extend(c.to_le_bytes()));
}

fn put_integer(out: &mut Vec<u8>, x: &IBig) {
    let (sign, size) = x.clone().into_parts();
    let bytes = size.to_le_bytes();
    put(out, (bytes.len() as u64) << 1 | u64::from(sign == Sign::Negative));
    out.extend_from_slice(&bytes);
}

/// The number of ids and their differences, which are at least 1 but for the first.
fn put_ids(out: &mut Vec<u8>, ids: &[u32]) {
    put(out, ids.len() as u64);
    let mut last = 0;
    for id in ids {
        put(out, u64::from(id.wrapping_sub(last)));
        last = *id;
    }
}

fn put_proof(out: &mut Vec<u8>, proof: &Proof) {
    put(out, proof.occluders.len() as u64);
    let mut last = 0i64;
    for occluder in &proof.occluders {
        put(out, occluder.len() as u64);
        for (id, turned) in occluder {
            // The difference, its sign and the turn, so that neighbours take a byte.
            let d = i64::from(*id) - last;
            last = i64::from(*id);
            put(out, (d.unsigned_abs() << 1 | u64::from(d < 0)) << 1 | u64::from(*turned));
        }
    }
    put(out, proof.steps.len() as u64);
    for step in &proof.steps {
        match step {
            Step::Unreal => out.push(0),
            Step::Block { occluder, negative, cuts } => {
                // Kinds 1 and 2 of four.
                put(out, (u64::from(*occluder) << 2) | (1 + u64::from(*negative)));
                put(out, cuts.len() as u64);
                cuts.iter().for_each(|c| put(out, u64::from(*c)));
            }
            Step::Split { polar } => {
                // Kind 3, the polar in doubles, is no longer written or read.
                out.push(11);
                polar.iter().for_each(|c| put_integer(out, c));
            }
            Step::Divide { of, from, to } => {
                out.push(7);
                out.push(u8::from(*of == Which::B));
                put(out, u64::from(*from));
                put(out, u64::from(*to));
            }
        }
    }
}

struct Reader<'a> {
    rest: &'a [u8],
    triangles: u32,
    /// Bytes that may still be taken for what is read.
    memory: usize,
}

impl Reader<'_> {
    fn byte(&mut self) -> Result<u8, EvidenceError> {
        let (first, rest) = self.rest.split_first().ok_or(EvidenceError("they end too early"))?;
        self.rest = rest;
        Ok(*first)
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], EvidenceError> {
        let (first, rest) = self.rest.split_first_chunk().ok_or(EvidenceError("they end too early"))?;
        self.rest = rest;
        Ok(*first)
    }

    fn number(&mut self) -> Result<u64, EvidenceError> {
        // Nine bytes hold 63 bits. There is one form for each number.
        varint::read_shortest(&mut self.rest, 9).map_err(|e| match e {
            VarintError::CutShort => EvidenceError("they end too early"),
            VarintError::NotShortest => EvidenceError("a number has more bytes than it needs"),
            VarintError::TooLarge | VarintError::TooLong => EvidenceError("a number is too large"),
        })
    }

    fn small<T: TryFrom<u64>>(&mut self) -> Result<T, EvidenceError> {
        T::try_from(self.number()?).map_err(|_| EvidenceError("a number is too large"))
    }

    /// Takes memory for one more thing.
    fn take<T>(&mut self) -> Result<(), EvidenceError> {
        let left = self.memory.checked_sub(size_of::<T>());
        self.memory = left.ok_or(EvidenceError("they would take more than 4 GiB of memory"))?;
        Ok(())
    }

    /// A number of things of at least `least` bytes each, all of which must still be there.
    fn count(&mut self, least: usize) -> Result<usize, EvidenceError> {
        let n: usize = self.small()?;
        if n > self.rest.len() / least {
            return Err(EvidenceError("a count does not fit what follows"));
        }
        Ok(n)
    }

    fn id(&self, id: u32) -> Result<u32, EvidenceError> {
        if id < self.triangles { Ok(id) } else { Err(EvidenceError("an id is out of range")) }
    }

    fn point(&mut self) -> Result<Vec3, EvidenceError> {
        let mut next = || Ok(f32::from_le_bytes(self.bytes()?));
        let p = Vec3::new(next()?, next()?, next()?);
        if p.is_finite() { Ok(p) } else { Err(EvidenceError("a point is not finite")) }
    }

    fn integer(&mut self) -> Result<IBig, EvidenceError> {
        let head = self.number()?;
        let length = usize::try_from(head >> 1).map_err(|_| EvidenceError("a number is too large"))?;
        let (bytes, rest) = self.rest.split_at_checked(length).ok_or(EvidenceError("they end too early"))?;
        self.rest = rest;
        let canonical = bytes.last().map_or(head & 1 == 0, |b| *b != 0);
        if !canonical {
            return Err(EvidenceError("a number has more bytes than it needs"));
        }
        let size = IBig::from(dashu_int::UBig::from_le_bytes(bytes));
        Ok(if head & 1 == 1 { -size } else { size })
    }

    fn ids(&mut self) -> Result<Vec<u32>, EvidenceError> {
        let mut last = 0u32;
        (0..self.count(1)?)
            .map(|k| {
                self.take::<u32>()?;
                let step: u32 = self.small()?;
                if k > 0 && step == 0 {
                    return Err(EvidenceError("ids are not in order"));
                }
                last = last.checked_add(step).ok_or(EvidenceError("an id is out of range"))?;
                self.id(last)
            })
            .collect()
    }

    fn hidden(&mut self) -> Result<Vec<Hidden>, EvidenceError> {
        let mut all = Vec::new();
        for _ in 0..self.count(3)? {
            self.take::<Hidden>()?;
            let target = match self.byte()? {
                0 => Target::Triangle,
                1 => Target::Box([self.point()?, self.point()?]),
                2 => Target::Surfaces,
                3 => Target::Half,
                4 => {
                    // Twelve bytes a corner.
                    let corners = (0..self.count(12)?).map(|_| {
                        self.take::<Vec3>()?;
                        self.point()
                    });
                    Target::Polygon(corners.collect::<Result<_, _>>()?)
                }
                _ => return Err(EvidenceError("a proof is about nothing there is")),
            };
            let triangles = self.ids()?;
            if triangles.is_empty() {
                return Err(EvidenceError("a proof is about no triangle"));
            }
            let proofs = (0..self.count(2)?).map(|_| self.proof()).collect::<Result<_, _>>()?;
            all.push(Hidden { target, triangles, proofs });
        }
        Ok(all)
    }

    fn proof(&mut self) -> Result<Proof, EvidenceError> {
        let mut proof = Proof::default();
        let mut last = 0i64;
        self.take::<Proof>()?;
        for _ in 0..self.count(2)? {
            self.take::<Vec<(u32, bool)>>()?;
            let mut members = Vec::new();
            for _ in 0..self.count(1)? {
                self.take::<(u32, bool)>()?;
                let x = self.number()?;
                let d = i64::try_from(x >> 2).map_err(|_| EvidenceError("an id is out of range"))?;
                if d == 0 && x & 2 != 0 {
                    return Err(EvidenceError("a difference of nothing has a sign"));
                }
                last = last.saturating_add(if x & 2 == 0 { d } else { -d });
                let id = u32::try_from(last).map_err(|_| EvidenceError("an id is out of range"))?;
                members.push((self.id(id)?, x & 1 == 1));
            }
            proof.occluders.push(members);
        }
        for _ in 0..self.count(1)? {
            self.take::<Step>()?;
            let x = self.number()?;
            let step = match (x & 3, x >> 2) {
                (0, 0) => Step::Unreal,
                (kind @ (1 | 2), occluder) => Step::Block {
                    occluder: u32::try_from(occluder)
                        .map_err(|_| EvidenceError("an occluder is out of range"))?,
                    negative: kind == 2,
                    cuts: (0..self.count(1)?)
                        .map(|_| self.take::<u16>().and_then(|()| self.small()))
                        .collect::<Result<_, _>>()?,
                },
                (3, 2) => {
                    self.take::<[IBig; 6]>()?;
                    let mut polar = Box::new([IBig::ZERO; 6]);
                    for c in polar.iter_mut() {
                        *c = self.integer()?;
                    }
                    Step::Split { polar }
                }
                (3, 1) => {
                    let of = match self.byte()? {
                        0 => Which::A,
                        1 => Which::B,
                        _ => return Err(EvidenceError("a step is of no kind there is")),
                    };
                    Step::Divide { of, from: self.small()?, to: self.small()? }
                }
                _ => return Err(EvidenceError("a step is of no kind there is")),
            };
            proof.steps.push(step);
        }
        Ok(proof)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn integer() -> impl Strategy<Value = IBig> {
        (any::<i64>(), 0usize..300).prop_map(|(x, up)| IBig::from(x) << up)
    }

    fn floats() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-1e30f32..1e30).prop_map(Vec3::from)
    }

    fn proof() -> impl Strategy<Value = Proof> {
        let step = prop_oneof![
            Just(Step::Unreal),
            (any::<u32>(), any::<bool>(), prop::collection::vec(any::<u16>(), 0..5))
                .prop_map(|(occluder, negative, cuts)| Step::Block { occluder, negative, cuts }),
            prop::array::uniform6(integer()).prop_map(|polar| Step::Split { polar: Box::new(polar) }),
            (any::<bool>(), any::<u16>(), any::<u16>()).prop_map(|(b, from, to)| Step::Divide {
                of: if b { Which::B } else { Which::A },
                from,
                to
            }),
        ];
        let occluder = prop::collection::vec((0u32..1000, any::<bool>()), 1..6);
        (prop::collection::vec(occluder, 0..4), prop::collection::vec(step, 0..8))
            .prop_map(|(occluders, steps)| Proof { occluders, steps })
    }

    fn hidden() -> impl Strategy<Value = Vec<Hidden>> {
        let target = prop_oneof![
            Just(Target::Triangle),
            Just(Target::Surfaces),
            Just(Target::Half),
            prop::array::uniform2(floats()).prop_map(Target::Box),
            prop::collection::vec(floats(), 0..5).prop_map(|c| Target::Polygon(c.into())),
        ];
        let ids = prop::collection::btree_set(0u32..1000, 1..8);
        let one = (target, ids, prop::collection::vec(proof(), 0..4)).prop_map(|(target, ids, proofs)| {
            Hidden { target, triangles: ids.into_iter().collect(), proofs }
        });
        prop::collection::vec(one, 0..5)
    }

    prop_compose! {
        fn evidence()(
            seen in prop::collection::btree_map(0u32..1000, prop_oneof![
                prop::array::uniform2(floats()).prop_map(Witness::Floats),
                prop::array::uniform2(prop::array::uniform4(integer())).prop_map(|e| Witness::Exact(Box::new(e))),
            ], 0..8),
            hidden in hidden(),
            shared in prop::option::of((prop::array::uniform2(floats()), hidden()).prop_filter("empty", |s| !s.1.is_empty())),
            above in prop::option::of(any::<u32>()),
        ) -> Evidence {
            Evidence {
                seen: seen.into_iter().collect(),
                hidden,
                shared: shared.map(|(bounds, hidden)| Shared { bounds, hidden }),
                above,
            }
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(e in evidence()) {
            let bytes = encode(&e).unwrap();
            prop_assert_eq!(decode(&bytes, 1000).unwrap(), e);
        }

        #[test]
        fn what_is_damaged_is_an_error_or_something_else(e in evidence(), at in any::<usize>(), value in 1u8.., cut in 0usize..3) {
            let mut raw = zstd::stream::decode_all(encode(&e).unwrap().as_slice()).unwrap();
            let at = at % raw.len();
            raw[at] ^= value;
            raw.truncate(raw.len() - cut);
            if let Ok(other) = decode(&zstd::stream::encode_all(raw.as_slice(), 1).unwrap(), 1000) {
                // One form for each: what can be read is written the same way.
                let again = zstd::stream::decode_all(encode(&other).unwrap().as_slice()).unwrap();
                prop_assert_eq!(again, raw);
            }
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = decode(&bytes, 1000);
            let _ = decode(&zstd::stream::encode_all(bytes.as_slice(), 1).unwrap(), 1000);
        }
    }
}
