//! Modes TRIANGLES and INDICES of EXT_meshopt_compression.

use sightline_numbers::varint;

/// Reads a number of up to 32 bits. Higher bits, which no encoder writes, are dropped.
fn number(rest: &mut &[u8]) -> Option<u32> {
    varint::read(rest, 5).ok().map(|v| v as u32)
}

/// Returns the two's complement of a zigzag-encoded integer, whose sign is in the lowest bit of `v`.
fn unzigzag(v: u32) -> u32 {
    (v >> 1) ^ (v & 1).wrapping_neg()
}

/// Decodes mode INDICES: each index is a delta to one of two running baselines. Returns `None` if the data
/// are malformed.
pub(super) fn index_sequence(count: usize, data: &[u8]) -> Option<Vec<u32>> {
    let (&0xd1, body) = data.split_first()? else {
        return None;
    };
    let (mut rest, _tail) = body.split_at_checked(body.len().checked_sub(4)?)?;
    if count > rest.len() {
        return None;
    }
    let mut last = [0u32; 2];
    let mut out = Vec::with_capacity(count);
    for _ in 0..count {
        let v = number(&mut rest)?;
        let baseline = &mut last[(v & 1) as usize];
        *baseline = baseline.wrapping_add(unzigzag(v >> 1));
        out.push(*baseline);
    }
    rest.is_empty().then_some(out)
}

/// The sixteen items that were pushed last.
struct Fifo<T> {
    items: [T; 16],
    next: usize,
}

impl<T: Copy> Fifo<T> {
    fn new(item: T) -> Self {
        Self {
            items: [item; 16],
            next: 0,
        }
    }

    fn push(&mut self, item: T) {
        self.items[self.next] = item;
        self.next = (self.next + 1) & 15;
    }

    /// Returns the item that was pushed `back` pushes ago. 1 is the newest item.
    fn back(&self, back: usize) -> T {
        self.items[self.next.wrapping_sub(back) & 15]
    }
}

/// A decoder of mode TRIANGLES.
struct TriangleDecoder<'a> {
    /// The sixteen most recent edges of triangles.
    edges: Fifo<(u32, u32)>,
    /// The sixteen most recent vertices.
    vertices: Fifo<u32>,
    /// The smallest index that has not occurred.
    next: u32,
    /// The last index written as a delta.
    last: u32,
    rest: &'a [u8],
}

impl TriangleDecoder<'_> {
    /// Returns the next new index.
    fn fresh(&mut self) -> u32 {
        let n = self.next;
        self.next = n.wrapping_add(1);
        n
    }

    /// Reads an index that is written as a delta.
    fn delta(&mut self) -> Option<u32> {
        let v = number(&mut self.rest)?;
        self.last = self.last.wrapping_add(unzigzag(v));
        Some(self.last)
    }

    /// Decodes a triangle that shares an edge with a recent triangle.
    fn on_edge(&mut self, code: u8) -> Option<[u32; 3]> {
        let (a, b) = self.edges.back(usize::from(code >> 4) + 1);
        let c = match code & 15 {
            0 => self.fresh(),
            f @ 1..=12 => self.vertices.back(usize::from(f) + 1),
            13 => {
                self.last = self.last.wrapping_sub(1);
                self.last
            }
            14 => {
                self.last = self.last.wrapping_add(1);
                self.last
            }
            _ => self.delta()?,
        };
        // A vertex from the recent vertices is not pushed again.
        if !(1..=12).contains(&(code & 15)) {
            self.vertices.push(c);
        }
        self.edges.push((c, b));
        self.edges.push((a, c));
        Some([a, b, c])
    }

    /// Decodes a triangle that does not share an edge with a recent triangle.
    fn alone(&mut self, code: u8, table: &[u8]) -> Option<[u32; 3]> {
        let (a_code, aux) = if code < 0xfe {
            (0, *table.get(usize::from(code & 15))?)
        } else {
            let (&aux, tail) = self.rest.split_first()?;
            self.rest = tail;
            if aux == 0 {
                self.next = 0;
            }
            (if code == 0xfe { 0 } else { 15 }, aux)
        };
        let codes = [a_code, aux >> 4, aux & 15];
        // All three codes precede any delta, so new vertices are numbered first.
        let mut v = [0u32; 3];
        for (v, code) in v.iter_mut().zip(codes) {
            *v = if code == 0 {
                self.fresh()
            } else {
                self.vertices.back(usize::from(code))
            };
        }
        for (v, code) in v.iter_mut().zip(codes) {
            if code == 15 {
                *v = self.delta()?;
            }
        }
        let [a, b, c] = v;
        for (v, code) in v.into_iter().zip(codes) {
            if code == 0 || code == 15 {
                self.vertices.push(v);
            }
        }
        self.edges.push((b, a));
        self.edges.push((c, b));
        self.edges.push((a, c));
        Some(v)
    }
}

/// Decodes mode TRIANGLES: a code byte for each triangle, then the deltas, then a table of 16 frequent codes.
/// Returns `None` if the data are malformed.
pub(super) fn triangles(count: usize, data: &[u8]) -> Option<Vec<u32>> {
    let (&0xe1, body) = data.split_first()? else {
        return None;
    };
    if !count.is_multiple_of(3) {
        return None;
    }
    let (codes, rest) = body.split_at_checked(count / 3)?;
    let (rest, table) = rest.split_at_checked(rest.len().checked_sub(16)?)?;
    let mut d = TriangleDecoder {
        edges: Fifo::new((u32::MAX, u32::MAX)),
        vertices: Fifo::new(u32::MAX),
        next: 0,
        last: 0,
        rest,
    };
    let mut out = Vec::with_capacity(count);
    for &code in codes {
        out.extend(if code < 0xf0 {
            d.on_edge(code)?
        } else {
            d.alone(code, table)?
        });
    }
    d.rest.is_empty().then_some(out)
}
