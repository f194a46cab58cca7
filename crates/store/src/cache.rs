//! Decoded pages under a budget: least recently used pages go first, pinned ones never.

use crate::stats::CacheStats;
use pbgi_format::PageId;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A decoded, verified page. Held in memory as long as anyone holds a [`PageRef`] to it.
#[derive(Debug)]
pub struct Page {
    bytes: Box<[u8]>,
    held: Arc<AtomicU64>,
}

impl Page {
    /// The decoded bytes.
    #[must_use]
    #[inline(always)]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.held.fetch_sub(self.bytes.len() as u64, Ordering::Relaxed);
    }
}

/// A pin on a page: while it lives, the page stays.
pub type PageRef = Arc<Page>;

const NONE: u32 = u32::MAX;

enum Slot {
    Absent,
    /// Some thread reads it; others wait.
    Loading,
    Present(PageRef),
}

struct State {
    slots: Vec<Slot>,
    /// Neighbors in order of use, per page: (newer, older).
    links: Vec<(u32, u32)>,
    newest: u32,
    oldest: u32,
    /// Bytes of pages in slots or being loaded.
    bytes: u64,
    /// Whether each page was ever read.
    seen: Vec<bool>,
    stats: CacheStats,
}

/// What [`Cache::get`] found.
pub(crate) enum Lookup {
    /// The page is here.
    Found(PageRef),
    /// The caller must load it and call [`Cache::insert`] or [`Cache::abandon`]; room is made.
    Load,
}

/// The pages of one file that are in memory.
pub(crate) struct Cache {
    state: Mutex<State>,
    loaded: Condvar,
    budget_bytes: u64,
    held: Arc<AtomicU64>,
}

impl Cache {
    pub fn new(page_count: usize, budget_bytes: u64) -> Self {
        Self {
            state: Mutex::new(State {
                slots: (0..page_count).map(|_| Slot::Absent).collect(),
                links: vec![(NONE, NONE); page_count],
                newest: NONE,
                oldest: NONE,
                bytes: 0,
                seen: vec![false; page_count],
                stats: CacheStats::default(),
            }),
            loaded: Condvar::new(),
            budget_bytes,
            held: Arc::default(),
        }
    }

    /// Bytes the cache itself takes per page of the file, whether in memory or not.
    pub const BYTES_PER_PAGE: u64 = (size_of::<Slot>() + size_of::<(u32, u32)>() + 1) as u64;

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic while holding the lock is a defect that has been reported already.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The page, or the duty to load it. Waits while another thread loads it. `decoded_bytes` is
    /// accounted for before this returns [`Lookup::Load`].
    pub fn get(&self, id: PageId, decoded_bytes: u32) -> Lookup {
        let index = id.0 as usize;
        let mut state = self.lock();
        let mut waited = None;
        loop {
            match &state.slots[index] {
                Slot::Present(page) => {
                    let page = page.clone();
                    state.touch(id.0);
                    state.stats.hits += 1;
                    state.add_wait(waited);
                    return Lookup::Found(page);
                }
                Slot::Loading => {
                    waited.get_or_insert_with(std::time::Instant::now);
                    state = self.loaded.wait(state).unwrap_or_else(PoisonError::into_inner);
                }
                Slot::Absent => {
                    state.make_room(u64::from(decoded_bytes), self.budget_bytes);
                    state.bytes += u64::from(decoded_bytes);
                    state.slots[index] = Slot::Loading;
                    state.add_wait(waited);
                    return Lookup::Load;
                }
            }
        }
    }

    /// Completes a load.
    pub fn insert(&self, id: PageId, bytes: Box<[u8]>, stored_bytes: u32, read_ns: u64) -> PageRef {
        let length = bytes.len() as u64;
        let held = self.held.fetch_add(length, Ordering::Relaxed) + length;
        let page = Arc::new(Page { bytes, held: self.held.clone() });
        let mut state = self.lock();
        let stats = &mut state.stats;
        stats.pages_read += 1;
        stats.bytes_read += u64::from(stored_bytes);
        stats.wait_ns += read_ns;
        stats.held_bytes_max = stats.held_bytes_max.max(held);
        if std::mem::replace(&mut state.seen[id.0 as usize], true) {
            state.stats.rereads += 1;
        } else {
            state.stats.distinct_pages += 1;
            state.stats.distinct_bytes += u64::from(stored_bytes);
        }
        state.slots[id.0 as usize] = Slot::Present(page.clone());
        state.push_newest(id.0);
        self.loaded.notify_all();
        page
    }

    /// Gives a load up after an error; the next reader tries again.
    pub fn abandon(&self, id: PageId, decoded_bytes: u32) {
        let mut state = self.lock();
        state.slots[id.0 as usize] = Slot::Absent;
        state.bytes -= u64::from(decoded_bytes);
        self.loaded.notify_all();
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
        let mut bytes = 0;
        let mut present = 0;
        for slot in &state.slots {
            if let Slot::Present(page) = slot {
                bytes += page.bytes.len() as u64;
                present += 1;
            }
        }
        let loading = state.slots.iter().filter(|s| matches!(s, Slot::Loading)).count();
        assert!(loading > 0 || bytes == state.bytes, "{bytes} {}", state.bytes);
        let (mut at, mut count, mut newer) = (state.newest, 0, NONE);
        while at != NONE {
            assert!(matches!(state.slots[at as usize], Slot::Present(_)));
            assert_eq!(state.links[at as usize].0, newer);
            newer = at;
            at = state.links[at as usize].1;
            count += 1;
        }
        assert_eq!(state.oldest, newer);
        assert_eq!(count, present);
    }
}

impl State {
    fn add_wait(&mut self, since: Option<std::time::Instant>) {
        self.stats.wait_ns += since.map_or(0, |s| s.elapsed().as_nanos() as u64);
    }

    fn push_newest(&mut self, id: u32) {
        self.links[id as usize] = (NONE, self.newest);
        match self.newest {
            NONE => self.oldest = id,
            newest => self.links[newest as usize].0 = id,
        }
        self.newest = id;
    }

    fn unlink(&mut self, id: u32) {
        let (newer, older) = self.links[id as usize];
        match newer {
            NONE => self.newest = older,
            newer => self.links[newer as usize].1 = older,
        }
        match older {
            NONE => self.oldest = newer,
            older => self.links[older as usize].0 = newer,
        }
    }

    fn touch(&mut self, id: u32) {
        if self.newest != id {
            self.unlink(id);
            self.push_newest(id);
        }
    }

    /// Drops the least recently used unpinned pages until `bytes` more fit. Where pins leave too
    /// little, the page is admitted all the same: `Octree::open` made sure that the budget holds
    /// what all readers may pin.
    fn make_room(&mut self, bytes: u64, budget_bytes: u64) {
        let mut at = self.oldest;
        while self.bytes + bytes > budget_bytes && at != NONE {
            let newer = self.links[at as usize].0;
            let pinned = match &self.slots[at as usize] {
                Slot::Present(page) => Arc::strong_count(page) > 1,
                _ => true,
            };
            if !pinned {
                self.unlink(at);
                if let Slot::Present(page) =
                    std::mem::replace(&mut self.slots[at as usize], Slot::Absent)
                {
                    self.bytes -= page.bytes.len() as u64;
                }
                self.stats.evictions += 1;
            }
            at = newer;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(cache: &Cache, id: u32, bytes: usize) -> PageRef {
        match cache.get(PageId(id), bytes as u32) {
            Lookup::Found(page) => page,
            Lookup::Load => cache.insert(PageId(id), vec![id as u8; bytes].into(), bytes as u32, 0),
        }
    }

    #[test]
    fn least_recently_used_pages_go_first_and_pinned_ones_stay() {
        let cache = Cache::new(10, 300);
        let pinned = load(&cache, 0, 100);
        drop(load(&cache, 1, 100));
        drop(load(&cache, 2, 100));
        drop(load(&cache, 1, 100));
        drop(load(&cache, 3, 100));
        cache.validate();
        let stats = cache.stats();
        assert_eq!((stats.evictions, stats.hits, stats.pages_read), (1, 1, 4));
        drop(load(&cache, 1, 100));
        assert_eq!(cache.stats().hits, 2, "page 1 was used more recently than page 2");
        assert_eq!(pinned.bytes(), &[0; 100]);
        drop(load(&cache, 0, 100));
        assert_eq!(cache.stats().hits, 3, "page 0 was pinned");
        assert_eq!(cache.stats().held_bytes_max, 300);
    }

    #[test]
    fn counters_agree_with_a_plain_model() {
        let cache = Cache::new(50, 1000);
        let mut order: Vec<u32> = Vec::new();
        let mut hits = 0;
        let mut random = 1u32;
        for _ in 0..5000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let id = (random >> 16) % 50 * ((random >> 8) % 3) / 2 % 50;
            drop(load(&cache, id, 100));
            if let Some(at) = order.iter().position(|&o| o == id) {
                hits += 1;
                order.remove(at);
            } else if order.len() == 10 {
                order.remove(0);
            }
            order.push(id);
        }
        cache.validate();
        assert_eq!(cache.stats().hits, hits);
        assert_eq!(cache.stats().pages_read, 5000 - hits);
    }

    #[test]
    fn one_thread_loads_while_others_wait() {
        let cache = Cache::new(4, 1000);
        let loads = AtomicU64::new(0);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for round in 0..200u32 {
                        let id = PageId(round % 4);
                        match cache.get(id, 10) {
                            Lookup::Found(page) => assert_eq!(page.bytes()[0], id.0 as u8),
                            Lookup::Load => {
                                loads.fetch_add(1, Ordering::Relaxed);
                                std::thread::yield_now();
                                cache.insert(id, vec![id.0 as u8; 10].into(), 10, 0);
                            }
                        }
                    }
                });
            }
        });
        cache.validate();
        assert_eq!(loads.into_inner(), 4);
    }

    #[test]
    fn abandoned_loads_can_be_tried_again() {
        let cache = Cache::new(1, 100);
        assert!(matches!(cache.get(PageId(0), 50), Lookup::Load));
        cache.abandon(PageId(0), 50);
        cache.validate();
        assert!(matches!(cache.get(PageId(0), 50), Lookup::Load));
    }
}
