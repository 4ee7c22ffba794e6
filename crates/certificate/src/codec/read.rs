//! The decoder of certificates.

use std::io::Read as _;

use dashu_int::IBig;
use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_numbers::memory::other_than_exhaustion;
use sightline_numbers::varint::{self, VarintError};

use super::{APART, CodecError, MAX_BYTES, MAX_MEMORY};
use crate::certificate::{
    CellCertificate, GroupCertificate, HiddenBox, HiddenGroup, Target, Witness,
};
use crate::proof::{OccluderTriangle, Proof, QueryPolygon, Step};

/// Decodes the bytes that [`encode`](super::encode) returned. `triangles` is the number of triangles of the
/// scene.
///
/// # Errors
/// [`CodecError`] if the bytes are not the compressed encoding of a certificate.
pub fn decode(bytes: &[u8], triangles: u32) -> Result<CellCertificate, CodecError> {
    let mut raw = Vec::new();
    zstd::stream::Decoder::new(bytes)
        .and_then(|d| d.take(MAX_BYTES + 1).read_to_end(&mut raw))
        .map_err(|e| {
            other_than_exhaustion(e);
            CodecError("zstd cannot decompress the bytes")
        })?;
    if raw.len() as u64 > MAX_BYTES {
        return Err(CodecError("the uncompressed size exceeds 256 MiB"));
    }
    decode_raw(&raw, triangles)
}

/// Decodes a certificate like [`decode`], from bytes without compression.
///
/// # Errors
/// [`CodecError`] if the bytes are not the encoding of a certificate.
pub fn decode_raw(raw: &[u8], triangles: u32) -> Result<CellCertificate, CodecError> {
    let mut from = Reader {
        rest: raw,
        triangles,
        memory: MAX_MEMORY,
    };
    let mut certificate = CellCertificate::default();
    let mut last = 0u32;
    for k in 0..from.count(2)? {
        from.take::<(u32, Witness)>()?;
        let step = from.small()?;
        if k > 0 && step == 0 {
            return Err(CodecError(
                "the ids of triangles with witnesses are not in ascending order",
            ));
        }
        last = last.checked_add(step).ok_or(CodecError(
            "a triangle id is not below the number of triangles of the scene",
        ))?;
        let witness = match from.byte()? {
            0 => Witness::Floats([from.point()?, from.point()?]),
            1 => {
                from.take::<[[IBig; 4]; 2]>()?;
                let mut next = || -> Result<[IBig; 4], CodecError> {
                    Ok([
                        from.integer()?,
                        from.integer()?,
                        from.integer()?,
                        from.integer()?,
                    ])
                };
                Witness::Exact(Box::new([next()?, next()?]))
            }
            _ => return Err(CodecError("the kind of a witness is neither 0 nor 1")),
        };
        certificate.seen.push((from.id(last)?, witness));
    }
    certificate.hidden = from.hidden()?;
    if !from.rest.is_empty() {
        let number = from.number()?;
        let apart = number >= APART;
        certificate.above = match if apart { number - APART } else { number } {
            0 => None,
            next => Some(
                u32::try_from(next - 1)
                    .map_err(|_| CodecError("the offset to an earlier cell exceeds 32 bits"))?,
            ),
        };
        let shared = match apart {
            false => !from.rest.is_empty(),
            true => match from.byte()? {
                0 => false,
                1 => true,
                _ => {
                    return Err(CodecError(
                        "the flag for a cell group's certificate is neither 0 nor 1",
                    ));
                }
            },
        };
        if shared {
            from.take::<GroupCertificate>()?;
            let shared = GroupCertificate {
                bounds: Aabb {
                    min: from.point()?,
                    max: from.point()?,
                },
                hidden: from.hidden()?,
            };
            if shared.hidden.is_empty() {
                return Err(CodecError(
                    "the certificate of a cell group contains no hidden triangles",
                ));
            }
            certificate.shared = Some(shared);
        }
        if apart {
            for _ in 0..from.count(25)? {
                from.take::<HiddenBox>()?;
                let bounds = Aabb {
                    min: from.point()?,
                    max: from.point()?,
                };
                certificate.apart.push(HiddenBox {
                    bounds,
                    proofs: from.proofs()?,
                });
            }
            if certificate.apart.is_empty() {
                return Err(CodecError("the list of hidden boxes is empty"));
            }
        }
        if !apart && certificate.shared.is_none() && certificate.above.is_none() {
            return Err(CodecError(
                "the section about a cell group is present but empty",
            ));
        }
    }
    if from.rest.is_empty() {
        Ok(certificate)
    } else {
        Err(CodecError(
            "additional bytes follow the end of the certificate",
        ))
    }
}

struct Reader<'a> {
    rest: &'a [u8],
    triangles: u32,
    /// The number of bytes of memory that the decoded values may still use.
    memory: usize,
}

impl Reader<'_> {
    fn byte(&mut self) -> Result<u8, CodecError> {
        let (first, rest) = self
            .rest
            .split_first()
            .ok_or(CodecError("the bytes end too early"))?;
        self.rest = rest;
        Ok(*first)
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], CodecError> {
        let (first, rest) = self
            .rest
            .split_first_chunk()
            .ok_or(CodecError("the bytes end too early"))?;
        self.rest = rest;
        Ok(*first)
    }

    fn number(&mut self) -> Result<u64, CodecError> {
        // Nine bytes contain 63 bits. Each number has only one form.
        varint::read_shortest(&mut self.rest, 9).map_err(|e| match e {
            VarintError::CutShort => CodecError("the bytes end too early"),
            VarintError::NotShortest => CodecError("a number is not in its shortest encoding"),
            VarintError::TooLarge | VarintError::TooLong => CodecError("a number exceeds 63 bits"),
        })
    }

    fn small<T: TryFrom<u64>>(&mut self) -> Result<T, CodecError> {
        T::try_from(self.number()?)
            .map_err(|_| CodecError("a number exceeds the range of its field"))
    }

    /// Subtracts the memory of one more value from the budget.
    fn take<T>(&mut self) -> Result<(), CodecError> {
        let left = self.memory.checked_sub(size_of::<T>());
        self.memory = left.ok_or(CodecError(
            "the decoded certificate needs more than 4 GiB of memory",
        ))?;
        Ok(())
    }

    /// Reads a count of values with at least `least` bytes each, and checks that enough bytes remain.
    fn count(&mut self, least: usize) -> Result<usize, CodecError> {
        let n: usize = self.small()?;
        if n > self.rest.len() / least {
            return Err(CodecError(
                "a count exceeds the number of values that the remaining bytes can contain",
            ));
        }
        Ok(n)
    }

    fn id(&self, id: u32) -> Result<u32, CodecError> {
        if id < self.triangles {
            Ok(id)
        } else {
            Err(CodecError(
                "a triangle id is not below the number of triangles of the scene",
            ))
        }
    }

    fn point(&mut self) -> Result<Vec3, CodecError> {
        let mut next = || Ok(f32::from_le_bytes(self.bytes()?));
        let p = Vec3::new(next()?, next()?, next()?);
        if p.is_finite() {
            Ok(p)
        } else {
            Err(CodecError("a coordinate is not finite"))
        }
    }

    fn integer(&mut self) -> Result<IBig, CodecError> {
        let head = self.number()?;
        let length =
            usize::try_from(head >> 1).map_err(|_| CodecError("an integer is too long"))?;
        let (bytes, rest) = self
            .rest
            .split_at_checked(length)
            .ok_or(CodecError("the bytes end too early"))?;
        self.rest = rest;
        let canonical = bytes.last().map_or(head & 1 == 0, |b| *b != 0);
        if !canonical {
            return Err(CodecError("a number is not in its shortest encoding"));
        }
        let size = IBig::from(dashu_int::UBig::from_le_bytes(bytes));
        Ok(if head & 1 == 1 { -size } else { size })
    }

    fn ids(&mut self) -> Result<Vec<u32>, CodecError> {
        let mut last = 0u32;
        (0..self.count(1)?)
            .map(|k| {
                self.take::<u32>()?;
                let step: u32 = self.small()?;
                if k > 0 && step == 0 {
                    return Err(CodecError(
                        "the triangle ids of a hidden group are not in ascending order",
                    ));
                }
                last = last.checked_add(step).ok_or(CodecError(
                    "a triangle id is not below the number of triangles of the scene",
                ))?;
                self.id(last)
            })
            .collect()
    }

    fn hidden(&mut self) -> Result<Vec<HiddenGroup>, CodecError> {
        let mut all = Vec::new();
        for _ in 0..self.count(3)? {
            self.take::<HiddenGroup>()?;
            let target = match self.byte()? {
                0 => Target::Triangle,
                1 => Target::Box(Aabb {
                    min: self.point()?,
                    max: self.point()?,
                }),
                2 => Target::Surfaces,
                3 => Target::Half,
                4 => {
                    // A corner has twelve bytes.
                    let corners = (0..self.count(12)?).map(|_| {
                        self.take::<Vec3>()?;
                        self.point()
                    });
                    Target::Polygon(corners.collect::<Result<_, _>>()?)
                }
                _ => return Err(CodecError("the kind of a target is not in 0 to 4")),
            };
            let triangles = self.ids()?;
            if triangles.is_empty() {
                return Err(CodecError("a hidden group contains no triangles"));
            }
            let proofs = self.proofs()?;
            all.push(HiddenGroup {
                target,
                triangles,
                proofs,
            });
        }
        Ok(all)
    }

    fn proofs(&mut self) -> Result<Vec<Proof>, CodecError> {
        (0..self.count(2)?).map(|_| self.proof()).collect()
    }

    fn proof(&mut self) -> Result<Proof, CodecError> {
        let mut proof = Proof::default();
        let mut last = 0i64;
        self.take::<Proof>()?;
        for _ in 0..self.count(2)? {
            self.take::<Vec<OccluderTriangle>>()?;
            let mut members = Vec::new();
            for _ in 0..self.count(1)? {
                self.take::<OccluderTriangle>()?;
                let x = self.number()?;
                let d = i64::try_from(x >> 2).map_err(|_| {
                    CodecError("a triangle id is not below the number of triangles of the scene")
                })?;
                if d == 0 && x & 2 != 0 {
                    return Err(CodecError(
                        "a difference of triangle ids is 0 but has a minus sign",
                    ));
                }
                last = last.saturating_add(if x & 2 == 0 { d } else { -d });
                let id = u32::try_from(last).map_err(|_| {
                    CodecError("a triangle id is not below the number of triangles of the scene")
                })?;
                members.push(OccluderTriangle {
                    triangle: self.id(id)?,
                    reversed: x & 1 == 1,
                });
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
                        .map_err(|_| CodecError("the index of an occluder exceeds 32 bits"))?,
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
                    let which = match self.byte()? {
                        0 => QueryPolygon::A,
                        1 => QueryPolygon::B,
                        _ => {
                            return Err(CodecError(
                                "the polygon of a division step is neither 0 nor 1",
                            ));
                        }
                    };
                    Step::Divide {
                        polygon: which,
                        from: self.small()?,
                        to: self.small()?,
                    }
                }
                _ => return Err(CodecError("the kind of a step is unknown")),
            };
            proof.steps.push(step);
        }
        Ok(proof)
    }
}
