//! The section of columns: named statistics of the bake, one value for each cell.
//!
//! The section has the number of columns as u32, then for each column the length of its name as u32, the name
//! in UTF-8, the length of its data as u32, and the data: a LEB128 number for each cell in cell order, each
//! in the fewest bytes. Most values are small. A file without columns has no such section instead of an empty
//! one, so that equal contents have equal bytes.

use std::collections::BTreeSet;

use crate::codec::varint;
use crate::error::PvsError;
use crate::layout::Section;

/// The longest name in bytes: a name is the head of a table's column.
const MAX_NAME: usize = 64;
/// Bytes of a column besides its name and its values: two lengths.
const LENGTHS: u64 = 8;

/// A statistic of the bake: one number for each cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name, for example `rays_uniform`: 1 to 64 bytes, different from the names of the other columns.
    pub name: String,
    /// The value of each cell, in cell order.
    pub values: Vec<u64>,
}

/// Checks and codes the columns of a file with `cells` cells; no columns give no bytes.
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
                "it has {} values for {cells} cells",
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

/// The columns of a file with `cells` cells.
pub fn decode(bytes: &[u8], cells: u32) -> Result<Vec<Column>, PvsError> {
    let mut columns = Vec::new();
    for_each(bytes, cells, |name, data| {
        // The data has at least a byte for each cell, so the file bounds this allocation.
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

/// Calls `each` with the name and the data of each column; the data has at least a byte for each cell.
fn for_each<'a>(
    bytes: &'a [u8],
    cells: u32,
    mut each: impl FnMut(&'a str, &'a [u8]) -> Result<(), PvsError>,
) -> Result<(), PvsError> {
    let bad = |reason: &str| Section::Columns.malformed(reason);
    let (count, mut rest) = take_length(bytes).ok_or_else(|| bad("it has no count"))?;
    if count == 0 {
        return Err(bad("it has no columns; then there is no such section"));
    }
    // A name and each value have at least one byte.
    let least = u64::from(count).checked_mul(LENGTHS + 1 + u64::from(cells));
    if least.is_none_or(|least| least > rest.len() as u64) {
        return Err(bad("its count does not fit its length"));
    }
    let mut names = BTreeSet::new();
    for _ in 0..count {
        let (name, after) = take_bytes(rest).ok_or_else(|| bad("a name reaches beyond its end"))?;
        let (data, after) =
            take_bytes(after).ok_or_else(|| bad("a column reaches beyond its end"))?;
        rest = after;
        let name =
            std::str::from_utf8(name).map_err(|e| Section::Columns.malformed(e.to_string()))?;
        // The message leaves out the name, which is the fault and may have any length.
        check_name(name, &mut names).map_err(|reason| bad(&format!("of a column, {reason}")))?;
        if (data.len() as u64) < u64::from(cells) {
            return Err(bad_values(name, "it has fewer values than there are cells"));
        }
        each(name, data)?;
    }
    if rest.is_empty() {
        Ok(())
    } else {
        Err(bad("bytes follow its last column"))
    }
}

/// Calls `each` with the values of a column's data, which must have one value for each cell and nothing else.
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
        Err(bad_values(name, "bytes follow its last value"))
    }
}

fn bad_values(name: &str, reason: &str) -> PvsError {
    Section::Columns.malformed(format!("of column {name:?}, {reason}"))
}

/// Checks a name, which must not be among the `earlier` ones.
fn check_name<'a>(name: &'a str, earlier: &mut BTreeSet<&'a str>) -> Result<(), &'static str> {
    if !(1..=MAX_NAME).contains(&name.len()) {
        return Err("the name must have 1 to 64 bytes");
    }
    if earlier.insert(name) {
        Ok(())
    } else {
        Err("the name is that of an earlier one")
    }
}

/// A length as the file has it.
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

/// Takes a length off the front; also the rest.
fn take_length(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*length), rest))
}

/// Takes a length and that many bytes off the front; also the rest.
fn take_bytes(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = take_length(bytes)?;
    rest.split_at_checked(usize::try_from(length).ok()?)
}

/// Takes a value off the front; also the rest. Unlike the codec's numbers, values use all of 64 bits. The
/// crate has its own code for LEB128 so that it depends on no other crate of the project.
fn take_value(bytes: &[u8]) -> Result<(u64, &[u8]), &'static str> {
    let mut value = 0u64;
    for (i, &byte) in bytes.iter().enumerate().take(10) {
        // Nine bytes hold 63 bits.
        if i == 9 && byte > 1 {
            break;
        }
        value |= u64::from(byte & 0x7f) << (7 * i);
        if byte < 0x80 {
            // One form for each value, so that the same columns are the same bytes.
            return if i > 0 && byte == 0 {
                Err("a value has more bytes than it needs")
            } else {
                Ok((value, &bytes[i + 1..]))
            };
        }
    }
    Err(if bytes.len() < 10 {
        "a value is cut short"
    } else {
        "a value is beyond 64 bits"
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

    /// A section of columns, each given by its name and data, valid or not.
    fn section(columns: &[(&[u8], &[u8])]) -> Vec<u8> {
        let mut bytes = (columns.len() as u32).to_le_bytes().to_vec();
        for part in columns.iter().flat_map(|c| [c.0, c.1]) {
            bytes.extend((part.len() as u32).to_le_bytes());
            bytes.extend(part);
        }
        bytes
    }

    #[test]
    fn the_bytes_are_as_described() {
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
    fn a_value_takes_a_byte_for_seven_bits() {
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
    fn bad_columns_are_not_coded() {
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
    fn bad_sections_are_named() {
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
        assert!(why(&[]).contains("no count"));
        assert!(why(&[1, 0, 0]).contains("no count"));
        assert!(why(&section(&[])).contains("no columns"));
        let mut many = section(&[(b"a", &[1, 2])]);
        many[..4].fill(0xff);
        assert!(why(&many).contains("count does not fit"));
        let mut long = section(&[(b"a", &[1, 2])]);
        long[4..8].fill(0xff);
        assert!(why(&long).contains("name reaches beyond"));
        let mut long = section(&[(b"a", &[1, 2])]);
        long[9] = 3;
        assert!(why(&long).contains("column reaches beyond"));
        let mut more = section(&[(b"a", &[1, 2])]);
        more.push(0);
        assert!(why(&more).contains("follow its last column"));
        assert!(why(&section(&[(b"a\xff", &[1, 2])])).contains("utf-8"));
        assert!(why(&section(&[(b"", &[1, 0x80, 1])])).contains("1 to 64"));
        assert!(why(&section(&[(&[b'a'; 65], &[1, 2])])).contains("1 to 64"));
        assert!(why(&section(&[(b"a", &[1, 2]), (b"a", &[1, 2])])).contains("earlier"));
        assert!(why(&section(&[(b"ab", &[1])])).contains("\"ab\", it has fewer values"));
        assert!(why(&section(&[(b"a", &[1, 0x80])])).contains("cut short"));
        assert!(why(&section(&[(b"a", &[1, 2, 3])])).contains("follow its last value"));
        assert!(why(&section(&[(b"a", &[1, 0x81, 0])])).contains("more bytes than it needs"));
        let mut beyond = vec![0xff; 9];
        beyond.extend([2, 1]);
        assert!(why(&section(&[(b"a", &beyond)])).contains("beyond 64 bits"));
        assert!(why(&section(&[(b"a", &[0xff; 12])])).contains("beyond 64 bits"));
    }

    proptest! {
        #[test]
        fn any_columns_round_trip(
            (cells, names, values) in (1usize..30).prop_flat_map(|cells| (
                Just(cells),
                proptest::collection::btree_set("[a-zü_]{1,32}", 0..6),
                proptest::collection::vec((any::<u64>(), 0u32..64), 6 * cells),
            )),
        ) {
            // Shifted, so that values of all lengths are equally likely.
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

        /// Bytes that are accepted are the only form of their contents.
        #[test]
        fn any_bytes_are_an_error_or_are_coded_back(
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
