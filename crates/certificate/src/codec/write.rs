//! The encoder of certificates.

use dashu_int::{IBig, Sign};
use glam::Vec3;
use sightline_numbers::memory::other_than_exhaustion;
use sightline_numbers::varint::write as put;

use super::{APART, LEVEL, MAX_BYTES};
use crate::certificate::{CellCertificate, HiddenGroup, Target, Witness};
use crate::proof::{OccluderTriangle, Proof, QueryPolygon, Step};

/// Encodes and compresses a certificate.
///
/// # Errors
/// An error if the certificate has more than 256 MiB before compression, or if zstd fails.
pub fn encode(certificate: &CellCertificate) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    put(&mut out, certificate.seen.len() as u64);
    let mut last = 0;
    for (id, witness) in &certificate.seen {
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
    put_hidden(&mut out, &certificate.hidden);
    // If the cell is in no cell group and the certificate has no hidden boxes, the certificate ends here.
    let above = certificate.above.map_or(0, |back| u64::from(back) + 1);
    if !certificate.apart.is_empty() {
        put(&mut out, above + APART);
        out.push(u8::from(certificate.shared.is_some()));
        if let Some(shared) = &certificate.shared {
            shared
                .bounds
                .corners()
                .iter()
                .for_each(|c| put_point(&mut out, *c));
            put_hidden(&mut out, &shared.hidden);
        }
        put(&mut out, certificate.apart.len() as u64);
        for hidden_box in &certificate.apart {
            hidden_box
                .bounds
                .corners()
                .iter()
                .for_each(|c| put_point(&mut out, *c));
            put(&mut out, hidden_box.proofs.len() as u64);
            hidden_box
                .proofs
                .iter()
                .for_each(|p| put_proof(&mut out, p));
        }
    } else if certificate.shared.is_some() || certificate.above.is_some() {
        put(&mut out, above);
        if let Some(shared) = &certificate.shared {
            shared
                .bounds
                .corners()
                .iter()
                .for_each(|c| put_point(&mut out, *c));
            put_hidden(&mut out, &shared.hidden);
        }
    }
    if out.len() as u64 > MAX_BYTES {
        return Err(std::io::Error::other(
            "the uncompressed certificate of a cell exceeds 256 MiB; bake smaller cells or smaller groups \
             (--block-cells)",
        ));
    }
    zstd::stream::encode_all(out.as_slice(), LEVEL).map_err(other_than_exhaustion)
}

fn put_hidden(out: &mut Vec<u8>, hidden: &[HiddenGroup]) {
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
            Target::Box(of) => {
                out.push(1);
                of.corners().iter().for_each(|c| put_point(out, *c));
            }
        }
        put_ids(out, &h.triangles);
        put(out, h.proofs.len() as u64);
        h.proofs.iter().for_each(|p| put_proof(out, p));
    }
}

fn put_point(out: &mut Vec<u8>, p: Vec3) {
    p.to_array()
        .iter()
        .for_each(|c| out.extend(c.to_le_bytes()));
}

fn put_integer(out: &mut Vec<u8>, x: &IBig) {
    let (sign, size) = x.clone().into_parts();
    let bytes = size.to_le_bytes();
    put(
        out,
        (bytes.len() as u64) << 1 | u64::from(sign == Sign::Negative),
    );
    out.extend_from_slice(&bytes);
}

/// Writes the number of ids, the first id, and the differences of the following ids, each at least 1.
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
        for OccluderTriangle {
            triangle: id,
            reversed,
        } in occluder
        {
            // Store the difference to the previous id, its sign, and the winding: one byte for neighbouring
            // ids.
            let d = i64::from(*id) - last;
            last = i64::from(*id);
            put(
                out,
                (d.unsigned_abs() << 1 | u64::from(d < 0)) << 1 | u64::from(*reversed),
            );
        }
    }
    put(out, proof.steps.len() as u64);
    for step in &proof.steps {
        match step {
            Step::Unreal => out.push(0),
            Step::Block {
                occluder,
                negative,
                cuts,
            } => {
                // The low two bits are the kind of the step: 1 for a block on the positive side, and 2 for a
                // block on the negative side.
                put(
                    out,
                    (u64::from(*occluder) << 2) | (1 + u64::from(*negative)),
                );
                put(out, cuts.len() as u64);
                cuts.iter().for_each(|c| put(out, u64::from(*c)));
            }
            Step::Split { polar } => {
                // The value 11 is kind 3 with number 2. (The value 3, kind 3 with number 0, was a polar in
                // doubles and is no longer valid.)
                out.push(11);
                polar.iter().for_each(|c| put_integer(out, c));
            }
            Step::Divide {
                polygon: of,
                from,
                to,
            } => {
                out.push(7);
                out.push(u8::from(*of == QueryPolygon::B));
                put(out, u64::from(*from));
                put(out, u64::from(*to));
            }
        }
    }
}
