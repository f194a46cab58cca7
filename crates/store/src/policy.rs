//! Which page goes when room is needed. Knows pages by number and size, not what holds or reads them.

/// Decides which page goes. Told of every page that comes and is used; asked when room is needed.
pub trait Policy {
    /// Bytes taken per page of the file, whether in memory or not.
    const BYTES_PER_PAGE: u64;

    /// For a file of so many pages and a cache of so many bytes.
    fn new(page_count: usize, budget_bytes: u64) -> Self;

    /// Page `page` of so many bytes, which was not there, has come.
    fn insert(&mut self, page: u32, bytes: u32);

    /// A page that is there has been used.
    fn touch(&mut self, page: u32);

    /// Takes out the page that should go, if there is one that is not pinned.
    fn evict(&mut self, is_pinned: &mut dyn FnMut(u32) -> bool) -> Option<u32>;

    /// Pages that are there.
    fn len(&self) -> usize;

    /// Whether no page is there.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

const NONE: u32 = u32::MAX;

/// Lists of pages, newest first. A page is in one of them at most.
pub struct PageLists<const N: usize> {
    /// Neighbors of each page: (newer, older).
    links: Vec<(u32, u32)>,
    /// Newest and oldest page of each list.
    ends: [(u32, u32); N],
    lengths: [usize; N],
}

impl<const N: usize> PageLists<N> {
    /// Bytes per page.
    pub const BYTES_PER_PAGE: u64 = size_of::<(u32, u32)>() as u64;

    /// Empty lists.
    #[must_use]
    pub fn new(page_count: usize) -> Self {
        let (links, ends) = (vec![(NONE, NONE); page_count], [(NONE, NONE); N]);
        Self { links, ends, lengths: [0; N] }
    }

    /// Pages in a list.
    #[must_use]
    pub fn len(&self, list: usize) -> usize {
        self.lengths[list]
    }

    /// Whether a list has no pages.
    #[must_use]
    pub fn is_empty(&self, list: usize) -> bool {
        self.lengths[list] == 0
    }

    /// The oldest page of a list.
    #[must_use]
    pub fn oldest(&self, list: usize) -> Option<u32> {
        Some(self.ends[list].1).filter(|page| *page != NONE)
    }

    /// Puts a page that is in no list at the new end of one.
    pub fn push(&mut self, list: usize, page: u32) {
        let (newest, oldest) = &mut self.ends[list];
        self.links[page as usize] = (NONE, *newest);
        match *newest {
            NONE => *oldest = page,
            before => self.links[before as usize].0 = page,
        }
        *newest = page;
        self.lengths[list] += 1;
    }

    /// Takes a page out of the list it is in.
    pub fn remove(&mut self, list: usize, page: u32) {
        let (newer, older) = self.links[page as usize];
        match newer {
            NONE => self.ends[list].0 = older,
            newer => self.links[newer as usize].1 = older,
        }
        match older {
            NONE => self.ends[list].1 = newer,
            older => self.links[older as usize].0 = newer,
        }
        self.lengths[list] -= 1;
    }
}

/// Pages whose last two uses lie far apart go first, by the number of other pages used between them (LIRS; Jiang and Zhang 2002).
///
/// Most of the budget is for pages that are *kept*: their last two uses lie close together. All others *pass* through a queue of
/// `PASSING` percent of the budget, and are kept when they are used again before the kept page that was not used for the longest
/// time. Where all fits that is used again soon, this is like least recently used first; but a walk round and round over more
/// pages than fit keeps some of them, where that keeps none.
pub struct Lirs<const PASSING: u64 = 30> {
    /// All pages by their last use, from the oldest of the kept ones on; some are no longer there.
    recent: PageLists<1>,
    is_recent: Vec<bool>,
    /// Pages that are there and not kept, by when they came or were used.
    passing: PageLists<1>,
    is_kept: Vec<bool>,
    bytes: Vec<u32>,
    count: usize,
    kept_bytes: u64,
    kept_bytes_max: u64,
}

impl<const PASSING: u64> Lirs<PASSING> {
    fn use_now(&mut self, page: u32) {
        if std::mem::replace(&mut self.is_recent[page as usize], true) {
            self.recent.remove(0, page);
        }
        self.recent.push(0, page);
    }

    fn forget(&mut self, page: u32) {
        self.recent.remove(0, page);
        self.is_recent[page as usize] = false;
    }

    fn keep(&mut self, page: u32) {
        self.is_kept[page as usize] = true;
        self.kept_bytes += u64::from(self.bytes[page as usize]);
        self.use_now(page);
    }

    /// Lets the kept pages that were not used for the longest time pass, until the rest fits; then forgets what was used before the
    /// oldest kept page.
    fn trim(&mut self) {
        while let Some(page) = self.recent.oldest(0) {
            let is_kept = self.is_kept[page as usize];
            if is_kept && self.kept_bytes <= self.kept_bytes_max {
                break;
            }
            self.forget(page);
            if is_kept {
                self.is_kept[page as usize] = false;
                self.kept_bytes -= u64::from(self.bytes[page as usize]);
                self.passing.push(0, page);
            }
        }
    }
}

impl<const PASSING: u64> Policy for Lirs<PASSING> {
    const BYTES_PER_PAGE: u64 = 2 * PageLists::<1>::BYTES_PER_PAGE + 6;

    fn new(page_count: usize, budget_bytes: u64) -> Self {
        Self {
            recent: PageLists::new(page_count),
            is_recent: vec![false; page_count],
            passing: PageLists::new(page_count),
            is_kept: vec![false; page_count],
            bytes: vec![0; page_count],
            count: 0,
            kept_bytes: 0,
            kept_bytes_max: budget_bytes
                - (u128::from(budget_bytes) * u128::from(PASSING) / 100) as u64,
        }
    }

    fn insert(&mut self, page: u32, bytes: u32) {
        self.bytes[page as usize] = bytes;
        self.count += 1;
        let fits = self.kept_bytes + u64::from(bytes) <= self.kept_bytes_max;
        if fits || self.is_recent[page as usize] {
            self.keep(page);
            self.trim();
        } else {
            self.use_now(page);
            self.passing.push(0, page);
        }
    }

    fn touch(&mut self, page: u32) {
        if self.is_kept[page as usize] {
            self.use_now(page);
        } else {
            self.passing.remove(0, page);
            if self.is_recent[page as usize] {
                self.keep(page);
            } else {
                self.use_now(page);
                self.passing.push(0, page);
            }
        }
        self.trim();
    }

    fn evict(&mut self, is_pinned: &mut dyn FnMut(u32) -> bool) -> Option<u32> {
        for _ in 0..self.passing.len(0) {
            let page = self.passing.oldest(0)?;
            self.passing.remove(0, page);
            if !is_pinned(page) {
                self.count -= 1;
                return Some(page);
            }
            self.passing.push(0, page);
        }
        for _ in 0..self.recent.len(0) {
            let page = self.recent.oldest(0)?;
            self.forget(page);
            if !self.is_kept[page as usize] {
                continue;
            }
            if !is_pinned(page) {
                self.is_kept[page as usize] = false;
                self.kept_bytes -= u64::from(self.bytes[page as usize]);
                self.trim();
                self.count -= 1;
                return Some(page);
            }
            self.use_now(page);
        }
        None
    }

    fn len(&self) -> usize {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs over pages of one byte with room for `room` of them and returns the number of hits.
    fn run<P: Policy>(pages: impl Iterator<Item = u32>, room: u64) -> u64 {
        let mut policy = P::new(100, room);
        let mut is_there = [false; 100];
        let (mut count, mut hits) = (0, 0);
        for page in pages {
            if is_there[page as usize] {
                policy.touch(page);
                hits += 1;
                continue;
            }
            if count == room {
                let gone = policy.evict(&mut |_| false).expect("nothing is pinned");
                assert!(std::mem::replace(&mut is_there[gone as usize], false), "{gone} was there");
                count -= 1;
            }
            policy.insert(page, 1);
            is_there[page as usize] = true;
            count += 1;
            assert_eq!(policy.len() as u64, count);
            assert_eq!(is_there.iter().filter(|there| **there).count() as u64, count);
        }
        hits
    }

    #[test]
    fn loops_over_more_than_fits_keep_some() {
        let rounds = 50;
        let hits = run::<Lirs>((0..rounds * 20).map(|i| i % 20), 10);
        // Seven of ten are kept in all rounds but the first.
        assert_eq!(hits, u64::from(rounds - 1) * 7);
    }

    #[test]
    fn what_is_used_again_soon_stays_whatever_passes_by() {
        let pages = (0..3000u32).map(|i| if i % 2 == 0 { i / 2 % 5 } else { 10 + i / 2 % 90 });
        let hits = run::<Lirs>(pages, 10);
        assert!(hits >= 1500 - 5, "{hits}");
    }

    #[test]
    fn a_new_place_takes_over_from_an_old_one() {
        let pages = (0..2000u32).map(|i| i % 9 + if i < 1000 { 0 } else { 50 });
        let hits = run::<Lirs>(pages, 10);
        assert!(hits >= 2000 - 5 * 9, "{hits}");
    }

    #[test]
    fn pinned_pages_stay_and_where_all_are_none_goes() {
        let mut policy = Lirs::<30>::new(10, 5);
        (0..5).for_each(|page| policy.insert(page, 1));
        let mut gone: Vec<u32> =
            std::iter::from_fn(|| policy.evict(&mut |page| page == 1 || page == 4)).collect();
        gone.sort_unstable();
        assert_eq!(gone, [0, 2, 3]);
        assert_eq!(policy.len(), 2);
        policy.touch(1);
        policy.insert(0, 1);
        assert_eq!(policy.evict(&mut |page| page != 4), Some(4));
    }

    #[test]
    fn lists_agree_with_plain_queues() {
        let mut lists = PageLists::<2>::new(20);
        let mut plain: [Vec<u32>; 2] = Default::default();
        let mut random = 1u32;
        for _ in 0..if cfg!(miri) { 100 } else { 5000 } {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let page = (random >> 16) % 20;
            let to = (random >> 8) as usize % 2;
            if let Some(from) = plain.iter().position(|list| list.contains(&page)) {
                lists.remove(from, page);
                plain[from].retain(|p| *p != page);
            } else {
                lists.push(to, page);
                plain[to].push(page);
            }
            for list in 0..2 {
                assert_eq!(lists.oldest(list), plain[list].first().copied());
                assert_eq!(
                    (lists.len(list), lists.is_empty(list)),
                    (plain[list].len(), plain[list].is_empty())
                );
            }
        }
    }
}
