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
