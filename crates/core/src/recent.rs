//! Values that were made recently, shared by threads.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

type Place<V> = Arc<Mutex<Option<Arc<V>>>>;

/// Keeps the values that were asked for last. The first thread that asks for a value makes it, others that ask meanwhile wait.
pub struct Recent<K, V> {
    kept: usize,
    /// The latest at the back.
    places: Mutex<VecDeque<(K, Place<V>)>>,
}

impl<K: PartialEq, V> Recent<K, V> {
    /// Keeps up to `kept` values, besides those still in use.
    pub fn new(kept: usize) -> Self {
        Self { kept, places: Mutex::default() }
    }

    /// The value of `key`, made by `make` if it is not among the recent ones. A value that could not be made is asked for again.
    ///
    /// # Errors
    /// That of `make`.
    pub fn get<E>(&self, key: K, make: impl FnOnce() -> Result<V, E>) -> Result<Arc<V>, E> {
        let place = self.place(key);
        // Only this value is locked while it is made.
        let mut place = lock(&place);
        found_or_made(&mut place, make)
    }

    /// As [`get`](Self::get), but `None` instead of waiting while another thread makes the value.
    ///
    /// # Errors
    /// That of `make`.
    pub fn try_get<E>(&self, key: K, make: impl FnOnce() -> Result<V, E>) -> Result<Option<Arc<V>>, E> {
        let place = self.place(key);
        let mut place = match place.try_lock() {
            Ok(place) => place,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return Ok(None),
        };
        found_or_made(&mut place, make).map(Some)
    }

    fn place(&self, key: K) -> Place<V> {
        let mut places = lock(&self.places);
        let found = places.iter().position(|(known, _)| *known == key).and_then(|at| places.remove(at));
        let found = found.unwrap_or_else(|| (key, Place::default()));
        let place = found.1.clone();
        places.push_back(found);
        if places.len() > self.kept.max(1) {
            places.pop_front();
        }
        place
    }
}

fn found_or_made<V, E>(place: &mut Option<Arc<V>>, make: impl FnOnce() -> Result<V, E>) -> Result<Arc<V>, E> {
    if let Some(value) = place {
        return Ok(value.clone());
    }
    let value = Arc::new(make()?);
    *place = Some(value.clone());
    Ok(value)
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A value is stored once it is whole, so a panic leaves nothing half-made.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn a_recent_value_is_made_once_and_an_old_one_again() {
        let (recent, made) = (Recent::new(3), AtomicUsize::new(0));
        let get = |key: usize| {
            let make = || Ok::<_, ()>((made.fetch_add(1, Ordering::SeqCst), key * 10).1);
            *recent.get(key, make).unwrap()
        };
        assert_eq!([1, 2, 3, 1, 4, 1].map(get), [10, 20, 30, 10, 40, 10]);
        assert_eq!(made.load(Ordering::SeqCst), 4);
        assert_eq!(get(2), 20); // 4 took its place
        assert_eq!(made.load(Ordering::SeqCst), 5);
    }

    #[test]
    fn threads_that_ask_at_once_share_one_value() {
        let (recent, made) = (Recent::new(2), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    recent.get("key", || Ok::<_, ()>(made.fetch_add(1, Ordering::SeqCst))).unwrap();
                });
            }
        });
        assert_eq!(made.load(Ordering::SeqCst), 1);
    }

    #[test]
    fn who_cannot_wait_gets_what_is_not_being_made() {
        let recent = Recent::new(2);
        let made = recent.get(1, || {
            std::thread::scope(|scope| {
                let other = || {
                    assert!(recent.try_get(1, || Ok::<_, ()>(7)).unwrap().is_none());
                    *recent.try_get(2, || Ok::<_, ()>(20)).unwrap().unwrap()
                };
                Ok::<_, ()>(scope.spawn(other).join().unwrap() / 2)
            })
        });
        assert_eq!(made.as_deref(), Ok(&10));
        assert_eq!(recent.try_get(1, || Err("made before")), Ok(Some(Arc::new(10))));
    }

    #[test]
    fn a_value_that_could_not_be_made_is_asked_for_again() {
        let recent = Recent::new(2);
        assert_eq!(recent.get(1, || Err("broken")), Err("broken"));
        assert_eq!(recent.get(1, || Ok::<_, ()>(7)).as_deref(), Ok(&7));
    }
}
