//! Many small pictures on one sheet, each under its name.

use crate::{ImageError, ToneMap, write_png};
use std::path::Path;

/// A picture of a [`write_contact_sheet`].
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// What is written above it.
    pub title: String,
    /// Linear display colors in 0..=1, row by row.
    pub pixels: Vec<[f32; 3]>,
}

/// Pixels between tiles, and around them.
const GAP: usize = 4;
/// Height of a title.
const TITLE: usize = 11;
/// Columns and rows of a letter, and the distance to the next.
const LETTER: [usize; 2] = [5, 7];
const LETTER_STEP: usize = 6;
const BACKGROUND: [f32; 3] = [0.01; 3];
const INK: [f32; 3] = [0.6; 3];

/// Writes tiles of `width × height` pixels in rows of about as many as there are rows, as an 8-bit sRGB PNG.
///
/// # Errors
///
/// [`ImageError::Unwritable`] if there are no tiles, or one has another number of pixels; [`ImageError::Io`] if
/// writing fails.
pub fn write_contact_sheet(
    path: &Path,
    width: usize,
    height: usize,
    tiles: &[Tile],
) -> Result<(), ImageError> {
    if let Some(tile) = tiles.iter().find(|tile| tile.pixels.len() != width * height) {
        let (title, found) = (&tile.title, tile.pixels.len());
        let message = format!("tile {title} has {found} pixels, expected {width} x {height}");
        return Err(ImageError::unwritable(path, message));
    }
    let columns = (1..=tiles.len()).find(|c| c * c >= tiles.len()).unwrap_or(0);
    let rows = tiles.len().div_ceil(columns.max(1));
    let step = [width + GAP, height + GAP + TITLE];
    let mut sheet = Sheet::new(columns * step[0] + GAP, rows * step[1] + GAP);
    if tiles.is_empty() {
        return Err(ImageError::unwritable(path, "there is no picture to put on the sheet"));
    }
    for (index, tile) in tiles.iter().enumerate() {
        let (x, y) = (GAP + index % columns * step[0], GAP + index / columns * step[1]);
        sheet.write(&tile.title, x, y, width);
        for (row, pixels) in tile.pixels.chunks_exact(width).enumerate() {
            let start = (y + TITLE + row) * sheet.width + x;
            sheet.pixels[start..start + width].copy_from_slice(pixels);
        }
    }
    let tone = ToneMap { exposure: 0.0, filmic: false };
    write_png(path, sheet.width, sheet.height, &sheet.pixels, tone)
}

struct Sheet {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

impl Sheet {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![BACKGROUND; width * height] }
    }

    /// Writes as much of `text` as fits into `width` pixels.
    fn write(&mut self, text: &str, x: usize, y: usize, width: usize) {
        for (index, character) in text.chars().take(width / LETTER_STEP).enumerate() {
            for (row, bits) in letter(character).into_iter().enumerate() {
                for column in (0..LETTER[0]).filter(|c| bits >> (LETTER[0] - 1 - c) & 1 == 1) {
                    let at = (y + row) * self.width + x + index * LETTER_STEP + column;
                    self.pixels[at] = INK;
                }
            }
        }
    }
}

/// Rows of a letter from the top, in five bits each; capitals only.
fn letter(character: char) -> [u8; LETTER[1]] {
    match character.to_ascii_uppercase() {
        'A' => [0x0e, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11],
        'B' => [0x1e, 0x11, 0x11, 0x1e, 0x11, 0x11, 0x1e],
        'C' => [0x0e, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0e],
        'D' => [0x1e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1e],
        'E' => [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f],
        'F' => [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x10],
        'G' => [0x0e, 0x11, 0x10, 0x17, 0x11, 0x11, 0x0f],
        'H' => [0x11, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11],
        'I' => [0x0e, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e],
        'J' => [0x07, 0x02, 0x02, 0x02, 0x02, 0x12, 0x0c],
        'K' => [0x11, 0x12, 0x14, 0x18, 0x14, 0x12, 0x11],
        'L' => [0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x1f],
        'M' => [0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11],
        'N' => [0x11, 0x19, 0x15, 0x13, 0x11, 0x11, 0x11],
        'O' => [0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        'P' => [0x1e, 0x11, 0x11, 0x1e, 0x10, 0x10, 0x10],
        'Q' => [0x0e, 0x11, 0x11, 0x11, 0x15, 0x12, 0x0d],
        'R' => [0x1e, 0x11, 0x11, 0x1e, 0x14, 0x12, 0x11],
        'S' => [0x0f, 0x10, 0x10, 0x0e, 0x01, 0x01, 0x1e],
        'T' => [0x1f, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04],
        'U' => [0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        'V' => [0x11, 0x11, 0x11, 0x11, 0x11, 0x0a, 0x04],
        'W' => [0x11, 0x11, 0x11, 0x15, 0x15, 0x1b, 0x11],
        'X' => [0x11, 0x11, 0x0a, 0x04, 0x0a, 0x11, 0x11],
        'Y' => [0x11, 0x11, 0x0a, 0x04, 0x04, 0x04, 0x04],
        'Z' => [0x1f, 0x01, 0x02, 0x04, 0x08, 0x10, 0x1f],
        '0' => [0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e],
        '1' => [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e],
        '2' => [0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f],
        '3' => [0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e],
        '4' => [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02],
        '5' => [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e],
        '6' => [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e],
        '7' => [0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08],
        '8' => [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e],
        '9' => [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c],
        '.' => [0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c],
        '-' => [0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00],
        '_' => [0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x1f],
        _ => [0x00; LETTER[1]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::tempdir;

    #[test]
    fn tiles_stand_in_a_grid_under_their_titles() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.png");
        let tile = |k: usize| Tile { title: "I".into(), pixels: vec![[k as f32 / 4.0; 3]; 12 * 3] };
        write_contact_sheet(&path, 12, 3, &[tile(0), tile(1), tile(4)]).unwrap();
        let read = ::image::open(&path).unwrap().into_rgb8();
        assert_eq!(read.dimensions(), (2 * 16 + 4, 2 * 18 + 4));
        let at = |x: usize, y: usize| read.get_pixel(x as u32, y as u32).0[0];
        // The third tile is white and stands below the first; its title's first row is `.###.`.
        assert_eq!(at(GAP, GAP + 18 + TITLE), 255);
        assert_eq!(at(GAP + 11, GAP + 18 + TITLE + 2), 255);
        assert_eq!(at(GAP, GAP + TITLE), 0);
        assert!(at(GAP + 16, GAP + TITLE) > 100);
        let title: Vec<bool> = (0..5).map(|x| at(GAP + x, GAP) > 100).collect();
        assert_eq!(title, [false, true, true, true, false]);
    }

    #[test]
    fn wrong_tiles_are_refused() {
        let path = Path::new("never-written.png");
        let tile = Tile { title: "a".into(), pixels: vec![[0.0; 3]; 5] };
        assert!(write_contact_sheet(path, 2, 3, &[tile]).is_err());
        assert!(write_contact_sheet(path, 2, 3, &[]).is_err() && !path.exists());
    }
}
