//! Images as textures.

use crate::{SceneError, Texture};
use image::ImageDecoder;
use std::path::Path;

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
    /// Reads the header of an image.
    pub fn of(path: &Path, place: &str, bytes: &[u8]) -> Result<Self, SceneError> {
        let reader = reader_of(path, place, bytes)?;
        let decoder = reader.into_decoder();
        let decoder = decoder.map_err(|e| SceneError::malformed(path, format!("{place}: {e}")))?;
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

fn reader_of<'b>(
    path: &Path,
    place: &str,
    bytes: &'b [u8],
) -> Result<image::ImageReader<std::io::Cursor<&'b [u8]>>, SceneError> {
    let format = image::guess_format(bytes)
        .ok()
        .filter(|f| matches!(f, image::ImageFormat::Png | image::ImageFormat::Jpeg));
    let Some(format) = format else {
        let what = format!("{place}: an image that is neither png nor jpeg");
        return Err(SceneError::unsupported(path, what, "convert its images to png"));
    };
    Ok(image::ImageReader::with_format(std::io::Cursor::new(bytes), format))
}

/// Decodes a PNG or JPEG image. Alpha becomes 1 unless `keeps_alpha`; `srgb` says how the color bytes
/// are encoded; `place` is for messages.
pub(crate) fn decode_texture(
    path: &Path,
    place: &str,
    bytes: &[u8],
    keeps_alpha: bool,
    srgb: bool,
) -> Result<Texture, SceneError> {
    // The reader bounds what a header may make it allocate.
    let decoded = reader_of(path, place, bytes)?
        .decode()
        .map_err(|e| SceneError::malformed(path, format!("{place}: {e}")))?
        .into_rgba8();
    let (width, height) = decoded.dimensions();
    let mut texels: Vec<[u8; 4]> = bytemuck::allocation::try_cast_vec(decoded.into_raw())
        .unwrap_or_else(|(_, bytes)| bytes.as_chunks().0.to_vec());
    if !keeps_alpha {
        texels.iter_mut().for_each(|texel| texel[3] = 255);
    }
    Texture::new(width, height, texels, srgb)
        .ok_or_else(|| SceneError::malformed(path, format!("{place} has no pixels")))
}
