//! Tests of the journal: truncation at every byte, every flipped bit, zeroes, old content, and a failing
//! disk.

use super::super::disk::SystemDisk;
use super::super::disk::simulated::{Faults, SimulatedDisk};
use super::*;

const NUMBERS: Numbers = Numbers {
    next_job: 7,
    epoch: 3,
};

fn open(path: &Path) -> Result<Journal, JournalError> {
    Journal::open(&SystemDisk, path, None)
}

fn payloads(path: &Path) -> Result<Vec<Vec<u8>>, JournalError> {
    let journal = open(path)?;
    let mut all = Vec::new();
    let start = JournalPosition {
        offset: HEADER_BYTES,
        chain: journal.id(),
    };
    let reached = replay(
        &SystemDisk,
        path,
        start,
        journal.end().offset,
        |payload, _| {
            all.push(payload.to_vec());
            Ok::<_, JournalError>(())
        },
    )?;
    assert!(reached);
    Ok(all)
}

fn sample() -> Vec<Vec<u8>> {
    (1..8_u8)
        .map(|i| (0..i * 5).map(|j| j.wrapping_mul(i)).collect())
        .collect()
}

/// Writes a journal of the samples. Returns its bytes, and the bytes of its watermark before the last frame.
fn written(path: &Path) -> (Vec<u8>, Vec<u8>) {
    let mut journal = open(path).unwrap();
    let mut before = Vec::new();
    for payload in sample() {
        before = std::fs::read(watermark::path_of(path)).unwrap();
        journal.append(&payload, NUMBERS).unwrap();
    }
    drop(journal);
    (std::fs::read(path).unwrap(), before)
}

fn frame_bytes(payload: &[u8]) -> usize {
    payload.len() + FRAME_HEADER as usize
}

#[test]
fn every_cut_of_acknowledged_journal_is_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let (whole, _) = written(&path);
    for length in 0..whole.len() {
        std::fs::write(&path, &whole[..length]).unwrap();
        assert!(
            matches!(payloads(&path), Err(JournalError::Damaged { .. })),
            "{length}"
        );
        assert_eq!(
            std::fs::read(&path).unwrap(),
            whole[..length],
            "a refused journal must stay as it is"
        );
    }
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(payloads(&path), Err(JournalError::Missing { .. })));
    std::fs::write(&path, &whole).unwrap();
    assert_eq!(payloads(&path).unwrap(), sample());
}

#[test]
fn torn_frame_behind_watermark_is_cut_off() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let (whole, mark) = written(&path);
    let last = whole.len() - frame_bytes(sample().last().unwrap());
    for length in last..=whole.len() {
        std::fs::write(&path, &whole[..length]).unwrap();
        // A crash before the acknowledgement leaves the watermark before the frame.
        std::fs::write(watermark::path_of(&path), &mark).unwrap();
        let found = payloads(&path).unwrap();
        let count = if length == whole.len() {
            sample().len()
        } else {
            sample().len() - 1
        };
        assert_eq!(found, sample()[..count]);
        open(&path).unwrap().append(b"more", NUMBERS).unwrap();
        assert_eq!(payloads(&path).unwrap().last().unwrap(), b"more");
    }
}

#[test]
fn every_flip_and_zeroed_end_is_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let (whole, _) = written(&path);
    let refused = |bytes: &[u8], at: usize| {
        if bytes == whole {
            return;
        }
        std::fs::write(&path, bytes).unwrap();
        match payloads(&path) {
            Err(JournalError::Damaged { offset, .. }) => assert!(offset <= at as u64),
            other => panic!("damage at {at} went unseen: {other:?}"),
        }
        assert_eq!(
            std::fs::read(&path).unwrap(),
            bytes,
            "a refused journal must stay as it is"
        );
    };
    for at in 0..whole.len() {
        for bit in 0..8 {
            let mut flipped = whole.clone();
            flipped[at] ^= 1 << bit;
            refused(&flipped, at);
        }
        let mut zeroed = whole.clone();
        zeroed[at] = 0;
        refused(&zeroed, at);
        zeroed[at..].fill(0);
        refused(&zeroed, at);
    }
}

#[test]
fn frame_is_bound_to_its_place_and_history() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let mut journal = open(&path).unwrap();
    for payload in [b"one!", b"two!", b"six!"] {
        journal.append(payload, NUMBERS).unwrap();
    }
    drop(journal);
    let whole = std::fs::read(&path).unwrap();
    let frame = frame_bytes(b"one!");
    let (first, second) = (HEADER_BYTES as usize, HEADER_BYTES as usize + frame);
    // The disk wrote a frame of the same length to a wrong position.
    let mut moved = whole.clone();
    moved.copy_within(first..first + frame, second);
    std::fs::write(&path, &moved).unwrap();
    assert!(matches!(open(&path), Err(JournalError::Damaged { .. })));
    // The same frame with a corrected predecessor: only its offset differs.
    let previous = whole[first + 12..first + 20].to_vec();
    moved[second + 4..second + 12].copy_from_slice(&previous);
    std::fs::write(&path, &moved).unwrap();
    assert!(matches!(open(&path), Err(JournalError::Damaged { .. })));
    let (_, begins, _) = frame_at(&whole[first..], first as u64).unwrap();
    assert_eq!(begins.offset, first as u64);
    assert!(
        frame_at(&whole[first..], second as u64).is_none(),
        "the check must cover the offset"
    );
    // Another history of the same length, which the watermark does not record.
    let other = directory.path().join("other");
    let mut journal = open(&other).unwrap();
    for payload in [b"one?", b"two?", b"six?"] {
        journal.append(payload, NUMBERS).unwrap();
    }
    std::fs::copy(&other, &path).unwrap();
    assert!(matches!(open(&path), Err(JournalError::Damaged { .. })));
}

#[test]
fn journal_without_watermark_is_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let (whole, before) = written(&path);
    let mark = watermark::path_of(&path);
    let good = std::fs::read(&mark).unwrap();
    for bad in [Vec::new(), vec![0; good.len()]] {
        std::fs::write(&mark, bad).unwrap();
        assert!(matches!(open(&path), Err(JournalError::Damaged { .. })));
    }
    std::fs::remove_file(&mark).unwrap();
    assert!(matches!(open(&path), Err(JournalError::Damaged { .. })));
    assert!(!mark.exists() && std::fs::read(&path).unwrap() == whole);
    // The view can replace the watermark.
    std::fs::write(&mark, &before).unwrap();
    let end = open(&path).unwrap().end();
    std::fs::remove_file(&mark).unwrap();
    let id = u64::from_le_bytes(whole[12..20].try_into().unwrap());
    assert!(Journal::open(&SystemDisk, &path, Some(Watermark::new(id, end, NUMBERS))).is_ok());
}

#[test]
fn view_ahead_of_journal_is_damage() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    written(&path);
    let journal = open(&path).unwrap();
    let end = JournalPosition {
        offset: journal.end().offset + 30,
        chain: 1,
    };
    let ahead = Watermark::new(journal.id(), end, NUMBERS);
    assert!(matches!(
        Journal::open(&SystemDisk, &path, Some(ahead)),
        Err(JournalError::Damaged { .. })
    ));
    // A watermark of another journal has no effect.
    let foreign = Watermark {
        journal: !journal.id(),
        ..ahead
    };
    assert!(Journal::open(&SystemDisk, &path, Some(foreign)).is_ok());
}

#[test]
fn replay_begins_at_frames_only() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let (whole, _) = written(&path);
    let journal = open(&path).unwrap();
    let mut ends = vec![JournalPosition {
        offset: HEADER_BYTES,
        chain: journal.id(),
    }];
    replay(
        &SystemDisk,
        &path,
        ends[0],
        journal.end().offset,
        |_, end| {
            ends.push(end);
            Ok::<_, JournalError>(())
        },
    )
    .unwrap();
    for offset in 0..whole.len() as u64 + 10 {
        let known = ends.iter().position(|end| end.offset == offset);
        for wrong in [0, 1] {
            let chain = known.map_or(0, |at| ends[at].chain) ^ wrong;
            let mut seen = 0;
            let reached = replay(
                &SystemDisk,
                &path,
                JournalPosition { offset, chain },
                journal.end().offset,
                |_, _| {
                    seen += 1;
                    Ok::<_, JournalError>(())
                },
            )
            .unwrap();
            match known.filter(|_| wrong == 0) {
                Some(index) => assert_eq!((reached, seen), (true, sample().len() - index)),
                None => assert_eq!((reached, seen), (false, 0)),
            }
        }
    }
}

/// Creates a journal of the samples on a simulated disk.
fn on_simulated_disk() -> (SimulatedDisk, PathBuf, Journal) {
    let disk = SimulatedDisk::new(1);
    let path = PathBuf::from("/state/journal");
    disk::create_folder(&disk, Path::new("/state")).unwrap();
    let mut journal = Journal::open(&disk, &path, None).unwrap();
    for payload in sample() {
        journal.append(&payload, NUMBERS).unwrap();
    }
    (disk, path, journal)
}

fn count(disk: &SimulatedDisk, path: &Path) -> usize {
    let journal = Journal::open(disk, path, None).unwrap();
    let mut count = 0;
    let start = JournalPosition {
        offset: HEADER_BYTES,
        chain: journal.id(),
    };
    replay(disk, path, start, journal.end().offset, |_, _| {
        count += 1;
        Ok::<_, JournalError>(())
    })
    .unwrap();
    count
}

#[test]
fn append_on_full_disk_leaves_journal_unchanged() {
    let (disk, path, mut journal) = on_simulated_disk();
    disk.set_room(Some(32));
    assert!(matches!(
        journal.append(&[7; 13], NUMBERS),
        Err(JournalError::NoSpace { .. })
    ));
    // Payloads that still fit are accepted.
    disk.set_room(Some(32));
    journal.append(&[7; 12], NUMBERS).unwrap();
    drop(journal);
    assert_eq!(count(&disk, &path), sample().len() + 1);
}

#[test]
fn failed_sync_ends_journal() {
    let (disk, _, mut journal) = on_simulated_disk();
    disk.set_faults(Faults {
        sync: 1,
        ..Faults::default()
    });
    assert!(matches!(
        journal.append(b"x", NUMBERS),
        Err(JournalError::Unusable { .. })
    ));
    disk.set_faults(Faults::default());
    assert!(matches!(
        journal.append(b"x", NUMBERS),
        Err(JournalError::Unusable { .. })
    ));
}

#[test]
fn journal_opens_after_failed_write_of_watermark() {
    for seed in 0..3000 {
        let disk = SimulatedDisk::new(seed);
        let path = PathBuf::from("/state/journal");
        disk::create_folder(&disk, Path::new("/state")).unwrap();
        let mut journal = Journal::open(&disk, &path, None).unwrap();
        journal.append(b"one", NUMBERS).unwrap();
        // The write fails after none, some or all of its bytes were written.
        disk.set_faults(Faults {
            write: 2,
            ..Faults::default()
        });
        let appended = journal.append(b"two", NUMBERS).is_ok();
        disk.set_faults(Faults::default());
        drop(journal);
        assert!(count(&disk, &path) > usize::from(appended), "seed {seed}");
    }
}

#[test]
fn appended_frame_survives_power_failure() {
    for seed in 0..40 {
        let disk = SimulatedDisk::new(seed);
        let path = PathBuf::from("/state/journal");
        disk::create_folder(&disk, Path::new("/state")).unwrap();
        let mut journal = Journal::open(&disk, &path, None).unwrap();
        for payload in sample() {
            journal.append(&payload, NUMBERS).unwrap();
        }
        disk.power_off();
        disk.power_on();
        assert_eq!(count(&disk, &path), sample().len(), "seed {seed}");
    }
}

#[test]
fn too_long_frame_is_not_written() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let (whole, _) = written(&path);
    let mut journal = open(&path).unwrap();
    let long = vec![0; MAX_FRAME_BYTES + 1];
    assert!(matches!(
        journal.append(&long, NUMBERS),
        Err(JournalError::Write { .. })
    ));
    drop(journal);
    assert_eq!(std::fs::read(&path).unwrap(), whole);
}
