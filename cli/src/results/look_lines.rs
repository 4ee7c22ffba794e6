//! The line processing of both kinds of `sightline look`: input lines, answers in the same order, and final
//! medians.

use serde::de::DeserializeOwned;
use serde_json::Value;
use sightline::Error;

use crate::terminal::json_lines::JsonLines;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// An answer with the values that medians are computed from.
pub struct LookReport {
    /// The line to print.
    pub line: Value,
    /// The time of the answer in nanoseconds.
    pub nanos: u64,
    /// The second value with a median: the number of visible triangles (.tets), or the visible share of the
    /// cell's set in steps of 1e-5 (.pvs).
    pub count: u64,
}

/// The medians over all answers.
#[derive(Default)]
pub struct Medians {
    /// The number of answers.
    pub answers: usize,
    /// The median time in nanoseconds.
    pub nanos: Median,
    /// The median of [`LookReport::count`].
    pub count: Median,
}

/// Reads lines, answers each batch of lines, and prints the answers up to the first failure. Returns the
/// outcome and the medians over the printed answers, also if the input ends with an error. `items` is the
/// noun for the answered lines in messages.
pub fn answer<L: DeserializeOwned, Q>(
    input: &mut JsonLines,
    check: impl Fn(L) -> Result<Q, String>,
    mut answers: impl FnMut(Vec<Q>) -> Vec<Result<LookReport, String>>,
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
            "the command answered only the {items} before the bad line"
        ));
    }
    (ended, medians)
}

/// The binary logarithm of the number of steps per power of two. Numbers below 2^(EXACT + 1) have one step
/// each, so their counts are exact.
const EXACT: u32 = 10;

/// The median of any number of integers, in bounded memory. A median up to 2047 is exact; a larger median has
/// a relative error of at most 1/1024.
#[derive(Default)]
pub struct Median {
    /// The count of the numbers in each step.
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

    /// Returns the median (the upper one of two middle numbers), rounded down to a step. Returns `None` if no
    /// number was added.
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
    fn steps_are_ordered_and_contain_their_numbers() {
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
    fn median_is_upper_middle() {
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
