//! Memory of tasks that is written before it is read.

use std::cell::RefCell;
use std::ops::{Deref, DerefMut};
use std::thread::LocalKey;

use crate::Pair;

/// Vectors that a thread keeps.
const KEPT: usize = 16;
/// Elements of the longest vector that is kept.
const LONGEST: usize = 1 << 20;

/// A slice whose elements are whatever they were. Each thread keeps the memory for its next task: rayon makes new scratch for every few
/// tasks, and clearing it took several percent of a network's time.
#[derive(Debug)]
pub struct Scratch<E: Element = f32> {
    memory: Vec<E>,
    len: usize,
}

/// What a [`Scratch`] holds.
pub trait Element: Copy + Default + 'static {
    #[doc(hidden)]
    fn kept() -> &'static LocalKey<RefCell<Vec<Vec<Self>>>>;
}

macro_rules! element {
    ($($element:ty)*) => {
        $(impl Element for $element {
            fn kept() -> &'static LocalKey<RefCell<Vec<Vec<Self>>>> {
                thread_local! {
                    static KEPT: RefCell<Vec<Vec<$element>>> = const { RefCell::new(Vec::new()) };
                }
                &KEPT
            }
        })*
    };
}

element!(f32 Pair);

impl<E: Element> Scratch<E> {
    /// Of this many elements.
    pub fn of(len: usize) -> Self {
        let fitting = |kept: &RefCell<Vec<Vec<E>>>| {
            let mut kept = kept.borrow_mut();
            // The shortest that is long enough, or else the longest, which is replaced.
            let place = |memory: &Vec<E>| (memory.len() < len, memory.len().abs_diff(len));
            let (number, _) = kept.iter().enumerate().min_by_key(|(_, memory)| place(memory))?;
            Some(kept.swap_remove(number))
        };
        let mut memory = E::kept().try_with(fitting).ok().flatten().unwrap_or_default();
        if memory.len() < len {
            // A new vector: growing would copy what nobody reads.
            memory = vec![E::default(); len];
        }
        Self { memory, len }
    }
}

impl<E: Element> Drop for Scratch<E> {
    fn drop(&mut self) {
        let memory = std::mem::take(&mut self.memory);
        // A thread that ends keeps nothing.
        let _ = E::kept().try_with(|kept| {
            let mut kept = kept.borrow_mut();
            if kept.len() < KEPT && memory.len() <= LONGEST {
                kept.push(memory);
            }
        });
    }
}

impl<E: Element> Deref for Scratch<E> {
    type Target = [E];

    fn deref(&self) -> &[E] {
        &self.memory[..self.len]
    }
}

impl<E: Element> DerefMut for Scratch<E> {
    fn deref_mut(&mut self) -> &mut [E] {
        &mut self.memory[..self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_used_again_and_two_never_share_it() {
        let (mut first, second) = (Scratch::<f32>::of(1000), Scratch::<f32>::of(500));
        assert_eq!((first.len(), second.len()), (1000, 500));
        assert_ne!(first.as_ptr(), second.as_ptr());
        first.fill(3.0);
        let addresses = (first.as_ptr(), second.as_ptr());
        drop((first, second));
        let (second, first) = (Scratch::<f32>::of(400), Scratch::<f32>::of(900));
        assert_eq!((first.as_ptr(), second.as_ptr()), addresses);
        assert_eq!(first[..], [3.0; 900]);
        drop(first);
        assert_eq!(Scratch::<f32>::of(2000)[1000..], [0.0; 1000], "what is new is cleared");
        assert_eq!(Scratch::<Pair>::of(3)[..], [Pair::default(); 3]);
    }

    #[test]
    fn a_thread_keeps_few_and_none_that_are_long() {
        drop((0..2 * KEPT).map(|_| Scratch::<Pair>::of(10)).collect::<Vec<_>>());
        drop(Scratch::<Pair>::of(LONGEST + 1));
        Pair::kept().with_borrow(|kept| {
            assert!(kept.len() <= KEPT && kept.iter().all(|memory| memory.len() <= LONGEST));
        });
    }
}
