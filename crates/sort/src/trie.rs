//! The cells surfels are divided into, finer where there are more of them.

use pbgi_math::{MORTON_AXIS_BITS, MortonCode};
use std::ops::Range;

/// Levels between a cell and the cells it is divided into, except at the finest level.
const LEVEL_STEP: u32 = 2;

/// A cell of the trie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cell {
    /// Index of its node.
    pub node: u32,
    /// Leading octants of its codes, `level` of them.
    pub prefix: u64,
    pub level: u32,
}

impl Cell {
    pub const ROOT: Self = Self { node: 0, prefix: 0, level: 0 };

    /// Node of cells that the trie does not have.
    const UNKNOWN: u32 = u32::MAX;

    /// Whether the trie does not have this cell.
    pub fn is_unknown(self) -> bool {
        self.node == Self::UNKNOWN
    }

    /// The parts of a cell that the trie does not divide.
    pub fn unknown_parts(self) -> impl Iterator<Item = Self> {
        (0..self.child_count()).map(move |i| Self { node: Self::UNKNOWN, ..self.child(0, i) })
    }

    /// The codes of the cell.
    pub fn codes(self) -> Range<u64> {
        let shift = 3 * (MORTON_AXIS_BITS - self.level);
        self.prefix << shift..(self.prefix + 1) << shift
    }

    /// Cells this one is divided into; 0 at the finest level.
    pub fn child_count(self) -> u32 {
        match self.step() {
            0 => 0,
            step => 1 << (3 * step),
        }
    }

    /// The part of this cell that holds a code: its number among the children.
    #[inline]
    pub fn child_of(self, code: MortonCode) -> u32 {
        let shift = 3 * (MORTON_AXIS_BITS - self.level - self.step());
        (code.0 >> shift) as u32 & (self.child_count() - 1)
    }

    fn step(self) -> u32 {
        LEVEL_STEP.min(MORTON_AXIS_BITS - self.level)
    }

    fn child(self, first: u32, index: u32) -> Self {
        Self {
            node: first + index,
            prefix: self.prefix << (3 * self.step()) | u64::from(index),
            level: self.level + self.step(),
        }
    }
}

/// A tree of cells. A cell that is divided keeps what it got before, and hands on what comes later.
#[derive(Debug)]
pub(crate) struct Trie {
    /// Node of the first child, 0 where there is none.
    first_children: Vec<u32>,
    /// Surfels each cell itself got.
    counts: Vec<u64>,
}

impl Trie {
    /// The whole cube, undivided.
    pub fn new() -> Self {
        Self { first_children: vec![0], counts: vec![0] }
    }

    /// Appends all there is to know.
    pub fn save(&self, words: &mut Vec<u64>) {
        words.push(self.counts.len() as u64);
        words.extend(self.first_children.iter().map(|&first| u64::from(first)));
        words.extend(&self.counts);
    }

    /// The inverse of [`Self::save`].
    pub fn load(words: &mut impl Iterator<Item = u64>) -> Option<Self> {
        let count = words.next()? as usize;
        let first_children: Vec<u32> = words.by_ref().take(count).map(|w| w as u32).collect();
        let counts: Vec<u64> = words.by_ref().take(count).collect();
        (counts.len() == count && count > 0).then_some(Self { first_children, counts })
    }

    pub fn node_count(&self) -> usize {
        self.counts.len()
    }

    /// Surfels the cell of a node itself got.
    pub fn count(&self, node: u32) -> u64 {
        self.counts[node as usize]
    }

    /// Counts one more surfel of a cell.
    #[inline]
    pub fn add(&mut self, node: u32) {
        self.counts[node as usize] += 1;
    }

    /// The undivided cell that holds a code.
    #[inline]
    pub fn locate(&self, code: MortonCode) -> Cell {
        let mut cell = Cell::ROOT;
        loop {
            match self.first_children[cell.node as usize] {
                0 => return cell,
                first => cell = cell.child(first, cell.child_of(code)),
            }
        }
    }

    /// Divides a cell, for what comes later.
    pub fn divide(&mut self, cell: Cell) {
        let first = self.counts.len() as u32;
        let children = cell.child_count() as usize;
        debug_assert!(children > 0 && self.first_children[cell.node as usize] == 0);
        self.first_children[cell.node as usize] = first;
        self.first_children.resize(self.first_children.len() + children, 0);
        self.counts.resize(self.counts.len() + children, 0);
    }

    /// The parts of a cell in the order of their codes; none where it is not divided.
    pub fn children(&self, cell: Cell) -> impl ExactSizeIterator<Item = Cell> + use<> {
        let first = self.first_children[cell.node as usize];
        let count = if first == 0 { 0 } else { cell.child_count() };
        (0..count).map(move |index| cell.child(first, index))
    }

    /// Calls `visit` for every node: a cell before its parts, these in the order of their codes.
    pub fn visit(&self, visit: &mut impl FnMut(u32)) {
        let mut stack = vec![Cell::ROOT];
        while let Some(cell) = stack.pop() {
            visit(cell.node);
            let start = stack.len();
            stack.extend(self.children(cell));
            stack[start..].reverse();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_found_at_every_level() {
        let mut trie = Trie::new();
        let code = MortonCode(0o123_456_701_234_567_012_345);
        for level in [0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 21] {
            let cell = trie.locate(code);
            assert_eq!((cell.level, cell.prefix), (level, code.cell_at(level)));
            assert!(cell.codes().contains(&code.0));
            assert_eq!(cell.codes().end - cell.codes().start, 1 << (3 * (21 - level)));
            if level < 21 {
                trie.divide(cell);
            } else {
                assert_eq!((cell.child_count(), trie.children(cell).len()), (0, 0));
            }
        }
        assert_eq!(trie.node_count(), 1 + 10 * 64 + 8);
    }

    #[test]
    fn visits_follow_the_codes() {
        let mut trie = Trie::new();
        trie.divide(Cell::ROOT);
        trie.divide(trie.locate(MortonCode(5 << 57)));
        let mut nodes = Vec::new();
        trie.visit(&mut |node| nodes.push(node));
        // The parts of part 5 come right after it.
        let parts: Vec<u32> = (65..129).collect();
        assert_eq!(nodes.len(), 129);
        assert_eq!((nodes[0], nodes[6], &nodes[7..71], nodes[71]), (0, 6, &parts[..], 7));
    }
}
