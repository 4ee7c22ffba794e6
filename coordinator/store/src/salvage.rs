//! Repair of a damaged journal: the entries that can still be read, and the lost acknowledged changes.
//!
//! The view is made from the journal and has its own checksums, so it often contains the changes of a damaged
//! frame. The salvaged entries come from the good frames before the damage or, if the view contains more,
//! from the view. In both cases, the good frames that continue the chain from there are added. Numbers of
//! jobs and epochs continue after the highest numbers in a watermark, the view or a readable frame.
//!
//! A repair writes a new journal of these entries and moves the damaged one to `damaged/` in the same folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use sightline_records::ids::JobId;

use super::compaction;
use super::disk::{self, Disk, ZeroUnreadable};
use super::entries::Entry;
use super::error::StoreError;
use super::journal::{self, HEADER_BYTES, Inspected, JournalPosition, Numbers};
use super::lock::fault;
use super::rules::{self, StateChange};
use super::table::{Bytes, Changes, View, encode, key};
use super::watermark::{self, Watermark};

/// The minimum length of a submission event, in bytes. It bounds the number of jobs in unreadable bytes.
const SUBMISSION_BYTES: u64 = 128;

/// The entries of a view, and the acknowledged part of the journal that they contain.
pub(super) type ViewEntries = (Watermark, BTreeMap<Bytes, Bytes>);

/// The readable state of a journal.
pub(super) struct Salvage {
    /// The surviving entries.
    pub(super) entries: BTreeMap<Bytes, Bytes>,
    /// The damage, or `None` if the journal is intact.
    pub(super) damage: Option<Damage>,
    /// True if a watermark of the journal was readable. Without one, a journal with a lost end may look
    /// complete.
    pub(super) is_marked: bool,
    /// The next job number and the epoch with which a repaired store continues.
    numbers: Numbers,
}

/// Damage to acknowledged frames, and its consequences.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// The offset of the first bad frame, in bytes.
    pub offset: u64,
    /// The description of the fault.
    pub what: String,
    /// The numbers of the first and the last job that were submitted in the lost part.
    pub lost_jobs: Option<(JobId, JobId)>,
    /// True if acknowledged changes are lost.
    pub is_loss: bool,
    /// True if no watermark survived, so that the loss may exceed [`Damage::lost_jobs`].
    pub is_unmeasured: bool,
}

impl Damage {
    /// Returns a sentence that describes the loss.
    pub fn loss(&self) -> String {
        match self.lost_jobs {
            _ if !self.is_loss && !self.is_unmeasured => {
                "a repair loses nothing, because the other frames or the view have these changes".to_owned()
            }
            _ if self.is_unmeasured => {
                "no record of the acknowledged length survived, so that jobs may be lost; compare the list \
                 of jobs with a backup"
                    .to_owned()
            }
            None => "the latest acknowledged changes of jobs are lost".to_owned(),
            Some((first, last)) if first == last => {
                format!("job {first} and the latest changes of other jobs are lost")
            }
            Some((first, last)) => {
                format!("jobs {first} to {last} and the latest changes of other jobs are lost")
            }
        }
    }
}

/// Reads the journal at `path` without changing it. Unreadable sectors count as damaged frames.
///
/// `view` contains the entries of the view, if they are intact.
///
/// # Errors
/// An error if the disk fails, or if another version of the program wrote the journal.
pub(super) fn read(
    disk: &dyn Disk,
    path: &Path,
    view: Option<ViewEntries>,
) -> Result<Salvage, StoreError> {
    let disk = &ZeroUnreadable(disk);
    let marks = watermark::read(disk, &watermark::path_of(path))?;
    let seen = view.as_ref().map(|(mark, _)| *mark);
    let mut entries = BTreeMap::new();
    let inspected = match disk.attributes(path).map_err(fault("look for", path))? {
        None => Inspected::missing(&marks, seen),
        Some(_) => {
            let visit = |payload: &[u8], end: JournalPosition| apply(payload, end, &mut entries);
            journal::inspect(disk, path, &marks, seen, visit)?
        }
    };
    let Inspected {
        id,
        mut end,
        length,
        acknowledged,
        mut is_met,
        damage,
    } = inspected;
    let is_marked = length <= HEADER_BYTES || marks.iter().any(|mark| mark.journal == id);
    let Some((offset, what)) = damage else {
        let numbers = View(&entries).numbers()?;
        return Ok(Salvage {
            entries,
            damage: None,
            is_marked,
            numbers,
        });
    };
    let is_acknowledged =
        |end: JournalPosition| acknowledged.is_some_and(|mark| mark.place() == end);
    if let Some((mark, of_view)) = view
        && mark.journal == id
        && mark.length > end.offset
    {
        (entries, end) = (of_view, mark.place());
        is_met |= is_acknowledged(end);
    }
    // Frames behind the damage count only if they continue the chain. Their numbers always count.
    let measured = acknowledged.map_or(HEADER_BYTES, |mark| mark.length);
    let (mut submitted, mut begun, mut last, mut unreadable) = (0, 0, HEADER_BYTES, 0);
    if length > 0 {
        journal::scattered_frames(disk, path, HEADER_BYTES, |payload, begins, next| {
            unreadable += begins.offset.saturating_sub(last.max(measured));
            last = next.offset;
            // A frame of another version stays unread. The reported loss includes it.
            let Ok(events) = rules::events(payload, next.offset) else {
                return Ok(());
            };
            for event in &events {
                match event {
                    StateChange::JobSubmitted(job) => submitted = submitted.max(job.id.0),
                    StateChange::EpochBegun(epoch) => begun = begun.max(*epoch),
                    _ => {}
                }
            }
            if begins == end {
                apply(payload, next, &mut entries)?;
                end = next;
                is_met |= is_acknowledged(end);
            }
            Ok::<_, StoreError>(())
        })?;
    }
    let own = View(&entries).numbers()?;
    let known = acknowledged.map_or(own, |mark| mark.numbers());
    if acknowledged.is_none() {
        unreadable += length.saturating_sub(last);
    }
    // Unreadable bytes behind the watermark contain at most this number of submissions.
    let unknown = unreadable / SUBMISSION_BYTES;
    let next_job = own.next_job.max(known.next_job).max(submitted + 1) + unknown;
    let numbers = Numbers {
        next_job,
        epoch: own.epoch.max(known.epoch).max(begun) + unknown,
    };
    let is_whole = if acknowledged.is_some() {
        is_met
    } else {
        end.offset >= length && length >= HEADER_BYTES
    };
    let is_loss = !is_whole || end.offset < last;
    let lost = (JobId(own.next_job), JobId(next_job - 1));
    let lost_jobs = Some(lost).filter(|(first, last)| is_loss && first <= last);
    let is_unmeasured = acknowledged.is_none();
    let damage = Some(Damage {
        offset,
        what,
        lost_jobs,
        is_loss,
        is_unmeasured,
    });
    Ok(Salvage {
        entries,
        damage,
        is_marked,
        numbers,
    })
}

/// Replaces a damaged journal by a new one with the salvaged entries, and keeps a copy of the damaged
/// journal.
///
/// Returns the path of the copy, or `None` if the journal did not exist.
///
/// # Errors
/// An error if the disk fails. A crash or an error leaves either the damaged journal or the new one in place.
pub(super) fn replace(
    disk: &dyn Disk,
    path: &Path,
    salvage: Salvage,
) -> Result<Option<PathBuf>, StoreError> {
    let Salvage {
        mut entries,
        numbers,
        ..
    } = salvage;
    let copy = match disk.attributes(path).map_err(fault("look for", path))? {
        None => None,
        Some(found) => Some(keep(disk, path, found.length)?),
    };
    let Numbers { next_job, epoch } = numbers;
    entries.insert(
        key::NEXT_JOB.to_vec(),
        encode(key::NEXT_JOB, &JobId(next_job))?,
    );
    entries.insert(key::EPOCH.to_vec(), encode(key::EPOCH, &epoch)?);
    let entries: Vec<Entry> = entries
        .into_iter()
        .map(|(key, value)| Entry { key, value })
        .collect();
    compaction::replace(disk, path, &entries, numbers)?;
    Ok(copy)
}

/// Keeps a damaged journal in the folder `damaged`, for inspection, and returns its path.
///
/// A hard link also preserves sectors that cannot be read now.
fn keep(disk: &dyn Disk, path: &Path, length: u64) -> Result<PathBuf, StoreError> {
    let state = path.parent().unwrap_or(path);
    let folder = state.join("damaged");
    disk.create_folder(&folder)
        .map_err(fault("create", &folder))?;
    let mut number = disk.list(&folder).map_err(fault("list", &folder))?.len() + 1;
    let mut to = folder.join(format!("journal-{number}"));
    while disk
        .attributes(&to)
        .map_err(fault("look for", &to))?
        .is_some()
    {
        number += 1;
        to = folder.join(format!("journal-{number}"));
    }
    if disk.link(path, &to).is_ok() {
        disk.sync_folder(&folder).map_err(fault("sync", &folder))?;
    } else {
        // Some file systems do not support links.
        let bytes =
            disk::read_up_to(&ZeroUnreadable(disk), path, length).map_err(fault("read", path))?;
        disk::replace(disk, &to, &folder.join("unfinished"), &bytes)
            .map_err(fault("write", &to))?;
    }
    disk.sync_folder(state).map_err(fault("sync", state))?;
    Ok(to)
}

/// Applies the events of a frame to the entries.
fn apply(
    payload: &[u8],
    end: JournalPosition,
    entries: &mut BTreeMap<Bytes, Bytes>,
) -> Result<(), StoreError> {
    let mut changes = Changes::new();
    for event in rules::events(payload, end.offset)? {
        rules::stage(&event, entries, &mut changes)?;
    }
    for (key, value) in changes {
        match value {
            Some(value) => entries.insert(key, value),
            None => entries.remove(&key),
        };
    }
    Ok(())
}

#[cfg(test)]
#[path = "salvage_tests.rs"]
mod tests;
