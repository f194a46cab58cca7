//! Memory that all Rust code of the process holds, counted, and refused beyond a bound.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// More is refused, which ends the process with a message. Readers are granted much less by their callers.
pub const LIVE_BYTES_MAX: usize = 512 << 20;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

/// Runs `work`, and returns with its result how many bytes more than before were held at a time, by all threads.
pub fn peak_bytes<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = LIVE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let result = work();
    (result, PEAK.load(Relaxed).saturating_sub(before))
}

struct Counted;

#[global_allocator]
static COUNTED: Counted = Counted;

/// Counts bytes that are about to be held; `false` where there are too many.
fn add(bytes: usize) -> bool {
    let live = LIVE.fetch_add(bytes, Relaxed).saturating_add(bytes);
    if live > LIVE_BYTES_MAX {
        LIVE.fetch_sub(bytes, Relaxed);
        return false;
    }
    PEAK.fetch_max(live, Relaxed);
    true
}

#[expect(unsafe_code, reason = "an allocator that counts stands before the system's")]
// SAFETY: every call is passed on to the system's allocator with the arguments it came with, or refused with a null pointer.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if !add(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller's promises are those of this function.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if !add(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller's promises are those of this function.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        if !add(bytes) {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller's promises are those of this function, and `pointer` came from the system's allocator.
        let moved = unsafe { System.realloc(pointer, layout, bytes) };
        LIVE.fetch_sub(if moved.is_null() { bytes } else { layout.size() }, Relaxed);
        moved
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's promises are those of this function, and `pointer` came from the system's allocator.
        unsafe { System.dealloc(pointer, layout) }
    }
}
