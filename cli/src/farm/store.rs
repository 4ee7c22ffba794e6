//! `sightline store`: the store of a coordinator that does not run is checked, compacted, and moved.
//!
//! An export is JSON Lines: a header with the format's name and version, one `["KEY","VALUE"]` a record
//! (the key in hexadecimal digits, the value with its checksum as base64), and a last line with the number
//! of records and the BLAKE3 digest of all lines before it.

use std::fs::File;
use std::io::{BufRead as _, BufReader, Write};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use sightline::Error;
use sightline::output::{Format, Output};
use sightline::words::plural;
use sightline_coordinator::Config;
use sightline_coordinator::blobs::ownership::{self, Ownership};
use sightline_coordinator::blobs::references::{self, KeepingError, Reference, Verified};
use sightline_records::ids::TileIndex;
use sightline_store::{
    BlobError, Damage, Entry, JournalError, Queries as _, Repaired, SledStore, Store, StoreError,
};

use crate::args::store::{
    ImportArgs, PlaceArgs, StoreCommand, StoreCommandArgs, StoreExportArgs, StoreVerifyArgs,
};
use crate::farm::coordinator::blob_place;
use crate::farm::store_location::StorePlace;
use crate::farm::store_migrate::{self, Opened};
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

const FORMAT: &str = "sightline.store";
const VERSION: u64 = 1;
/// Longest line of an export; a record has at most 4 KiB.
const MOST_LINE: u64 = 16 << 10;

/// Runs `sightline store`.
pub fn run(args: &StoreCommandArgs, json: bool) -> Result<(), Error> {
    match &args.command {
        StoreCommand::Verify(args) => verify(args, json),
        StoreCommand::Compact(args) => compact(args, json),
        StoreCommand::Export(args) => export(args, json),
        StoreCommand::Import(args) => import(args, json),
        StoreCommand::Migrate(args) => store_migrate::migrate(args, json),
    }
}

fn of_store(e: StoreError) -> Error {
    Error::input(e.to_string())
}

fn of_keeping(e: KeepingError) -> Error {
    Error::input(e.to_string())
}

/// The directory of the records, which must be there.
fn state(place: &PlaceArgs) -> Result<PathBuf, Error> {
    let state = place.data_dir.join("state");
    if state.is_dir() {
        return Ok(state);
    }
    Err(Error::input(format!(
        "{} is no data directory of a coordinator: it has no folder state; give --data-dir",
        place.data_dir.display()
    )))
}

fn open(place: &PlaceArgs) -> Result<SledStore, Error> {
    SledStore::open(&state(place)?).map_err(of_store)
}

/// The outcome of `store verify`.
struct Outcome {
    /// Counts, and lost blobs.
    found: Verified,
    /// The number of tiles that are computed again; `None` without a repair of lost blobs.
    opened: Option<u64>,
    /// The journal with its damage, if it is damaged.
    journal: Option<(PathBuf, Damage)>,
    /// Whether the journal's watermark could be read; `None` where this was not looked at.
    is_marked: Option<bool>,
    /// The repair of the journal, if it was necessary.
    repaired: Option<Repaired>,
    /// The relation of the blobs to the store.
    ownership: Ownership,
}

fn verify(args: &StoreVerifyArgs, json: bool) -> Result<(), Error> {
    let folder = match args.store.as_deref().filter(|text| !text.is_empty()) {
        None => Some(state(&args.place)?),
        Some(text) => match StorePlace::parse(text, args.store_ca.as_deref())? {
            StorePlace::Sled(folder) if folder.is_dir() => Some(folder),
            StorePlace::Sled(folder) => {
                return Err(Error::input(format!(
                    "there is no folder {}; correct --store",
                    folder.display()
                )));
            }
            _ => None,
        },
    };
    let changes = args.repair || args.claim_blobs;
    let outcome = match &folder {
        Some(folder) if !changes => {
            let inspection = SledStore::inspect(folder).map_err(of_store)?;
            let outcome = look(args, &inspection.store)?;
            let journal = inspection
                .damage
                .map(|damage| (folder.join("journal"), damage));
            Outcome {
                journal,
                is_marked: Some(inspection.is_marked),
                ..outcome
            }
        }
        Some(folder) => {
            let repaired = match args.repair {
                true => SledStore::repair(folder).map_err(of_store)?,
                false => None,
            };
            let opened = Opened::on_disk(folder)?;
            let looked = look(args, &*opened.store);
            opened.close();
            Outcome {
                repaired,
                ..looked?
            }
        }
        None => {
            let address = args.store.as_deref().unwrap_or_default();
            let opened = Opened::at(address, "--store", args.store_ca.as_deref())?;
            let looked = look(args, &*opened.store);
            opened.close();
            looked?
        }
    };
    if json {
        print(&report(&outcome).to_string())?;
    } else {
        tell(&outcome)?;
    }
    if let Some((path, damage)) = outcome.journal {
        let (offset, lost) = (damage.offset, damage.loss());
        let error = JournalError::Damaged {
            path,
            offset,
            what: damage.what,
            lost,
        };
        return Err(Error::input(error.to_string()));
    }
    let Outcome { found, opened, .. } = outcome;
    // What is repaired is not lost, but for what has to be sent again.
    let mut rest = found
        .lost
        .values()
        .filter(|(needs, _)| opened.is_none() || must_be_sent(needs));
    let Some((needs, why)) = rest.next() else {
        return Ok(());
    };
    let needs: Vec<String> = needs.iter().map(need_text).collect();
    Err(Error::input(format!(
        "lost blobs: {}, first {}: {why}; --repair has the next start compute again what it can, and \
         scenes have to be sent again",
        rest.count() + 1,
        needs.join(", ")
    )))
}

/// Checks the records and the blobs, repairs lost outputs if `--repair` is given, and claims the blobs if
/// `--claim-blobs` is given.
fn look(args: &StoreVerifyArgs, store: &dyn Store) -> Result<Outcome, Error> {
    let mut config = Config::new(args.place.data_dir.clone());
    config.blobs = blob_place(args.blobs.as_deref(), false)?;
    let folder = args.place.data_dir.join("blobs");
    if config.blobs.is_none() && !folder.is_dir() {
        return Err(Error::input(format!(
            "there is no folder {}; --blobs says where the blobs are",
            folder.display()
        )));
    }
    let blobs_fault = |e: BlobError| of_keeping(e.into());
    // Copies of a bucket's blobs go into a folder that is removed.
    let copies = tempfile::tempdir().map_err(Error::internal)?;
    let blobs = match args.repair || args.claim_blobs {
        true => config.open_blobs(None),
        false => config.inspect_blobs(copies.path()),
    }
    .map_err(blobs_fault)?;
    let found = references::verify(store, &*blobs, &|_| ()).map_err(of_keeping)?;
    let opened = match args.repair && !found.lost.is_empty() {
        true => {
            let mut reopen = |job, tiles: &[TileIndex]| store.invalidate_tiles(job, tiles);
            Some(references::repair(&*blobs, &found, &mut reopen).map_err(of_keeping)?)
        }
        false => None,
    };
    let own = store.identity().map_err(of_store)?.id();
    if args.claim_blobs {
        blobs.claim(own).map_err(blobs_fault)?;
    }
    let ownership = match ownership::inspect(own, &*blobs).map_err(of_keeping)? {
        // The coordinator's next start names an empty blob store.
        Ownership::Unnamed if found.blobs == 0 => Ownership::Own,
        other => other,
    };
    Ok(Outcome {
        found,
        opened,
        journal: None,
        is_marked: None,
        repaired: None,
        ownership,
    })
}

fn must_be_sent(needs: &[Reference]) -> bool {
    needs
        .iter()
        .any(|need| matches!(need, Reference::Scene | Reference::Spec(_)))
}

fn need_text(need: &Reference) -> String {
    match need {
        Reference::Scene => "a scene".to_owned(),
        Reference::Result(job) => format!("the result of job {job}"),
        Reference::Spec(job) => format!("a part of the specification of job {job}"),
        Reference::Output(job, tile) => format!("the output of tile {tile} of job {job}"),
    }
}

fn report(outcome: &Outcome) -> Value {
    let Outcome {
        found,
        opened,
        journal,
        is_marked,
        repaired,
        ownership,
    } = outcome;
    let lost = |(_, (needs, why)): (_, &(Vec<Reference>, String))| {
        let needed: Vec<String> = needs.iter().map(need_text).collect();
        json!({"why": why, "needed": needed})
    };
    let damage = journal
        .as_ref()
        .map(|(_, damage)| damage)
        .or(repaired.as_ref().map(|r| &r.damage));
    let damaged = repaired
        .as_ref()
        .and_then(|repaired| repaired.damaged.as_ref());
    let owner = match ownership {
        Ownership::Own => "own",
        Ownership::Foreign(_) => "foreign",
        Ownership::Unnamed => "unnamed",
    };
    json!({
        "scenes": found.scenes, "jobs": found.jobs, "blobs": found.blobs, "bytes": found.bytes,
        "unneeded": found.unneeded, "unneeded_bytes": found.unneeded_bytes,
        "lost": found.lost.iter().map(lost).collect::<Vec<_>>(), "tiles_opened": opened,
        "blobs_owner": owner, "journal_watermark": is_marked,
        "journal": damage.map(|damage| json!({
            "offset": damage.offset, "fault": damage.what, "is_loss": damage.is_loss,
            "is_unmeasured": damage.is_unmeasured,
            "lost_jobs": damage.lost_jobs.map(|(first, last)| [first.0, last.0]),
            "repaired": repaired.is_some(), "copy": damaged.map(|path| path.display().to_string()),
        })),
    })
}

fn tell(outcome: &Outcome) -> Result<(), Error> {
    let Outcome {
        found,
        opened,
        repaired,
        ownership,
        journal,
        is_marked,
    } = outcome;
    if let Some(Repaired { damage, damaged }) = repaired {
        let copy = damaged.as_ref().map_or_else(String::new, |path| {
            format!("; the damaged journal is kept as {}", path.display())
        });
        print(&format!(
            "the journal was damaged at byte {} ({}) and is repaired: {}{copy}",
            damage.offset,
            damage.what,
            damage.loss()
        ))?;
        if damage.is_loss || damage.is_unmeasured {
            print("jobs that were deleted lately may be back; delete them again")?;
        }
    }
    print(&format!(
        "{}, {}; {}, {} bytes; needed by nobody: {}, {} bytes; a coordinator removes these a day after they \
         were written",
        plural(found.scenes as usize, "scene"),
        plural(found.jobs as usize, "job"),
        plural(found.blobs as usize, "blob"),
        found.bytes,
        plural(found.unneeded as usize, "blob"),
        found.unneeded_bytes
    ))?;
    if let Some(refusal) = ownership.refusal() {
        print(&refusal)?;
    }
    if *is_marked == Some(false) {
        print(
            "no watermark of the journal can be read (journal.mark), so a lost end of the journal cannot be \
             told; compare the list of jobs with a backup. The next start writes the watermark anew",
        )?;
    }
    for (needs, why) in found.lost.values() {
        let needs: Vec<String> = needs.iter().map(need_text).collect();
        print(&format!("LOST: {}: {why}", needs.join(", ")))?;
    }
    match opened {
        Some(tiles) => print(&format!(
            "tiles to compute again when the coordinator runs: {tiles}"
        )),
        None if found.lost.is_empty() && journal.is_none() => {
            let is_repaired = repaired.is_some();
            print(if is_repaired {
                "all blobs that the records name are there"
            } else {
                "everything that is needed is there"
            })
        }
        None => Ok(()),
    }
}

fn compact(args: &PlaceArgs, json: bool) -> Result<(), Error> {
    let done = SledStore::compact(&state(args)?).map_err(of_store)?;
    if json {
        return print(&json!({"from_bytes": done.from, "to_bytes": done.to}).to_string());
    }
    print(&format!(
        "the journal had {} bytes and has {}",
        done.from, done.to
    ))
}

/// Hashes what is written.
struct Hashed<W> {
    to: W,
    hasher: blake3::Hasher,
}

impl<W: Write> Write for Hashed<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.to.write(bytes)?;
        self.hasher.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.to.flush()
    }
}

fn export(args: &StoreExportArgs, json: bool) -> Result<(), Error> {
    let output = Output::check(&args.output, Format::Json, None)?;
    let entries = open(&args.place)?.entries().map_err(of_store)?;
    let count = entries.len();
    let write = |file: &mut dyn Write| -> std::io::Result<()> {
        let mut out = Hashed {
            to: file,
            hasher: blake3::Hasher::new(),
        };
        writeln!(out, "{}", json!({"format": FORMAT, "version": VERSION}))?;
        for entry in &entries {
            let (key, value) = entry.written();
            writeln!(out, "{}", json!([key, value]))?;
        }
        let digest = out.hasher.finalize().to_hex();
        writeln!(
            out,
            "{}",
            json!({"records": count, "blake3": digest.as_str()})
        )?;
        out.flush()
    };
    output.write(|file| write(file).map_err(|e| Error::writing(&args.output, &e)))?;
    if json {
        return print(&json!({"records": count}).to_string());
    }
    print(&format!(
        "{count} records; copy the folder {} as well",
        args.place.data_dir.join("blobs").display()
    ))
}

/// The entries of an export, its header and its end checked.
fn read(path: &Path) -> Result<Vec<Entry>, Error> {
    let bad =
        |line: usize, what: &str| Error::input(format!("{}, line {line}: {what}", path.display()));
    let file = File::open(path)
        .map_err(|e| Error::input(format!("cannot read {}: {e}", path.display())))?;
    let mut reader = BufReader::new(file);
    let mut hasher = blake3::Hasher::new();
    let mut entries = Vec::new();
    let mut line = String::new();
    for number in 1.. {
        line.clear();
        let read = std::io::Read::take(&mut reader, MOST_LINE).read_line(&mut line);
        let length = read.map_err(|e| bad(number, &e.to_string()))?;
        if length == 0 {
            return Err(bad(
                number,
                "the file ends before its last line; it was cut short",
            ));
        }
        let value: Value = serde_json::from_str(&line).map_err(|e| bad(number, &e.to_string()))?;
        if number == 1 {
            if value["format"] != FORMAT || value["version"] != VERSION {
                return Err(bad(
                    1,
                    "this is no export of a store that this version of the program reads",
                ));
            }
        } else if let Value::Array(_) = value {
            let text: (String, String) =
                serde_json::from_value(value).map_err(|e| bad(number, &e.to_string()))?;
            let damaged = |_| bad(number, "the record is damaged; export the store again");
            entries.push(Entry::of_text(&text).map_err(damaged)?);
        } else {
            let whole = value["records"] == entries.len()
                && value["blake3"] == hasher.finalize().to_hex().as_str();
            return if whole {
                Ok(entries)
            } else {
                Err(bad(number, "the file was altered or cut short"))
            };
        }
        hasher.update(line.as_bytes());
    }
    Ok(entries)
}

fn import(args: &ImportArgs, json: bool) -> Result<(), Error> {
    // Everything is read and checked before anything is written.
    let entries = read(&args.input)?;
    let store = SledStore::open(&args.place.data_dir.join("state")).map_err(of_store)?;
    let count = entries.len();
    store_migrate::take_over(&store, entries)?;
    if json {
        return print(&json!({"records": count}).to_string());
    }
    say(&format!(
        "the blobs belong into {}",
        args.place.data_dir.join("blobs").display()
    ));
    print(&format!("{count} records"))
}
