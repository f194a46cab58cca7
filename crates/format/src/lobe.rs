//! The directional form of a node: how much area it shows, and what radiance, in each direction.

use crate::{Channels, MiniFloat, read_u16, read_u32};
use pbgi_math::{SharedExponent, Stencil, Vec3, decode_octahedral24, encode_octahedral24};

/// Most lobes a node may have.
pub const LOBES_MAX: usize = 4;

/// Largest `h/(|V| + h)` of a lobe of a solid thing that is drawn in its plane, where its stencil says; rounder ones are drawn facing the receiver.
/// A half sphere has 0.55. At 0.3 sr, the street has an error of 8.0 % with 0.25, of 2.9 % with 0.7 and the same with 1.
const SOLID_FLAT_WIDTH: f32 = 0.7;

/// The same for sheets, whose parts lie in no plane where their normals differ: leaves. 0.05 and 0.25 change errors by a tenth of themselves.
const SHEET_FLAT_WIDTH: f32 = 0.1;

/// Largest code of `h/(|V| + h)` of a plane: normals of a few degrees' scatter.
const PLANE_WIDTH_CODE: u8 = 3;

/// Least code of the fill of a lobe of a surface that fills its section, 0.95.
const FILLED_CODE: u8 = 121;

/// Bit of the fill's byte: the surfels are loose.
const LOOSE_BIT: u8 = 0x80;

/// Largest clumping index that is stored.
const CLUMPING_MAX: f32 = 2.0;

/// Steps of `h/(|V| + h)`.
const WIDTH_STEPS: f32 = 255.0;

/// Steps of a fill.
const FILL_STEPS: f32 = 127.0;

/// Surfels of similar normals and radiance, summed.
///
/// With the vector area `V = Σ aᵢ nᵢ` and the width `h`, the front shows toward the unit direction `d`
///
/// ```text
/// A(d) = ½ (V·d + √((V·d)² + h²))
/// ```
///
/// A flat lobe has `h = 0` and shows exactly `|V| max(0, n·d)`; a closed or shapeless one has `V = 0` and shows `h/2`
/// everywhere. For every `h`, `A(d) − A(−d) = V·d` as for the surfels themselves, and `h` is chosen
/// so that the mean of `A` over all directions is theirs, too. `A` is never negative and does not ring.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lobe {
    /// Vector area `Σ aᵢ nᵢ`, scene units squared.
    pub vector: Vec3,
    /// Width `h`, scene units squared.
    pub width: f32,
    /// Whether the back blocks as much as the front (and is black).
    pub blocks_back: bool,
    /// Mean radiance of the front, W·m⁻²·sr⁻¹.
    pub radiance: [f32; 3],
    /// Where the surfels' plane lies: height of their centroid along `vector` over the center of the node's stored box, as
    /// a share of how far the box reaches in that direction, −1..=1.
    pub height: f32,
    /// Area of the surfels, seen along `vector`, over that of what the stencil leaves of the section of the box by that plane, 0..=1. Of
    /// loose ones, the share of it that they cover; of sheets and loose ones that are not flat, half of their node's clumping index.
    pub fill: f32,
    /// Whether the surfels make no surface: they lie anywhere, and hide each other at random.
    pub is_loose: bool,
    /// Where in the node's stored box the surfels lie, seen along the largest axis of the decoded vector ([`pbgi_math::stencil_axis`]); of
    /// sheets that are not flat, seen along each axis ([`Stencil::view`]).
    pub stencil: Stencil,
}

impl Lobe {
    /// Area shown toward the unit direction `d` by the fronts.
    #[must_use]
    #[inline(always)]
    pub fn front_area(&self, d: Vec3) -> f32 {
        let x = self.vector.dot(d);
        0.5 * (x + (x * x + self.width * self.width).sqrt())
    }

    /// Area shown toward the unit direction `d` by blocking backs.
    #[must_use]
    #[inline(always)]
    pub fn back_area(&self, d: Vec3) -> f32 {
        if self.blocks_back { self.front_area(-d) } else { 0.0 }
    }

    /// Whether the surfels are drawn as a piece of their plane. The limits lie between widths that are stored, so that a lobe and what is read of it agree.
    #[must_use]
    #[inline(always)]
    pub fn is_flat(&self) -> bool {
        let flat_width = if self.is_solid() { SOLID_FLAT_WIDTH } else { SHEET_FLAT_WIDTH };
        self.width <= flat_width * (self.vector.length() + self.width)
    }

    /// Whether the surfels have two sides, and make surfaces.
    #[must_use]
    #[inline(always)]
    pub fn is_solid(&self) -> bool {
        self.blocks_back && !self.is_loose
    }

    /// Whether the surfels have one side only, and make surfaces: two such back to back are a leaf, or cloth.
    #[must_use]
    #[inline(always)]
    pub fn is_sheet(&self) -> bool {
        !self.blocks_back && !self.is_loose
    }

    /// The clumping index of the node of a sheet that is not flat: which share of its optical depth would, in a turbid medium that fills the node's box, cover
    /// as much as the sheets do (Nilson 1971). Of loose surfels that are not flat, which share of it they have before each other.
    #[must_use]
    #[inline(always)]
    pub fn clumping(&self) -> f32 {
        CLUMPING_MAX * self.fill
    }

    /// Sets [`Self::clumping`], or the largest that can be stored.
    pub fn set_clumping(&mut self, clumping: f32) {
        self.fill = (clumping / CLUMPING_MAX).clamp(0.0, 1.0);
    }

    /// Whether a stored lobe is a plane that fills the section of its node's box: what is drawn for it is what is there.
    #[must_use]
    #[inline(always)]
    pub fn is_filled_plane(stored: &[u8]) -> bool {
        stored[6] <= PLANE_WIDTH_CODE && (FILLED_CODE..LOOSE_BIT).contains(&stored[7])
    }

    /// Radiance of the brightest channel of a stored lobe of three channels, divided by the file's radiance scale.
    #[must_use]
    #[inline(always)]
    pub fn stored_brightness(stored: &[u8]) -> f32 {
        SharedExponent(read_u32(stored, 8)).largest()
    }

    /// Bytes of a stored lobe.
    #[must_use]
    #[inline(always)]
    pub const fn stored_bytes(channels: Channels) -> usize {
        match channels {
            Channels::Occlusion => 8,
            Channels::Rgb => 12,
        }
    }

    /// Appends the stored form but for the stencil, which the group has; `area` is the file's codec of areas, radiance is divided by
    /// `radiance_scale`.
    pub fn write(
        &self,
        channels: Channels,
        area: MiniFloat,
        radiance_scale: f32,
        out: &mut Vec<u8>,
    ) {
        let length = self.vector.length();
        let normal = if length > 0.0 { self.vector / length } else { Vec3::Z };
        let size = length + self.width;
        let height = (self.height.clamp(-1.0, 1.0) * 127.0).round() as i8;
        let direction = encode_octahedral24(normal).to_le_bytes();
        out.extend_from_slice(&[direction[0], direction[1], direction[2], height as u8]);
        let flag = u16::from(self.blocks_back) << 15;
        out.extend_from_slice(&(area.encode(size) | flag).to_le_bytes());
        let fill = (self.fill.clamp(0.0, 1.0) * FILL_STEPS).round() as u8;
        let loose = if self.is_loose { LOOSE_BIT } else { 0 };
        let width = (self.width / size.max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        out.extend_from_slice(&[(width * WIDTH_STEPS).round() as u8, fill | loose]);
        if channels == Channels::Rgb {
            let stored = SharedExponent::from_rgb(self.radiance.map(|c| c / radiance_scale));
            out.extend_from_slice(&stored.0.to_le_bytes());
        }
    }

    /// The direction of a vector area as a reader finds it.
    #[must_use]
    pub fn decoded_direction(vector: Vec3) -> Vec3 {
        decode_octahedral24(encode_octahedral24(vector.normalize_or(Vec3::Z)))
    }

    /// Reads the stored form at the start of `bytes`; the stencil is full.
    #[must_use]
    #[inline(always)]
    pub fn read(bytes: &[u8], channels: Channels, area: MiniFloat, radiance_scale: f32) -> Self {
        let place = read_u32(bytes, 0);
        let size_code = read_u16(bytes, 4);
        let size = area.decode(size_code);
        let width = size * f32::from(bytes[6]) * (1.0 / WIDTH_STEPS);
        Self {
            vector: decode_octahedral24(place) * (size - width),
            width,
            blocks_back: size_code & 0x8000 != 0,
            radiance: match channels {
                Channels::Occlusion => [0.0; 3],
                Channels::Rgb => {
                    SharedExponent(read_u32(bytes, 8)).to_rgb().map(|c| c * radiance_scale)
                }
            },
            height: (f32::from((place >> 24) as u8 as i8) * (1.0 / 127.0)).max(-1.0),
            fill: f32::from(bytes[7] & !LOOSE_BIT) * (1.0 / FILL_STEPS),
            is_loose: bytes[7] & LOOSE_BIT != 0,
            stencil: Stencil::FULL,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_lobe_is_a_clamped_cosine_and_round_one_is_constant() {
        let flat = Lobe { vector: Vec3::Z * 2.0, blocks_back: true, ..Lobe::default() };
        assert_eq!(flat.front_area(Vec3::Z), 2.0);
        assert_eq!(flat.front_area(Vec3::NEG_Z), 0.0);
        assert_eq!(flat.back_area(Vec3::NEG_Z), 2.0);
        let round = Lobe { width: 3.0, ..Lobe::default() };
        assert_eq!(round.front_area(Vec3::X), 1.5);
        assert_eq!(round.back_area(Vec3::X), 0.0);
    }

    #[test]
    fn loose_surfels_are_no_filled_plane() {
        let area = MiniFloat::covering(2.0);
        for (fill, is_loose, is_plane) in
            [(1.0, false, true), (0.955, false, true), (0.94, false, false), (1.0, true, false)]
        {
            let lobe = Lobe { vector: Vec3::Z, fill, is_loose, ..Lobe::default() };
            let mut bytes = Vec::new();
            lobe.write(Channels::Occlusion, area, 1.0, &mut bytes);
            assert_eq!(Lobe::is_filled_plane(&bytes), is_plane, "{fill} {is_loose}");
        }
    }

    #[test]
    fn stored_lobes_come_back() {
        let lobe = Lobe {
            vector: Vec3::new(0.3, -0.2, 0.9) * 0.04,
            width: 0.01,
            blocks_back: true,
            radiance: [10.0, 5.0, 1.0],
            height: -0.7,
            fill: 0.6,
            is_loose: true,
            stencil: Stencil::FULL,
        };
        let area = MiniFloat::covering(2.0);
        for channels in [Channels::Occlusion, Channels::Rgb] {
            let mut bytes = Vec::new();
            lobe.write(channels, area, 0.25, &mut bytes);
            assert_eq!(bytes.len(), Lobe::stored_bytes(channels));
            let back = Lobe::read(&bytes, channels, area, 0.25);
            assert!((back.vector - lobe.vector).length() < 0.05 * 4e-3);
            assert!((back.width - lobe.width).abs() < 0.05 * 2.1e-3);
            assert!((back.height - lobe.height).abs() < 4.1e-3);
            assert!((back.fill - lobe.fill).abs() < 4.1e-3);
            assert!(back.blocks_back && back.is_loose);
            if channels == Channels::Rgb {
                assert!((back.radiance[0] / 10.0 - 1.0).abs() < 2e-3);
            }
        }
    }
}
