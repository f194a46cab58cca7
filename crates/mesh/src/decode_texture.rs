//! Images as textures.

use image::{ImageDecoder, ImageFormat, ImageReader, RgbaImage};
use std::io::Cursor;
use std::path::Path;

/// Kinds of images that are read, for messages.
pub(crate) const IMAGE_KINDS: &str = "png, jpeg, webp, bmp or tga";

/// What an image takes, by its header.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TextureSize {
    texels: u64,
    /// Bytes of the decoded image.
    bytes: u64,
}

/// Bytes a texel takes for as long as the scene lives: itself, and the pyramid above it.
const HELD_BYTES: u64 = 6;

/// Bytes a texel takes while it is decoded, besides the image, or while the pyramid is made.
const WORKING_BYTES: u64 = 6;

impl TextureSize {
    /// Reads the header of an image; name and error are those of [`decode_image`].
    pub fn of(name: &str, bytes: &[u8]) -> Result<Self, String> {
        let decoder = reader_of(name, bytes)?.into_decoder().map_err(not_decoded)?;
        let (width, height) = decoder.dimensions();
        Ok(Self { texels: u64::from(width) * u64::from(height), bytes: decoder.total_bytes() })
    }

    /// Bytes that the texture takes for as long as it lives.
    pub fn held_bytes(self) -> u64 {
        self.texels.saturating_mul(HELD_BYTES)
    }

    /// Bytes that decoding takes for a while.
    pub fn decoding_bytes(self) -> u64 {
        self.bytes.saturating_add(self.texels.saturating_mul(WORKING_BYTES))
    }
}

fn not_decoded(error: image::ImageError) -> String {
    format!("it cannot be decoded ({error})")
}

fn reader_of<'b>(name: &str, bytes: &'b [u8]) -> Result<ImageReader<Cursor<&'b [u8]>>, String> {
    let extension = Path::new(name).extension().unwrap_or_default();
    let format = match image::guess_format(bytes) {
        Ok(format) => Some(format),
        Err(_) if extension.eq_ignore_ascii_case("tga") => Some(ImageFormat::Tga),
        Err(_) => None,
    };
    let read = [
        ImageFormat::Png,
        ImageFormat::Jpeg,
        ImageFormat::WebP,
        ImageFormat::Bmp,
        ImageFormat::Tga,
    ];
    let format = format
        .filter(|format| read.contains(format))
        .ok_or_else(|| format!("it is neither {IMAGE_KINDS}; convert it to png"))?;
    Ok(ImageReader::with_format(Cursor::new(bytes), format))
}

/// Decodes an image of one of [`IMAGE_KINDS`]; `name` tells files of tga, which have no mark. The error says what is wrong with it.
pub(crate) fn decode_image(name: &str, bytes: &[u8]) -> Result<RgbaImage, String> {
    // The reader bounds what a header may make it allocate.
    let decoded = reader_of(name, bytes)?.decode().map_err(not_decoded)?.into_rgba8();
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err("it has no pixels".into());
    }
    Ok(decoded)
}

/// The texels of an image, in its place where that can be.
pub(crate) fn texels_of(image: RgbaImage) -> Vec<[u8; 4]> {
    bytemuck::allocation::try_cast_vec(image.into_raw())
        .unwrap_or_else(|(_, bytes)| bytes.as_chunks().0.to_vec())
}
