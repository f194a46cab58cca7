//! PNG previews.

use crate::{ImageError, ToneMap, write_atomically};
use ::png::{BitDepth, ColorType, Compression, Encoder, EncodingError, Filter};
use std::io::{self, Write};
use std::path::Path;

/// Bytes of compressed data that are collected before they are written.
const CHUNK_BYTES: usize = 1 << 18;

/// Writes linear colors as an 8-bit sRGB PNG after tone mapping; the file appears whole or not at
/// all.
///
/// # Errors
///
/// [`ImageError::Unwritable`] if `rgb` does not hold `width · height` pixels or there are none;
/// [`ImageError::Io`] if writing fails.
pub fn write_png(
    path: &Path,
    width: usize,
    height: usize,
    rgb: &[[f32; 3]],
    tone: ToneMap,
) -> Result<(), ImageError> {
    if rgb.len() != width * height {
        let message = format!("{} pixels, expected {width} x {height}", rgb.len());
        return Err(ImageError::unwritable(path, message));
    }
    write_png_rows(path, width, height, tone, |y, row| {
        row.extend_from_slice(&rgb[y * width..(y + 1) * width]);
        Ok(())
    })
}

/// As [`write_png`], of an image that is not in memory: `read_row` appends the pixels of a row to the empty list it is given, the top
/// row first.
///
/// # Errors
///
/// Those of [`write_png`] and of `read_row`.
///
/// # Panics
///
/// If a row has not `width` pixels.
pub fn write_png_rows(
    path: &Path,
    width: usize,
    height: usize,
    tone: ToneMap,
    mut read_row: impl FnMut(usize, &mut Vec<[f32; 3]>) -> Result<(), ImageError>,
) -> Result<(), ImageError> {
    let sizes = u32::try_from(width).ok().zip(u32::try_from(height).ok());
    let Some((columns, rows)) = sizes.filter(|(columns, rows)| *columns > 0 && *rows > 0) else {
        let message = format!("{width} x {height} pixels are out of range");
        return Err(ImageError::unwritable(path, message));
    };
    write_atomically(path, |file| {
        let mut encoder = Encoder::new(file, columns, rows);
        encoder.set_color(ColorType::Rgb);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(Compression::Fast);
        encoder.set_filter(Filter::Adaptive);
        let mut header = encoder.write_header().map_err(io_error)?;
        let mut writer = header.stream_writer_with_size(CHUNK_BYTES).map_err(io_error)?;
        let (mut row, mut bytes) = (Vec::with_capacity(width), Vec::with_capacity(3 * width));
        for y in 0..height {
            row.clear();
            read_row(y, &mut row).map_err(io::Error::other)?;
            assert_eq!(row.len(), width, "a row has a pixel per column");
            bytes.clear();
            bytes.extend(row.iter().flat_map(|pixel| tone.to_srgb8(*pixel)));
            writer.write_all(&bytes)?;
        }
        writer.finish().map_err(io_error)?;
        header.finish().map_err(io_error)
    })
    .map_err(ImageError::or_cause)
}

fn io_error(error: EncodingError) -> io::Error {
    match error {
        EncodingError::IoError(cause) => cause,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::tempdir;

    #[test]
    fn preview_decodes_to_its_bytes() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.png");
        let tone = ToneMap { exposure: 1.0, filmic: true };
        let pixels = [[0.0, 0.1, 0.2], [1.0, 2.0, 3.0], [0.4; 3], [9.0; 3], [0.0; 3], [0.3; 3]];
        write_png(&path, 3, 2, &pixels, tone).unwrap();
        let read = ::image::open(&path).unwrap().into_rgb8();
        assert_eq!(read.dimensions(), (3, 2));
        let expected: Vec<u8> = pixels.iter().flat_map(|p| tone.to_srgb8(*p)).collect();
        assert_eq!(read.into_raw(), expected);
    }

    #[test]
    fn wrong_sizes_are_refused() {
        let path = Path::new("never-written.png");
        for (width, height, count) in [(2, 2, 3), (0, 0, 0), (0, 4, 0)] {
            let pixels = vec![[0.0; 3]; count];
            assert!(write_png(path, width, height, &pixels, ToneMap::default()).is_err());
        }
        assert!(!path.exists());
    }

    #[test]
    fn errors_of_rows_come_out_and_leave_no_file() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.png");
        let result = write_png_rows(&path, 2, 3, ToneMap::default(), |y, row| {
            row.extend([[0.5; 3]; 2]);
            if y < 2 { Ok(()) } else { Err(ImageError::malformed(Path::new("scratch"), "gone")) }
        });
        assert_eq!(result.unwrap_err().to_string(), "scratch: gone");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
    }
}
