//! Images as textures.

mod bmp;
mod byte_reader;
mod jpeg;
mod layout;
mod png;
#[cfg(test)]
mod tests;
mod tga;
mod webp;

use self::layout::Layout;
use pbgi_file::catch_decoder_panic;
use std::path::Path;

/// Kinds of images that are read, for messages.
pub(crate) const IMAGE_KINDS: &str = "png, jpeg, webp, bmp or tga";

/// Most bytes that a decoded image may take, before its texels are made of it.
const DECODED_BYTES_MAX: u64 = 512 << 20;

/// A decoded image.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DecodedImage {
    pub width: u32,
    pub height: u32,
    /// Red, green, blue and alpha in rows from the top left: `width` × `height` of them.
    pub texels: Vec<[u8; 4]>,
}

/// An image of which the header is read.
trait Decoder {
    /// Width and height.
    fn dimensions(&self) -> (u32, u32);

    /// What one texel is, once decoded.
    fn layout(&self) -> Layout;

    /// Fills rows from the top left. `decoded` has just the size of the image, which has texels, and holds zeros.
    fn decode(self: Box<Self>, decoded: &mut [u8]) -> Result<(), String>;
}

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
        Ok(Self::of_decoder(&*open(name, bytes)?))
    }

    fn of_decoder(decoder: &dyn Decoder) -> Self {
        let (width, height) = decoder.dimensions();
        let texels = u64::from(width) * u64::from(height);
        Self { texels, bytes: texels.saturating_mul(decoder.layout().texel_bytes()) }
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

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq)]
enum FileKind {
    Png,
    Jpeg,
    WebP,
    Bmp,
    Tga,
}

impl FileKind {
    /// The kind by the first bytes, or else by the name: files of tga have no mark.
    fn of(name: &str, bytes: &[u8]) -> Option<Self> {
        let extension = Path::new(name).extension().unwrap_or_default();
        match bytes {
            [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n', ..] => Some(Self::Png),
            [0xff, 0xd8, 0xff, ..] => Some(Self::Jpeg),
            // Between the words stands the size of the file.
            [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Some(Self::WebP),
            [b'B', b'M', ..] => Some(Self::Bmp),
            _ if extension.eq_ignore_ascii_case("tga") => Some(Self::Tga),
            _ => None,
        }
    }
}

/// Reads the header of an image; name and error are those of [`decode_image`].
fn open<'b>(name: &str, bytes: &'b [u8]) -> Result<Box<dyn Decoder + 'b>, String> {
    let kind = FileKind::of(name, bytes)
        .ok_or_else(|| format!("it is neither {IMAGE_KINDS}; convert it to png"))?;
    run_decoder(|| {
        let decoder: Box<dyn Decoder + 'b> = match kind {
            FileKind::Png => Box::new(png::PngDecoder::new(bytes)?),
            FileKind::Jpeg => Box::new(jpeg::JpegDecoder::new(bytes)?),
            FileKind::WebP => Box::new(webp::WebPDecoder::new(bytes)?),
            FileKind::Bmp => Box::new(bmp::BmpDecoder::new(bytes)?),
            FileKind::Tga => Box::new(tga::TgaDecoder::new(bytes)?),
        };
        Ok(decoder)
    })
}

/// Runs a decoder on bytes nobody vouches for; a panic inside it becomes an error.
fn run_decoder<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_decoder_panic(decode)
        .unwrap_or_else(|| Err("the decoder failed on damaged data".into()))
        .map_err(|why| format!("it cannot be decoded ({why})"))
}

/// Decodes an image of one of [`IMAGE_KINDS`]; `name` tells files of tga, which have no mark. The error says what is wrong with it.
pub(crate) fn decode_image(name: &str, bytes: &[u8]) -> Result<DecodedImage, String> {
    let decoder = open(name, bytes)?;
    let ((width, height), layout) = (decoder.dimensions(), decoder.layout());
    if width == 0 || height == 0 {
        return Err("it has no pixels".into());
    }
    let decoded_bytes = TextureSize::of_decoder(&*decoder).bytes;
    let texels = run_decoder(|| {
        if decoded_bytes > DECODED_BYTES_MAX {
            let most = DECODED_BYTES_MAX >> 20;
            return Err(format!("{width} x {height} texels take more than {most} MiB"));
        }
        let mut decoded = vec![0; decoded_bytes as usize];
        decoder.decode(&mut decoded)?;
        Ok(layout.texels_of(decoded))
    })?;
    Ok(DecodedImage { width, height, texels })
}
