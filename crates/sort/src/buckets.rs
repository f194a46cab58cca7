//! Surfels in memory, each in the list of its cell.

use bytemuck::allocation::try_zeroed_vec;
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

/// Blocks of a segment: 11 MiB.
const SEGMENT_BLOCKS: usize = 1 << 13;

/// Lists of surfels in memory that is taken as they fill, a segment at a time, up to a fixed size.
pub(crate) struct Buckets {
    segments: Vec<Segment>,
    /// Blocks there may be.
    blocks_max: usize,
    used: usize,
    lists: Vec<List>,
}

struct Segment {
    surfels: Vec<Surfel>,
    /// Block after each block.
    next: Vec<u32>,
}

impl Segment {
    /// So many blocks; none where the system has no memory for them.
    fn new(blocks: usize) -> Option<Self> {
        let surfels = try_zeroed_vec(blocks * BLOCK).ok()?;
        Some(Self { surfels, next: try_zeroed_vec(blocks).ok()? })
    }
}

impl Buckets {
    /// Lists of up to `capacity` surfels if all blocks were full.
    pub fn new(capacity: usize) -> Self {
        let blocks_max = (capacity / BLOCK).clamp(1, NONE as usize);
        Self { segments: Vec::new(), blocks_max, used: 0, lists: Vec::new() }
    }

    /// Takes a block, if there is room.
    #[inline]
    fn take_block(&mut self) -> Option<u32> {
        if self.used == self.blocks_max {
            return None;
        }
        if self.used == self.segments.len() * SEGMENT_BLOCKS {
            let blocks = SEGMENT_BLOCKS.min(self.blocks_max - self.used);
            match Segment::new(blocks) {
                Some(segment) => self.segments.push(segment),
                None => {
                    // A few surfels must fit, or nothing can be sorted at all.
                    assert!(self.used > 0, "there is no memory for {blocks} blocks of surfels");
                    self.blocks_max = self.used;
                    return None;
                }
            }
        }
        let block = self.used;
        self.used += 1;
        *self.next(block as u32) = NONE;
        Some(block as u32)
    }

    #[inline]
    fn next(&mut self, block: u32) -> &mut u32 {
        let block = block as usize;
        &mut self.segments[block / SEGMENT_BLOCKS].next[block % SEGMENT_BLOCKS]
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
        let mut entry = self.lists[list as usize];
        let within = entry.len as usize % BLOCK;
        if within == 0 {
            let Some(block) = self.take_block() else { return false };
            match entry.last {
                NONE => entry.first = block,
                last => *self.next(last) = block,
            }
            entry.last = block;
        }
        let block = entry.last as usize;
        let segment = &mut self.segments[block / SEGMENT_BLOCKS];
        segment.surfels[block % SEGMENT_BLOCKS * BLOCK + within] = *surfel;
        entry.len += 1;
        self.lists[list as usize] = entry;
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
            let segment = &self.segments[block as usize / SEGMENT_BLOCKS];
            let within = block as usize % SEGMENT_BLOCKS;
            let count = left.min(BLOCK);
            block = segment.next[within];
            left -= count;
            Some(&segment.surfels[within * BLOCK..within * BLOCK + count])
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
        let mut buckets = Buckets::new(10 * BLOCK + 5);
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

    #[test]
    fn memory_is_taken_as_surfels_come_and_not_for_all_there_could_be() {
        // 64 TiB: no system grants that.
        let mut buckets = Buckets::new(usize::MAX >> 2);
        buckets.reserve_lists(2);
        let surfel = |i: usize| Surfel::new(Vec3::splat(i as f32), Vec3::Z, 1.0, 1.0);
        let count = SEGMENT_BLOCKS * BLOCK + 5 * BLOCK;
        for i in 0..count {
            assert!(buckets.push((i % 2) as u32, &surfel(i)));
        }
        assert_eq!(buckets.segments.len(), 2);
        for list in 0..2 {
            let found = buckets.pieces(list).flatten().map(|s| s.position[0] as usize);
            assert!(found.eq((list as usize..count).step_by(2)));
        }
    }
}
