//! Making numbered things on several threads, ahead of the one who takes them in order.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Things number `first`, `first + 1`, and so on, made on threads. What is taken does not depend on how many there are.
pub(crate) struct ReadAhead<T> {
    shared: Arc<Shared<T>>,
    workers: Vec<JoinHandle<()>>,
    waited: Duration,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    changed: Condvar,
    capacity: u64,
}

struct State<T> {
    /// The next that nobody makes yet.
    next: u64,
    /// The next that is taken.
    wanted: u64,
    made: BTreeMap<u64, T>,
    /// A worker that panicked, or the end.
    stopped: bool,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State<T>>) -> MutexGuard<'a, State<T>> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }
}

/// Wakes the others when a worker ends, be it by a panic.
struct Leaving<T>(Arc<Shared<T>>);

impl<T> Drop for Leaving<T> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.lock().stopped = true;
        }
        self.0.changed.notify_all();
    }
}

impl<T: Send + 'static> ReadAhead<T> {
    /// Starts `workers` threads that call `make`; at most `capacity` things are made or being made that nobody took.
    pub(crate) fn new(
        first: u64,
        workers: usize,
        capacity: usize,
        make: impl Fn(u64) -> T + Send + Sync + 'static,
    ) -> Self {
        let state = State { next: first, wanted: first, made: BTreeMap::new(), stopped: false };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            changed: Condvar::new(),
            capacity: capacity.max(1) as u64,
        });
        let make = Arc::new(make);
        let workers = (0..workers.max(1))
            .map(|_| {
                let (shared, make) = (shared.clone(), make.clone());
                std::thread::spawn(move || work(shared, &*make))
            })
            .collect();
        Self { shared, workers, waited: Duration::ZERO }
    }

    /// The next thing; `None` when a worker panicked.
    pub(crate) fn take(&mut self) -> Option<T> {
        let start = Instant::now();
        let mut state = self.shared.lock();
        let taken = loop {
            let wanted = state.wanted;
            if let Some(made) = state.made.remove(&wanted) {
                state.wanted += 1;
                break Some(made);
            }
            if state.stopped {
                break None;
            }
            state = self.shared.wait(state);
        };
        drop(state);
        self.shared.changed.notify_all();
        self.waited += start.elapsed();
        taken
    }

    /// How long [`take`](Self::take) has waited, all in all.
    pub(crate) fn waited(&self) -> Duration {
        self.waited
    }
}

impl<T> Drop for ReadAhead<T> {
    fn drop(&mut self) {
        self.shared.lock().stopped = true;
        self.shared.changed.notify_all();
        for worker in self.workers.drain(..) {
            let _ = worker.join(); // its panic was reported where it happened
        }
    }
}

fn work<T>(shared: Arc<Shared<T>>, make: &impl Fn(u64) -> T) {
    let leaving = Leaving(shared);
    let shared = &leaving.0;
    let mut state = shared.lock();
    loop {
        if state.stopped {
            return;
        }
        if state.next < state.wanted.saturating_add(shared.capacity) {
            let number = state.next;
            state.next += 1;
            drop(state);
            let made = make(number);
            state = shared.lock();
            state.made.insert(number, made);
            shared.changed.notify_all();
        } else {
            state = shared.wait(state);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    #[test]
    fn things_come_in_order_whoever_made_them() {
        for workers in [1, 2, 7] {
            let mut ahead = ReadAhead::new(5, workers, 3, |number| {
                std::thread::sleep(Duration::from_micros(number * 7919 % 300));
                number
            });
            let taken: Vec<u64> = (0..50).filter_map(|_| ahead.take()).collect();
            assert_eq!(taken, (5..55).collect::<Vec<_>>());
        }
    }

    #[test]
    fn no_more_is_made_than_was_asked_for() {
        let made = Arc::new(AtomicU64::new(0));
        let count = made.clone();
        let mut ahead = ReadAhead::new(0, 4, 6, move |_| count.fetch_add(1, Ordering::SeqCst));
        for _ in 0..10 {
            ahead.take();
        }
        std::thread::sleep(Duration::from_millis(20));
        assert!(made.load(Ordering::SeqCst) <= 16);
        drop(ahead);
    }

    #[test]
    fn a_panic_ends_the_waiting() {
        let mut ahead = ReadAhead::new(0, 2, 4, |number| assert!(number != 3, "on purpose"));
        let taken = (0..10).take_while(|_| ahead.take().is_some()).count();
        assert!(taken <= 3);
    }
}
