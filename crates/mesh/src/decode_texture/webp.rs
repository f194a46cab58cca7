//! WebP, by the crate `image-webp`.

use super::Decoder;
use super::layout::{Channels, Layout};
use std::io::Cursor;

/// A WebP image of which the header is read; of an animation the first picture.
pub(super) struct WebPDecoder<'b>(image_webp::WebPDecoder<Cursor<&'b [u8]>>);

impl<'b> WebPDecoder<'b> {
    pub fn new(bytes: &'b [u8]) -> Result<Self, String> {
        image_webp::WebPDecoder::new(Cursor::new(bytes))
            .map(Self)
            .map_err(|error| error.to_string())
    }
}

impl Decoder for WebPDecoder<'_> {
    fn dimensions(&self) -> (u32, u32) {
        self.0.dimensions()
    }

    fn layout(&self) -> Layout {
        Layout::narrow(if self.0.has_alpha() { Channels::Rgba } else { Channels::Rgb })
    }

    fn decode(mut self: Box<Self>, decoded: &mut [u8]) -> Result<(), String> {
        self.0.read_image(decoded).map_err(|error| error.to_string())
    }
}
