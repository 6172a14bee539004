//! Computes without the interpreter's lock, on threads that survive a fork, and ends on Ctrl-C.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
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
