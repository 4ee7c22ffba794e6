//! Tests of damage at every byte of an acknowledged journal. Every damage causes an error that reports the
//! loss, and a repair never reuses a number.

use std::collections::BTreeSet;
use std::io::Write as _;
use std::sync::Arc;

use sightline_records::{NewJob, SceneRecord};

use super::super::disk::simulated::SimulatedDisk;
use super::super::disk::{Access, read_up_to};
use super::super::error::JournalError;
use super::super::journal::Journal;
use super::super::sled_store::SledStore;
use super::super::{Queries as _, Store as _, engine::Engine};
use super::*;

const FOLDER: &str = "/data/state";
const JOBS: u64 = 20;

/// A kind of damage that begins at one byte of a file.
#[derive(Clone, Copy, Debug)]
enum Harm {
    Flip,
    Cut,
    Zeroes,
}

impl Harm {
    fn apply(self, whole: &[u8], at: usize) -> Vec<u8> {
        let mut bytes = whole.to_vec();
        match self {
            Self::Flip => bytes[at] ^= 1 << (at % 8),
            Self::Cut => bytes.truncate(at),
            Self::Zeroes => bytes[at..].fill(0),
        }
        bytes
    }
}

fn path() -> PathBuf {
    Path::new(FOLDER).join("journal")
}

fn job(n: u64) -> NewJob {
    NewJob {
        key: *blake3::hash(&n.to_le_bytes()).as_bytes(),
        request_id: format!("request {n}"),
        name: String::new(),
        owner: String::new(),
        user: String::new(),
        priority: 0,
        scene: [7; 32],
        spec: vec![1; 30],
        tiles: 1,
        submitted_at_ms: n,
    }
}

fn scene() -> SceneRecord {
    SceneRecord {
        digest: [7; 32],
        bytes: 1,
        triangles: 1,
        objects: 1,
        owners: Default::default(),
    }
}

/// The files of a store with 20 acknowledged jobs, and its view.
struct Acknowledged {
    journal: Vec<u8>,
    mark: Vec<u8>,
    view: ViewEntries,
}

fn acknowledged() -> Acknowledged {
    let disk = SimulatedDisk::new(0);
    let store = SledStore::open_on(Arc::new(disk.clone()), Path::new(FOLDER)).unwrap();
    store.begin_epoch().unwrap();
    store.record_scene(scene()).unwrap();
    (1..=JOBS).for_each(|n| assert_eq!(store.submit_job(job(n)).unwrap().id, JobId(n)));
    let entries: BTreeMap<Bytes, Bytes> = store
        .query(|view| view.0.scan(&[]))
        .unwrap()
        .into_iter()
        .collect();
    drop(store);
    let read = |path: &Path| read_up_to(&disk, path, u64::MAX).unwrap();
    let mark_path = watermark::path_of(&path());
    let mark = watermark::read(&disk, &mark_path).unwrap()[0];
    Acknowledged {
        journal: read(&path()),
        mark: read(&mark_path),
        view: (mark, entries),
    }
}

/// Creates a disk with these files.
fn disk_of(journal: &[u8], mark: &[u8]) -> SimulatedDisk {
    let disk = SimulatedDisk::new(0);
    disk::create_folder(&disk, Path::new(FOLDER)).unwrap();
    for (path, bytes) in [(path(), journal), (watermark::path_of(&path()), mark)] {
        disk.open(&path, Access::Create)
            .unwrap()
            .write_all(bytes)
            .unwrap();
    }
    disk
}

fn jobs(entries: &BTreeMap<Bytes, Bytes>) -> BTreeSet<u64> {
    View(entries)
        .jobs()
        .unwrap()
        .iter()
        .map(|job| job.id.0)
        .collect()
}

/// Checks the error, the loss and the repair of one damaged journal.
fn check(files: &Acknowledged, harm: Harm, at: usize) {
    let harmed = harm.apply(&files.journal, at);
    if harmed == files.journal {
        return;
    }
    let disk = disk_of(&harmed, &files.mark);
    match Journal::open(&disk, &path(), None) {
        Err(JournalError::Damaged { .. }) => {}
        Err(other) => panic!("{harm:?} at {at}: {other}"),
        Ok(_) => panic!("{harm:?} at {at} went unseen"),
    }
    assert_eq!(
        read_up_to(&disk, &path(), u64::MAX).unwrap(),
        harmed,
        "{harm:?} at {at} changed the file"
    );
    // With the view, no change is lost.
    let whole = read(&disk, &path(), Some(files.view.clone())).unwrap();
    let damage = whole.damage.as_ref().unwrap();
    assert!(
        !damage.is_loss && damage.lost_jobs.is_none(),
        "{harm:?} at {at}: {damage:?}"
    );
    assert_eq!(whole.entries, files.view.1, "{harm:?} at {at}");
    // Without the view, the report names the lost jobs.
    let part = read(&disk, &path(), None).unwrap();
    let damage = part.damage.clone().unwrap();
    let present = jobs(&part.entries);
    let lost: BTreeSet<u64> = damage
        .lost_jobs
        .map_or(BTreeSet::new(), |(a, b)| (a.0..=b.0).collect());
    assert!(present.is_disjoint(&lost), "{harm:?} at {at}");
    assert_eq!(
        present.union(&lost).copied().collect::<BTreeSet<_>>(),
        (1..=JOBS).collect(),
        "{harm:?} at {at}"
    );
    assert_eq!(
        damage.is_loss,
        part.entries != files.view.1,
        "{harm:?} at {at}"
    );
    // A repair keeps the damaged bytes, and continues behind every assigned number.
    let copy = replace(&disk, &path(), part).unwrap().unwrap();
    assert_eq!(read_up_to(&disk, &copy, u64::MAX).unwrap(), harmed);
    let store = SledStore::open_on(Arc::new(disk), Path::new(FOLDER)).unwrap();
    assert_eq!(
        store
            .jobs()
            .unwrap()
            .iter()
            .map(|job| job.id.0)
            .collect::<BTreeSet<_>>(),
        present
    );
    store.record_scene(scene()).unwrap();
    assert!(
        store.submit_job(job(99)).unwrap().id.0 > JOBS,
        "{harm:?} at {at} gave a number out again"
    );
    assert!(store.begin_epoch().unwrap() > 1);
}

fn check_each(stride: usize) {
    let files = acknowledged();
    for at in (0..files.journal.len()).step_by(stride) {
        [Harm::Flip, Harm::Cut, Harm::Zeroes]
            .into_iter()
            .for_each(|harm| check(&files, harm, at));
    }
}

#[test]
fn damage_loses_no_job_silently() {
    check_each(61);
}

#[test]
#[ignore = "takes minutes; scripts/nightly.sh runs it"]
fn damage_at_every_byte_loses_no_job_silently() {
    check_each(1);
}

#[test]
fn repair_uses_readable_frames_around_bad_sector() {
    let files = acknowledged();
    for at in (0..files.journal.len()).step_by(512) {
        let disk = disk_of(&files.journal, &files.mark);
        disk.spoil(&path(), at);
        let Err(JournalError::Io { source, .. }) = Journal::open(&disk, &path(), None) else {
            panic!("the sector at {at} was read");
        };
        assert!(disk::is_unreadable(&source), "{source}");
        let whole = read(&disk, &path(), Some(files.view.clone())).unwrap();
        assert!(
            !whole.damage.unwrap().is_loss && whole.entries == files.view.1,
            "sector at {at}"
        );
        let part = read(&disk, &path(), None).unwrap();
        let (present, damage) = (jobs(&part.entries), part.damage.clone().unwrap());
        let lost = damage
            .lost_jobs
            .map_or(BTreeSet::new(), |(a, b)| (a.0..=b.0).collect());
        assert!(
            !lost.is_empty() && present.len() + lost.len() == JOBS as usize,
            "sector at {at}"
        );
        replace(&disk, &path(), part).unwrap().unwrap();
        let store = SledStore::open_on(Arc::new(disk), Path::new(FOLDER)).unwrap();
        assert_eq!(jobs_of(&store), present, "sector at {at}");
    }
}

#[test]
fn unreadable_slot_of_watermark_counts_as_damaged() {
    let files = acknowledged();
    let disk = disk_of(&files.journal, &files.mark);
    disk.spoil(&watermark::path_of(&path()), 600);
    assert!(Journal::open(&disk, &path(), Some(files.view.0)).is_ok());
    let part = read(&disk, &path(), None).unwrap();
    assert_eq!(jobs(&part.entries).len(), JOBS as usize);
    if part.damage.is_some() {
        replace(&disk, &path(), part).unwrap();
    }
    assert_eq!(
        jobs_of(&SledStore::open_on(Arc::new(disk), Path::new(FOLDER)).unwrap()).len(),
        JOBS as usize
    );
}

#[test]
fn lost_watermark_is_noticed() {
    let files = acknowledged();
    let disk = disk_of(&files.journal, &files.mark);
    assert!(
        read(&disk, &path(), Some(files.view.clone()))
            .unwrap()
            .is_marked
    );
    let without = disk_of(&files.journal, &[]);
    let salvage = read(&without, &path(), Some(files.view.clone())).unwrap();
    assert!(salvage.damage.is_none() && !salvage.is_marked);
    // Without the view, too, the length of the journal is unknown.
    assert!(
        read(&without, &path(), None)
            .unwrap()
            .damage
            .unwrap()
            .is_unmeasured
    );
}

fn jobs_of(store: &SledStore) -> BTreeSet<u64> {
    store.jobs().unwrap().iter().map(|job| job.id.0).collect()
}

#[test]
fn repair_without_watermark_skips_numbers_of_unreadable_bytes() {
    let files = acknowledged();
    let at = files.journal.len() / 2;
    let disk = disk_of(&Harm::Zeroes.apply(&files.journal, at), &[]);
    let part = read(&disk, &path(), None).unwrap();
    let present = jobs(&part.entries);
    let damage = part.damage.clone().unwrap();
    assert!(damage.is_loss && damage.is_unmeasured && present.len() < JOBS as usize);
    assert!(damage.loss().contains("jobs may be lost"));
    replace(&disk, &path(), part).unwrap();
    let store = SledStore::open_on(Arc::new(disk), Path::new(FOLDER)).unwrap();
    store.record_scene(scene()).unwrap();
    assert!(store.submit_job(job(99)).unwrap().id.0 > JOBS);
}

#[test]
fn missing_journal_is_damage_only_if_frames_were_acknowledged() {
    let files = acknowledged();
    let disk = disk_of(&files.journal, &files.mark);
    disk.remove(&path()).unwrap();
    let part = read(&disk, &path(), Some(files.view.clone())).unwrap();
    assert_eq!(
        (part.entries, part.damage.unwrap().is_loss),
        (files.view.1.clone(), false)
    );
    let nothing = read(&disk, &path(), None).unwrap();
    let lost = nothing.damage.as_ref().unwrap().lost_jobs;
    assert_eq!(lost, Some((JobId(1), JobId(JOBS))));
    replace(&disk, &path(), nothing).unwrap();
    let store = SledStore::open_on(Arc::new(disk), Path::new(FOLDER)).unwrap();
    store.record_scene(scene()).unwrap();
    assert_eq!(store.submit_job(job(99)).unwrap().id, JobId(JOBS + 1));
    // A store that was just created has no changes to lose.
    let new = SimulatedDisk::new(0);
    disk::create_folder(&new, Path::new(FOLDER)).unwrap();
    assert!(read(&new, &path(), None).unwrap().damage.is_none());
}

#[test]
fn interrupted_repair_can_be_repeated() {
    let files = acknowledged();
    let harmed = Harm::Flip.apply(&files.journal, files.journal.len() / 2);
    for seed in 0..60 {
        let disk = SimulatedDisk::new(seed);
        disk::create_folder(&disk, Path::new(FOLDER)).unwrap();
        for (path, bytes) in [
            (path(), &harmed),
            (watermark::path_of(&path()), &files.mark),
        ] {
            disk::replace(&disk, &path, &path.with_extension("beside"), bytes).unwrap();
        }
        // An operation of the repair meets a full disk, and then the power fails.
        disk.set_room(Some(seed * 700));
        let part = read(&disk, &path(), Some(files.view.clone())).unwrap();
        let done = replace(&disk, &path(), part).is_ok();
        disk.power_off();
        disk.power_on();
        disk.set_room(None);
        if !done {
            let part = read(&disk, &path(), Some(files.view.clone())).unwrap();
            // The power may have failed after the new journal was in its place.
            if part.damage.is_some() {
                replace(&disk, &path(), part).unwrap();
            }
        }
        let store = SledStore::open_on(Arc::new(disk), Path::new(FOLDER)).unwrap();
        assert_eq!(store.jobs().unwrap().len() as u64, JOBS, "seed {seed}");
    }
}
