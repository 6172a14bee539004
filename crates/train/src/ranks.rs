//! Processes that train one network together: ranks, as MPI calls them.
//!
//! Each rank computes the gradients of its part of every batch. The sum has the order of the ranks, so that N ranks give the same
//! bits as one process that accumulates N parts. Every exchange begins with a report of each rank, in which a rank that has failed
//! says so: then all of them end, and none waits for values that never come.

use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::time::{Duration, Instant};

use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};

use crate::error::TrainError;

/// How ranks exchange bytes. All of them must call the same methods in the same order.
pub trait Communicator {
    /// Number of this process among all, from 0.
    fn rank(&self) -> usize;

    /// Number of processes.
    fn ranks(&self) -> usize;

    /// The bytes of every rank, in their order.
    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>>;

    /// Sends `parts[i]` to rank `i`. Returns what the ranks have sent to this one, in their order.
    fn all_to_all(&self, parts: &[&[u8]]) -> Vec<Vec<u8>>;

    /// Ends all processes at once.
    fn abort(&self, exit_code: u8) -> !;
}

/// A process that trains alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Alone;

impl Communicator for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn ranks(&self) -> usize {
        1
    }

    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>> {
        vec![mine.to_vec()]
    }

    fn all_to_all(&self, parts: &[&[u8]]) -> Vec<Vec<u8>> {
        parts.iter().map(|part| part.to_vec()).collect()
    }

    fn abort(&self, exit_code: u8) -> ! {
        std::process::exit(exit_code.into())
    }
}

/// The share of a batch of `samples` that a rank takes: the part of its number in [`Batch::split`](crate::batch::Batch::split).
pub(crate) fn share(rank: usize, ranks: usize, samples: usize) -> Range<usize> {
    rank * samples / ranks..(rank + 1) * samples / ranks
}

/// What a rank says at the beginning of an exchange.
#[derive(Serialize, Deserialize)]
enum Report<T> {
    Fine(T),
    Failed(String),
}

/// The exchanges of a training.
pub(crate) struct Ranks<'a> {
    communicator: &'a dyn Communicator,
    /// Whether all ranks know that one has failed.
    ended: Cell<bool>,
    times: RefCell<Times>,
}

/// Time that a rank has spent on others.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Times {
    /// Waiting for the last rank to come to an exchange.
    pub waiting: Duration,
    pub summing: Duration,
}

impl<'a> Ranks<'a> {
    pub fn new(communicator: &'a dyn Communicator) -> Self {
        Self { communicator, ended: Cell::new(false), times: RefCell::default() }
    }

    pub fn count(&self) -> usize {
        self.communicator.ranks()
    }

    pub fn rank(&self) -> usize {
        self.communicator.rank()
    }

    /// Whether this rank writes the files of the run.
    pub fn leads(&self) -> bool {
        self.rank() == 0
    }

    pub fn times(&self) -> Times {
        *self.times.borrow()
    }

    /// The value of every rank, in their order.
    ///
    /// # Errors
    /// When a rank has failed. The first of those has its own error, and all others [`TrainError::OtherRank`].
    pub fn agree<T: Serialize + DeserializeOwned>(
        &self,
        mine: Result<T, TrainError>,
    ) -> Result<Vec<T>, TrainError> {
        if self.count() == 1 {
            return Ok(vec![mine?]);
        }
        let (mine, error) = match mine {
            Ok(value) => (Report::Fine(value), None),
            Err(error) => (Report::Failed(error.to_string()), Some(error)),
        };
        let start = Instant::now();
        let bytes = serde_json::to_vec(&mine).expect("numbers and text");
        let reports = self.communicator.all_gather(&bytes);
        self.times.borrow_mut().waiting += start.elapsed();
        let ranks = self.count();
        // All are asked for failures first: a rank that has one is elsewhere in its work, and what the others report here is not for it.
        for (rank, report) in reports.iter().enumerate() {
            let Report::Failed(reason) = read::<IgnoredAny>(report) else { continue };
            self.ended.set(true);
            return Err(match error {
                Some(error) if rank == self.rank() => {
                    TrainError::Rank { rank, ranks, error: Box::new(error) }
                }
                _ => TrainError::OtherRank { rank, ranks, reason },
            });
        }
        let value = |(rank, report): (usize, &Vec<u8>)| match read(report) {
            Report::Fine(value) => Ok(value),
            Report::Failed(reason) => Err(TrainError::OtherRank { rank, ranks, reason }),
        };
        reports.iter().enumerate().map(value).collect()
    }

    /// Checks that `value` is the same in all ranks; `what` says what it is.
    pub fn same(&self, what: &'static str, value: impl FnOnce() -> u64) -> Result<(), TrainError> {
        if self.count() == 1 {
            return Ok(());
        }
        let values = self.agree(Ok(value()))?;
        match values.iter().position(|other| *other != values[0]) {
            Some(rank) => Err(TrainError::RanksDiffer { what, rank }),
            None => Ok(()),
        }
    }

    /// Ends the training of all ranks, unless they know already: with an error if one of them has one.
    pub fn end<T>(&self, result: Result<T, TrainError>) -> Result<T, TrainError> {
        if self.ended.get() {
            return result;
        }
        let (result, mine) = match result {
            Ok(value) => (Some(value), Ok(())),
            Err(error) => (None, Err(error)),
        };
        self.agree(mine)?;
        Ok(result.expect("a rank that has not failed"))
    }

    /// Sums the values of all ranks, in the order of the ranks.
    ///
    /// Each rank sums a part of the values, which the others send it, and gives all of them the sum: it sends and receives
    /// two times the size of the values, however many ranks there are.
    pub fn sum(&self, values: &mut [f32]) {
        if self.count() == 1 || values.is_empty() {
            return;
        }
        let start = Instant::now();
        let part = |rank: usize| share(rank, self.count(), values.len());
        let parts: Vec<&[u8]> =
            (0..self.count()).map(|rank| bytemuck::cast_slice(&values[part(rank)])).collect();
        let mut sum = vec![0.0; part(self.rank()).len()];
        for summand in self.communicator.all_to_all(&parts) {
            for (sum, summand) in sum.iter_mut().zip(numbers(&summand)) {
                *sum += summand;
            }
        }
        let sums = self.communicator.all_gather(bytemuck::cast_slice(&sum));
        for (value, sum) in values.iter_mut().zip(sums.iter().flat_map(|sums| numbers(sums))) {
            *value = sum;
        }
        self.times.borrow_mut().summing += start.elapsed();
    }
}

fn read<T: DeserializeOwned>(report: &[u8]) -> Report<T> {
    serde_json::from_slice(report).unwrap_or_else(|error| {
        Report::Failed(format!("its report cannot be read ({error}); do all ranks run the same srflow?"))
    })
}

/// Numbers as the bytes of this machine.
fn numbers(bytes: &[u8]) -> impl Iterator<Item = f32> {
    bytes.as_chunks().0.iter().map(|bytes| f32::from_ne_bytes(*bytes))
}
