//! Work on a sequence in stages that overlap: reading, computing, writing.

use std::panic::resume_unwind;
use std::sync::mpsc::sync_channel;
use std::thread::{ScopedJoinHandle, scope};

/// Runs the stages of a sequence of items at once: `read` and `write` on threads of their own, `work` on the calling thread and thus in its
/// rayon pool. Items keep their order.
///
/// `read` hands each item, or the error in its place, to the function that it gets, and should return as soon as that returns `false`: nothing
/// more is needed. At most `ahead` items wait for `work`, and as many results for `write`, besides one in the hands of each stage.
///
/// Panics when a stage panics, with that stage's panic.
///
/// # Errors
/// The one that a loop over the stages would have ended with: the first by the order of items, and of an item that of its first stage. All
/// results before it have been written, none after it; `read` may have been further.
pub fn in_stages<A: Send, B: Send, E: Send>(
    ahead: usize,
    read: impl FnOnce(&mut dyn FnMut(Result<A, E>) -> bool) + Send,
    mut work: impl FnMut(A) -> Result<B, E>,
    mut write: impl FnMut(B) -> Result<(), E> + Send,
) -> Result<(), E> {
    scope(|scope| {
        let (give, items) = sync_channel(ahead);
        let (hand_on, results) = sync_channel(ahead);
        let reader = scope.spawn(move || read(&mut |item| give.send(item).is_ok()));
        let writer = scope.spawn(move || results.into_iter().try_for_each(&mut write));
        let mut worked = Ok(());
        for item in items {
            // A result that is not taken follows one that could not be written.
            let handed_on = item.and_then(&mut work).map(|result| hand_on.send(result).is_ok());
            if !matches!(handed_on, Ok(true)) {
                worked = handed_on.map(drop);
                break;
            }
        }
        drop(hand_on);
        let written = joined(writer);
        joined(reader);
        written.and(worked)
    })
}

fn joined<T>(thread: ScopedJoinHandle<'_, T>) -> T {
    thread.join().unwrap_or_else(|panic| resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use super::*;

    /// What happens to the items 0 to 9 when each stage fails at one of them: the numbers that were written, and the outcome.
    fn run([read, work, write]: [usize; 3]) -> (Vec<usize>, Result<(), String>) {
        let mut written = Vec::new();
        let outcome = in_stages(
            1,
            |give| {
                for item in 0..10 {
                    let item = if item == read { Err(format!("read {item}")) } else { Ok(item) };
                    if !give(item) {
                        return;
                    }
                }
            },
            |item| if item == work { Err(format!("work {item}")) } else { Ok(item) },
            |item| {
                std::thread::sleep(Duration::from_millis(1)); // so that the stages before are further
                if item == write {
                    return Err(format!("write {item}"));
                }
                written.push(item);
                Ok(())
            },
        );
        (written, outcome)
    }

    #[test]
    fn items_keep_their_order() {
        assert_eq!(run([99; 3]), ((0..10).collect(), Ok(())));
    }

    #[test]
    fn the_first_error_by_the_order_of_items_ends_the_work() {
        for (failing, at, error) in [
            ([4, 99, 99], 4, "read 4"),
            ([99, 4, 99], 4, "work 4"),
            ([99, 99, 4], 4, "write 4"),
            ([5, 5, 4], 4, "write 4"),
            ([6, 5, 5], 5, "work 5"),
            ([5, 5, 5], 5, "read 5"),
            ([0, 1, 2], 0, "read 0"),
            ([99, 9, 8], 8, "write 8"),
        ] {
            assert_eq!(run(failing), ((0..at).collect(), Err(error.to_owned())), "{failing:?}");
        }
    }

    #[test]
    fn a_panic_of_any_stage_ends_the_work_with_that_panic() {
        for stage in 0..3 {
            let fail = |at: usize, item: usize| assert!(at != stage || item != 3, "stage {stage} at {item}");
            let ended = catch_unwind(AssertUnwindSafe(|| {
                in_stages(
                    1,
                    |give| {
                        (0..10).all(|item| {
                            fail(0, item);
                            give(Ok::<_, ()>(item))
                        });
                    },
                    |item| {
                        fail(1, item);
                        Ok(item)
                    },
                    |item| {
                        fail(2, item);
                        Ok(())
                    },
                )
            }));
            let panic = ended.expect_err("a panic");
            assert_eq!(panic.downcast_ref(), Some(&format!("stage {stage} at 3")));
        }
    }

    #[test]
    fn reading_is_a_few_items_ahead_and_ends_early() {
        let (read, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let outcome = in_stages(
            1,
            |give| while give(Ok(read.fetch_add(1, Ordering::SeqCst))) {},
            |item| {
                std::thread::sleep(Duration::from_millis(1));
                most.fetch_max(read.load(Ordering::SeqCst) - item, Ordering::SeqCst);
                if item == 20 { Err("enough") } else { Ok(()) }
            },
            |()| Ok(()),
        );
        assert_eq!(outcome, Err("enough"));
        let most = most.into_inner();
        assert!((2..=4).contains(&most), "{most}");
    }
}
