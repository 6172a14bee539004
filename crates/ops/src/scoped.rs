//! Settings that hold in a thread while a function is called.

use std::cell::Cell;
use std::thread::LocalKey;

/// Calls `of` with a setting of this thread at a value; it has its former one afterwards, also after a panic.
pub(crate) fn with<V: Copy + 'static, T>(
    setting: &'static LocalKey<Cell<V>>,
    value: V,
    of: impl FnOnce() -> T,
) -> T {
    struct Restore<V: Copy + 'static>(&'static LocalKey<Cell<V>>, V);
    impl<V: Copy> Drop for Restore<V> {
        fn drop(&mut self) {
            self.0.set(self.1);
        }
    }
    let _restore = Restore(setting, setting.replace(value));
    of()
}
