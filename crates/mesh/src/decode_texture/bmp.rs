//! BMP: palettes of 1, 2, 4 and 8 bits, runs of 4 and 8 bits, colors of 16, 24 and 32 bits, of any masks.
//!
//! A file is a header of 14 bytes (mark, size, reserved, offset of the pixels), a header of the picture that starts with its own size, then masks or
//! a palette, and rows of pixels: from the bottom unless the height is negative, each padded to 4 bytes. All numbers are little-endian.

use super::Decoder;
use super::byte_reader::ByteReader;
use super::layout::{Channels, Layout};

/// Bytes before the header of the picture.
const FILE_HEADER_BYTES: usize = 14;
/// Size of the oldest header of a picture, which has 16-bit sizes and palettes of 3 bytes a color.
const CORE_HEADER_BYTES: u32 = 12;
/// Sizes of the other headers that are known. Those from 56 on hold a mask of alpha.
const INFO_HEADER_BYTES: [u32; 5] = [40, 52, 56, 108, 124];
/// Where masks lie from the start of the picture's header: behind the header of 40 bytes, or in a longer one.
const MASKS_OFFSET: usize = 40;
/// Most texels a side.
const SIDE_MAX: i32 = 0xffff;

/// A BMP image of which the header is read.
pub(super) struct BmpDecoder<'b> {
    bytes: &'b [u8],
    header: Header,
    pixels: Pixels,
}

/// The fields that matter.
struct Header {
    /// Where pixels start.
    pixels_offset: usize,
    /// Size of the header of the picture.
    own_bytes: u32,
    width: u32,
    height: u32,
    is_top_down: bool,
    /// Bits of a pixel.
    bits: u16,
    compression: u32,
    /// Colors of the palette; 0 is as many as there can be.
    color_count: u32,
}

/// How pixels are stored.
enum Pixels {
    /// Indices of this many bits, the first in the high bits.
    Indices(u16, Palette),
    /// Runs of indices of this many bits.
    Runs(u16, Palette),
    /// This many bytes, which hold red, green, blue and alpha by these masks.
    Colors(usize, [Mask; 4]),
}

impl<'b> BmpDecoder<'b> {
    pub fn new(bytes: &'b [u8]) -> Result<Self, String> {
        let header = Header::read(bytes)?;
        let pixels = header.read_pixels(bytes)?;
        Ok(Self { bytes, header, pixels })
    }
}

impl Header {
    fn read(bytes: &[u8]) -> Result<Self, String> {
        let mut reader = ByteReader::at(bytes, 10)?;
        let pixels_offset = reader.u32()? as usize;
        let own_bytes = reader.u32()?;
        let is_core = own_bytes == CORE_HEADER_BYTES;
        if !is_core && !INFO_HEADER_BYTES.contains(&own_bytes) {
            return Err(format!("a header of {own_bytes} bytes is not known"));
        }
        let (width, height) = match is_core {
            true => (i32::from(reader.u16()?), i32::from(reader.u16()?)),
            false => (reader.u32()? as i32, reader.u32()? as i32),
        };
        if !(0..=SIDE_MAX).contains(&width) || height > SIDE_MAX {
            return Err(format!("{width} x {height} texels, expected at most {SIDE_MAX} a side"));
        }
        let planes = reader.u16()?;
        if planes != 1 {
            return Err(format!("{planes} planes, expected 1"));
        }
        let bits = reader.u16()?;
        let mut header = Self {
            pixels_offset,
            own_bytes,
            width: width as u32,
            height: height.unsigned_abs(),
            is_top_down: height < 0,
            bits,
            compression: 0,
            color_count: 0,
        };
        if !is_core {
            header.compression = reader.u32()?;
            // The size of the pixels, and how many there are to a meter.
            reader.take(12)?;
            header.color_count = reader.u32()?;
            // How many colors matter.
            reader.take(4)?;
        }
        Ok(header)
    }

    /// Reads the palette or the masks.
    fn read_pixels(&self, bytes: &[u8]) -> Result<Pixels, String> {
        const OPAQUE_555: [u32; 4] = [0x7c00, 0x3e0, 0x1f, 0];
        const OPAQUE_888: [u32; 4] = [0xff_0000, 0xff00, 0xff, 0];
        let is_core = self.own_bytes == CORE_HEADER_BYTES;
        let colors = |masks: [u32; 4]| {
            Ok(Pixels::Colors(usize::from(self.bits / 8), Mask::of_all(masks, self.bits)?))
        };
        match (self.compression, self.bits) {
            (1 | 2, _) if self.is_top_down => Err("runs from the top are not allowed".into()),
            (0, 2 | 16 | 32) if is_core => {
                Err(format!("pixels of {} bits in an old header", self.bits))
            }
            (0, 1 | 2 | 4 | 8) => Ok(Pixels::Indices(self.bits, self.read_palette(bytes)?)),
            (1, 8) | (2, 4) => Ok(Pixels::Runs(self.bits, self.read_palette(bytes)?)),
            (0, 16) => colors(OPAQUE_555),
            (0, 24 | 32) => colors(OPAQUE_888),
            (3, 16 | 32) => colors(self.read_masks(bytes)?),
            (compression, bits) => {
                Err(format!("compression {compression} of {bits} bits a pixel is not read"))
            }
        }
    }

    fn read_palette(&self, bytes: &[u8]) -> Result<Palette, String> {
        let count_max = 1 << self.bits;
        if self.color_count > count_max {
            return Err(format!("{} colors, expected at most {count_max}", self.color_count));
        }
        let count = if self.color_count == 0 { count_max } else { self.color_count };
        let color_bytes = if self.own_bytes == CORE_HEADER_BYTES { 3 } else { 4 };
        let mut reader = ByteReader::at(bytes, FILE_HEADER_BYTES + self.own_bytes as usize)?;
        let mut palette = [[0; 3]; 256];
        for color in &mut palette[..count as usize] {
            let stored = reader.take(color_bytes)?;
            *color = [stored[2], stored[1], stored[0]];
        }
        Ok(palette)
    }

    fn read_masks(&self, bytes: &[u8]) -> Result<[u32; 4], String> {
        let mut reader = ByteReader::at(bytes, FILE_HEADER_BYTES + MASKS_OFFSET)?;
        let mut masks = [reader.u32()?, reader.u32()?, reader.u32()?, 0];
        if self.own_bytes >= 56 {
            masks[3] = reader.u32()?;
        }
        Ok(masks)
    }

    /// Index from the top of the `k`th stored row.
    fn row(&self, k: usize) -> usize {
        if self.is_top_down { k } else { self.height as usize - 1 - k }
    }
}

impl Decoder for BmpDecoder<'_> {
    fn dimensions(&self) -> (u32, u32) {
        (self.header.width, self.header.height)
    }

    fn layout(&self) -> Layout {
        Layout::narrow(match &self.pixels {
            Pixels::Colors(_, [_, _, _, alpha]) if alpha.is_some() => Channels::Rgba,
            _ => Channels::Rgb,
        })
    }

    fn decode(self: Box<Self>, decoded: &mut [u8]) -> Result<(), String> {
        let mut reader = ByteReader::at(self.bytes, self.header.pixels_offset)?;
        let (width, height) = (self.header.width as usize, self.header.height as usize);
        let row_bytes = decoded.len() / height;
        let stored_bytes = (width * usize::from(self.header.bits)).div_ceil(32) * 4;
        if let Pixels::Runs(bits, palette) = &self.pixels {
            return decode_runs(reader, *bits, palette, &self.header, decoded.as_chunks_mut().0);
        }
        for k in 0..height {
            let stored = reader.take(stored_bytes)?;
            let row = &mut decoded[self.header.row(k) * row_bytes..][..row_bytes];
            match &self.pixels {
                Pixels::Colors(pixel_bytes, masks) => {
                    decode_colors(stored, *pixel_bytes, masks, row)
                }
                Pixels::Indices(bits, palette) | Pixels::Runs(bits, palette) => {
                    let texels = row.as_chunks_mut().0.iter_mut().enumerate();
                    texels.for_each(|(x, texel)| *texel = palette[index_at(stored, *bits, x)]);
                }
            }
        }
        Ok(())
    }
}

/// Red, green and blue by index; black where the file has none.
type Palette = [[u8; 3]; 256];

/// The `x`th index of a row.
fn index_at(stored: &[u8], bits: u16, x: usize) -> usize {
    let bits = usize::from(bits);
    let from_high = x * bits % 8 + bits;
    (usize::from(stored[x * bits / 8]) >> (8 - from_high)) & ((1 << bits) - 1)
}

/// Decodes a row of colors into texels with as many channels as `row` has bytes for.
fn decode_colors(stored: &[u8], pixel_bytes: usize, masks: &[Mask; 4], row: &mut [u8]) {
    let channels = if masks[3].is_some() { 4 } else { 3 };
    for (texel, pixel) in row.chunks_exact_mut(channels).zip(stored.chunks_exact(pixel_bytes)) {
        let mut bytes = [0; 4];
        bytes[..pixel_bytes].copy_from_slice(pixel);
        let pixel = u32::from_le_bytes(bytes);
        texel.iter_mut().zip(masks).for_each(|(channel, mask)| *channel = mask.of(pixel));
    }
}

/// Decodes runs of indices. What they skip stays black.
///
/// Two bytes are a run: its length, and the index, or the two 4-bit indices that alternate. Behind a length of 0 follow: 0 for the end of a row, 1 for
/// that of the picture, 2 for steps right and up in two bytes, or the number of indices that follow, padded to 2 bytes.
fn decode_runs(
    mut reader: ByteReader,
    bits: u16,
    palette: &Palette,
    header: &Header,
    texels: &mut [[u8; 3]],
) -> Result<(), String> {
    let (width, height) = (header.width as usize, header.height as usize);
    let (mut x, mut k) = (0, 0);
    while k < height {
        match (reader.u8()?, reader.u8()?) {
            (0, 0) => (x, k) = (0, k + 1),
            (0, 1) => return Ok(()),
            (0, 2) => {
                x += usize::from(reader.u8()?);
                k += usize::from(reader.u8()?);
                if x > width || k >= height {
                    return Err("a step leads out of the picture".into());
                }
            }
            (0, count) => {
                let count = usize::from(count);
                let indices = reader.take((count * usize::from(bits)).div_ceil(16) * 2)?;
                if count > width - x {
                    return Err("indices go on behind the end of a row".into());
                }
                let row = &mut texels[header.row(k) * width..][x..x + count];
                let texels = row.iter_mut().enumerate();
                texels.for_each(|(i, texel)| *texel = palette[index_at(indices, bits, i)]);
                x += count;
            }
            (count, index) => {
                // Some programs let the last run of a row go on.
                let end = width.min(x + usize::from(count));
                let row = &mut texels[header.row(k) * width..][x..end];
                let per_byte = usize::from(8 / bits);
                let texels = row.iter_mut().enumerate();
                texels.for_each(|(i, texel)| {
                    *texel = palette[index_at(&[index], bits, i % per_byte)]
                });
                x = end;
            }
        }
    }
    Ok(())
}

/// Where a channel lies in a pixel.
#[derive(Clone, Copy)]
struct Mask {
    shift: u32,
    /// The largest value, of at most 8 bits; 0 where there is no such channel.
    max: u32,
}

impl Mask {
    /// Masks of red, green, blue and alpha for pixels of `bits`.
    fn of_all(masks: [u32; 4], bits: u16) -> Result<[Self; 4], String> {
        let mut found = [Self { shift: 0, max: 0 }; 4];
        for (found, mask) in found.iter_mut().zip(masks) {
            *found = Self::new(mask, bits)?;
        }
        match found[..3].iter().all(|mask| mask.is_some()) {
            true => Ok(found),
            false => Err("a mask of a color is missing".into()),
        }
    }

    fn new(mask: u32, bits: u16) -> Result<Self, String> {
        if mask == 0 {
            return Ok(Self { shift: 0, max: 0 });
        }
        let (shift, length) = (mask.trailing_zeros(), mask.count_ones());
        let end = u32::BITS - mask.leading_zeros();
        if end - shift != length || end > u32::from(bits) {
            return Err(format!("the mask {mask:#x} cannot be one of {bits} bits"));
        }
        // Of more than 8 bits the high ones count.
        let kept = length.min(8);
        Ok(Self { shift: end - kept, max: (1 << kept) - 1 })
    }

    fn is_some(self) -> bool {
        self.max > 0
    }

    /// The channel of a pixel, scaled to 0..=255 and rounded. There must be one.
    fn of(self, pixel: u32) -> u8 {
        let value = (pixel >> self.shift) & self.max;
        ((value * 255 + self.max / 2) / self.max) as u8
    }
}
