//! SIGTERM and SIGINT (Ctrl-C) end work that can be continued with exit code 75, so that a job engine runs the command again.
//!
//! Files get their names when they are complete, so that work may end at any time. Commands that ask [`requested`] end in order; those that
//! have not after [`GRACE`] are ended, and lose the files in progress alone.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::STOPPED;

/// How long work may take to end in order, so that all is over within a second.
const GRACE: Duration = Duration::from_millis(700);

static REQUESTED: AtomicBool = AtomicBool::new(false);
static WORK: Mutex<Option<Work>> = Mutex::new(None);

/// Work that the same command continues.
struct Work {
    /// What is left of it.
    left: Box<dyn Fn() -> String + Send>,
    /// Whether it is ended after [`GRACE`].
    may_be_dropped: bool,
}

/// While it lives, a signal ends the program with exit code 75.
pub struct Continuable(());

impl Continuable {
    /// Work that may be dropped; `left` says what is left of it.
    pub fn dropping(left: impl Fn() -> String + Send + 'static) -> Self {
        Self::of(true, left)
    }

    /// Work that asks [`requested`] and saves what it has done, which may take longer than a second.
    pub fn saved() -> Self {
        Self::of(false, || "saving what is done; a second signal ends without".to_owned())
    }

    fn of(may_be_dropped: bool, left: impl Fn() -> String + Send + 'static) -> Self {
        *work() = Some(Work { left: Box::new(left), may_be_dropped });
        Self(())
    }
}

impl Drop for Continuable {
    fn drop(&mut self) {
        *work() = None;
    }
}

fn work() -> MutexGuard<'static, Option<Work>> {
    WORK.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether a signal asked the work to end.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}

/// Watches for signals until the process ends. `on_dropped` gets what was left of work that is ended.
#[cfg(unix)]
pub fn watch(on_dropped: impl Fn(&str) + Send + Clone + 'static) {
    use signal_hook::consts::{SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;

    // A shell without job control starts what it runs in the background with SIGINT ignored.
    let watched = [SIGTERM, SIGINT].into_iter().filter(|signal| !is_ignored(*signal));
    let Ok(mut signals) = Signals::new(watched) else { return };
    let handle = move || {
        for signal in signals.forever() {
            let first = !REQUESTED.swap(true, Ordering::Relaxed);
            let Some((left, may_be_dropped)) =
                work().as_ref().filter(|_| first).map(|work| ((work.left)(), work.may_be_dropped))
            else {
                // Ends the process as if it were not watched.
                _ = signal_hook::low_level::emulate_default_handler(signal);
                continue;
            };
            let name = signal_hook::low_level::signal_name(signal).unwrap_or("a signal");
            if may_be_dropped {
                let on_dropped = on_dropped.clone();
                std::thread::spawn(move || {
                    std::thread::sleep(GRACE);
                    on_dropped(&format!("stopped by {name}: {left}; the same command continues"));
                    std::process::exit(STOPPED.into());
                });
            } else {
                note!("{name}: {left}");
            }
        }
    };
    _ = std::thread::Builder::new().name("signals".to_owned()).spawn(handle);
}

#[cfg(not(unix))]
pub fn watch(_on_dropped: impl Fn(&str) + Send + Clone + 'static) {}

#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    // SAFETY: all zeros is a value of sigaction, which has integers, a set of signals and an optional function pointer.
    let mut current: libc::sigaction = unsafe { std::mem::zeroed() };
    // SAFETY: the pointer to the new action may be null, and that to the old one is of a living sigaction.
    let read = unsafe { libc::sigaction(signal, std::ptr::null(), &mut current) };
    read == 0 && current.sa_sigaction == libc::SIG_IGN
}
