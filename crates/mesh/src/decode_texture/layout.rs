//! What decoders give, and how texels are made of it.

/// Channels of a decoded texel, in their order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Channels {
    Gray,
    GrayAlpha,
    Rgb,
    Rgba,
}

/// What one decoded texel is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layout {
    pub channels: Channels,
    /// A channel takes two bytes, the high one first, instead of one.
    pub is_wide: bool,
}

impl Layout {
    /// Channels of one byte.
    pub fn narrow(channels: Channels) -> Self {
        Self { channels, is_wide: false }
    }

    /// Bytes of a texel.
    pub fn texel_bytes(self) -> u64 {
        let channels = match self.channels {
            Channels::Gray => 1,
            Channels::GrayAlpha => 2,
            Channels::Rgb => 3,
            Channels::Rgba => 4,
        };
        if self.is_wide { 2 * channels } else { channels }
    }

    /// Red, green, blue and alpha of each decoded texel, in its place where that can be.
    pub fn texels_of(self, mut decoded: Vec<u8>) -> Vec<[u8; 4]> {
        if self.is_wide {
            narrow(&mut decoded);
        }
        match self.channels {
            Channels::Gray => decoded.iter().map(|&v| [v, v, v, 255]).collect(),
            Channels::GrayAlpha => {
                decoded.as_chunks().0.iter().map(|&[v, alpha]| [v, v, v, alpha]).collect()
            }
            Channels::Rgb => {
                decoded.as_chunks().0.iter().map(|&[r, g, b]| [r, g, b, 255]).collect()
            }
            Channels::Rgba => bytemuck::allocation::try_cast_vec(decoded)
                .unwrap_or_else(|(_, bytes)| bytes.as_chunks().0.to_vec()),
        }
    }
}

/// Rounds channels of two bytes to one, in their place.
fn narrow(decoded: &mut Vec<u8>) {
    let count = decoded.len() / 2;
    for k in 0..count {
        let wide = u16::from_be_bytes([decoded[2 * k], decoded[2 * k + 1]]);
        // 65535 = 257 · 255.
        decoded[k] = ((u32::from(wide) + 128) / 257) as u8;
    }
    decoded.truncate(count);
}
