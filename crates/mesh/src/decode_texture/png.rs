//! PNG, by the crate `png`.

use super::layout::{Channels, Layout};
use super::{DECODED_BYTES_MAX, Decoder};
use png::{BitDepth, ColorType, Limits, Transformations};
use std::io::Cursor;

/// A PNG image of which the header is read; of an animation the first picture.
pub(super) struct PngDecoder<'b>(png::Reader<Cursor<&'b [u8]>>);

impl<'b> PngDecoder<'b> {
    pub fn new(bytes: &'b [u8]) -> Result<Self, String> {
        let limits = Limits { bytes: DECODED_BYTES_MAX as usize };
        let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
        decoder.set_ignore_text_chunk(true);
        decoder.set_ignore_iccp_chunk(true);
        // Palettes and less than 8 bits become 8 bits a channel, and a transparent color alpha.
        decoder.set_transformations(Transformations::EXPAND);
        decoder.read_info().map(Self).map_err(|error| error.to_string())
    }
}

impl Decoder for PngDecoder<'_> {
    fn dimensions(&self) -> (u32, u32) {
        self.0.info().size()
    }

    fn layout(&self) -> Layout {
        let (colors, depth) = self.0.output_color_type();
        let channels = match colors {
            ColorType::Grayscale => Channels::Gray,
            ColorType::GrayscaleAlpha => Channels::GrayAlpha,
            // Palettes are expanded.
            ColorType::Rgb | ColorType::Indexed => Channels::Rgb,
            ColorType::Rgba => Channels::Rgba,
        };
        Layout { channels, is_wide: depth == BitDepth::Sixteen }
    }

    fn decode(mut self: Box<Self>, decoded: &mut [u8]) -> Result<(), String> {
        self.0.next_frame(decoded).map(drop).map_err(|error| error.to_string())
    }
}
