//! From cells to pieces of the sorted stream.

use crate::SortError;
use crate::buckets::Buckets;
use crate::runs::{RunCursors, Runs};
use crate::trie::{Cell, Trie};
use pbgi_cloud::Surfel;
use pbgi_math::{MortonCode, RootCube};
use std::ops::Range;

/// Surfels next to each other in the sorted stream, yet to be sorted.
pub struct UnsortedPiece {
    pub(crate) root: RootCube,
    pub(crate) surfels: Vec<Surfel>,
    /// See [`SortedPiece::whole`].
    pub(crate) whole: Range<u64>,
}

/// Surfels next to each other in the sorted stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SortedPiece {
    /// Codes in ascending order.
    pub codes: Vec<MortonCode>,
    /// Surfels of these codes, equal codes in input order.
    pub surfels: Vec<Surfel>,
    /// Codes of which no other piece holds a surfel; this one may hold others.
    pub whole: Range<u64>,
}

impl UnsortedPiece {
    /// Surfels of the piece.
    #[must_use]
    pub fn len(&self) -> usize {
        self.surfels.len()
    }

    /// Whether the piece holds no surfels.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.surfels.is_empty()
    }

    /// Sorts.
    #[must_use]
    pub fn sort(self) -> SortedPiece {
        let Self { root, surfels, whole } = self;
        let codes: Vec<MortonCode> = surfels.iter().map(|s| root.code(s.center())).collect();
        if codes.is_sorted() {
            return SortedPiece { codes, surfels, whole };
        }
        let ranks = sorted_ranks(&codes);
        SortedPiece {
            codes: ranks.iter().map(|&rank| codes[rank as usize]).collect(),
            surfels: ranks.iter().map(|&rank| surfels[rank as usize]).collect(),
            whole,
        }
    }
}

/// The order of codes: by code, equal ones by place.
fn sorted_ranks(codes: &[MortonCode]) -> Vec<u32> {
    let rank_bits = usize::BITS - codes.len().leading_zeros();
    let first = codes.first().map_or(0, |c| c.0);
    let differing = codes.iter().fold(0, |bits, code| bits | (code.0 ^ first));
    let code_bits = u64::BITS - differing.leading_zeros();
    if code_bits + rank_bits <= u64::BITS {
        // Without the leading bits that all share, code and rank fit one word.
        let own = (1u64 << code_bits) - 1;
        let pack = |(rank, code): (usize, &MortonCode)| (code.0 & own) << rank_bits | rank as u64;
        let mut keys: Vec<u64> = codes.iter().enumerate().map(pack).collect();
        keys.sort_unstable();
        let mask = (1u64 << rank_bits) - 1;
        keys.into_iter().map(|key| (key & mask) as u32).collect()
    } else {
        let mut keys: Vec<(u64, u32)> =
            codes.iter().enumerate().map(|(rank, code)| (code.0, rank as u32)).collect();
        keys.sort_unstable();
        keys.into_iter().map(|(_, rank)| rank).collect()
    }
}

/// Where the surfels of the cells are.
pub(crate) enum Content {
    Memory(Buckets),
    Disk(Runs),
}

/// Surfels divided by place.
pub(crate) struct DividedSurfels {
    pub root: RootCube,
    pub trie: Trie,
    pub content: Content,
    /// Most surfels of a cell that can be divided; pieces have less than three times as many.
    pub cell_surfels: usize,
    /// Bytes of the read buffer of a run.
    pub buffer_bytes: usize,
    /// Whether what was read is not read again, so that its disk space may be given back.
    pub releases: bool,
}

/// How far the surfels are handed out.
pub(crate) struct PieceWalk {
    cursors: Option<RunCursors>,
    /// Divided cells on the way to the next one.
    stack: Vec<Frame>,
    is_started: bool,
    /// Surfels gathered for the next piece, and the codes of which they are all.
    gathered: Vec<Surfel>,
    whole: Range<u64>,
    endless: Option<Endless>,
}

/// A cell that is too large and cannot be divided: all its surfels have one code, and are handed out in input order.
struct Endless {
    cell: Cell,
    /// What cells around it got before they were divided, last first.
    inherited: Vec<Surfel>,
    /// Surfels of its own that have been handed out.
    done: usize,
}

/// A divided cell whose parts are being visited.
struct Frame {
    children: std::vec::IntoIter<Cell>,
    /// What the cell itself got before it was divided, by part.
    inherited: std::vec::IntoIter<Vec<Surfel>>,
}

impl PieceWalk {
    /// From the first surfel on.
    pub fn new(divided: &DividedSurfels) -> Self {
        let cursors = match &divided.content {
            Content::Memory(_) => None,
            Content::Disk(runs) => {
                Some(RunCursors::new(runs, divided.buffer_bytes, divided.releases))
            }
        };
        Self {
            cursors,
            stack: Vec::new(),
            is_started: false,
            gathered: Vec::new(),
            whole: 0..0,
            endless: None,
        }
    }

    /// The next piece, `None` at the end.
    pub fn next(&mut self, divided: &DividedSurfels) -> Result<Option<UnsortedPiece>, SortError> {
        if !self.is_started {
            self.is_started = true;
            self.enter(divided, Cell::ROOT, Vec::new())?;
        }
        loop {
            if self.endless.is_some() {
                if self.gathered.is_empty() {
                    self.gather_endless(divided)?;
                    continue;
                }
                return Ok(Some(self.hand_out(divided)));
            }
            if self.gathered.len() >= divided.cell_surfels {
                return Ok(Some(self.hand_out(divided)));
            }
            match self.stack.last_mut() {
                None if self.gathered.is_empty() => return Ok(None),
                None => return Ok(Some(self.hand_out(divided))),
                Some(frame) => match frame.children.next() {
                    None => drop(self.stack.pop()),
                    Some(cell) => {
                        let inherited = frame.inherited.next().unwrap_or_default();
                        self.enter(divided, cell, inherited)?;
                    }
                },
            }
        }
    }

    /// Gathers what an undivided cell holds; divides what a divided one got before.
    fn enter(
        &mut self,
        divided: &DividedSurfels,
        cell: Cell,
        mut inherited: Vec<Surfel>,
    ) -> Result<(), SortError> {
        let mut own = 0;
        let mut children = Vec::new();
        if !cell.is_unknown() {
            if let (Some(cursors), Content::Disk(runs)) = (&mut self.cursors, &divided.content) {
                cursors.begin(runs, cell.node);
            }
            own = divided.trie.count(cell.node) as usize;
            children.extend(divided.trie.children(cell));
        }
        if children.is_empty() {
            if inherited.len() + own <= 2 * divided.cell_surfels {
                self.gathered.append(&mut inherited);
                self.whole.end = cell.codes().end;
                return self.read_own(divided, cell, 0, own);
            }
            if cell.child_count() == 0 {
                inherited.reverse();
                self.endless = Some(Endless { cell, inherited, done: 0 });
                return Ok(());
            }
            children.extend(cell.unknown_parts());
        }
        let start = self.gathered.len();
        self.read_own(divided, cell, 0, own)?;
        let mut parts = vec![Vec::new(); children.len()];
        for surfel in inherited.iter().chain(&self.gathered[start..]) {
            let code = divided.root.code(surfel.center());
            parts[cell.child_of(code) as usize].push(*surfel);
        }
        self.gathered.truncate(start);
        self.stack.push(Frame { children: children.into_iter(), inherited: parts.into_iter() });
        Ok(())
    }

    /// Gathers the next surfels of one code that are too many for a piece.
    fn gather_endless(&mut self, divided: &DividedSurfels) -> Result<(), SortError> {
        let Some(mut endless) = self.endless.take() else { return Ok(()) };
        let first = endless.inherited.len().saturating_sub(divided.cell_surfels);
        self.gathered.extend(endless.inherited.drain(first..).rev());
        if self.gathered.is_empty() {
            self.read_own(divided, endless.cell, endless.done, divided.cell_surfels)?;
            endless.done += self.gathered.len();
        }
        // No piece holds all of this code.
        let end = endless.cell.codes().end;
        self.whole = end..end;
        self.endless = (!self.gathered.is_empty()).then_some(endless);
        Ok(())
    }

    /// Gathers at most `max` surfels that the cell itself got, leaving out `done`.
    fn read_own(
        &mut self,
        divided: &DividedSurfels,
        cell: Cell,
        done: usize,
        max: usize,
    ) -> Result<(), SortError> {
        if max == 0 {
            return Ok(());
        }
        match (&divided.content, &mut self.cursors) {
            (Content::Disk(runs), Some(cursors)) => cursors.read(runs, max, &mut self.gathered),
            (Content::Memory(buckets), _) => {
                let (mut skip, mut left) = (done, max);
                for piece in buckets.pieces(cell.node) {
                    let part = &piece[skip.min(piece.len())..];
                    skip -= skip.min(piece.len());
                    let part = &part[..left.min(part.len())];
                    self.gathered.extend_from_slice(part);
                    left -= part.len();
                    if left == 0 {
                        break;
                    }
                }
                Ok(())
            }
            (Content::Disk(_), None) => unreachable!("runs are read with cursors"),
        }
    }

    fn hand_out(&mut self, divided: &DividedSurfels) -> UnsortedPiece {
        let whole = self.whole.clone();
        self.whole.start = whole.end;
        let room = 2 * divided.cell_surfels;
        let surfels = std::mem::replace(&mut self.gathered, Vec::with_capacity(room));
        UnsortedPiece { root: divided.root, surfels, whole }
    }
}
