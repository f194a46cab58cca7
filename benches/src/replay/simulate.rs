//! A cache without bytes: readers with pins of their own over one policy, as in `pbgi_store`.

use pbgi_store::PageTrace;
use pbgi_store::policy::Policy;
use std::collections::{BTreeSet, HashMap};

/// Numbers of all pages of a trace, each once.
pub fn distinct(trace: &PageTrace) -> Vec<u32> {
    let mut is_there = vec![false; trace.page_bytes.len()];
    for (id, _) in trace.chunks.iter().flat_map(|chunk| &chunk.entries) {
        is_there[id.0 as usize] = true;
    }
    (0..is_there.len()).filter(|page| is_there[*page]).map(|page| page as u32).collect()
}

/// Requests of a trace.
pub fn requests(trace: &PageTrace) -> u64 {
    let entries = trace.chunks.iter().flat_map(|chunk| &chunk.entries);
    entries.map(|(_, requests)| u64::from(*requests)).sum()
}

/// What a replay counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// All requests, those answered by a reader's own pins included.
    pub requests: u64,
    /// Pages read.
    pub reads: u64,
    /// Bytes of those.
    pub bytes_read: u64,
}

/// What one request of a reader means for the cache.
struct Request {
    page: u32,
    /// The page the reader unpinned, if it was asked for again while it was pinned.
    used: Option<u32>,
}

/// A page a reader holds.
#[derive(Clone, Copy)]
struct LocalPin {
    page: u32,
    is_used: bool,
}

/// The pins of all readers.
struct Pins {
    size: usize,
    readers: HashMap<u32, Vec<Option<LocalPin>>>,
    /// By how many readers each page is pinned.
    counts: Vec<u32>,
}

impl Pins {
    fn new(size: usize, page_count: usize) -> Self {
        Self { size, readers: HashMap::new(), counts: vec![0; page_count] }
    }

    /// A reader asks for a page so many times in a row: what reaches the cache of it.
    fn ask(&mut self, reader: u32, page: u32, times: u32) -> Option<Request> {
        let pins = self.readers.entry(reader).or_insert_with(|| vec![None; self.size]);
        let slot = &mut pins[page as usize & (self.size - 1)];
        match slot {
            Some(pin) if pin.page == page => {
                pin.is_used = true;
                return None;
            }
            _ => {}
        }
        let before = slot.replace(LocalPin { page, is_used: times > 1 });
        if let Some(before) = before {
            self.counts[before.page as usize] -= 1;
        }
        self.counts[page as usize] += 1;
        Some(Request { page, used: before.filter(|pin| pin.is_used).map(|pin| pin.page) })
    }

    fn forget(&mut self, reader: u32) {
        for pin in self.readers.remove(&reader).into_iter().flatten().flatten() {
            self.counts[pin.page as usize] -= 1;
        }
    }
}

/// A trace, a budget, and pins for each reader.
#[derive(Clone, Copy)]
pub struct Replay<'a> {
    pub trace: &'a PageTrace,
    pub budget_bytes: u64,
    /// A power of two.
    pub pins: usize,
}

impl Replay<'_> {
    /// Calls `visit` for each request that reaches the cache, with how many readers pin each page.
    fn for_each_request(&self, mut visit: impl FnMut(&Request, &[u32])) {
        let mut pins = Pins::new(self.pins, self.trace.page_bytes.len());
        for chunk in &self.trace.chunks {
            if chunk.entries.is_empty() {
                pins.forget(chunk.reader);
            }
            for (id, times) in &chunk.entries {
                if let Some(request) = pins.ask(chunk.reader, id.0, *times) {
                    visit(&request, &pins.counts);
                }
            }
        }
    }

    /// Replays with a policy; `pins_count` tells it of pages that were used from a reader's pins.
    pub fn run<P: Policy>(&self, pins_count: bool) -> Seen {
        self.run_without(
            &vec![false; self.trace.page_bytes.len()],
            self.budget_bytes,
            |used| used.filter(|_| pins_count),
            P::new(self.trace.page_bytes.len(), self.budget_bytes),
        )
    }

    /// Replays with a policy for all pages but those asked for most often, the top of the tree, which stay for ever in a share of the
    /// budget.
    pub fn run_with_top<P: Policy>(&self, share: f64) -> Seen {
        let mut times = vec![0u64; self.trace.page_bytes.len()];
        for (id, requests) in self.trace.chunks.iter().flat_map(|chunk| &chunk.entries) {
            times[id.0 as usize] += u64::from(*requests);
        }
        let mut order: Vec<usize> = (0..times.len()).filter(|page| times[*page] > 0).collect();
        order.sort_by_key(|page| std::cmp::Reverse(times[*page]));
        let mut room = (self.budget_bytes as f64 * share) as u64;
        let mut budget = self.budget_bytes;
        let mut stays = vec![false; times.len()];
        for page in order {
            let bytes = u64::from(self.trace.page_bytes[page]);
            let Some(rest) = room.checked_sub(bytes) else { break };
            (room, budget) = (rest, budget - bytes);
            stays[page] = true;
        }
        let policy = P::new(times.len(), budget);
        self.run_without(&stays, budget, |_| None, policy)
    }

    /// Replays with a policy and a budget for all pages but those that stay once they are read.
    fn run_without<P: Policy>(
        &self,
        stays: &[bool],
        budget_bytes: u64,
        filter: impl Fn(Option<u32>) -> Option<u32>,
        mut policy: P,
    ) -> Seen {
        let sizes = &self.trace.page_bytes;
        let mut is_there = vec![false; sizes.len()];
        let mut bytes = 0;
        let mut seen = Seen { requests: requests(self.trace), ..Seen::default() };
        self.for_each_request(|request, pinned| {
            let used = filter(request.used);
            if let Some(used) =
                used.filter(|page| is_there[*page as usize] && !stays[*page as usize])
            {
                policy.touch(used);
            }
            let page = request.page as usize;
            if is_there[page] {
                if !stays[page] {
                    policy.touch(request.page);
                }
                return;
            }
            let size = sizes[page];
            (seen.reads, seen.bytes_read) = (seen.reads + 1, seen.bytes_read + u64::from(size));
            is_there[page] = true;
            if stays[page] {
                return;
            }
            while bytes + u64::from(size) > budget_bytes {
                // The page on its way in is pinned already, and not yet there.
                let Some(gone) = policy.evict(&mut |page| pinned[page as usize] > 0) else { break };
                is_there[gone as usize] = false;
                bytes -= u64::from(sizes[gone as usize]);
            }
            bytes += u64::from(size);
            policy.insert(request.page, size);
        });
        seen
    }

    /// Replays with the knowledge of what will be asked for: the page that is needed last goes (Belády 1966), the best there is for
    /// pages of one size.
    pub fn run_belady(&self) -> Seen {
        let mut sequence = Vec::new();
        self.for_each_request(|request, _| sequence.push(request.page));
        let sizes = &self.trace.page_bytes;
        let mut next = vec![usize::MAX; sequence.len()];
        let mut latest = vec![usize::MAX; sizes.len()];
        for (at, page) in sequence.iter().enumerate().rev() {
            next[at] = std::mem::replace(&mut latest[*page as usize], at);
        }
        // Pages that are there by when they are needed.
        let mut there: BTreeSet<(usize, u32)> = BTreeSet::new();
        let mut needed_at = vec![None; sizes.len()];
        let mut bytes = 0;
        let mut seen = Seen { requests: requests(self.trace), ..Seen::default() };
        for (at, &page) in sequence.iter().enumerate() {
            let size = u64::from(sizes[page as usize]);
            match needed_at[page as usize].replace(next[at]) {
                Some(before) => {
                    there.remove(&(before, page));
                }
                None => {
                    (seen.reads, seen.bytes_read) = (seen.reads + 1, seen.bytes_read + size);
                    while bytes + size > self.budget_bytes
                        && let Some((_, gone)) = there.pop_last()
                    {
                        needed_at[gone as usize] = None;
                        bytes -= u64::from(sizes[gone as usize]);
                    }
                    bytes += size;
                }
            }
            there.insert((next[at], page));
        }
        seen
    }
}
