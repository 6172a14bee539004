//! A global allocator that keeps large blocks for the next tensor of the same size.
//!
//! Each operation returns a new tensor of many megabytes. The system allocator returns such blocks to the system at once, and every
//! page of the next one costs a page fault: a quarter of the time of a network's iteration.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr;
use std::sync::{Mutex, PoisonError};

/// Smaller blocks are left to the system allocator.
const SMALLEST: usize = 128 << 10;
/// Bytes that may be kept in any case; also the most by which free and used blocks may exceed the peak use.
const KEPT_BYTES: usize = 384 << 20;
/// Size classes: eight between consecutive powers of two.
const SIZES: usize = 8 * usize::BITS as usize;
/// Alignment of every block that may be kept: a cache line.
const ALIGNMENT: usize = 64;
/// A kept block may serve tensors of as many smaller classes: those that need at least two thirds of it.
const SMALLER: usize = 4;
/// Most blocks that serve tensors of a smaller class at once.
const LENT: usize = 64;
/// Blocks of at least this size use huge pages.
const HUGE: usize = 4 << 20;
const HUGE_PAGE: usize = 2 << 20;

/// Use as `#[global_allocator] static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();`.
///
/// Free blocks are kept while they total at most 384 MiB, or while free and used blocks together total at most five quarters of the
/// peak use, and at most 384 MiB more than it: a training step frees most of its memory, and the next one allocates the same sizes again, though not all at once.
/// Where a new block would exceed that, one of a slightly larger size takes its place if there is one.
#[derive(Debug)]
pub struct ReusingAllocator {
    kept: Mutex<Kept>,
}

/// The header of a free block: its neighbours in the list of its size, and in the list of all by age.
#[derive(Debug, Clone, Copy)]
struct Free {
    size: usize,
    /// Freed before and after, with the same size.
    below: *mut Free,
    above: *mut Free,
    /// Freed before and after, with any size.
    older: *mut Free,
    newer: *mut Free,
}

#[derive(Debug)]
struct Kept {
    /// The most recently freed block of each size.
    last: [*mut Free; SIZES],
    oldest: *mut Free,
    newest: *mut Free,
    /// The first `lent_count` are blocks in use by tensors of a smaller class: their address and size.
    lent: [(*mut u8, usize); LENT],
    lent_count: usize,
    bytes: usize,
    in_use: usize,
    most_in_use: usize,
}

// SAFETY: the pointers lead to free blocks, which nothing else owns.
unsafe impl Send for Kept {}

impl ReusingAllocator {
    /// Initially empty.
    pub const fn new() -> Self {
        let none = ptr::null_mut();
        let kept = Kept {
            last: [none; SIZES],
            oldest: none,
            newest: none,
            lent: [(ptr::null_mut(), 0); LENT],
            lent_count: 0,
            bytes: 0,
            in_use: 0,
            most_in_use: 0,
        };
        Self { kept: Mutex::new(kept) }
    }

    fn with_kept<T>(&self, of: impl FnOnce(&mut Kept) -> T) -> T {
        of(&mut self.kept.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Makes the allocator usable in processes that this one forks, as workers of Python's data loaders are: without it, one forked while
    /// another thread allocates waits for that thread, which it does not have, forever. Only the first allocator of a program is served.
    pub fn survive_forks(&'static self) {
        #[cfg(unix)]
        forks::register(self);
    }

    /// Returns blocks beyond the limit to the system.
    fn give_back(&self) {
        while let Some((address, size)) = self.with_kept(Kept::take_surplus) {
            // SAFETY: allocated by `alloc` with this layout; nothing else owns a kept block.
            unsafe { System.dealloc(address, Layout::from_size_align_unchecked(size, alignment(size))) }
        }
    }
}

impl Default for ReusingAllocator {
    fn default() -> Self {
        Self::new()
    }
}

impl Kept {
    /// Takes a block for a tensor of this size, if there is one; in either case the size counts as in use from now on.
    fn take(&mut self, size: usize) -> Option<*mut u8> {
        let number = size_number(size);
        let exact = self.last[number];
        let block = if exact.is_null() && self.bytes > self.allowed(self.in_use + size) {
            self.larger(number)
        } else {
            exact
        };
        // SAFETY: the lists contain only free blocks.
        let held = unsafe { block.as_ref() }.map_or(size, |block| block.size);
        self.in_use += held;
        self.most_in_use = self.most_in_use.max(self.in_use);
        if block.is_null() {
            return None;
        }
        // SAFETY: as above.
        let address = unsafe { self.unlink(block) };
        if held != size {
            self.lent[self.lent_count] = (address, held);
            self.lent_count += 1;
        }
        Some(address)
    }

    /// A free block that is slightly larger than this class and may be lent, or null.
    fn larger(&self, number: usize) -> *mut Free {
        let larger = self.last.iter().skip(number + 1).take(SMALLER).find(|block| !block.is_null());
        larger.filter(|_| self.lent_count < LENT).copied().unwrap_or(ptr::null_mut())
    }

    /// The size of a block in use by a tensor of class `size`; it no longer counts as lent.
    fn returned(&mut self, address: *mut u8, size: usize) -> usize {
        let lent = &self.lent[..self.lent_count];
        let Some(at) = lent.iter().position(|&(block, _)| block == address) else { return size };
        self.lent_count -= 1;
        self.lent.swap(at, self.lent_count);
        self.lent[self.lent_count].1
    }

    /// Bytes that may be kept while so many are in use.
    fn allowed(&self, in_use: usize) -> usize {
        let most = self.most_in_use.max(in_use);
        KEPT_BYTES.max(most + KEPT_BYTES.min(most / 4) - in_use)
    }

    fn take_surplus(&mut self) -> Option<(*mut u8, usize)> {
        if self.bytes <= self.allowed(self.in_use) || self.oldest.is_null() {
            return None;
        }
        // SAFETY: as in `take`.
        unsafe {
            let size = (*self.oldest).size;
            Some((self.unlink(self.oldest), size))
        }
    }

    /// Keeps a block that was in use by a tensor of class `size`.
    ///
    /// # Safety
    /// [`Kept::take`] returned it for that size, or it was new and has that size; it is free.
    unsafe fn push(&mut self, address: *mut u8, size: usize) {
        let size = self.returned(address, size);
        self.in_use -= size;
        self.bytes += size;
        let block = address.cast::<Free>();
        let below = self.last[size_number(size)];
        let free = Free { size, below, above: ptr::null_mut(), older: self.newest, newer: ptr::null_mut() };
        // SAFETY: the block is large enough and free, and so are those in the lists.
        unsafe {
            block.write(free);
            if let Some(below) = below.as_mut() {
                below.above = block;
            }
            match self.newest.as_mut() {
                Some(newest) => newest.newer = block,
                None => self.oldest = block,
            }
        }
        self.last[size_number(size)] = block;
        self.newest = block;
    }

    /// # Safety
    /// The block is in the lists.
    unsafe fn unlink(&mut self, block: *mut Free) -> *mut u8 {
        // SAFETY: guaranteed by the caller; the lists contain only free blocks.
        unsafe {
            let Free { size, below, above, older, newer } = block.read();
            if let Some(below) = below.as_mut() {
                below.above = above;
            }
            match above.as_mut() {
                Some(above) => above.below = below,
                None => self.last[size_number(size)] = below,
            }
            match older.as_mut() {
                Some(older) => older.newer = newer,
                None => self.oldest = newer,
            }
            match newer.as_mut() {
                Some(newer) => newer.older = older,
                None => self.newest = older,
            }
            self.bytes -= size;
        }
        block.cast()
    }
}

/// Index of the size class.
fn size_number(size: usize) -> usize {
    let power = size.ilog2() as usize;
    8 * power + (size >> (power - 3)) - 8
}

/// The layout of the block for `layout`, unless it is left to the system. Sizes are rounded up to one of eight classes between
/// consecutive powers of two, so that nearly equal tensors share blocks.
fn block_layout(layout: Layout) -> Option<Layout> {
    if layout.size() < SMALLEST || layout.align() > ALIGNMENT {
        return None;
    }
    let step = 1_usize << (layout.size().ilog2() - 3);
    let size = layout.size().checked_next_multiple_of(step)?;
    Layout::from_size_align(size, alignment(size)).ok()
}

fn alignment(size: usize) -> usize {
    if size >= HUGE { HUGE_PAGE } else { ALIGNMENT }
}

#[cfg(target_os = "linux")]
fn ask_for_huge_pages(address: *mut u8, size: usize) {
    // SAFETY: the block was just allocated; advice on whole pages of it changes no content, and a refusal is harmless.
    unsafe {
        libc::madvise(address.cast(), size / HUGE_PAGE * HUGE_PAGE, libc::MADV_HUGEPAGE);
    }
}

#[cfg(not(target_os = "linux"))]
fn ask_for_huge_pages(_: *mut u8, _: usize) {}

/// Holds an allocator's lock while the process forks, so that it is free, and the lists are whole, in both processes.
#[cfg(unix)]
mod forks {
    use std::cell::UnsafeCell;
    use std::sync::{MutexGuard, OnceLock, PoisonError};

    use super::{Kept, ReusingAllocator};

    static ALLOCATOR: OnceLock<&ReusingAllocator> = OnceLock::new();
    static HELD: Held = Held(UnsafeCell::new(None));

    /// The lock of [`ALLOCATOR`] during a fork.
    struct Held(UnsafeCell<Option<MutexGuard<'static, Kept>>>);

    // SAFETY: only the thread that holds the lock of the allocator accesses it; see `prepare` and `release`.
    unsafe impl Sync for Held {}

    pub(super) fn register(allocator: &'static ReusingAllocator) {
        if ALLOCATOR.set(allocator).is_ok() {
            // SAFETY: the functions unwind in no case, and call nothing but the lock. Without memory for the handlers forks are as
            // they were.
            unsafe { libc::pthread_atfork(Some(prepare), Some(release), Some(release)) };
        }
    }

    extern "C" fn prepare() {
        if let Some(allocator) = ALLOCATOR.get() {
            let guard = allocator.kept.lock().unwrap_or_else(PoisonError::into_inner);
            // SAFETY: this thread holds the lock.
            unsafe { *HELD.0.get() = Some(guard) };
        }
    }

    extern "C" fn release() {
        // SAFETY: `prepare` ran on this thread, which in the child is a copy of the parent's: it holds the lock until the guard is
        // dropped, after it was taken out.
        drop(unsafe { (*HELD.0.get()).take() });
    }
}

// SAFETY: blocks come from the system allocator with at least the requested size and alignment, each has one owner at a time, and
// is freed with the layout it was allocated with, which is a function of the requested one.
unsafe impl GlobalAlloc for ReusingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let Some(block) = block_layout(layout) else {
            // SAFETY: guaranteed by the caller.
            return unsafe { System.alloc(layout) };
        };
        if let Some(address) = self.with_kept(|kept| kept.take(block.size())) {
            return address;
        }
        self.give_back();
        // SAFETY: the size is not zero.
        let address = unsafe { System.alloc(block) };
        if !address.is_null() && block.size() >= HUGE {
            ask_for_huge_pages(address, block.size());
        }
        address
    }

    unsafe fn dealloc(&self, address: *mut u8, layout: Layout) {
        let Some(block) = block_layout(layout) else {
            // SAFETY: guaranteed by the caller.
            return unsafe { System.dealloc(address, layout) };
        };
        // SAFETY: allocated by `alloc` with this layout, and free from now on.
        self.with_kept(|kept| unsafe { kept.push(address, block.size()) });
        self.give_back();
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if block_layout(layout).is_none() {
            // SAFETY: guaranteed by the caller.
            return unsafe { System.alloc_zeroed(layout) };
        }
        // SAFETY: guaranteed by the caller; the block is at least as long as the layout.
        unsafe {
            let address = self.alloc(layout);
            if !address.is_null() {
                address.write_bytes(0, layout.size());
            }
            address
        }
    }

    /// A block that is large enough stays in place; blocks of the system allocator are left to it.
    unsafe fn realloc(&self, address: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // SAFETY: guaranteed by the caller: the size does not overflow when rounded up to the alignment.
        let new_layout = unsafe { Layout::from_size_align_unchecked(new_size, layout.align()) };
        match (block_layout(layout), block_layout(new_layout)) {
            // SAFETY: allocated by the system allocator with this layout.
            (None, None) => unsafe { System.realloc(address, layout, new_size) },
            (Some(block), Some(new_block)) if block == new_block => address,
            // SAFETY: both are at least as long as the copy; the old one is not used again.
            _ => unsafe {
                let new = self.alloc(new_layout);
                if !new.is_null() {
                    ptr::copy_nonoverlapping(address, new, layout.size().min(new_size));
                    self.dealloc(address, layout);
                }
                new
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_serves_the_next_of_its_size_and_is_zeroed_when_asked() {
        let allocator = ReusingAllocator::new();
        let layout = Layout::from_size_align(3 << 20, 16).expect("valid");
        let shorter = Layout::from_size_align((3 << 20) - 1000, 4).expect("valid");
        // SAFETY: the layouts are not empty, and each block is freed once with its own.
        unsafe {
            let first = allocator.alloc(layout);
            first.write_bytes(7, layout.size());
            allocator.dealloc(first, layout);
            let second = allocator.alloc_zeroed(shorter);
            assert_eq!(first, second);
            let bytes = std::slice::from_raw_parts(second, shorter.size());
            assert!(bytes.iter().all(|&byte| byte == 0));
            let third = allocator.alloc(layout);
            assert_ne!(second, third);
            allocator.dealloc(second, shorter);
            allocator.dealloc(third, layout);
            let (bytes, in_use) = allocator.with_kept(|kept| (kept.bytes, kept.in_use));
            assert_eq!((bytes, in_use), (6 << 20, 0));
        }
    }

    #[test]
    fn what_grows_keeps_its_content_and_its_place_while_the_block_is_large_enough() {
        let allocator = ReusingAllocator::new();
        let layout = |size: usize| Layout::from_size_align(size, 16).expect("valid");
        // Within the system's sizes, across, within a block, to the next class and to huge pages; then back.
        let sizes = [1000, 2000, SMALLEST + 1, SMALLEST + 1000, 3 << 20, HUGE - 5, HUGE, 9 << 20];
        // SAFETY: the sizes are not zero, and each block is reallocated and freed with its own layout.
        unsafe {
            let mut address = allocator.alloc(layout(sizes[0]));
            address.write_bytes(0xA5, sizes[0]);
            let down = sizes.iter().rev().skip(1);
            for sizes in sizes.iter().chain(down).collect::<Vec<_>>().windows(2) {
                let (size, new_size) = (*sizes[0], *sizes[1]);
                let block = block_layout(layout(size));
                let new = allocator.realloc(address, layout(size), new_size);
                assert_eq!(new as usize % 16, 0);
                if block.is_some() && block == block_layout(layout(new_size)) {
                    assert_eq!(new, address, "{size} to {new_size}");
                }
                let kept = std::slice::from_raw_parts(new, size.min(new_size));
                assert!(kept.iter().all(|&byte| byte == 0xA5), "{size} to {new_size}");
                new.write_bytes(0xA5, new_size);
                address = new;
            }
            allocator.dealloc(address, layout(sizes[0]));
        }
        assert_eq!(allocator.with_kept(|kept| kept.in_use), 0);
    }

    #[test]
    fn little_more_is_kept_than_was_in_use() {
        let allocator = ReusingAllocator::new();
        let layouts: Vec<Layout> =
            (0..1000).map(|i| Layout::from_size_align((i % 7 + 1) << 20, 64).expect("valid")).collect();
        let held = || allocator.with_kept(|kept| kept.bytes + kept.in_use);
        // SAFETY: as above.
        unsafe {
            let take = || -> Vec<*mut u8> { layouts.iter().map(|&layout| allocator.alloc(layout)).collect() };
            let free = |blocks: &[*mut u8]| {
                for (&block, &layout) in blocks.iter().zip(&layouts) {
                    allocator.dealloc(block, layout);
                }
            };
            let blocks = take();
            let most = held();
            assert!(most > 2 * KEPT_BYTES);
            free(&blocks);
            assert_eq!(held(), most, "all is kept for the next step");
            let mut again = take();
            assert_eq!(held(), most, "which takes the same");
            free(&again);
            let mut before = blocks;
            before.sort();
            again.sort();
            assert_eq!(before, again);

            let other = Layout::from_size_align(900 << 20, 64).expect("valid");
            let large = allocator.alloc(other);
            assert!(held() <= most + most / 4, "another size takes the place of what is kept");
            allocator.dealloc(large, other);
            assert!(held() <= most + most / 4);
        }
    }

    #[test]
    fn at_the_limit_a_slightly_larger_block_serves_instead_of_a_new_one() {
        let allocator = ReusingAllocator::new();
        let layout = |mebibytes: usize| Layout::from_size_align(mebibytes << 20, 64).expect("valid");
        let totals = || allocator.with_kept(|kept| (kept.bytes, kept.in_use, kept.lent_count));
        // SAFETY: as above.
        unsafe {
            let take = |size| -> Vec<*mut u8> { (0..10).map(|_| allocator.alloc(layout(size))).collect() };
            let free = |blocks: &[*mut u8], size| {
                blocks.iter().for_each(|&block| allocator.dealloc(block, layout(size)));
            };
            let large = take(120);
            free(&large, 120);
            assert_eq!(totals(), (1200 << 20, 0, 0));
            // A quarter more may be new: three blocks of 88 MiB. Then those of 120 MiB serve.
            let small = take(88);
            let lent = small.iter().filter(|block| large.contains(block)).count();
            assert_eq!((lent, totals().2), (7, 7));
            small.iter().for_each(|block| block.write_bytes(1, 88 << 20));
            let grown = allocator.realloc(small[9], layout(88), 85 << 20);
            assert_eq!(grown, small[9], "still long enough");
            free(&small, 88);
            assert_eq!((totals().1, totals().2), (0, 0));
            let again = take(120);
            assert!(
                again.iter().filter(|block| large.contains(block)).count() >= lent,
                "they are whole again"
            );
            free(&again, 120);
            assert_eq!(totals().1, 0);
        }
    }
    /// Threads allocate all the time while processes are forked, which allocate as well.
    #[cfg(unix)]
    #[test]
    fn forked_processes_never_wait_for_threads_that_they_do_not_have() {
        use std::sync::atomic::{AtomicBool, Ordering};
        use std::time::{Duration, Instant};

        static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();
        ALLOCATOR.survive_forks();
        let layout = Layout::from_size_align(SMALLEST, 64).expect("valid");
        let allocate = move || {
            // SAFETY: the layout is not empty, and the block is freed with it.
            unsafe { ALLOCATOR.dealloc(ALLOCATOR.alloc(layout), layout) }
        };
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    while !done.load(Ordering::Relaxed) {
                        allocate();
                    }
                });
            }
            let hung = (0..300).find(|_| {
                // SAFETY: the child only allocates and ends.
                let child = unsafe { libc::fork() };
                if child == 0 {
                    allocate();
                    // SAFETY: ends the process at once.
                    unsafe { libc::_exit(0) }
                }
                let until = Instant::now() + Duration::from_secs(20);
                loop {
                    // SAFETY: a child of this process, whose status is not asked for.
                    if unsafe { libc::waitpid(child, std::ptr::null_mut(), libc::WNOHANG) } != 0 {
                        return false;
                    }
                    if Instant::now() > until {
                        // SAFETY: as above.
                        unsafe { libc::kill(child, libc::SIGKILL) };
                        return true;
                    }
                    std::thread::sleep(Duration::from_micros(200));
                }
            });
            done.store(true, Ordering::Relaxed);
            assert_eq!(hung, None, "a forked process hangs");
        });
    }
}
