//! JPEG, by the crate `zune-jpeg`.

use super::Decoder;
use super::layout::{Channels, Layout};
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// A JPEG image of which the header is read.
pub(super) struct JpegDecoder<'b> {
    bytes: &'b [u8],
    dimensions: (u32, u32),
    /// What is asked of the decoder.
    colors: ColorSpace,
}

impl<'b> JpegDecoder<'b> {
    pub fn new(bytes: &'b [u8]) -> Result<Self, String> {
        let mut decoder = start(bytes, DecoderOptions::default());
        decoder.decode_headers().map_err(text_of)?;
        let (Some((width, height)), Some(own)) = (decoder.dimensions(), decoder.input_colorspace())
        else {
            return Err("no size in its header".into());
        };
        // All others, such as CMYK, become RGB.
        let colors = match own {
            ColorSpace::Luma | ColorSpace::LumaA | ColorSpace::RGBA => own,
            _ => ColorSpace::RGB,
        };
        Ok(Self { bytes, dimensions: (width as u32, height as u32), colors })
    }
}

/// A decoder that goes on behind damage, as viewers do, and takes images of any size: that is looked at before they are decoded.
fn start(bytes: &[u8], options: DecoderOptions) -> zune_jpeg::JpegDecoder<ZCursor<&[u8]>> {
    let options =
        options.set_strict_mode(false).set_max_width(usize::MAX).set_max_height(usize::MAX);
    zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options)
}

/// The crate shows the text of its errors by `Debug` alone.
fn text_of(error: DecodeErrors) -> String {
    format!("{error:?}")
}

impl Decoder for JpegDecoder<'_> {
    fn dimensions(&self) -> (u32, u32) {
        self.dimensions
    }

    fn layout(&self) -> Layout {
        Layout::narrow(match self.colors {
            ColorSpace::Luma => Channels::Gray,
            ColorSpace::LumaA => Channels::GrayAlpha,
            ColorSpace::RGBA => Channels::Rgba,
            _ => Channels::Rgb,
        })
    }

    fn decode(self: Box<Self>, decoded: &mut [u8]) -> Result<(), String> {
        let options = DecoderOptions::default().jpeg_set_out_colorspace(self.colors);
        start(self.bytes, options).decode_into(decoded).map_err(text_of)
    }
}
