//! Surfels in memory, each in the list of its cell.

use bytemuck::allocation::zeroed_vec;
use pbgi_cloud::Surfel;

/// Surfels of a block; the list of a cell is made of such.
const BLOCK: usize = 32;

/// End of a list.
const NONE: u32 = u32::MAX;

/// Bytes a surfel takes: itself and its part of the link to the next block.
pub(crate) const SURFEL_BYTES: f64 =
    size_of::<Surfel>() as f64 + size_of::<u32>() as f64 / BLOCK as f64;

#[derive(Clone, Copy, Debug)]
struct List {
    first: u32,
    last: u32,
    len: u32,
}

const EMPTY: List = List { first: NONE, last: NONE, len: 0 };

/// Lists of surfels in one piece of memory of fixed size, which is touched as it fills.
pub(crate) struct Buckets {
    surfels: Vec<Surfel>,
    /// Block after each block.
    next: Vec<u32>,
    used: usize,
    lists: Vec<List>,
}

impl Buckets {
    /// Lists of up to `capacity` surfels if all blocks were full.
    pub fn new(capacity: usize) -> Self {
        let blocks = (capacity / BLOCK).clamp(1, NONE as usize);
        Self {
            surfels: zeroed_vec(blocks * BLOCK),
            next: zeroed_vec(blocks),
            used: 0,
            lists: Vec::new(),
        }
    }

    /// Makes room for lists `0..count`.
    pub fn reserve_lists(&mut self, count: usize) {
        if count > self.lists.len() {
            self.lists.resize(count, EMPTY);
        }
    }

    /// Appends to a list; `false`, and nothing done, where there is no room.
    #[inline]
    pub fn push(&mut self, list: u32, surfel: &Surfel) -> bool {
        let entry = &mut self.lists[list as usize];
        let within = entry.len as usize % BLOCK;
        if within == 0 {
            if self.used == self.next.len() {
                return false;
            }
            let block = self.used as u32;
            self.used += 1;
            self.next[block as usize] = NONE;
            match entry.last {
                NONE => entry.first = block,
                last => self.next[last as usize] = block,
            }
            entry.last = block;
        }
        self.surfels[entry.last as usize * BLOCK + within] = *surfel;
        entry.len += 1;
        true
    }

    /// Surfels of a list.
    pub fn len(&self, list: u32) -> usize {
        self.lists.get(list as usize).map_or(0, |l| l.len as usize)
    }

    /// The surfels of a list in the order of their coming, in pieces.
    pub fn pieces(&self, list: u32) -> impl Iterator<Item = &[Surfel]> {
        let List { first, len, .. } = self.lists.get(list as usize).copied().unwrap_or(EMPTY);
        let (mut block, mut left) = (first, len as usize);
        std::iter::from_fn(move || {
            if left == 0 {
                return None;
            }
            let start = block as usize * BLOCK;
            let count = left.min(BLOCK);
            block = self.next[block as usize];
            left -= count;
            Some(&self.surfels[start..start + count])
        })
    }

    /// Forgets all surfels but keeps the memory.
    pub fn clear(&mut self) {
        self.lists.fill(EMPTY);
        self.used = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::Vec3;

    #[test]
    fn lists_keep_their_order_until_memory_is_full() {
        let mut buckets = Buckets::new(10 * BLOCK);
        buckets.reserve_lists(3);
        let surfel = |i: usize| Surfel::new(Vec3::splat(i as f32), Vec3::Z, 1.0, 1.0);
        for _ in 0..2 {
            let mut pushed = 0;
            while buckets.push([0, 2, 0][pushed % 3], &surfel(pushed)) {
                pushed += 1;
            }
            // Nine whole blocks at least; no list has more than one that is not full.
            assert!(pushed >= 9 * BLOCK, "{pushed}");
            let list = |i| buckets.pieces(i).flatten().map(|s| s.position[0] as usize);
            assert!(list(0).eq((0..pushed).filter(|i| i % 3 != 1)));
            assert!(list(2).eq((0..pushed).filter(|i| i % 3 == 1)));
            assert_eq!((buckets.len(1), list(1).count(), buckets.len(9)), (0, 0, 0));
            buckets.clear();
            assert_eq!(buckets.len(0), 0);
        }
    }
}
