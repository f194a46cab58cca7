//! The octree of everything, grown along its open path from subtrees and what lies between them.
//!
//! Surfels between subtrees are cut into leaves: a leaf is the largest cell that holds no more than `leaf_surfels_max` surfels. In Morton
//! order it begins where the surfel before it is outside, and ends before the surfel `leaf_surfels_max` further on (Kontkanen et al. 2011): its
//! level is the first at which both are in other cells.

use crate::error::BuildError;
use crate::items::{Item, Subtree};
use crate::pack::PendingNode;
use crate::reduce::LobeReducer;
use crate::tree::TreeBuilder;
use crate::writer::FileWriter;
use pbgi_format::CHILDREN_MAX;
use pbgi_math::{MORTON_AXIS_BITS, MortonCode};
use std::borrow::Cow;
use std::collections::VecDeque;

/// Gives the items of the next piece; `None` at the end.
pub(crate) type NextItems<'a> = dyn FnMut() -> Result<Option<Vec<Item>>, BuildError> + 'a;

/// A leaf or subtree whose place in the octree is known.
struct Closed {
    /// Code of its first surfel.
    code: MortonCode,
    /// Level of its cell; of a leaf, one more than the finest where others share that.
    level: u32,
    content: ClosedContent,
}

enum ClosedContent {
    /// The next so many items are the surfels of a leaf.
    Leaf(usize),
    /// The next item is a subtree.
    Subtree,
}

/// Joins the items of all pieces.
pub(crate) struct Stitcher<'a> {
    pub tree: TreeBuilder<FileWriter>,
    ahead: Ahead<'a>,
}

impl<'a> Stitcher<'a> {
    pub fn new(tree: TreeBuilder<FileWriter>, next_items: &'a mut NextItems<'a>) -> Self {
        let ahead = Ahead {
            next_items,
            leaf_surfels_max: tree.settings.leaf_surfels_max,
            items: VecDeque::new(),
            is_ended: false,
            last: None,
            next: None,
        };
        Self { tree, ahead }
    }

    /// The node of everything; `None` where there is nothing.
    pub fn build(&mut self) -> Result<Option<PendingNode<'static>>, BuildError> {
        self.build_cell(0, 0)
    }

    /// The node of the cell with leading octants `cell` at `level`, or none if the stream has left it.
    fn build_cell(
        &mut self,
        level: u32,
        cell: u64,
    ) -> Result<Option<PendingNode<'static>>, BuildError> {
        match self.ahead.peek()? {
            Some(next) if next.code.cell_at(level) == cell => {
                if next.level == level {
                    return self.take();
                }
            }
            _ => return Ok(None),
        }
        let root = self.tree.settings.root;
        if level == MORTON_AXIS_BITS {
            return self.build_list(cell).map(Some);
        }
        let mut children: Vec<(u32, PendingNode<'static>)> = Vec::with_capacity(CHILDREN_MAX);
        while let Some(next) = self.ahead.peek()? {
            let code = next.code;
            if code.cell_at(level) != cell {
                break;
            }
            let child = self.build_cell(level + 1, code.cell_at(level + 1))?;
            children.push((code.octant(level), child.expect("the cell holds the next surfel")));
        }
        if children.len() == 1 {
            return Ok(children.pop().map(|(_, child)| child));
        }
        let split = root.cell_box(cell, level).center();
        self.tree.close_group(split, children.drain(..)).map(Some)
    }

    /// A balanced tree over all leaves of one code.
    fn build_list(&mut self, code: u64) -> Result<PendingNode<'static>, BuildError> {
        let split = self.tree.settings.root.cell_box(code, MORTON_AXIS_BITS).center();
        let Self { tree, ahead } = self;
        tree.build_list(split, &mut |reducer| match ahead.peek()? {
            Some(leaf) if leaf.code.0 == code => Ok(ahead.take_leaf(reducer)),
            _ => Ok(None),
        })
    }

    /// The next leaf or subtree, whose pages go to the file.
    fn take(&mut self) -> Result<Option<PendingNode<'static>>, BuildError> {
        if let Some(leaf) = self.ahead.take_leaf(self.tree.reducer()) {
            return Ok(Some(leaf));
        }
        let Some(subtree) = self.ahead.take_subtree() else { return Ok(None) };
        let mut node = subtree.node;
        let first = self.tree.sink.append(subtree.pages)?;
        node.move_pages(first);
        self.tree.counts.add(&subtree.counts);
        Ok(Some(node))
    }
}

/// The items ahead.
struct Ahead<'a> {
    next_items: &'a mut NextItems<'a>,
    leaf_surfels_max: usize,
    items: VecDeque<Item>,
    is_ended: bool,
    /// Code of the last item taken.
    last: Option<MortonCode>,
    /// The next leaf or subtree, once found.
    next: Option<Closed>,
}

impl Ahead<'_> {
    /// The next leaf or subtree, which stays.
    fn peek(&mut self) -> Result<Option<&Closed>, BuildError> {
        let most = self.leaf_surfels_max;
        while self.next.is_none() {
            // A subtree holds more surfels than a leaf, so that what follows it does not matter.
            let ahead = self.items.iter().take(most + 1);
            let subtree = ahead.clone().position(|item| matches!(item, Item::Subtree(_)));
            let is_enough = subtree.is_some() || ahead.len() > most;
            if !is_enough && !self.is_ended {
                match (self.next_items)()? {
                    Some(items) => self.items.extend(items),
                    None => self.is_ended = true,
                }
                continue;
            }
            let Some(first) = self.items.front() else { return Ok(None) };
            self.next = Some(match first {
                Item::Subtree(subtree) => Closed {
                    code: subtree.code,
                    level: subtree.level,
                    content: ClosedContent::Subtree,
                },
                Item::Surfel(code, _) => self.close_leaf(*code, most, subtree),
            });
        }
        Ok(self.next.as_ref())
    }

    /// The leaf that begins with `code`, where the first subtree ahead is the item `subtree`.
    fn close_leaf(&self, code: MortonCode, most: usize, subtree: Option<usize>) -> Closed {
        let below = |other: Option<MortonCode>| other.map_or(0, |o| code.common_level(o) + 1);
        let beyond = self.items.get(subtree.unwrap_or(most)).map(Item::code);
        let level = below(self.last).max(below(beyond));
        let cell_level = level.min(MORTON_AXIS_BITS);
        let cell = code.cell_at(cell_level);
        let ahead = self.items.iter().take(subtree.unwrap_or(most));
        let count = ahead.take_while(|item| item.code().cell_at(cell_level) == cell).count();
        Closed { code, level, content: ClosedContent::Leaf(count) }
    }

    /// Takes what [`Ahead::peek`] found, if that is a subtree.
    fn take_subtree(&mut self) -> Option<Box<Subtree>> {
        match self.items.pop_front()? {
            Item::Subtree(subtree) => {
                (self.next, self.last) = (None, Some(subtree.code));
                Some(subtree)
            }
            surfel => {
                self.items.push_front(surfel);
                None
            }
        }
    }

    /// Takes what [`Ahead::peek`] found, if that is a leaf.
    fn take_leaf(&mut self, reducer: &mut LobeReducer) -> Option<PendingNode<'static>> {
        let Some(Closed { content: ClosedContent::Leaf(count), .. }) = self.next else {
            return None;
        };
        self.next = None;
        let mut surfels = Vec::with_capacity(count);
        for item in self.items.drain(..count) {
            self.last = Some(item.code());
            if let Item::Surfel(_, surfel) = item {
                surfels.push(surfel);
            }
        }
        Some(PendingNode::leaf(reducer, Cow::Owned(surfels)))
    }
}
