//! No memory is allocated on a header's claim alone: the largest allocation stays within what the file's own size can
//! justify.

use std::alloc::{GlobalAlloc, Layout, System};
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use srflow_core::random::Key;
use srflow_files::{read_flow, read_image, read_npy};

/// The system allocator, recording the largest request.
struct Watched;

static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is forwarded to the system allocator with the same arguments.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: guaranteed by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: guaranteed by the caller.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LARGEST.fetch_max(size, Ordering::Relaxed);
        // SAFETY: guaranteed by the caller.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: guaranteed by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

/// A deflate stream can expand 1032 times, and a byte of a 1-bit image to eight pixels of three bytes. JPEG has no such bound
/// except its own limit on sides, so its headers are not changed here.
fn justified(file_bytes: usize) -> usize {
    (1 << 20) + 1032 * 4 * file_bytes
}

#[test]
fn changed_headers_take_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let data = PathBuf::from("tests/data");
    let names = [
        "flow.npy",
        "flow_f16.npy",
        "flow.npz",
        "flow_compressed.npz",
        "flow_opencv.flo",
        "flow_kitti.png",
        "flow.pfm",
        "spring.flo5",
        "shuffled.flo5",
        "latest.flo5",
        "image.png",
        "image_grey.png",
    ];
    let mut random = Key::new(5).stream("changed headers");
    for name in names {
        let good = fs::read(data.join(name)).unwrap();
        let path = folder.path().join(name);
        for _ in 0..80 {
            let mut bytes = good.clone();
            for _ in 0..1 + random.below(4) {
                // Sizes are small numbers of 2 to 8 bytes: changing one byte makes them large.
                let at = random.below(bytes.len().min(1200) as u32) as usize;
                bytes[at] = [0xff, 0x7f, 0x10, 0x39][random.below(4) as usize];
            }
            fs::write(&path, &bytes).unwrap();
            LARGEST.store(0, Ordering::Relaxed);
            let _ = read_flow(&path);
            let _ = read_image(&path);
            let _ = read_npy(&path);
            let largest = LARGEST.load(Ordering::Relaxed);
            assert!(
                largest <= justified(bytes.len()),
                "{name}: {largest} bytes for a file of {}",
                bytes.len()
            );
        }
    }
}
