//! Memory of decoded pages: one region, reserved once and handed out in runs of blocks.
//!
//! A general allocator keeps what threads free for the thread that took it, and leaves gaps that the next page, of another size,
//! does not fit in: a cache that counts its pages' bytes rightly may then hold half as much again. Here, what pages take is what the
//! region is long, whoever takes and frees, and a page that finds no gap waits for more pages to go.
#![expect(unsafe_code, reason = "runs of one region are lent to several threads at once")]

use memmap2::{MmapMut, MmapOptions};
use std::io;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes of a block. Half a block is lost per page, and as much again as pages are long in gaps that none fits in: of a region of
/// 8 MiB that pages of 35 KiB fill, 88 % are in use, of 64 MiB 91 %; with blocks of 4 KiB, 86 % and 89 %.
pub(crate) const BLOCK_BYTES: u64 = 1024;

/// Blocks that `bytes` take.
fn block_count(bytes: usize) -> usize {
    bytes.div_ceil(BLOCK_BYTES as usize)
}

/// Bytes of the blocks that a page of `decoded_bytes` takes.
pub(crate) fn reserved_bytes(decoded_bytes: u32) -> u64 {
    u64::from(decoded_bytes).next_multiple_of(BLOCK_BYTES)
}

/// A region, and all its buffers. Never shuttle's: no thread waits while it holds the lock of one.
pub(crate) type SharedRegion = Arc<Region>;

/// The memory all pages of a cache share.
pub(crate) struct Region {
    start: NonNull<u8>,
    runs: Mutex<Runs>,
    /// Bytes of buffers that live, in the region or past it.
    held: AtomicU64,
    /// Keeps the memory; reached through `start` alone.
    _map: MmapMut,
}

// SAFETY: `start` points into the map, which may be used from any thread; `runs` gives each byte to one buffer at a time.
unsafe impl Send for Region {}
// SAFETY: as above; all that is shared is behind a lock or atomic.
unsafe impl Sync for Region {}

impl Region {
    /// A region of so many whole blocks as fit into `bytes`. The system gives the memory when it is first written to.
    ///
    /// # Errors
    ///
    /// If the system refuses so much address space.
    pub fn new(bytes: u64) -> io::Result<Arc<Self>> {
        let too_large = |_| io::Error::from(io::ErrorKind::OutOfMemory);
        let blocks = usize::try_from(bytes / BLOCK_BYTES).map_err(too_large)?.max(1);
        let length = blocks * BLOCK_BYTES as usize;
        let mut options = MmapOptions::new();
        options.len(length);
        if !cfg!(miri) {
            // Not known to Miri.
            options.no_reserve_swap();
        }
        let mut map = options.map_anon()?;
        let start = NonNull::from(&mut map[..]).cast();
        let runs = Mutex::new(Runs::new(blocks));
        Ok(Arc::new(Self { start, runs, held: AtomicU64::new(0), _map: map }))
    }

    /// Bytes of all buffers that live, with what rounding to blocks adds.
    pub fn held_bytes(&self) -> u64 {
        self.held.load(Ordering::Relaxed)
    }

    /// A buffer of `length` bytes, if there is a gap for it. What it holds is left over from others.
    pub fn reserve(self: &Arc<Self>, length: usize) -> Option<Buffer> {
        let mut runs = self.runs.lock().unwrap_or_else(PoisonError::into_inner);
        let block = runs.take(block_count(length))?;
        Some(self.buffer(length, Place::Run { block }))
    }

    /// A buffer of `length` bytes past the region.
    pub fn reserve_past(self: &Arc<Self>, length: usize) -> Buffer {
        self.buffer(length, Place::Heap(vec![0; length].into_boxed_slice()))
    }

    #[inline(always)]
    fn address(&self, block: usize) -> *mut u8 {
        // SAFETY: `Runs` gives out blocks of the map only.
        unsafe { self.start.as_ptr().add(block * BLOCK_BYTES as usize) }
    }

    fn buffer(self: &Arc<Self>, length: usize, place: Place) -> Buffer {
        let bytes = block_count(length) as u64 * BLOCK_BYTES;
        self.held.fetch_add(bytes, Ordering::Relaxed);
        Buffer { region: Arc::clone(self), length, place }
    }
}

enum Place {
    /// Blocks of the region, from this one on.
    Run {
        block: usize,
    },
    Heap(Box<[u8]>),
}

/// Bytes of a page; they go back to the region when it is dropped.
pub(crate) struct Buffer {
    region: Arc<Region>,
    length: usize,
    place: Place,
}

impl Buffer {
    #[inline(always)]
    pub fn bytes(&self) -> &[u8] {
        match &self.place {
            Place::Run { block } => {
                let start = self.region.address(*block);
                // SAFETY: the run's blocks lie in the map, are initialized (the map starts as zeros), and belong to this buffer alone
                // until it is dropped; the borrow of `self` forbids writing meanwhile.
                unsafe { std::slice::from_raw_parts(start, self.length) }
            }
            Place::Heap(bytes) => bytes,
        }
    }

    pub fn bytes_mut(&mut self) -> &mut [u8] {
        match &mut self.place {
            Place::Run { block } => {
                let start = self.region.address(*block);
                // SAFETY: as in `bytes`; the unique borrow of `self` forbids any other use of the run meanwhile.
                unsafe { std::slice::from_raw_parts_mut(start, self.length) }
            }
            Place::Heap(bytes) => bytes,
        }
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        let blocks = block_count(self.length);
        self.region.held.fetch_sub(blocks as u64 * BLOCK_BYTES, Ordering::Relaxed);
        if let Place::Run { block } = self.place {
            let mut runs = self.region.runs.lock().unwrap_or_else(PoisonError::into_inner);
            runs.give_back(block, blocks);
        }
    }
}

impl std::fmt::Debug for Buffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Buffer").field("length", &self.length).finish_non_exhaustive()
    }
}

/// Which blocks are taken, one bit each. The first gap from the front that is long enough is given out, which leaves the longer ones
/// further back for longer runs.
struct Runs {
    taken: Vec<u64>,
    /// All words before this one are full.
    first: usize,
}

/// A word of taken blocks.
const FULL: u64 = u64::MAX;

impl Runs {
    fn new(blocks: usize) -> Self {
        let mut taken = vec![0; blocks.div_ceil(64)];
        if let (Some(last), rest @ 1..) = (taken.last_mut(), blocks % 64) {
            *last = FULL << rest;
        }
        Self { taken, first: 0 }
    }

    /// The first block of a run of so many that were free and are now taken.
    fn take(&mut self, count: usize) -> Option<usize> {
        let start = self.find(count)?;
        self.for_each_word(start, count, |word, mask| {
            debug_assert_eq!(*word & mask, 0, "free blocks are taken");
            *word |= mask;
        });
        let full = self.taken[self.first..].iter().take_while(|word| **word == FULL).count();
        self.first += full;
        Some(start)
    }

    fn find(&self, count: usize) -> Option<usize> {
        let mut gap = 0;
        for (index, &word) in self.taken.iter().enumerate().skip(self.first) {
            if word == FULL {
                gap = 0;
                continue;
            }
            let mut bit = 0;
            while bit < 64 {
                let rest = word >> bit;
                let free = (rest.trailing_zeros() as usize).min(64 - bit);
                gap += free;
                if gap >= count {
                    return Some(index * 64 + bit + free - gap);
                }
                bit += free;
                if bit < 64 {
                    bit += (!(word >> bit)).trailing_zeros() as usize;
                    gap = 0;
                }
            }
        }
        None
    }

    fn give_back(&mut self, start: usize, count: usize) {
        self.first = self.first.min(start / 64);
        self.for_each_word(start, count, |word, mask| {
            debug_assert_eq!(*word & mask, mask, "taken blocks are given back");
            *word &= !mask;
        });
    }

    /// Hands the words that hold the bits of a run to `change`, with the bits of each.
    fn for_each_word(&mut self, start: usize, count: usize, change: impl Fn(&mut u64, u64)) {
        let (mut bit, end) = (start, start + count);
        while bit < end {
            let (index, low) = (bit / 64, bit % 64);
            let bits = (end - bit).min(64 - low);
            change(&mut self.taken[index], FULL >> (64 - bits) << low);
            bit += bits;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run of blocks found by looking at every one.
    fn find_plainly(taken: &[bool], count: usize) -> Option<usize> {
        taken.windows(count).position(|window| window.iter().all(|taken| !taken))
    }

    #[test]
    fn the_first_gap_that_is_long_enough_is_taken() {
        for blocks in [1, 63, 64, 65, 200, 1000] {
            let mut runs = Runs::new(blocks);
            let mut plain = vec![false; blocks];
            let mut live: Vec<(usize, usize)> = Vec::new();
            let mut seed = 7u64;
            let mut random = |below: usize| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (seed >> 33) as usize % below
            };
            for round in 0..if cfg!(miri) { 100 } else { 4000 } {
                let count = 1 + random(if round % 7 == 0 { 150 } else { 17 });
                let expected = if count <= blocks { find_plainly(&plain, count) } else { None };
                assert_eq!(runs.take(count), expected, "{count} of {blocks}");
                if let Some(start) = expected {
                    plain[start..start + count].fill(true);
                    live.push((start, count));
                }
                while expected.is_none() && !live.is_empty() || live.len() > 60 {
                    let (start, count) = live.swap_remove(random(live.len()));
                    plain[start..start + count].fill(false);
                    runs.give_back(start, count);
                    if random(3) == 0 {
                        break;
                    }
                }
            }
            for (start, count) in live.drain(..) {
                runs.give_back(start, count);
            }
            assert_eq!(runs.take(blocks), Some(0), "all gaps join again");
        }
    }

    #[test]
    fn buffers_do_not_share_bytes_and_come_back() {
        let region = Region::new(10 * BLOCK_BYTES + 5).unwrap();
        let lengths = [1, 1024, 1025, 2500, 3000];
        let mut buffers: Vec<Buffer> =
            lengths.iter().map(|&length| region.reserve(length).unwrap()).collect();
        assert_eq!(region.held_bytes(), 10 * BLOCK_BYTES);
        assert!(region.reserve(1).is_none());
        for (value, buffer) in (1..).zip(&mut buffers) {
            buffer.bytes_mut().fill(value);
        }
        let mut past = region.reserve_past(2000);
        past.bytes_mut().fill(99);
        assert_eq!((past.bytes(), region.held_bytes()), (&[99; 2000][..], 12 * BLOCK_BYTES));
        for ((value, buffer), length) in (1..).zip(&buffers).zip(lengths) {
            assert_eq!(buffer.bytes(), vec![value; length]);
        }
        drop((buffers, past));
        assert_eq!(region.held_bytes(), 0);
        assert!(region.reserve(10240).is_some());
    }
}
