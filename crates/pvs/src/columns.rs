//! The section of columns: named statistics of the bake, with one value per cell.
//!
//! The section contains the number of columns as u32. For each column follow the length of its name as u32,
//! the name in UTF-8, the length of its data as u32, and the data. The data has one LEB128 number per cell,
//! in cell order, each in the fewest bytes: most values are small. A file without columns has no such
//! section, and never an empty one, so that equal contents have equal bytes.

use std::collections::BTreeSet;

use crate::codec::varint;
use crate::error::PvsError;
use crate::layout::Section;

/// The maximum length of a name in bytes. A name is the header of a table column.
const MAX_NAME: usize = 64;
/// The number of bytes of a column in addition to its name and values: two lengths.
const LENGTHS: u64 = 8;

/// A statistic of the bake: one number per cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// The name of the column, for example `rays_uniform`: 1 to 64 bytes, different from the other columns'
    /// names.
    pub name: String,
    /// The values of the cells, in cell order.
    pub values: Vec<u64>,
}

/// Checks and codes the columns of a file with `cells` cells. Returns no bytes if `columns` is empty.
pub fn encode(columns: &[Column], cells: u32) -> Result<Vec<u8>, PvsError> {
    let mut bytes = Vec::new();
    if columns.is_empty() {
        return Ok(bytes);
    }
    bytes.extend(length("the number of columns", columns.len())?);
    let mut names = BTreeSet::new();
    for Column { name, values } in columns {
        let bad = |reason: String| PvsError::Column {
            name: name.clone(),
            reason,
        };
        check_name(name, &mut names).map_err(|reason| bad(reason.to_owned()))?;
        if values.len() as u64 != u64::from(cells) {
            return Err(bad(format!(
                "{} values for {cells} cells; give one value per cell",
                values.len()
            )));
        }
        let mut data = Vec::with_capacity(values.len());
        for &value in values {
            varint(value, &mut data);
        }
        bytes.extend(length("the name of a column", name.len())?);
        bytes.extend(name.as_bytes());
        bytes.extend(length("the data of a column", data.len())?);
        bytes.extend(data);
    }
    Ok(bytes)
}

/// Checks that the section of a file with `cells` cells can be decoded.
pub fn check(bytes: &[u8], cells: u32) -> Result<(), PvsError> {
    for_each(bytes, cells, |name, data| {
        each_value(name, data, cells, |_| ())
    })
}

/// Decodes the columns of a file with `cells` cells.
pub fn decode(bytes: &[u8], cells: u32) -> Result<Vec<Column>, PvsError> {
    let mut columns = Vec::new();
    for_each(bytes, cells, |name, data| {
        // The data has at least one byte per cell, so the length of the file bounds this allocation.
        let mut values = Vec::with_capacity(cells as usize);
        each_value(name, data, cells, |value| values.push(value))?;
        columns.push(Column {
            name: name.to_owned(),
            values,
        });
        Ok(())
    })?;
    Ok(columns)
}

/// Calls `each` with the name and the data of each column. The data has at least one byte per cell.
fn for_each<'a>(
    bytes: &'a [u8],
    cells: u32,
    mut each: impl FnMut(&'a str, &'a [u8]) -> Result<(), PvsError>,
) -> Result<(), PvsError> {
    let bad = |reason: &str| Section::Columns.malformed(reason);
    let (count, mut rest) =
        take_length(bytes).ok_or_else(|| bad("the number of columns is missing"))?;
    if count == 0 {
        return Err(bad("the section exists, but contains no columns"));
    }
    // A name and each value have at least one byte.
    let least = u64::from(count).checked_mul(LENGTHS + 1 + u64::from(cells));
    if least.is_none_or(|least| least > rest.len() as u64) {
        return Err(bad(
            "the number of columns does not fit the length of the section",
        ));
    }
    let mut names = BTreeSet::new();
    for _ in 0..count {
        let (name, after) =
            take_bytes(rest).ok_or_else(|| bad("a name reaches beyond the end of the section"))?;
        let (data, after) = take_bytes(after)
            .ok_or_else(|| bad("a column reaches beyond the end of the section"))?;
        rest = after;
        let name =
            std::str::from_utf8(name).map_err(|e| Section::Columns.malformed(e.to_string()))?;
        // The message omits the name, because the name is invalid and may have any length.
        check_name(name, &mut names)
            .map_err(|reason| bad(&format!("a column is not valid: {reason}")))?;
        if (data.len() as u64) < u64::from(cells) {
            return Err(bad_values(
                name,
                "the data has fewer bytes than the file has cells",
            ));
        }
        each(name, data)?;
    }
    if rest.is_empty() {
        Ok(())
    } else {
        Err(bad("bytes follow the last column"))
    }
}

/// Calls `each` with the values of a column's data, which must contain exactly one value per cell.
fn each_value(
    name: &str,
    mut data: &[u8],
    cells: u32,
    mut each: impl FnMut(u64),
) -> Result<(), PvsError> {
    for _ in 0..cells {
        let (value, rest) = take_value(data).map_err(|reason| bad_values(name, reason))?;
        each(value);
        data = rest;
    }
    if data.is_empty() {
        Ok(())
    } else {
        Err(bad_values(name, "bytes follow the last value"))
    }
}

fn bad_values(name: &str, reason: &str) -> PvsError {
    Section::Columns.malformed(format!("column {name:?} is not valid: {reason}"))
}

/// Checks a name, which must not be among the names in `earlier`, and adds it to them.
fn check_name<'a>(name: &'a str, earlier: &mut BTreeSet<&'a str>) -> Result<(), &'static str> {
    if !(1..=MAX_NAME).contains(&name.len()) {
        return Err("the name must have 1 to 64 bytes");
    }
    if earlier.insert(name) {
        Ok(())
    } else {
        Err("an earlier column has the same name")
    }
}

/// Returns a length in the form in which the file stores it.
fn length(what: &'static str, value: usize) -> Result<[u8; 4], PvsError> {
    let limit = u64::from(u32::MAX);
    u32::try_from(value)
        .map(u32::to_le_bytes)
        .map_err(|_| PvsError::TooLarge {
            what,
            value: value as u64,
            limit,
        })
}

/// Splits a length off the front of `bytes`. Also returns the rest.
fn take_length(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*length), rest))
}

/// Splits a length and that number of bytes off the front of `bytes`. Also returns the rest.
fn take_bytes(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = take_length(bytes)?;
    rest.split_at_checked(usize::try_from(length).ok()?)
}

/// Splits a value off the front of `bytes`. Also returns the rest. Unlike the numbers of the set codec,
/// values use all 64 bits. The crate contains this LEB128 code so that it depends on no other crate of the
/// project.
fn take_value(bytes: &[u8]) -> Result<(u64, &[u8]), &'static str> {
    let mut value = 0u64;
    for (i, &byte) in bytes.iter().enumerate().take(10) {
        // Nine bytes contain 63 bits.
        if i == 9 && byte > 1 {
            break;
        }
        value |= u64::from(byte & 0x7f) << (7 * i);
        if byte < 0x80 {
            // Each value has only one form, so that equal columns have equal bytes.
            return if i > 0 && byte == 0 {
                Err("a value is not encoded in the fewest bytes")
            } else {
                Ok((value, &bytes[i + 1..]))
            };
        }
    }
    Err(if bytes.len() < 10 {
        "a value is cut short"
    } else {
        "a value exceeds 64 bits"
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn column(name: &str, values: &[u64]) -> Column {
        Column {
            name: name.to_owned(),
            values: values.to_vec(),
        }
    }

    /// Returns a section of columns, each given by its name and data, valid or not.
    fn section(columns: &[(&[u8], &[u8])]) -> Vec<u8> {
        let mut bytes = (columns.len() as u32).to_le_bytes().to_vec();
        for part in columns.iter().flat_map(|c| [c.0, c.1]) {
            bytes.extend((part.len() as u32).to_le_bytes());
            bytes.extend(part);
        }
        bytes
    }

    #[test]
    fn encode_writes_documented_bytes() {
        let bytes = encode(
            &[
                column("a", &[0, 127, 128]),
                column("bü", &[1, u64::MAX, 300]),
            ],
            3,
        )
        .unwrap();
        let longest = [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1];
        let second = [&[1][..], &longest, &[0xac, 2]].concat();
        assert_eq!(
            bytes,
            section(&[(b"a", &[0, 127, 0x80, 1]), ("bü".as_bytes(), &second)])
        );
        assert!(encode(&[], 3).unwrap().is_empty());
    }

    #[test]
    fn value_has_one_byte_per_seven_bits() {
        let size =
            |value| encode(&[column("a", &[value])], 1).unwrap().len() - 4 - LENGTHS as usize - 1;
        for bits in 1..=64u32 {
            let largest = u64::MAX >> (64 - bits);
            assert_eq!(size(largest), bits.div_ceil(7) as usize, "{bits} bits");
            assert_eq!(
                decode(&encode(&[column("a", &[largest])], 1).unwrap(), 1).unwrap()[0].values,
                [largest]
            );
        }
        assert_eq!(size(0), 1);
    }

    #[test]
    fn encode_rejects_bad_columns() {
        let why = |columns: &[Column]| match encode(columns, 2) {
            Err(PvsError::Column { reason, .. }) => reason,
            other => panic!("{other:?}"),
        };
        assert!(why(&[column("", &[1, 2])]).contains("1 to 64"));
        assert!(why(&[column(&"ü".repeat(33), &[1, 2])]).contains("1 to 64"));
        assert!(encode(&[column(&"ü".repeat(32), &[1, 2])], 2).is_ok());
        assert!(
            why(&[
                column("a", &[1, 2]),
                column("b", &[1, 2]),
                column("a", &[3, 4])
            ])
            .contains("earlier")
        );
        assert!(why(&[column("a", &[1])]).contains("1 values for 2 cells"));
        assert!(why(&[column("a", &[1, 2, 3])]).contains("3 values for 2 cells"));
    }

    #[test]
    fn errors_name_section_and_reason() {
        let why = |bytes: &[u8]| match (check(bytes, 2), decode(bytes, 2)) {
            (
                Err(PvsError::Malformed {
                    section: "columns",
                    reason,
                }),
                Err(again),
            ) => {
                assert!(again.to_string().contains(&reason), "{again}");
                reason
            }
            other => panic!("{other:?}"),
        };
        assert!(check(&section(&[(b"a", &[1, 2])]), 2).is_ok());
        assert!(why(&[]).contains("number of columns is missing"));
        assert!(why(&[1, 0, 0]).contains("number of columns is missing"));
        assert!(why(&section(&[])).contains("no columns"));
        let mut many = section(&[(b"a", &[1, 2])]);
        many[..4].fill(0xff);
        assert!(why(&many).contains("number of columns does not fit"));
        let mut long = section(&[(b"a", &[1, 2])]);
        long[4..8].fill(0xff);
        assert!(why(&long).contains("name reaches beyond"));
        let mut long = section(&[(b"a", &[1, 2])]);
        long[9] = 3;
        assert!(why(&long).contains("column reaches beyond"));
        let mut more = section(&[(b"a", &[1, 2])]);
        more.push(0);
        assert!(why(&more).contains("follow the last column"));
        assert!(why(&section(&[(b"a\xff", &[1, 2])])).contains("utf-8"));
        assert!(why(&section(&[(b"", &[1, 0x80, 1])])).contains("1 to 64"));
        assert!(why(&section(&[(&[b'a'; 65], &[1, 2])])).contains("1 to 64"));
        assert!(why(&section(&[(b"a", &[1, 2]), (b"a", &[1, 2])])).contains("earlier"));
        assert!(
            why(&section(&[(b"ab", &[1])]))
                .contains("\"ab\" is not valid: the data has fewer bytes")
        );
        assert!(why(&section(&[(b"a", &[1, 0x80])])).contains("cut short"));
        assert!(why(&section(&[(b"a", &[1, 2, 3])])).contains("follow the last value"));
        assert!(
            why(&section(&[(b"a", &[1, 0x81, 0])])).contains("not encoded in the fewest bytes")
        );
        let mut beyond = vec![0xff; 9];
        beyond.extend([2, 1]);
        assert!(why(&section(&[(b"a", &beyond)])).contains("exceeds 64 bits"));
        assert!(why(&section(&[(b"a", &[0xff; 12])])).contains("exceeds 64 bits"));
    }

    proptest! {
        #[test]
        fn random_columns_round_trip(
            table in (1usize..30).prop_flat_map(|cells| (
                Just(cells),
                proptest::collection::btree_set("[a-zü_]{1,32}", 0..6),
                proptest::collection::vec((any::<u64>(), 0u32..64), 6 * cells),
            )),
        ) {
            let (cells, names, values) = table;
            // The values are shifted, so that all lengths are equally likely.
            let values: Vec<u64> = values.into_iter().map(|(value, shift)| value >> shift).collect();
            let columns: Vec<Column> =
                names.iter().zip(values.chunks(cells)).map(|(name, v)| column(name, v)).collect();
            let bytes = encode(&columns, cells as u32).unwrap();
            if columns.is_empty() {
                prop_assert!(bytes.is_empty());
            } else {
                check(&bytes, cells as u32).unwrap();
                prop_assert_eq!(decode(&bytes, cells as u32).unwrap(), columns);
                for keep in 0..bytes.len() {
                    prop_assert!(check(&bytes[..keep], cells as u32).is_err());
                }
            }
        }

        /// Checks that accepted bytes are the only form of their contents.
        #[test]
        fn accepted_bytes_encode_to_same_bytes(
            changes in proptest::collection::vec((any::<usize>(), any::<u8>()), 0..6),
            cut in 0usize..10,
            cells in 1u32..5,
        ) {
            let values: Vec<u64> = (0..u64::from(cells)).map(|c| c << (c * 20)).collect();
            let mut bytes = encode(&[column("a", &values), column("bc", &values)], cells).unwrap();
            bytes.truncate(bytes.len() - cut.saturating_sub(5));
            for (at, value) in changes {
                let at = at % bytes.len();
                bytes[at] = value;
            }
            match decode(&bytes, cells) {
                Ok(columns) => {
                    check(&bytes, cells).unwrap();
                    prop_assert_eq!(encode(&columns, cells).unwrap(), bytes);
                }
                Err(_) => prop_assert!(check(&bytes, cells).is_err()),
            }
        }
    }
}
