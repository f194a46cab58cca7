//! Images as textures.

use crate::{SceneError, Texture};
use std::path::Path;

/// Decodes a PNG or JPEG image. Alpha becomes 1 unless `keeps_alpha`; `srgb` says how the color bytes
/// are encoded; `place` is for messages.
pub(crate) fn decode_texture(
    path: &Path,
    place: &str,
    bytes: &[u8],
    keeps_alpha: bool,
    srgb: bool,
) -> Result<Texture, SceneError> {
    let format = image::guess_format(bytes)
        .ok()
        .filter(|f| matches!(f, image::ImageFormat::Png | image::ImageFormat::Jpeg));
    let Some(format) = format else {
        let what = format!("{place}: an image that is neither png nor jpeg");
        return Err(SceneError::unsupported(path, what, "convert its images to png"));
    };
    // The reader bounds what a header may make it allocate.
    let reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), format);
    let decoded = reader
        .decode()
        .map_err(|e| SceneError::malformed(path, format!("{place}: {e}")))?
        .into_rgba8();
    let (width, height) = decoded.dimensions();
    let opaque = |[r, g, b, a]: [u8; 4]| [r, g, b, if keeps_alpha { a } else { 255 }];
    let texels = decoded.pixels().map(|p| opaque(p.0)).collect();
    Texture::new(width, height, texels, srgb)
        .ok_or_else(|| SceneError::malformed(path, format!("{place} has no pixels")))
}
