//! What both kinds of `sightline look` share: lines in, answers out in their order, and medians at the end.

use serde::de::DeserializeOwned;
use serde_json::Value;
use sightline::Error;

use crate::terminal::json_lines::JsonLines;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// An answer, and what the medians are of.
pub struct Answer {
    /// The line to print.
    pub line: Value,
    /// How long it took.
    pub nanos: u64,
    /// A number that is told beside the time.
    pub count: u64,
}

/// Medians over all answers.
#[derive(Default)]
pub struct Medians {
    /// Number of answers.
    pub answers: usize,
    /// Of the nanoseconds.
    pub nanos: Median,
    /// Of the numbers beside them.
    pub count: Median,
}

/// Reads lines, has those that were read together answered, and prints the answers up to the first that
/// fails. The medians are of what was answered, also where the input ends with an error, which says so.
pub fn answer<L: DeserializeOwned, Q>(
    input: &mut JsonLines,
    check: impl Fn(L) -> Result<Q, String>,
    mut answers: impl FnMut(Vec<Q>) -> Vec<Result<Answer, String>>,
    items: &str,
) -> (Result<(), Error>, Medians) {
    let mut medians = Medians::default();
    let ended = 'all: loop {
        let (queries, failure) = input.read(&check);
        let last = queries.is_empty();
        for (number, answer) in input.numbers.iter().zip(answers(queries)) {
            let answer = match answer {
                Ok(answer) => answer,
                Err(why) => {
                    break 'all Err(Error::input(format!(
                        "{}, line {number}: {why}",
                        input.name
                    )));
                }
            };
            medians.answers += 1;
            medians.nanos.add(answer.nanos);
            medians.count.add(answer.count);
            if let Err(e) = print(&answer.line.to_string()) {
                return (Err(e), medians);
            }
        }
        match failure {
            Some(e) => break Err(e),
            None if last => break Ok(()),
            None => {}
        }
    };
    if ended.is_err() {
        say(&format!(
            "only the {items} before the bad line were answered"
        ));
    }
    (ended, medians)
}

/// Numbers below 2^EXACT are counted one by one; each power of two above has so many steps.
const EXACT: u32 = 10;

/// The median of any number of numbers, in memory that does not grow with them: exact up to 2047, and within
/// one part in 1024.
#[derive(Default)]
pub struct Median {
    /// Numbers by step.
    counts: Vec<u64>,
    total: u64,
}

impl Median {
    /// Counts a number.
    pub fn add(&mut self, number: u64) {
        let step = step_of(number);
        if self.counts.len() <= step {
            self.counts.resize(step + 1, 0);
        }
        self.counts[step] += 1;
        self.total += 1;
    }

    /// The upper one of the middle numbers, rounded down to a step; nothing of none.
    pub fn get(&self) -> Option<u64> {
        let mut before = 0;
        let step = self.counts.iter().position(|count| {
            before += count;
            before > self.total / 2
        });
        step.map(least_of)
    }
}

fn step_of(number: u64) -> usize {
    let shift = (64 - number.leading_zeros()).saturating_sub(EXACT + 1);
    ((u64::from(shift) << EXACT) + (number >> shift)) as usize
}

fn least_of(step: usize) -> u64 {
    let shift = (step >> EXACT).saturating_sub(1);
    ((step - (shift << EXACT)) as u64) << shift
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_in_order_and_hold_their_numbers() {
        for number in (0..5000).chain([u64::MAX / 3, u64::MAX - 1, u64::MAX]) {
            let least = least_of(step_of(number));
            assert!(
                least <= number && number - least <= number >> EXACT,
                "{number} {least}"
            );
            assert_eq!(step_of(least), step_of(number));
            assert!(number == u64::MAX || step_of(number) <= step_of(number + 1));
        }
    }

    #[test]
    fn the_median_is_the_upper_middle() {
        let median_of = |numbers: &[u64]| {
            let mut median = Median::default();
            numbers.iter().for_each(|n| median.add(*n));
            median.get()
        };
        assert_eq!(median_of(&[]), None);
        assert_eq!(median_of(&[7]), Some(7));
        assert_eq!(median_of(&[9, 1, 5]), Some(5));
        assert_eq!(median_of(&[1, 2, 3, 200]), Some(3));
    }
}
