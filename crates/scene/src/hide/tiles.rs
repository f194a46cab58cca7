//! Square tiles of the image and the lists of what may touch each.

use rayon::prelude::*;

/// Pixels along an edge of a tile.
pub(super) const TILE_EDGE: u32 = 64;

/// A rectangle of pixels, `x0..x1 × y0..y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PixelRect {
    pub x0: u32,
    pub y0: u32,
    pub x1: u32,
    pub y1: u32,
}

impl PixelRect {
    pub fn is_empty(&self) -> bool {
        self.x0 >= self.x1 || self.y0 >= self.y1
    }

    pub fn intersection(&self, other: &Self) -> Self {
        Self {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        }
    }

    /// Pixels that the raster box `min..=max` may touch, within this rectangle. The box grows by a
    /// hundredth of a pixel, far above the rounding of its projection.
    pub fn clamp_box(&self, min: [f64; 2], max: [f64; 2]) -> Self {
        let low = |x: f64, a: u32, b: u32| ((x - 0.01).floor().max(f64::from(a)) as u32).min(b);
        let high =
            |x: f64, a: u32, b: u32| ((x + 1.01).floor().clamp(f64::from(a), f64::from(b))) as u32;
        Self {
            x0: low(min[0], self.x0, self.x1),
            y0: low(min[1], self.y0, self.y1),
            x1: high(max[0], self.x0, self.x1),
            y1: high(max[1], self.y0, self.y1),
        }
    }
}

/// The tiles that a window of the image touches. Tiles lie on a grid anchored at the image's top
/// left corner, whatever the window, so that a window shows what the whole image shows there.
#[derive(Clone, Debug)]
pub(super) struct TileGrid {
    /// The wanted window.
    pub window: PixelRect,
    /// The whole image.
    pub image: PixelRect,
    first: [u32; 2],
    columns: u32,
    rows: u32,
}

impl TileGrid {
    /// Tiles of a window that is not empty and lies in the image.
    pub fn new(image: PixelRect, window: PixelRect) -> Self {
        let first = [window.x0 / TILE_EDGE, window.y0 / TILE_EDGE];
        Self {
            window,
            image,
            first,
            columns: window.x1.div_ceil(TILE_EDGE) - first[0],
            rows: window.y1.div_ceil(TILE_EDGE) - first[1],
        }
    }

    /// Number of tiles.
    pub fn tile_count(&self) -> usize {
        self.columns as usize * self.rows as usize
    }

    /// Pixels of a tile, cut at the image's edge.
    pub fn tile(&self, index: usize) -> PixelRect {
        let column = self.first[0] + index as u32 % self.columns;
        let row = self.first[1] + index as u32 / self.columns;
        let whole = PixelRect {
            x0: column * TILE_EDGE,
            y0: row * TILE_EDGE,
            x1: (column + 1) * TILE_EDGE,
            y1: (row + 1) * TILE_EDGE,
        };
        whole.intersection(&self.image)
    }

    /// Pixels of all tiles together.
    pub fn covered(&self) -> PixelRect {
        let edge = |tile: u32, end: u32| (tile * TILE_EDGE).min(end);
        PixelRect {
            x0: self.first[0] * TILE_EDGE,
            y0: self.first[1] * TILE_EDGE,
            x1: edge(self.first[0] + self.columns, self.image.x1),
            y1: edge(self.first[1] + self.rows, self.image.y1),
        }
    }

    /// Indices of the tiles that a rectangle inside [`TileGrid::covered`] touches.
    pub fn tiles_of(&self, rect: PixelRect) -> impl Iterator<Item = u32> + use<> {
        let (empty, columns, first) = (rect.is_empty(), self.columns, self.first);
        let row_range = (rect.y0 / TILE_EDGE)..rect.y1.div_ceil(TILE_EDGE);
        let column_range = (rect.x0 / TILE_EDGE)..rect.x1.div_ceil(TILE_EDGE);
        row_range
            .flat_map(move |row| column_range.clone().map(move |column| (column, row)))
            .filter(move |_| !empty)
            .map(move |(column, row)| (row - first[1]) * columns + (column - first[0]))
    }
}

/// For each tile the items that may touch it, in rising order.
pub(super) struct Bins {
    starts: Vec<usize>,
    items: Vec<u32>,
}

impl Bins {
    /// Gathers `(tile, item)` pairs from work pieces that run in parallel; within one piece and
    /// from piece to piece items rise, whatever the number of threads.
    pub fn gather(
        tile_count: usize,
        piece_count: usize,
        pairs_of: impl Fn(usize, &mut Vec<(u32, u32)>) + Sync,
    ) -> Self {
        let pieces: Vec<Vec<(u32, u32)>> = (0..piece_count)
            .into_par_iter()
            .map(|piece| {
                let mut pairs = Vec::new();
                pairs_of(piece, &mut pairs);
                pairs
            })
            .collect();
        let mut starts = vec![0usize; tile_count + 1];
        for (tile, _) in pieces.iter().flatten() {
            starts[*tile as usize + 1] += 1;
        }
        for tile in 0..tile_count {
            starts[tile + 1] += starts[tile];
        }
        let mut items = vec![0u32; starts[tile_count]];
        let mut next = starts.clone();
        for (tile, item) in pieces.iter().flatten() {
            let place = &mut next[*tile as usize];
            items[*place] = *item;
            *place += 1;
        }
        Self { starts, items }
    }

    /// Items of a tile.
    pub fn of(&self, tile: usize) -> &[u32] {
        &self.items[self.starts[tile]..self.starts[tile + 1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_each_pixel_of_the_window_once() {
        let image = PixelRect { x0: 0, y0: 0, x1: 150, y1: 70 };
        for window in [image, PixelRect { x0: 63, y0: 60, x1: 65, y1: 66 }] {
            let grid = TileGrid::new(image, window);
            let mut seen = vec![0; 150 * 70];
            for tile in 0..grid.tile_count() {
                let rect = grid.tile(tile);
                assert_eq!(grid.tiles_of(rect).collect::<Vec<_>>(), [tile as u32]);
                for y in rect.y0..rect.y1 {
                    for x in rect.x0..rect.x1 {
                        seen[(y * 150 + x) as usize] += 1;
                    }
                }
            }
            for y in window.y0..window.y1 {
                for x in window.x0..window.x1 {
                    assert_eq!(seen[(y * 150 + x) as usize], 1);
                }
            }
        }
    }

    #[test]
    fn bins_keep_the_order_of_items() {
        let bins = Bins::gather(3, 10, |piece, pairs| {
            for item in piece * 10..piece * 10 + 10 {
                pairs.push((item as u32 % 3, item as u32));
            }
        });
        for tile in 0..3 {
            let expected: Vec<u32> = (0..100).filter(|item| item % 3 == tile).collect();
            assert_eq!(bins.of(tile as usize), expected);
        }
    }
}
