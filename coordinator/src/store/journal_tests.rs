//! The journal against truncation at every byte, every byte flipped, and a disk that fills up.

use super::*;

fn payloads(path: &Path) -> Result<Vec<Vec<u8>>, JournalError> {
    let journal = Journal::open(path)?;
    let mut all = Vec::new();
    let reached = replay(path, HEADER_BYTES, journal.end(), |payload, _| {
        all.push(payload.to_vec());
        Ok::<_, JournalError>(())
    })?;
    assert!(reached);
    Ok(all)
}

fn sample() -> Vec<Vec<u8>> {
    (1..8_u8).map(|i| (0..i * 5).map(|j| j.wrapping_mul(i)).collect()).collect()
}

fn written(path: &Path) -> Vec<u8> {
    let mut journal = Journal::open(path).unwrap();
    for payload in sample() {
        journal.append(&payload).unwrap();
    }
    drop(journal);
    std::fs::read(path).unwrap()
}

#[test]
fn cut_anywhere_it_is_a_prefix_or_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let whole = written(&path);
    for length in 0..whole.len() {
        std::fs::write(&path, &whole[..length]).unwrap();
        match payloads(&path) {
            Ok(found) => {
                assert!(length >= HEADER_BYTES as usize);
                assert_eq!(found, sample()[..found.len()]);
                // Only the truncated frame is gone, and a frame can be appended to the rest.
                let kept = HEADER_BYTES as usize + found.iter().map(|p| p.len() + 8).sum::<usize>();
                assert!(kept <= length && length < kept + 8 + sample()[found.len()].len());
                Journal::open(&path).unwrap().append(b"more").unwrap();
                assert_eq!(payloads(&path).unwrap().last().unwrap(), b"more");
            }
            Err(JournalError::BadHeader { .. }) => assert!(length < HEADER_BYTES as usize),
            Err(other) => panic!("{other}"),
        }
    }
}

#[test]
fn any_bit_flipped_is_refused_unless_in_the_last_frame() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let whole = written(&path);
    let last = whole.len() - sample().last().unwrap().len() - 8;
    for at in 0..whole.len() {
        for bit in 0..8 {
            let mut flipped = whole.clone();
            flipped[at] ^= 1 << bit;
            std::fs::write(&path, &flipped).unwrap();
            match payloads(&path) {
                Ok(found) => {
                    assert!(at >= last, "a flip at {at} went unseen");
                    assert_eq!(found, sample()[..sample().len() - 1]);
                }
                Err(JournalError::BadHeader { .. }) => assert!(at < HEADER_BYTES as usize),
                Err(JournalError::Corrupt { offset, .. }) => {
                    assert!(at < last && offset <= at as u64 && offset >= HEADER_BYTES);
                    assert_eq!(
                        std::fs::read(&path).unwrap(),
                        flipped,
                        "a refused journal must stay as it is"
                    );
                }
                Err(other) => panic!("{other}"),
            }
        }
    }
}

#[test]
fn replay_begins_at_frames_only() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let whole = written(&path);
    let journal = Journal::open(&path).unwrap();
    let mut ends = vec![HEADER_BYTES];
    replay(&path, HEADER_BYTES, journal.end(), |_, end| {
        ends.push(end);
        Ok::<_, JournalError>(())
    })
    .unwrap();
    for from in 0..whole.len() as u64 + 10 {
        let mut seen = 0;
        let reached = replay(&path, from, journal.end(), |_, _| {
            seen += 1;
            Ok::<_, JournalError>(())
        })
        .unwrap();
        match ends.iter().position(|&end| end == from) {
            Some(index) => assert_eq!((reached, seen), (true, sample().len() - index)),
            None => assert_eq!((reached, seen), (false, 0)),
        }
    }
}

/// A file on a disk of a given size, whose sync fails on demand.
struct SmallDisk {
    file: File,
    size: u64,
    sync_fails: bool,
}

impl LogFile for SmallDisk {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let room = (self.size - self.file.metadata()?.len()) as usize;
        if room < bytes.len() {
            self.file.write_all(&bytes[..room])?;
            return Err(ErrorKind::StorageFull.into());
        }
        self.file.write_all(bytes)
    }
    fn sync(&mut self) -> io::Result<()> {
        if self.sync_fails { Err(io::Error::other("lost")) } else { self.file.sync_data() }
    }
    fn truncate(&mut self, length: u64) -> io::Result<()> {
        LogFile::truncate(&mut self.file, length)
    }
}

fn on_small_disk(path: &Path, room: u64, sync_fails: bool) -> Journal {
    let mut journal = Journal::open(path).unwrap();
    let file = OpenOptions::new().append(true).open(path).unwrap();
    journal.file = Box::new(SmallDisk { file, size: journal.end + room, sync_fails });
    journal
}

#[test]
fn a_full_disk_refuses_and_leaves_the_journal_as_it_was() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let whole = written(&path);
    let mut journal = on_small_disk(&path, 20, false);
    assert!(matches!(journal.append(&[7; 13]), Err(JournalError::NoSpace { .. })));
    assert_eq!(std::fs::read(&path).unwrap(), whole);
    // Payloads that still fit are accepted.
    journal.append(&[7; 12]).unwrap();
    assert_eq!(payloads(&path).unwrap().last().unwrap(), &[7; 12]);
}

#[test]
fn after_a_failed_sync_nothing_is_accepted() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    written(&path);
    let mut journal = on_small_disk(&path, 1000, true);
    assert!(matches!(journal.append(b"x"), Err(JournalError::Unusable { .. })));
    journal.file = Box::new(File::create(directory.path().join("other")).unwrap());
    assert!(matches!(journal.append(b"x"), Err(JournalError::Unusable { .. })));
}

#[test]
fn a_longer_frame_than_may_be_read_is_not_written() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("journal");
    let whole = written(&path);
    let mut journal = Journal::open(&path).unwrap();
    assert!(matches!(journal.append(&vec![0; MAX_FRAME_BYTES + 1]), Err(JournalError::Write { .. })));
    drop(journal);
    assert_eq!(std::fs::read(&path).unwrap(), whole);
}
