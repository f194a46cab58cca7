//! Policies that were measured against the cache's own.

use pbgi_store::policy::{PageLists, Policy};

/// Pages that went lately: those among the last so many that went.
struct Ghosts {
    /// When each page went, from 1; 0 where it never did.
    went: Vec<u32>,
    clock: u32,
}

impl Ghosts {
    fn new(page_count: usize) -> Self {
        Self { went: vec![0; page_count], clock: 0 }
    }

    fn push(&mut self, page: u32) {
        self.clock += 1;
        self.went[page as usize] = self.clock;
    }

    fn contains(&self, page: u32, last: usize) -> bool {
        let went = self.went[page as usize];
        went > 0 && ((self.clock - went) as usize) < last
    }
}

/// Least recently used pages go first.
pub struct Lru {
    order: PageLists<1>,
}

impl Policy for Lru {
    const BYTES_PER_PAGE: u64 = PageLists::<1>::BYTES_PER_PAGE;

    fn new(page_count: usize, _budget_bytes: u64) -> Self {
        Self { order: PageLists::new(page_count) }
    }

    fn insert(&mut self, page: u32, _bytes: u32) {
        self.order.push(0, page);
    }

    fn touch(&mut self, page: u32) {
        self.order.remove(0, page);
        self.order.push(0, page);
    }

    fn evict(&mut self, is_pinned: &mut dyn FnMut(u32) -> bool) -> Option<u32> {
        for _ in 0..self.order.len(0) {
            let page = self.order.oldest(0)?;
            self.order.remove(0, page);
            if !is_pinned(page) {
                return Some(page);
            }
            // What is pinned is in use.
            self.order.push(0, page);
        }
        None
    }

    fn len(&self) -> usize {
        self.order.len(0)
    }
}

/// First in, first out, with a second chance for what was used since.
pub struct Clock {
    order: PageLists<1>,
    is_used: Vec<bool>,
}

impl Policy for Clock {
    const BYTES_PER_PAGE: u64 = PageLists::<1>::BYTES_PER_PAGE + 1;

    fn new(page_count: usize, _budget_bytes: u64) -> Self {
        Self { order: PageLists::new(page_count), is_used: vec![false; page_count] }
    }

    fn insert(&mut self, page: u32, _bytes: u32) {
        self.is_used[page as usize] = false;
        self.order.push(0, page);
    }

    fn touch(&mut self, page: u32) {
        self.is_used[page as usize] = true;
    }

    fn evict(&mut self, is_pinned: &mut dyn FnMut(u32) -> bool) -> Option<u32> {
        for _ in 0..=2 * self.order.len(0) {
            let page = self.order.oldest(0)?;
            self.order.remove(0, page);
            let was_used = std::mem::replace(&mut self.is_used[page as usize], false);
            if !was_used && !is_pinned(page) {
                return Some(page);
            }
            self.order.push(0, page);
        }
        None
    }

    fn len(&self) -> usize {
        self.order.len(0)
    }
}

/// New pages, and those that proved themselves.
const NEW: usize = 0;
const MAIN: usize = 1;

/// Yang, Zhang, Qiu, Yue and Rashmi 2023: new pages pass a short queue, which they leave for the main one if they were used
/// more than once; pages that come back soon after they went join the main queue at once.
pub struct S3Fifo {
    queues: PageLists<2>,
    bytes: Vec<u32>,
    uses: Vec<u8>,
    is_main: Vec<bool>,
    ghosts: Ghosts,
    new_bytes: u64,
    new_bytes_max: u64,
}

impl S3Fifo {
    fn push(&mut self, queue: usize, page: u32) {
        self.is_main[page as usize] = queue == MAIN;
        if queue == NEW {
            self.new_bytes += u64::from(self.bytes[page as usize]);
        }
        self.queues.push(queue, page);
    }

    fn pop(&mut self, queue: usize) -> Option<u32> {
        let page = self.queues.oldest(queue)?;
        self.queues.remove(queue, page);
        if queue == NEW {
            self.new_bytes -= u64::from(self.bytes[page as usize]);
        }
        Some(page)
    }
}

impl Policy for S3Fifo {
    const BYTES_PER_PAGE: u64 = PageLists::<2>::BYTES_PER_PAGE + 10;

    fn new(page_count: usize, budget_bytes: u64) -> Self {
        Self {
            queues: PageLists::new(page_count),
            bytes: vec![0; page_count],
            uses: vec![0; page_count],
            is_main: vec![false; page_count],
            ghosts: Ghosts::new(page_count),
            new_bytes: 0,
            new_bytes_max: budget_bytes / 10,
        }
    }

    fn insert(&mut self, page: u32, bytes: u32) {
        self.bytes[page as usize] = bytes;
        self.uses[page as usize] = 0;
        let came_back = self.ghosts.contains(page, self.len());
        self.push(if came_back { MAIN } else { NEW }, page);
    }

    fn touch(&mut self, page: u32) {
        let uses = &mut self.uses[page as usize];
        *uses = (*uses + 1).min(3);
    }

    fn evict(&mut self, is_pinned: &mut dyn FnMut(u32) -> bool) -> Option<u32> {
        for _ in 0..=5 * self.len() {
            let from_new = self.new_bytes > self.new_bytes_max || self.queues.is_empty(MAIN);
            if from_new && let Some(page) = self.pop(NEW) {
                if self.uses[page as usize] > 1 || is_pinned(page) {
                    self.push(MAIN, page);
                } else {
                    self.ghosts.push(page);
                    return Some(page);
                }
            } else if let Some(page) = self.pop(MAIN) {
                let uses = &mut self.uses[page as usize];
                let was_used = *uses > 0;
                *uses = uses.saturating_sub(1);
                if !was_used && !is_pinned(page) {
                    return Some(page);
                }
                self.push(MAIN, page);
            }
        }
        None
    }

    fn len(&self) -> usize {
        self.queues.len(NEW) + self.queues.len(MAIN)
    }
}

/// Johnson and Shasha 1994: new pages pass a queue of a quarter of the budget; those that come back soon after they went are
/// kept by how lately they were used.
pub struct TwoQueues {
    queues: PageLists<2>,
    bytes: Vec<u32>,
    is_main: Vec<bool>,
    ghosts: Ghosts,
    new_bytes: u64,
    new_bytes_max: u64,
}

impl Policy for TwoQueues {
    const BYTES_PER_PAGE: u64 = PageLists::<2>::BYTES_PER_PAGE + 9;

    fn new(page_count: usize, budget_bytes: u64) -> Self {
        Self {
            queues: PageLists::new(page_count),
            bytes: vec![0; page_count],
            is_main: vec![false; page_count],
            ghosts: Ghosts::new(page_count),
            new_bytes: 0,
            new_bytes_max: budget_bytes / 4,
        }
    }

    fn insert(&mut self, page: u32, bytes: u32) {
        self.bytes[page as usize] = bytes;
        let came_back = self.ghosts.contains(page, self.len().div_ceil(2));
        self.is_main[page as usize] = came_back;
        self.new_bytes += if came_back { 0 } else { u64::from(bytes) };
        self.queues.push(usize::from(came_back), page);
    }

    fn touch(&mut self, page: u32) {
        if self.is_main[page as usize] {
            self.queues.remove(MAIN, page);
            self.queues.push(MAIN, page);
        }
    }

    fn evict(&mut self, is_pinned: &mut dyn FnMut(u32) -> bool) -> Option<u32> {
        for _ in 0..=2 * self.len() {
            let from_new = self.new_bytes > self.new_bytes_max || self.queues.is_empty(MAIN);
            let queue = if from_new && !self.queues.is_empty(NEW) { NEW } else { MAIN };
            let page = self.queues.oldest(queue)?;
            self.queues.remove(queue, page);
            if queue == NEW {
                self.new_bytes -= u64::from(self.bytes[page as usize]);
            }
            if !is_pinned(page) {
                if queue == NEW {
                    self.ghosts.push(page);
                }
                return Some(page);
            }
            self.is_main[page as usize] = true;
            self.queues.push(MAIN, page);
        }
        None
    }

    fn len(&self) -> usize {
        self.queues.len(NEW) + self.queues.len(MAIN)
    }
}
