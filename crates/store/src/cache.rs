//! Decoded pages under a budget: a [`Policy`] says which go, pinned ones never do.

use crate::policy::{Lirs, Policy};
use crate::region::{Buffer, Region, SharedRegion, reserved_bytes};
use crate::stats::CacheStats;
use crate::sync::{Arc, Condvar, Mutex, MutexGuard};
use pbgi_format::PageId;
use std::sync::PoisonError;
use std::time::Instant;

/// A decoded, verified page. Held in memory as long as anyone holds a [`PageRef`] to it.
#[derive(Debug)]
pub struct Page {
    buffer: Buffer,
}

impl Page {
    /// The decoded bytes.
    #[must_use]
    #[inline(always)]
    pub fn bytes(&self) -> &[u8] {
        self.buffer.bytes()
    }
}

/// A pin on a page: while it lives, the page stays.
pub type PageRef = Arc<Page>;

enum Slot {
    Absent,
    /// Some thread reads it; others wait.
    Loading,
    Present(PageRef),
    /// Found damaged and left out.
    Damaged,
}

impl Slot {
    /// Whether anyone but the cache holds the page.
    fn is_pinned(&self) -> bool {
        match self {
            Self::Present(page) => Arc::strong_count(page) > 1,
            _ => false,
        }
    }
}

struct State {
    slots: Vec<Slot>,
    policy: ChosenPolicy,
    /// Whether each page was ever read.
    seen: Vec<bool>,
    stats: CacheStats,
}

/// The policy that measured best (`docs/measuring.md`).
type ChosenPolicy = Lirs;

/// Tenths of a full region that pages fill; the rest are gaps.
const FILLED_TENTHS: u64 = 9;

/// What [`Cache::get`] found.
pub(crate) enum Lookup {
    /// The page is here.
    Found(PageRef),
    /// The caller must load it into this buffer and call [`Cache::insert`], or drop the buffer and call [`Cache::abandon`] or
    /// [`Cache::leave_out`].
    Load(Buffer),
    /// The page is damaged and left out.
    LeftOut,
}

/// A page that has been read.
pub(crate) struct LoadedPage {
    /// Its decoded bytes.
    pub buffer: Buffer,
    /// Bytes read for it.
    pub stored_bytes: u32,
    /// Time reading, checking and decoding took.
    pub read_ns: u64,
}

/// The pages of one file that are in memory.
pub(crate) struct Cache {
    state: Mutex<State>,
    loaded: Condvar,
    region: SharedRegion,
}

impl Cache {
    /// A cache of `budget_bytes` at most for pages of these decoded bytes.
    ///
    /// # Errors
    ///
    /// If the system refuses the address space.
    pub fn new(decoded_bytes: &[u32], budget_bytes: u64) -> std::io::Result<Self> {
        let page_count = decoded_bytes.len();
        let all_bytes = decoded_bytes.iter().map(|&bytes| reserved_bytes(bytes)).sum();
        let region = Region::new(budget_bytes.min(all_bytes))?;
        Ok(Self {
            state: Mutex::new(State {
                slots: (0..page_count).map(|_| Slot::Absent).collect(),
                policy: ChosenPolicy::new(page_count, budget_bytes / 10 * FILLED_TENTHS),
                seen: vec![false; page_count],
                stats: CacheStats::default(),
            }),
            loaded: Condvar::new(),
            region,
        })
    }

    /// Bytes the cache itself takes per page of the file, whether in memory or not.
    pub const BYTES_PER_PAGE: u64 = size_of::<Slot>() as u64 + ChosenPolicy::BYTES_PER_PAGE + 1;

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic while holding the lock is a defect that has been reported already.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The page, or the duty to load it, with room for its `decoded_bytes`. Waits while another thread loads it.
    pub fn get(&self, id: PageId, decoded_bytes: u32) -> Lookup {
        let index = id.0 as usize;
        let mut state = self.lock();
        let mut waited = None;
        loop {
            match &state.slots[index] {
                Slot::Present(page) => {
                    let page = page.clone();
                    state.policy.touch(id.0);
                    state.stats.hits += 1;
                    state.add_wait(waited);
                    return Lookup::Found(page);
                }
                Slot::Loading => {
                    waited.get_or_insert_with(Instant::now);
                    state = self.loaded.wait(state).unwrap_or_else(PoisonError::into_inner);
                }
                Slot::Damaged => {
                    state.stats.hits += 1;
                    state.add_wait(waited);
                    return Lookup::LeftOut;
                }
                Slot::Absent => {
                    let buffer = state.make_room(decoded_bytes as usize, &self.region);
                    let held = &mut state.stats.held_bytes_max;
                    *held = self.region.held_bytes().max(*held);
                    state.slots[index] = Slot::Loading;
                    state.add_wait(waited);
                    return Lookup::Load(buffer);
                }
            }
        }
    }

    /// Completes a load.
    pub fn insert(&self, id: PageId, loaded: LoadedPage) -> PageRef {
        let LoadedPage { buffer, stored_bytes, read_ns } = loaded;
        let bytes = reserved_bytes(buffer.bytes().len() as u32) as u32;
        let page = Arc::new(Page { buffer });
        let mut state = self.lock();
        state.count_read(id, stored_bytes, read_ns);
        state.slots[id.0 as usize] = Slot::Present(page.clone());
        state.policy.insert(id.0, bytes);
        self.loaded.notify_all();
        page
    }

    /// Gives a load up after an error; the next reader tries again.
    pub fn abandon(&self, id: PageId) {
        self.give_up(id, Slot::Absent);
    }

    /// Gives a load up for good: the page is damaged, and no reader will get it.
    pub fn leave_out(&self, id: PageId) {
        self.give_up(id, Slot::Damaged);
    }

    fn give_up(&self, id: PageId, slot: Slot) {
        self.lock().slots[id.0 as usize] = slot;
        self.loaded.notify_all();
    }

    /// Pages that were left out, in the order of their numbers.
    pub fn left_out(&self) -> Vec<PageId> {
        let state = self.lock();
        let damaged = |(_, slot): &(u32, &Slot)| matches!(slot, Slot::Damaged);
        (0..).zip(&state.slots).filter(damaged).map(|(index, _)| PageId(index)).collect()
    }

    /// Counts requests that a reader answered from its own pins.
    pub fn add_requests(&self, requests: u64, local_hits: u64) {
        let mut state = self.lock();
        state.stats.requests += requests;
        state.stats.hits += local_hits;
    }

    pub fn stats(&self) -> CacheStats {
        self.lock().stats
    }

    /// Recounts everything from scratch and compares.
    ///
    /// # Panics
    ///
    /// If the books do not balance.
    #[cfg(test)]
    pub fn validate(&self) {
        let state = self.lock();
        let (mut bytes, mut present) = (0, 0);
        for slot in &state.slots {
            match slot {
                Slot::Present(page) => {
                    bytes += reserved_bytes(page.bytes().len() as u32);
                    present += 1;
                }
                Slot::Absent | Slot::Loading | Slot::Damaged => {}
            }
        }
        assert_eq!(state.policy.len(), present, "the policy knows what is there");
        let held = self.region.held_bytes();
        assert!(bytes <= held, "{bytes} in slots, {held} held");
        let stats = &state.stats;
        assert_eq!(stats.pages_read, stats.distinct_pages + stats.rereads);
        assert_eq!(stats.pages_read, present as u64 + stats.evictions);
        let seen = state.seen.iter().filter(|seen| **seen).count() as u64;
        assert_eq!(stats.distinct_pages, seen);
    }
}

impl State {
    fn add_wait(&mut self, since: Option<Instant>) {
        if let Some(since) = since {
            self.stats.waits += 1;
            self.stats.wait_ns += since.elapsed().as_nanos() as u64;
        }
    }

    fn count_read(&mut self, id: PageId, stored_bytes: u32, read_ns: u64) {
        let stats = &mut self.stats;
        stats.pages_read += 1;
        stats.bytes_read += u64::from(stored_bytes);
        stats.read_ns += read_ns;
        stats.wait_ns += read_ns;
        if std::mem::replace(&mut self.seen[id.0 as usize], true) {
            stats.rereads += 1;
        } else {
            stats.distinct_pages += 1;
            stats.distinct_bytes += u64::from(stored_bytes);
        }
    }

    /// A buffer of so many bytes, for which unpinned pages are dropped until there is a gap for it. Where pins leave none, it lies
    /// past the budget: `Octree::open` made sure that the budget holds what all readers may pin, so that this is rare and small.
    fn make_room(&mut self, bytes: usize, region: &SharedRegion) -> Buffer {
        loop {
            if let Some(buffer) = region.reserve(bytes) {
                return buffer;
            }
            let slots = &self.slots;
            let is_pinned = &mut |page: u32| slots[page as usize].is_pinned();
            let Some(page) = self.policy.evict(is_pinned) else {
                return region.reserve_past(bytes);
            };
            self.slots[page as usize] = Slot::Absent;
            self.stats.evictions += 1;
        }
    }
}

#[cfg(test)]
mod tests;
