//! Values for reuse, shared by threads.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Values that a thread uses alone and then hands on to the next one, such as buffers. There are as many as threads needed one at once.
#[derive(Debug)]
pub struct Spares<T>(Mutex<Vec<T>>);

impl<T> Spares<T> {
    /// A value that nobody uses, if there is one.
    pub fn take(&self) -> Option<T> {
        self.lock().pop()
    }

    /// Keeps a value for the next one who needs it.
    pub fn put(&self, value: T) {
        self.lock().push(value);
    }

    fn lock(&self) -> MutexGuard<'_, Vec<T>> {
        // Values are whole when they are put here, so a panic leaves nothing half-made.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Default for Spares<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}
