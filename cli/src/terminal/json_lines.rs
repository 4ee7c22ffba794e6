//! The reader of queries as JSON Lines from a file or from stdin.

use std::io::{BufRead as _, BufReader, Read};
use std::path::Path;

use serde::de::DeserializeOwned;
use sightline::Error;

/// Maximum number of lines in one batch.
const AT_A_TIME: usize = 4096;
/// The size of the read buffer in bytes.
const BUFFER: usize = 1 << 20;
/// The minimum length of a rejected line, in bytes, including the line end.
const LONGEST_LINE: u64 = 1 << 20;

/// The byte order mark of UTF-8.
const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

/// The reader of the lines of a file or of stdin.
pub struct JsonLines {
    /// The name of the input, for messages.
    pub name: String,
    reader: BufReader<Box<dyn Read>>,
    /// The number of lines read so far, including blank lines.
    pub lines: u64,
    /// The line numbers of the queries in the last batch, starting at 1. Blank lines contain no query.
    pub numbers: Vec<u64>,
    /// An example of a line, for messages.
    example: &'static str,
}

impl JsonLines {
    /// Opens the file that a flag names, or stdin for `-`.
    pub fn open(path: &Path, flag: &str, example: &'static str) -> Result<Self, Error> {
        let is_stdin = path.as_os_str() == "-";
        let source: Box<dyn Read> = if is_stdin {
            Box::new(std::io::stdin())
        } else {
            let unreadable = |e: std::io::Error| {
                Error::input(format!(
                    "{} cannot be read: {e}; give {flag} a file of JSON Lines, or - for stdin",
                    path.display()
                ))
            };
            let file = std::fs::File::open(path).map_err(unreadable)?;
            if file.metadata().map_err(unreadable)?.is_dir() {
                return Err(unreadable(std::io::ErrorKind::IsADirectory.into()));
            }
            Box::new(file)
        };
        let name = if is_stdin {
            "stdin".to_owned()
        } else {
            path.display().to_string()
        };
        Ok(Self {
            name,
            reader: BufReader::with_capacity(BUFFER, source),
            lines: 0,
            numbers: Vec::new(),
            example,
        })
    }

    /// Returns the next batch of queries, and the error of the line after the batch if that line is invalid.
    /// Reads at least one query. Reads further queries only if they are already buffered, because a program
    /// may wait for each answer before it writes the next query. At the end of the input, returns no queries.
    pub fn read<L: DeserializeOwned, Q>(
        &mut self,
        check: impl Fn(L) -> Result<Q, String>,
    ) -> (Vec<Q>, Option<Error>) {
        let mut queries = Vec::new();
        self.numbers.clear();
        while queries.is_empty()
            || (queries.len() < AT_A_TIME && self.reader.buffer().contains(&b'\n'))
        {
            match self.next(&check) {
                Ok(Some(query)) => {
                    queries.push(query);
                    self.numbers.push(self.lines);
                }
                Ok(None) => break,
                Err(e) => return (queries, Some(e)),
            }
        }
        (queries, None)
    }

    fn next<L: DeserializeOwned, Q>(
        &mut self,
        check: &impl Fn(L) -> Result<Q, String>,
    ) -> Result<Option<Q>, Error> {
        loop {
            let mut text = Vec::new();
            let mut limited = Read::take(&mut self.reader, LONGEST_LINE);
            let read = limited
                .read_until(b'\n', &mut text)
                .map_err(|e| Error::input(format!("{} cannot be read: {e}", self.name)))?;
            if read == 0 {
                return Ok(None);
            }
            self.lines += 1;
            let bad =
                |why: String| Error::input(format!("{}, line {}: {why}", self.name, self.lines));
            if read as u64 == LONGEST_LINE {
                return Err(bad(format!(
                    "the line has {LONGEST_LINE} bytes or more; split the query"
                )));
            }
            // Some editors start a file with a byte order mark.
            let text = text
                .strip_prefix(BYTE_ORDER_MARK)
                .filter(|_| self.lines == 1)
                .unwrap_or(&text);
            let text = text.trim_ascii();
            if text.is_empty() {
                continue;
            }
            let no_query = |why: String| {
                bad(format!(
                    "the line is not a query ({why}); give {} on one line",
                    self.example
                ))
            };
            if text[0] == b'[' {
                // Serde would accept the fields of a list by their order.
                return Err(no_query("the line is a JSON list".to_owned()));
            }
            let line: L = serde_json::from_slice(text).map_err(|e| no_query(e.to_string()))?;
            return check(line).map(Some).map_err(bad);
        }
    }
}
