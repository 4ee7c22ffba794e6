//! The body of the fuzz target `journal`: any bytes as the files of a journal. The tests also run it.

use std::path::{Path, PathBuf};

use super::disk::SystemDisk;
use super::error::JournalError;
use super::journal::{HEADER_BYTES, Journal, JournalPosition, Numbers, replay};
use super::watermark;

/// The numbers that the test records in the watermark.
const NUMBERS: Numbers = Numbers {
    next_job: 7,
    epoch: 2,
};

/// Opens bytes as a journal in a folder, replays it, appends a frame and opens it again.
///
/// The first two bytes are the length of the watermark's file, which follows. The remaining bytes are the
/// journal's file. Returns true if the files are a journal.
///
/// # Panics
/// Panics if an opened journal cannot be replayed, or if frames change. No input may cause that.
pub fn journal(folder: &Path, bytes: &[u8]) -> bool {
    let Some((length, rest)) = bytes.split_first_chunk::<2>() else {
        return false;
    };
    let (marks, frames) = rest.split_at(rest.len().min(u16::from_le_bytes(*length).into()));
    let [path, mark_path] = paths(folder);
    #[expect(clippy::unwrap_used, reason = "the folder can be written")]
    for (path, bytes) in [(&path, frames), (&mark_path, marks)] {
        std::fs::write(path, bytes).unwrap();
    }
    let Ok(mut journal) = Journal::open(&SystemDisk, &path, None) else {
        return false;
    };
    let before = payloads(&path, &journal);
    assert!(before.iter().map(Vec::len).sum::<usize>() <= bytes.len());
    let appended = journal.append(b"the next frame", NUMBERS);
    assert!(appended.is_ok(), "{appended:?}");
    let after = payloads(&path, &journal);
    assert!(after.len() == before.len() + 1 && after.starts_with(&before));
    drop(journal);
    let again = Journal::open(&SystemDisk, &path, None);
    assert!(again.is_ok_and(|again| payloads(&path, &again) == after));
    true
}

/// Returns the paths of the journal and of its watermark.
fn paths(folder: &Path) -> [PathBuf; 2] {
    let path = folder.join("journal");
    let marks = watermark::path_of(&path);
    [path, marks]
}

/// Returns the payloads of all frames.
fn payloads(path: &Path, journal: &Journal) -> Vec<Vec<u8>> {
    let mut payloads = Vec::new();
    let start = JournalPosition {
        offset: HEADER_BYTES,
        chain: journal.id(),
    };
    let visit = |payload: &[u8], _: JournalPosition| {
        payloads.push(payload.to_vec());
        Ok::<(), JournalError>(())
    };
    let replayed = replay(&SystemDisk, path, start, journal.end().offset, visit);
    assert!(matches!(replayed, Ok(true)), "{replayed:?}");
    payloads
}

#[cfg(test)]
mod tests {
    use sightline_numbers::random::SplitMix64;

    use super::*;

    /// Checks mutations of a valid journal. `SIGHTLINE_FUZZ_SEED` selects other mutations.
    #[test]
    fn fuzzed_journals_do_not_crash() {
        let folder = tempfile::tempdir().unwrap();
        let [path, marks] = paths(folder.path());
        let mut valid = Journal::open(&SystemDisk, &path, None).unwrap();
        for length in [1, 30, 500] {
            valid.append(&vec![7; length], NUMBERS).unwrap();
        }
        drop(valid);
        let marks = std::fs::read(marks).unwrap();
        let mut seed = (marks.len() as u16).to_le_bytes().to_vec();
        seed.extend(marks);
        seed.extend(std::fs::read(&path).unwrap());
        assert!(journal(folder.path(), &seed));
        let first = std::env::var("SIGHTLINE_FUZZ_SEED").map_or(1, |text| text.parse().unwrap());
        let mut random = SplitMix64::new(first);
        let mut below = |n: usize| (random.bits() % n.max(1) as u64) as usize;
        let (rounds, mut opened) = (400, 0);
        for round in 0..rounds {
            let mut bytes = seed.clone();
            for _ in 0..1 + below(2) {
                let at = below(bytes.len());
                match below(6) {
                    0 if !bytes.is_empty() => bytes[at] ^= 1 << below(8),
                    1 => bytes.truncate(at),
                    2 => bytes[at..].iter_mut().take(8).for_each(|b| *b = 0),
                    // A length far beyond the end of the file.
                    3 => bytes[at..].iter_mut().take(4).for_each(|b| *b = 0xff),
                    4 => drop(bytes.drain(at..(at + below(20)).min(bytes.len()))),
                    _ => bytes.extend(vec![below(3) as u8; below(60)]),
                }
            }
            let ran = std::panic::catch_unwind(|| journal(folder.path(), &bytes));
            opened += usize::from(ran.unwrap_or_else(|_| panic!("round {round}: {bytes:02x?}")));
        }
        assert!(
            (rounds / 50..rounds - rounds / 50).contains(&opened),
            "{opened} of {rounds} were opened"
        );
    }
}
