//! TGA: palettes, colors of 15, 16, 24 and 32 bits, gray with and without alpha; each also in runs, from any corner.
//!
//! A file is a header of 18 bytes, a text, a palette, and texels, all little-endian. Colors are blue, green, red, alpha.

use super::Decoder;
use super::byte_reader::ByteReader;
use super::layout::{Channels, Layout};

/// A TGA image of which header and palette are read.
pub(super) struct TgaDecoder<'b> {
    header: Header,
    texel: Texel,
    /// Colors as stored. Empty where texels are colors themselves.
    palette: &'b [u8],
    /// What follows the palette.
    texels: ByteReader<'b>,
}

/// The fields that matter.
struct Header {
    has_palette: bool,
    /// Texels are indices into the palette.
    is_mapped: bool,
    is_gray: bool,
    is_in_runs: bool,
    /// Index of the palette's first color.
    palette_start: u16,
    palette_count: u16,
    /// Bits of a color in the palette.
    palette_bits: u8,
    width: u16,
    height: u16,
    /// Bits of a stored texel.
    bits: u8,
    /// Bits of alpha, as the header counts them.
    alpha_bits: u8,
    /// Whether rows start at the right, and columns at the bottom.
    is_from_right: bool,
    is_from_bottom: bool,
}

/// What a stored color is.
#[derive(Clone, Copy, PartialEq)]
enum Texel {
    Gray,
    GrayAlpha,
    /// 5 bits a color, blue lowest. The highest bit is no alpha that one could trust.
    Bgr5,
    Bgr,
    Bgra,
}

impl<'b> TgaDecoder<'b> {
    pub fn new(bytes: &'b [u8]) -> Result<Self, String> {
        let mut reader = ByteReader::at(bytes, 0)?;
        let text_bytes = reader.u8()?;
        let header = Header::read(&mut reader)?;
        let texel = header.texel()?;
        reader.take(usize::from(text_bytes))?;
        let mut palette: &[u8] = &[];
        if header.has_palette {
            if ![15, 16, 24, 32].contains(&header.palette_bits) {
                return Err(format!("a palette of {} bits is not read", header.palette_bits));
            }
            let color_bytes = usize::from(header.palette_bits.div_ceil(8));
            palette = reader.take(color_bytes * usize::from(header.palette_count))?;
        }
        Ok(Self { header, texel, palette, texels: reader })
    }

    /// The color of a stored texel: itself, or one of the palette.
    fn color<'a>(&'a self, stored: &'a [u8]) -> Result<&'a [u8], String> {
        if !self.header.is_mapped {
            return Ok(stored);
        }
        let index = stored.iter().rev().fold(0, |index, byte| index << 8 | usize::from(*byte));
        let color_bytes = self.texel.stored_bytes();
        index
            .checked_sub(usize::from(self.header.palette_start))
            .and_then(|index| self.palette.get(index * color_bytes..(index + 1) * color_bytes))
            .ok_or_else(|| format!("the palette has no color {index}"))
    }

    /// Where the `k`th stored texel lies, counted from the top left.
    fn place(&self, k: usize) -> usize {
        let (width, height) = (usize::from(self.header.width), usize::from(self.header.height));
        let (x, y) = (k % width, k / width);
        let x = if self.header.is_from_right { width - 1 - x } else { x };
        let y = if self.header.is_from_bottom { height - 1 - y } else { y };
        y * width + x
    }
}

impl Header {
    /// Reads what follows the first byte.
    fn read(reader: &mut ByteReader) -> Result<Self, String> {
        let (palette_kind, kind) = (reader.u8()?, reader.u8()?);
        let (palette_start, palette_count, palette_bits) =
            (reader.u16()?, reader.u16()?, reader.u8()?);
        // Where the picture lies on a screen.
        reader.take(4)?;
        let (width, height) = (reader.u16()?, reader.u16()?);
        let (bits, descriptor) = (reader.u8()?, reader.u8()?);
        if palette_kind > 1 || ![1, 2, 3, 9, 10, 11].contains(&kind) {
            return Err(format!("kind {kind} with a palette of kind {palette_kind} is not read"));
        }
        Ok(Self {
            has_palette: palette_kind == 1,
            is_mapped: kind & 3 == 1,
            is_gray: kind & 3 == 3,
            is_in_runs: kind & 8 != 0,
            palette_start,
            palette_count,
            palette_bits,
            width,
            height,
            bits,
            alpha_bits: descriptor & 15,
            is_from_right: descriptor & 16 != 0,
            is_from_bottom: descriptor & 32 == 0,
        })
    }

    /// What colors are.
    fn texel(&self) -> Result<Texel, String> {
        if self.is_mapped && !(self.has_palette && [8, 16].contains(&self.bits)) {
            return Err(format!("indices of {} bits need a palette, and 8 or 16 bits", self.bits));
        }
        let bits = if self.is_mapped { self.palette_bits } else { self.bits };
        match (self.is_gray, bits, self.alpha_bits) {
            (true, 8, 0 | 8) => Ok(Texel::Gray),
            (true, 16, 8) => Ok(Texel::GrayAlpha),
            (false, 15, 0) | (false, 16, 0 | 1) => Ok(Texel::Bgr5),
            (false, 24, 0) => Ok(Texel::Bgr),
            // Programs that write alpha do not always count it.
            (false, 32, 0 | 8) => Ok(Texel::Bgra),
            (_, _, alpha_bits) => {
                Err(format!("texels of {bits} bits, {alpha_bits} of them alpha, are not read"))
            }
        }
    }
}

impl Texel {
    /// Bytes of a stored color.
    fn stored_bytes(self) -> usize {
        match self {
            Self::Gray => 1,
            Self::GrayAlpha | Self::Bgr5 => 2,
            Self::Bgr => 3,
            Self::Bgra => 4,
        }
    }

    fn channels(self) -> Channels {
        match self {
            Self::Gray => Channels::Gray,
            Self::GrayAlpha => Channels::GrayAlpha,
            Self::Bgr5 | Self::Bgr => Channels::Rgb,
            Self::Bgra => Channels::Rgba,
        }
    }

    /// Decodes a color of [`Self::stored_bytes`] into as many bytes as it has channels.
    fn decode(self, stored: &[u8], decoded: &mut [u8]) {
        match self {
            Self::Gray | Self::GrayAlpha => decoded.copy_from_slice(stored),
            Self::Bgr5 => {
                let value = u16::from_le_bytes([stored[0], stored[1]]);
                // Rounded: 31 becomes 255.
                let channel = |shift: u16| (((value >> shift & 31) * 255 + 15) / 31) as u8;
                decoded.copy_from_slice(&[10, 5, 0].map(channel));
            }
            Self::Bgr | Self::Bgra => {
                decoded.copy_from_slice(stored);
                decoded.swap(0, 2);
            }
        }
    }
}

impl Decoder for TgaDecoder<'_> {
    fn dimensions(&self) -> (u32, u32) {
        (u32::from(self.header.width), u32::from(self.header.height))
    }

    fn layout(&self) -> Layout {
        Layout::narrow(self.texel.channels())
    }

    fn decode(self: Box<Self>, decoded: &mut [u8]) -> Result<(), String> {
        let count = usize::from(self.header.width) * usize::from(self.header.height);
        let channels = decoded.len() / count;
        let stored_bytes = usize::from(self.header.bits.div_ceil(8));
        let mut reader = self.texels;
        let mut put = |k: usize, stored: &[u8]| {
            let texel = &mut decoded[self.place(k) * channels..][..channels];
            self.color(stored).map(|color| self.texel.decode(color, texel))
        };
        let mut k = 0;
        while k < count {
            // Without runs, all texels are like those behind one head. The last head may count more texels than there are.
            let head = if self.header.is_in_runs { reader.u8()? } else { 0 };
            let end = match self.header.is_in_runs {
                true => count.min(k + usize::from(head & 127) + 1),
                false => count,
            };
            if head & 128 != 0 {
                let stored = reader.take(stored_bytes)?;
                (k..end).try_for_each(|k| put(k, stored))?;
            } else {
                let stored = reader.take((end - k) * stored_bytes)?;
                let stored = stored.chunks_exact(stored_bytes);
                (k..end).zip(stored).try_for_each(|(k, stored)| put(k, stored))?;
            }
            k = end;
        }
        Ok(())
    }
}
