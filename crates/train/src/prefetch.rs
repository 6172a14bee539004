//! Items made on several threads, ahead of the consumer that takes them in order.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Items number `first`, `first + 1`, and so on. Which thread makes an item depends on its number alone, and no item on how
/// many threads there are.
pub(crate) struct Prefetcher<T> {
    /// One for each worker: items number `first + worker`, `first + worker + workers`, and so on.
    made: Vec<Receiver<T>>,
    next: usize,
    workers: Vec<JoinHandle<()>>,
    waited: Duration,
}

impl<T: Send + 'static> Prefetcher<T> {
    /// Starts at most `workers` threads that call `make`; at most `capacity` items are finished or in the making and not yet
    /// taken. There is at least one thread and one item.
    pub(crate) fn new(
        first: u64,
        workers: usize,
        capacity: usize,
        make: impl Fn(u64) -> T + Send + Sync + 'static,
    ) -> Self {
        let workers = workers.clamp(1, capacity.max(1));
        let waiting = capacity.max(1) / workers - 1; // beside the one that a worker holds
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

    /// How long [`take`](Self::take) has waited in total.
    pub(crate) fn waited(&self) -> Duration {
        self.waited
    }
}

fn work<T>(numbers: impl Iterator<Item = u64>, make: &impl Fn(u64) -> T, made: &SyncSender<T>) {
    for number in numbers {
        if made.send(make(number)).is_err() {
            return; // nobody takes it any more
        }
    }
}

impl<T> Drop for Prefetcher<T> {
    fn drop(&mut self) {
        self.made.clear();
        for worker in self.workers.drain(..) {
            let _ = worker.join(); // its panic was reported where it happened
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    #[test]
    fn items_come_in_order_whichever_thread_made_them() {
        for workers in [1, 2, 7] {
            // The later an item, the sooner it is made.
            let spin =
                |number: u64| (0..(60 - number) * 1000).fold(number, |x, i| x ^ std::hint::black_box(i));
            let mut prefetcher = Prefetcher::new(5, workers, 3, move |number| (number, spin(number)).0);
            let taken: Vec<u64> = (0..50).filter_map(|_| prefetcher.take()).collect();
            assert_eq!(taken, (5..55).collect::<Vec<_>>());
        }
    }

    #[test]
    fn no_more_is_made_than_the_capacity() {
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
    fn a_panic_ends_the_waiting() {
        let mut prefetcher = Prefetcher::new(0, 2, 4, |number| assert!(number != 3, "on purpose"));
        let taken = (0..10).take_while(|_| prefetcher.take().is_some()).count();
        assert_eq!(taken, 3);
    }
}
