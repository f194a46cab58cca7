//! Images as textures.

use image::{ImageFormat, RgbaImage};
use std::path::Path;

/// Kinds of images that are read, for messages.
pub(crate) const IMAGE_KINDS: &str = "png, jpeg, webp, bmp or tga";

/// Decodes an image of one of [`IMAGE_KINDS`]; `name` tells files of tga, which have no mark. The error says what is wrong with it.
pub(crate) fn decode_image(name: &str, bytes: &[u8]) -> Result<RgbaImage, String> {
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
    // The reader bounds what a header may make it allocate.
    let reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), format);
    let decoded = reader.decode().map_err(|e| format!("it cannot be decoded ({e})"))?.into_rgba8();
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err("it has no pixels".into());
    }
    Ok(decoded)
}
