//! PNG previews.

use crate::{ImageError, ToneMap, write_atomically};
use ::image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::io;
use std::path::Path;

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
    let sizes = u32::try_from(width).ok().zip(u32::try_from(height).ok());
    let (columns, rows) = match sizes {
        Some(sizes) if rgb.len() == width * height && !rgb.is_empty() => sizes,
        _ => {
            let message = format!("{} pixels, expected {width} x {height}", rgb.len());
            return Err(ImageError::unwritable(path, message));
        }
    };
    let bytes: Vec<u8> = rgb.iter().flat_map(|pixel| tone.to_srgb8(*pixel)).collect();
    write_atomically(path, |file| {
        PngEncoder::new(file)
            .write_image(&bytes, columns, rows, ExtendedColorType::Rgb8)
            .map_err(io::Error::other)
    })
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
}
