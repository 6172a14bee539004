//! Makes items on several threads ahead of a consumer that takes them in order.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Makes the items `first`, `first + 1`, and so on. The worker of an item follows from its number, and no item depends on the
/// number of workers.
pub(crate) struct Prefetcher<T> {
    /// One per worker, which makes the items `first + worker`, `first + worker + workers`, and so on.
    made: Vec<Receiver<T>>,
    next: usize,
    workers: Vec<JoinHandle<()>>,
    waited: Duration,
}

impl<T: Send + 'static> Prefetcher<T> {
    /// Starts up to `workers` threads that call `make`. At most `capacity` items are in progress or waiting to be taken. Both
    /// limits are at least 1.
    pub(crate) fn new(
        first: u64,
        workers: usize,
        capacity: usize,
        make: impl Fn(u64) -> T + Send + Sync + 'static,
    ) -> Self {
        let workers = workers.clamp(1, capacity.max(1));
        let waiting = capacity.max(1) / workers - 1; // besides the one that a worker is making or sending
        let make = Arc::new(make);
        let (made, workers) = (0..workers)
            .map(|worker| {
                let (sender, receiver) = sync_channel(waiting);
                let make = make.clone();
                let numbers = (first + worker as u64..).step_by(workers);
                (receiver, std::thread::spawn(move || work(numbers, &*make, &sender)))
            })
            .unzip();
        Self { made, next: 0, workers, waited: Duration::ZERO }
    }

    /// The next item; `None` when its worker panicked.
    pub(crate) fn take(&mut self) -> Option<T> {
        let start = Instant::now();
        let taken = self.made[self.next].recv().ok();
        self.next = (self.next + 1) % self.made.len();
        self.waited += start.elapsed();
        taken
    }

    /// Total time that [`take`](Self::take) has waited.
    pub(crate) fn waited(&self) -> Duration {
        self.waited
    }
}

fn work<T>(numbers: impl Iterator<Item = u64>, make: &impl Fn(u64) -> T, made: &SyncSender<T>) {
    for number in numbers {
        if made.send(make(number)).is_err() {
            return; // the consumer is gone
        }
    }
}

impl<T> Drop for Prefetcher<T> {
    fn drop(&mut self) {
        self.made.clear();
        for worker in self.workers.drain(..) {
            let _ = worker.join(); // the panic hook has already reported a panic
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    #[test]
    fn items_arrive_in_order_with_any_number_of_workers() {
        for workers in [1, 2, 7] {
            // Later items take less time to make.
            let spin =
                |number: u64| (0..(60 - number) * 1000).fold(number, |x, i| x ^ std::hint::black_box(i));
            let mut prefetcher = Prefetcher::new(5, workers, 3, move |number| (number, spin(number)).0);
            let taken: Vec<u64> = (0..50).filter_map(|_| prefetcher.take()).collect();
            assert_eq!(taken, (5..55).collect::<Vec<_>>());
        }
    }

    #[test]
    fn workers_run_no_further_ahead_than_the_capacity() {
        for (workers, capacity) in [(4, 6), (4, 2), (1, 1), (3, 9)] {
            let made = Arc::new(AtomicU64::new(0));
            let count = made.clone();
            let mut prefetcher =
                Prefetcher::new(0, workers, capacity, move |_| count.fetch_add(1, Ordering::SeqCst));
            for _ in 0..10 {
                prefetcher.take();
            }
            drop(prefetcher); // waits for the workers
            assert!(made.load(Ordering::SeqCst) <= 10 + capacity as u64, "{workers} workers");
        }
    }

    #[test]
    fn take_returns_none_after_a_panic() {
        let mut prefetcher = Prefetcher::new(0, 2, 4, |number| assert!(number != 3, "on purpose"));
        let taken = (0..10).take_while(|_| prefetcher.take().is_some()).count();
        assert_eq!(taken, 3);
    }
}
