//! An allocator for the binary that keeps large blocks for the next tensor of their size.
//!
//! Each operation returns a new tensor of many megabytes. The system's allocator gives such blocks back at once, and every
//! page of the next one costs a fault: a quarter of the time of a network's refinement.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::{Mutex, PoisonError};

/// Smaller blocks are the system's business.
const SMALLEST: usize = 128 << 10;
/// Bytes kept in all.
const KEPT_BYTES: usize = 384 << 20;
/// Blocks kept in all.
const KEPT_BLOCKS: usize = 512;
/// Of every block that may be kept; what a cache line and a vector want.
const ALIGNMENT: usize = 64;
/// From here on blocks are made of huge pages.
const HUGE: usize = 4 << 20;
const HUGE_PAGE: usize = 2 << 20;

/// Use as `#[global_allocator] static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();`.
#[derive(Debug)]
pub struct ReusingAllocator {
    kept: Mutex<Kept>,
}

/// Free blocks, oldest first.
#[derive(Debug)]
struct Kept {
    /// Address and size.
    blocks: [(usize, usize); KEPT_BLOCKS],
    count: usize,
    bytes: usize,
}

impl ReusingAllocator {
    /// Keeping nothing yet.
    pub const fn new() -> Self {
        Self { kept: Mutex::new(Kept { blocks: [(0, 0); KEPT_BLOCKS], count: 0, bytes: 0 }) }
    }

    fn with_kept<T>(&self, of: impl FnOnce(&mut Kept) -> T) -> T {
        of(&mut self.kept.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Default for ReusingAllocator {
    fn default() -> Self {
        Self::new()
    }
}

impl Kept {
    /// The oldest block.
    fn pop_oldest(&mut self) -> Option<(usize, usize)> {
        (self.count > 0).then(|| self.take(0))
    }

    fn take(&mut self, index: usize) -> (usize, usize) {
        let block = self.blocks[index];
        self.blocks.copy_within(index + 1..self.count, index);
        self.count -= 1;
        self.bytes -= block.1;
        block
    }

    /// The block of this size that was freed last.
    fn take_fitting(&mut self, size: usize) -> Option<usize> {
        let fitting = self.blocks[..self.count].iter().enumerate().filter(|(_, block)| block.1 == size);
        let index = fitting.map(|(index, _)| index).next_back()?;
        Some(self.take(index).0)
    }

    /// Whether there is room for the block now.
    fn push(&mut self, block: (usize, usize)) -> bool {
        let room = self.count < KEPT_BLOCKS && self.bytes + block.1 <= KEPT_BYTES;
        if room {
            self.blocks[self.count] = block;
            self.count += 1;
            self.bytes += block.1;
        }
        room
    }
}

/// The layout of the block that serves `layout`, if that is not left to the system. Sizes are rounded up to one of eight between a
/// power of two and the next, so that nearly equal tensors share blocks.
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
    // SAFETY: the block was just allocated; advice on whole pages of it changes no content, and refusal does no harm.
    unsafe {
        libc::madvise(address.cast(), size / HUGE_PAGE * HUGE_PAGE, libc::MADV_HUGEPAGE);
    }
}

#[cfg(not(target_os = "linux"))]
fn ask_for_huge_pages(_: *mut u8, _: usize) {}

// SAFETY: blocks come from the system's allocator with at least the size and alignment asked for, each is handed out to
// one owner at a time, and goes back to the system with the layout it was made with, a function of the one asked for.
unsafe impl GlobalAlloc for ReusingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let Some(block) = block_layout(layout) else {
            // SAFETY: the caller's promise.
            return unsafe { System.alloc(layout) };
        };
        if let Some(address) = self.with_kept(|kept| kept.take_fitting(block.size())) {
            return address as *mut u8;
        }
        // SAFETY: the size is not zero.
        let address = unsafe { System.alloc(block) };
        if !address.is_null() && block.size() >= HUGE {
            ask_for_huge_pages(address, block.size());
        }
        address
    }

    unsafe fn dealloc(&self, address: *mut u8, layout: Layout) {
        let Some(block) = block_layout(layout) else {
            // SAFETY: the caller's promise.
            return unsafe { System.dealloc(address, layout) };
        };
        if block.size() > KEPT_BYTES / 2 {
            // SAFETY: made by `alloc` with this layout.
            return unsafe { System.dealloc(address, block) };
        }
        while !self.with_kept(|kept| kept.push((address as usize, block.size()))) {
            let Some((oldest, size)) = self.with_kept(Kept::pop_oldest) else { continue };
            // SAFETY: made by `alloc` with this layout; nobody else holds a block that was kept.
            unsafe {
                System.dealloc(oldest as *mut u8, Layout::from_size_align_unchecked(size, alignment(size)))
            }
        }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if block_layout(layout).is_none() {
            // SAFETY: the caller's promise.
            return unsafe { System.alloc_zeroed(layout) };
        }
        // SAFETY: the caller's promise; the block is at least as long as the layout.
        unsafe {
            let address = self.alloc(layout);
            if !address.is_null() {
                address.write_bytes(0, layout.size());
            }
            address
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
            assert_eq!(allocator.with_kept(|kept| kept.count), 2);
        }
    }

    #[test]
    fn what_is_kept_is_bounded() {
        let allocator = ReusingAllocator::new();
        let layouts: Vec<Layout> = (0..2 * KEPT_BLOCKS)
            .map(|i| Layout::from_size_align((i % 7 + 1) << 20, 64).expect("valid"))
            .collect();
        // SAFETY: as above.
        unsafe {
            let blocks: Vec<*mut u8> = layouts.iter().map(|&layout| allocator.alloc(layout)).collect();
            for (&block, &layout) in blocks.iter().zip(&layouts) {
                allocator.dealloc(block, layout);
            }
        }
        let (count, bytes) = allocator.with_kept(|kept| (kept.count, kept.bytes));
        assert!(count <= KEPT_BLOCKS && bytes <= KEPT_BYTES && bytes > KEPT_BYTES / 2);
    }
}
