//! A surfel as a leaf stores it.

use crate::{Channels, MiniFloat, read_u16, read_u32};
use pbgi_math::{Aabb, SharedExponent, TileCode, Vec3, decode_octahedral24, encode_octahedral24};

/// A decoded surfel of a leaf.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeafSurfel {
    /// Center relative to the file's origin.
    pub center: Vec3,
    /// Unit normal; meaningless when isotropic.
    pub normal: Vec3,
    /// Radius of the covering disk; half the diagonal of a rectangle.
    pub radius: f32,
    /// True area.
    pub area: f32,
    /// Direction of the long edge of the rectangle the surfel stands for, if one is known.
    pub tile: TileCode,
    /// Half the long edge; 0 where no rectangle is known.
    pub half_long: f32,
    /// Radiance of the front, W·m⁻²·sr⁻¹.
    pub radiance: [f32; 3],
    /// Diffuse albedo, 0 where the file stores none.
    pub albedo: [f32; 3],
    /// Shows half its area to every direction.
    pub isotropic: bool,
    /// Blocks and shines on its front only.
    pub front_only: bool,
}

/// How the surfels of one file are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfelLayout {
    /// Light channels.
    pub channels: Channels,
    /// Whether albedo is stored.
    pub albedo: bool,
    /// Codec of radii.
    pub radius: MiniFloat,
    /// Codec of areas, of surfels and lobes alike.
    pub area: MiniFloat,
    /// Stored radiance is a multiple of this.
    pub radiance_scale: f32,
}

impl LeafSurfel {
    /// Half the long and half the short edge of a known rectangle.
    #[must_use]
    #[inline(always)]
    pub fn half_edges(&self) -> [f32; 2] {
        [self.half_long, 0.25 * self.area / self.half_long]
    }
}

impl SurfelLayout {
    /// Bytes of a stored surfel.
    #[must_use]
    #[inline(always)]
    pub const fn stored_bytes(&self) -> usize {
        14 + match self.channels {
            Channels::Occlusion => 0,
            Channels::Rgb => 4,
        } + if self.albedo { 4 } else { 0 }
    }

    /// Appends the stored form of `surfel`, its center quantized to 16 bits per axis in `parent`, the box of its leaf's
    /// group.
    pub fn write(&self, surfel: &LeafSurfel, parent: &Aabb, out: &mut Vec<u8>) {
        let extent = parent.extent();
        for axis in 0..3 {
            let fraction = if extent[axis] > 0.0 {
                (surfel.center[axis] - parent.min[axis]) / extent[axis]
            } else {
                0.0
            };
            let code = (fraction * 65535.0).round().clamp(0.0, 65535.0) as u16;
            out.extend_from_slice(&code.to_le_bytes());
        }
        let is_tile = surfel.tile.is_known() && !surfel.isotropic;
        let tile = if is_tile { u32::from(surfel.tile.0) << 24 } else { 0 };
        let size = if is_tile { surfel.half_long } else { surfel.radius };
        out.extend_from_slice(&(encode_octahedral24(surfel.normal) | tile).to_le_bytes());
        let isotropic = u16::from(surfel.isotropic) << 15;
        let front_only = u16::from(surfel.front_only) << 15;
        out.extend_from_slice(&(self.radius.encode(size) | isotropic).to_le_bytes());
        out.extend_from_slice(&(self.area.encode(surfel.area) | front_only).to_le_bytes());
        if self.channels == Channels::Rgb {
            let scale = self.radiance_scale;
            let stored = SharedExponent::from_rgb(surfel.radiance.map(|c| c / scale));
            out.extend_from_slice(&stored.0.to_le_bytes());
        }
        if self.albedo {
            out.extend_from_slice(&SharedExponent::from_rgb(surfel.albedo).0.to_le_bytes());
        }
    }

    /// Reads the stored form at the start of `bytes`; `parent` as in [`SurfelLayout::write`].
    #[must_use]
    #[inline(always)]
    pub fn read(&self, bytes: &[u8], parent: &Aabb) -> LeafSurfel {
        let step = parent.extent() * (1.0 / 65535.0);
        let cell = Vec3::new(
            f32::from(read_u16(bytes, 0)),
            f32::from(read_u16(bytes, 2)),
            f32::from(read_u16(bytes, 4)),
        );
        let orientation = read_u32(bytes, 6);
        let size_code = read_u16(bytes, 10);
        let area_code = read_u16(bytes, 12);
        let (size, area) = (self.radius.decode(size_code), self.area.decode(area_code));
        let isotropic = size_code & 0x8000 != 0;
        let tile = if isotropic { TileCode::NONE } else { TileCode((orientation >> 24) as u8) };
        let (mut radius, mut half_long) = (size, 0.0);
        if tile.is_known() {
            let half_short = 0.25 * area / size;
            (radius, half_long) = ((size * size + half_short * half_short).sqrt(), size);
        }
        let mut at = 14;
        let mut radiance = [0.0; 3];
        if self.channels == Channels::Rgb {
            let scale = self.radiance_scale;
            radiance = SharedExponent(read_u32(bytes, at)).to_rgb().map(|c| c * scale);
            at += 4;
        }
        let albedo =
            if self.albedo { SharedExponent(read_u32(bytes, at)).to_rgb() } else { [0.0; 3] };
        LeafSurfel {
            center: parent.min + cell * step,
            normal: decode_octahedral24(orientation),
            radius,
            area,
            tile,
            half_long,
            radiance,
            albedo,
            isotropic,
            front_only: area_code & 0x8000 != 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_surfels_come_back() {
        let surfel = LeafSurfel {
            center: Vec3::new(1.2, -0.3, 7.5),
            normal: Vec3::new(0.1, 0.9, -0.2).normalize(),
            radius: 0.013,
            area: 0.0004,
            tile: TileCode::NONE,
            half_long: 0.0,
            radiance: [3.0, 2.0, 0.5],
            albedo: [0.7, 0.1, 0.02],
            isotropic: false,
            front_only: true,
        };
        let parent = Aabb { min: Vec3::new(1.0, -0.5, 7.25), max: Vec3::new(1.5, 0.0, 7.75) };
        for (channels, albedo) in [
            (Channels::Occlusion, false),
            (Channels::Occlusion, true),
            (Channels::Rgb, false),
            (Channels::Rgb, true),
        ] {
            let layout = SurfelLayout {
                channels,
                albedo,
                radius: MiniFloat::covering(1.0),
                area: MiniFloat::covering(1.0),
                radiance_scale: 0.5,
            };
            let mut bytes = Vec::new();
            layout.write(&surfel, &parent, &mut bytes);
            assert_eq!(bytes.len(), layout.stored_bytes());
            let back = layout.read(&bytes, &parent);
            assert!((back.center - surfel.center).abs().max_element() < 0.5 / 65535.0);
            assert!(back.normal.dot(surfel.normal) > 0.999_999);
            assert!((back.radius / surfel.radius - 1.0).abs() < 1e-3);
            assert!((back.area / surfel.area - 1.0).abs() < 1e-3);
            assert!(back.front_only && !back.isotropic);
            assert_eq!(back.radiance[0] > 0.0, channels == Channels::Rgb);
            assert_eq!(back.albedo[0] > 0.0, albedo);
        }
    }
    #[test]
    fn stored_rectangles_come_back() {
        let layout = SurfelLayout {
            channels: Channels::Occlusion,
            albedo: false,
            radius: MiniFloat::covering(1.0),
            area: MiniFloat::covering(1.0),
            radiance_scale: 1.0,
        };
        let parent = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        for (aspect, code) in [(1.0f32, 1), (1.3, 128), (7.0, 255)] {
            let area = 0.0004f32;
            let half_long = 0.5 * (area * aspect).sqrt();
            let surfel = LeafSurfel {
                normal: Vec3::new(0.1, 0.9, -0.2).normalize(),
                area,
                radius: 0.5 * (area * (aspect + 1.0 / aspect)).sqrt(),
                tile: TileCode(code),
                half_long,
                ..LeafSurfel::default()
            };
            let mut bytes = Vec::new();
            layout.write(&surfel, &parent, &mut bytes);
            assert_eq!(bytes.len(), layout.stored_bytes());
            let back = layout.read(&bytes, &parent);
            assert_eq!(back.tile, surfel.tile);
            let [long, short] = back.half_edges();
            // Rounding of one code, or of two.
            assert!((long / half_long - 1.0).abs() < 1e-3);
            assert!((short / (half_long / aspect) - 1.0).abs() < 2.1e-3);
            assert!((back.radius / surfel.radius - 1.0).abs() < 2.1e-3);
            let round = LeafSurfel { isotropic: true, ..surfel };
            bytes.clear();
            layout.write(&round, &parent, &mut bytes);
            let back = layout.read(&bytes, &parent);
            assert_eq!((back.tile, back.half_long), (TileCode::NONE, 0.0));
            assert!((back.radius / surfel.radius - 1.0).abs() < 1e-3);
        }
    }
}
