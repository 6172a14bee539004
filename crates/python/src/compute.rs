//! Computes without the interpreter's lock, on threads that survive a fork, and ends on Ctrl-C.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// How often Python looks for signals.
const SIGNALS: Duration = Duration::from_millis(50);

/// The threads of this process. Those of the parent do not exist in a forked child, such as a worker of PyTorch's `DataLoader`, where
/// work for them would never end.
fn threads() -> PyResult<Arc<ThreadPool>> {
    static THREADS: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);
    let mut threads = THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    match &*threads {
        Some((owner, threads)) if *owner == process => return Ok(threads.clone()),
        // It is not dropped: that would wake threads that do not exist.
        Some((_, of_parent)) => std::mem::forget(of_parent.clone()),
        None => {}
    }
    let own = Arc::new(new_threads()?);
    *threads = Some((process, own.clone()));
    Ok(own)
}

/// Threads of their own, for work that waits for Python in between.
pub fn new_threads() -> PyResult<ThreadPool> {
    let threads = ThreadPoolBuilder::new().thread_name(|number| format!("srflow {number}")).build();
    threads.map_err(|error| PyRuntimeError::new_err(format!("starting threads: {error}")))
}

/// The result of `work`. On Ctrl-C it raises `KeyboardInterrupt`, and `work` ends unheard.
pub fn compute<R: Send + 'static>(py: Python<'_>, work: impl FnOnce() -> R + Send + 'static) -> PyResult<R> {
    let (sender, mut result) = sync_channel(1);
    threads()?.spawn(move || {
        // The panic hook has printed why; the receiver sees that nothing comes.
        if let Ok(found) = catch_unwind(AssertUnwindSafe(work)) {
            _ = sender.send(found);
        }
    });
    wait_for(py, &mut result)
}

/// Waits for what another thread computes.
pub fn wait_for<R: Send>(py: Python<'_>, result: &mut Receiver<R>) -> PyResult<R> {
    loop {
        let waiting = &mut *result;
        match py.detach(move || waiting.recv_timeout(SIGNALS)) {
            Ok(found) => return Ok(found),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => {
                return Err(PyRuntimeError::new_err(
                    "srflow panicked: see the message above, and please report it",
                ));
            }
        }
    }
}

/// Where work on other threads reports to, while Python waits for it.
pub struct Reporter<E> {
    /// Returns when Python has heard the event; `None` if nobody listens any more.
    tell: Mutex<Box<dyn FnMut(E) -> Option<()> + Send>>,
    stop: Arc<AtomicBool>,
}

impl<E> Reporter<E> {
    /// Waits until `on_event` has returned, unless the work is to stop.
    pub fn report(&self, event: E) {
        let mut tell = self.tell.lock().unwrap_or_else(PoisonError::into_inner);
        if !self.stops() && tell(event).is_none() {
            self.stop.store(true, Ordering::Relaxed);
        }
    }

    /// Whether `on_event` has failed, or Ctrl-C was pressed.
    pub fn stops(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// From the thread that computes to the one that waits.
enum Message<E, R> {
    Event(E),
    Done(R),
}

/// The result of `work`, which reports to `on_event` on this thread. When that fails, or on Ctrl-C, `work` is asked to stop, and the error is
/// raised when it has; a second Ctrl-C does not wait.
pub fn compute_reporting<E: Send + 'static, R: Send + 'static>(
    py: Python<'_>,
    mut on_event: impl FnMut(E) -> PyResult<()>,
    work: impl FnOnce(&Reporter<E>) -> R + Send + 'static,
) -> PyResult<R> {
    let ((sender, mut messages), (answer, answered)) = (channel(), channel());
    let stop = Arc::new(AtomicBool::new(false));
    let events = sender.clone();
    let tell = move |event| {
        events.send(Message::Event(event)).ok()?;
        answered.recv().ok()
    };
    let reporter = Reporter { tell: Mutex::new(Box::new(tell)), stop: stop.clone() };
    // Not the threads of `compute`: the callback may compute too, while this work waits for it.
    new_threads()?.spawn(move || {
        if let Ok(found) = catch_unwind(AssertUnwindSafe(|| work(&reporter))) {
            _ = sender.send(Message::Done(found));
        }
    });
    let mut failed: Option<PyErr> = None;
    loop {
        let error = match wait_for(py, &mut messages) {
            Ok(Message::Done(found)) => return failed.map_or(Ok(found), Err),
            Ok(Message::Event(event)) => {
                let heard = if failed.is_none() { on_event(event) } else { Ok(()) };
                stop.fetch_or(heard.is_err(), Ordering::Relaxed);
                _ = answer.send(());
                match heard {
                    Ok(()) => continue,
                    Err(error) => error,
                }
            }
            Err(error) if failed.is_some() => return Err(failed.unwrap_or(error)),
            Err(error) => error,
        };
        stop.store(true, Ordering::Relaxed);
        failed.get_or_insert(error);
    }
}
