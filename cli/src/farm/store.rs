//! `sightline store`: checks, compacts and moves the store of a coordinator that is not running.
//!
//! An export is JSON Lines. The first line is a header with the format's name and version. Each record is one
//! `["KEY","VALUE"]`: the key in hexadecimal digits, and the value with its checksum as base64. The last line
//! contains the number of records and the BLAKE3 digest of all lines before it.

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
/// Maximum length of a line in an export, in bytes. A record has at most 4 KiB, which its text form enlarges.
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

/// Returns the directory of the records, which must exist.
fn state(place: &PlaceArgs) -> Result<PathBuf, Error> {
    let state = place.data_dir.join("state");
    if state.is_dir() {
        return Ok(state);
    }
    Err(Error::input(format!(
        "{} is not a data directory of a coordinator, because the folder state is missing; give \
         --data-dir",
        place.data_dir.display()
    )))
}

fn open(place: &PlaceArgs) -> Result<SledStore, Error> {
    SledStore::open(&state(place)?).map_err(of_store)
}

/// The outcome of `store verify`.
struct Outcome {
    /// The numbers of scenes, jobs and blobs, and the lost blobs.
    found: Verified,
    /// The number of tiles to be computed again. `None` without a repair of lost blobs.
    opened: Option<u64>,
    /// The journal with its damage, if it is damaged.
    journal: Option<(PathBuf, Damage)>,
    /// True if the journal's watermark could be read. `None` if the command did not check the watermark.
    is_marked: Option<bool>,
    /// The repair of the journal, if a repair was necessary.
    repaired: Option<Repaired>,
    /// The owner of the blobs: this store, another store, or unknown.
    ownership: Ownership,
}

fn verify(args: &StoreVerifyArgs, json: bool) -> Result<(), Error> {
    let folder = match args.store.as_deref().filter(|text| !text.is_empty()) {
        None => Some(state(&args.place)?),
        Some(text) => match StorePlace::parse(text, args.store_ca.as_deref())? {
            StorePlace::Sled(folder) if folder.is_dir() => Some(folder),
            StorePlace::Sled(folder) => {
                return Err(Error::input(format!(
                    "the folder {} does not exist; correct --store",
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
    // A repair recovers all blobs except scenes, receivers and specifications, which clients upload again.
    let mut rest = found
        .lost
        .values()
        .filter(|(needs, _)| opened.is_none() || must_be_sent(needs));
    let Some((needs, why)) = rest.next() else {
        return Ok(());
    };
    let needs: Vec<String> = needs.iter().map(need_text).collect();
    Err(Error::input(format!(
        "lost blobs: {}, the first is {} ({why}); run with --repair, so that the next start computes lost \
         tiles and results again, and upload lost scenes again",
        rest.count() + 1,
        needs.join(", ")
    )))
}

/// Checks the records and the blobs. Repairs lost outputs if `--repair` is given, and claims the blobs if
/// `--claim-blobs` is given.
fn look(args: &StoreVerifyArgs, store: &dyn Store) -> Result<Outcome, Error> {
    let mut config = Config::new(args.place.data_dir.clone());
    config.blobs = blob_place(args.blobs.as_deref(), false)?;
    let folder = args.place.data_dir.join("blobs");
    if config.blobs.is_none() && !folder.is_dir() {
        return Err(Error::input(format!(
            "the folder {} does not exist; give the location of the blobs with --blobs",
            folder.display()
        )));
    }
    let blobs_fault = |e: BlobError| of_keeping(e.into());
    // Copies of a bucket's blobs are stored in a temporary folder.
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
        // At its next start, the coordinator writes the store's name to an empty blob store.
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
        Reference::Spec(job) => format!("the receivers, viewpoints or boxes of job {job}"),
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
            format!("; a copy of the damaged journal is in {}", path.display())
        });
        print(&format!(
            "the journal was damaged at byte {} ({}) and is repaired: {}{copy}",
            damage.offset,
            damage.what,
            damage.loss()
        ))?;
        if damage.is_loss || damage.is_unmeasured {
            print(
                "jobs that were deleted shortly before the damage may exist again; delete these jobs \
             again",
            )?;
        }
    }
    print(&format!(
        "{}, {}; {}, {} bytes; unreferenced: {}, {} bytes; a coordinator removes unreferenced blobs one day \
         after they were written",
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
            "the watermark of the journal (journal.mark) cannot be read, so a lost end of the \
             journal cannot be detected; compare the list of jobs with a backup. The next start \
             writes a new watermark",
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
                "all blobs that the records refer to exist"
            } else {
                "all required records and blobs exist"
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
        "compacted the journal from {} to {} bytes",
        done.from, done.to
    ))
}

/// A writer that computes the digest of the written bytes.
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
        "exported {count} records; copy the blobs in the folder {} as well",
        args.place.data_dir.join("blobs").display()
    ))
}

/// Reads the entries of an export, and checks the header and the last line.
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
                "the last line of the export is missing; export the store again",
            ));
        }
        let value: Value = serde_json::from_str(&line).map_err(|e| bad(number, &e.to_string()))?;
        if number == 1 {
            if value["format"] != FORMAT || value["version"] != VERSION {
                return Err(bad(
                    1,
                    "the file is not an export of a store that this version of the program \
                     supports",
                ));
            }
        } else if let Value::Array(_) = value {
            let (key, text): (String, String) =
                serde_json::from_value(value).map_err(|e| bad(number, &e.to_string()))?;
            let damaged = |_| bad(number, "the record is damaged; export the store again");
            entries.push(Entry::parse(&key, &text).map_err(damaged)?);
        } else {
            let whole = value["records"] == entries.len()
                && value["blake3"] == hasher.finalize().to_hex().as_str();
            return if whole {
                Ok(entries)
            } else {
                Err(bad(
                    number,
                    "the file was altered or cut short; export the store again",
                ))
            };
        }
        hasher.update(line.as_bytes());
    }
    Ok(entries)
}

fn import(args: &ImportArgs, json: bool) -> Result<(), Error> {
    // All entries are read and checked before the first write.
    let entries = read(&args.input)?;
    let store = SledStore::open(&args.place.data_dir.join("state")).map_err(of_store)?;
    let count = entries.len();
    store_migrate::take_over(&store, entries)?;
    if json {
        return print(&json!({"records": count}).to_string());
    }
    say(&format!(
        "copy the blobs of the exported store to {}",
        args.place.data_dir.join("blobs").display()
    ));
    print(&format!("imported {count} records"))
}
