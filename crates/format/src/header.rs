//! The file's header.

use crate::{
    FormatError, MiniFloat, PAGE_ENTRY_BYTES, PageId, SurfelLayout, read_f32, read_u32, read_u64,
};
use pbgi_math::{Aabb, DVec3, RootCube, Vec3};

/// First bytes of every octree file.
pub const MAGIC: [u8; 8] = *b"PBGITREE";

/// Version of the layout; readers accept this one only.
pub const FORMAT_VERSION: u32 = 7;

/// Bytes of the header.
pub const HEADER_BYTES: usize = 256;

/// Which light a file stores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Channels {
    /// None: surfels only block.
    Occlusion = 0,
    /// Linear Rec. 709 radiance.
    Rgb = 3,
}

impl Channels {
    /// Number of channels.
    #[must_use]
    pub const fn count(self) -> usize {
        self as usize
    }
}

/// What a file holds besides the minimum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HeaderFlags {
    /// Surfels have an albedo.
    pub albedo: bool,
    /// Some pages are LZ4-compressed.
    pub compressed: bool,
    /// Some surfels have no normal.
    pub isotropic: bool,
    /// +Z is up (LiDAR); +Y otherwise.
    pub z_up: bool,
}

impl HeaderFlags {
    fn to_bits(self) -> u32 {
        u32::from(self.albedo)
            | u32::from(self.compressed) << 1
            | u32::from(self.isotropic) << 2
            | u32::from(self.z_up) << 3
    }

    fn from_bits(bits: u32) -> Result<Self, FormatError> {
        if bits > 15 {
            return Err(FormatError::new("header: flags", bits, "0 to 15"));
        }
        Ok(Self {
            albedo: bits & 1 != 0,
            compressed: bits & 2 != 0,
            isotropic: bits & 4 != 0,
            z_up: bits & 8 != 0,
        })
    }
}

/// Largest coordinate of a file, relative to its origin, and largest size: the fourth power of such is a number still.
pub const COORDINATE_MAX: f32 = (1u64 << 31) as f32;

/// Largest scale of stored radiance: that of the largest number there is.
const RADIANCE_SCALE_MAX: f32 = 1.1e34;

/// Everything about the file that is not in a page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// Light channels.
    pub channels: Channels,
    /// Optional contents.
    pub flags: HeaderFlags,
    /// Surfels.
    pub surfel_count: u64,
    /// Nodes: children of all groups, leaves included.
    pub node_count: u64,
    /// Leaves.
    pub leaf_count: u64,
    /// Pages.
    pub page_count: u64,
    /// First byte of the page table.
    pub page_table_offset: u64,
    /// XXH3-64 of the page table.
    pub page_table_checksum: u64,
    /// Page of the root group.
    pub root_page: PageId,
    /// Byte offset of the root group in its page.
    pub root_offset: u32,
    /// Largest decoded page.
    pub page_bytes_max: u32,
    /// Most surfels of a leaf.
    pub leaf_surfels_max: u32,
    /// Most groups on a way from the root to a leaf.
    pub depth: u32,
    /// World position of the coordinate origin.
    pub origin: DVec3,
    /// The octree's cube.
    pub root: RootCube,
    /// Box of all area-true disks.
    pub bounds: Aabb,
    /// Codec of radii.
    pub radius_codec: MiniFloat,
    /// Codec of areas.
    pub area_codec: MiniFloat,
    /// Stored radiance is a multiple of this power of two.
    pub radiance_scale: f32,
    /// Median-like spacing of surfels: √(total area ÷ surfels).
    pub spacing: f32,
    /// Σ area over all surfels.
    pub area_total: f64,
    /// Σ area × radiance over all surfels.
    pub flux_total: [f64; 3],
}

impl Header {
    /// How this file's surfels and lobes are stored.
    #[must_use]
    pub fn surfel_layout(&self) -> SurfelLayout {
        SurfelLayout {
            channels: self.channels,
            albedo: self.flags.albedo,
            radius: self.radius_codec,
            area: self.area_codec,
            radiance_scale: self.radiance_scale,
        }
    }

    /// The stored form.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; HEADER_BYTES] {
        let mut out = Vec::with_capacity(HEADER_BYTES);
        out.extend_from_slice(&MAGIC);
        let u32s = |out: &mut Vec<u8>, values: &[u32]| {
            values.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
        };
        let f32s = |out: &mut Vec<u8>, values: &[f32]| {
            values.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
        };
        let f64s = |out: &mut Vec<u8>, values: &[f64]| {
            values.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
        };
        let flags = self.flags.to_bits();
        u32s(&mut out, &[FORMAT_VERSION, HEADER_BYTES as u32, self.channels as u32, flags]);
        for value in [
            self.surfel_count,
            self.node_count,
            self.leaf_count,
            self.page_count,
            self.page_table_offset,
            self.page_table_checksum,
        ] {
            out.extend_from_slice(&value.to_le_bytes());
        }
        u32s(&mut out, &[self.root_page.0, self.root_offset, self.page_bytes_max]);
        u32s(&mut out, &[self.leaf_surfels_max, self.depth]);
        u32s(
            &mut out,
            &[self.radius_codec.exponent_max as u32, self.area_codec.exponent_max as u32],
        );
        f32s(&mut out, &[self.radiance_scale]);
        f64s(&mut out, &self.origin.to_array());
        f32s(&mut out, &self.root.min.to_array());
        f32s(&mut out, &[self.root.edge]);
        f32s(&mut out, &self.bounds.min.to_array());
        f32s(&mut out, &self.bounds.max.to_array());
        f64s(&mut out, &[self.area_total]);
        f64s(&mut out, &self.flux_total);
        f32s(&mut out, &[self.spacing]);
        assert!(out.len() <= HEADER_BYTES - 8, "the header's fields fit");
        out.resize(HEADER_BYTES - 8, 0);
        let checksum = crate::page_checksum(&out);
        out.extend_from_slice(&checksum.to_le_bytes());
        out.try_into().expect("exactly the header's bytes")
    }

    /// Reads a header and checks every field against its range and against `file_bytes`.
    ///
    /// # Errors
    ///
    /// Names the first field that is wrong.
    pub fn from_bytes(bytes: &[u8; HEADER_BYTES], file_bytes: u64) -> Result<Self, FormatError> {
        if bytes[..8] != MAGIC {
            return Err(FormatError::new("header: magic", bytes[..8].escape_ascii(), "PBGITREE"));
        }
        let version = read_u32(bytes, 8);
        if version != FORMAT_VERSION {
            let cure = if version < FORMAT_VERSION {
                "the file is of an older program: bake it again"
            } else {
                "the file is of a newer program, which reads it"
            };
            let expected = format_args!("{FORMAT_VERSION} ({cure})");
            return Err(FormatError::new("header: version", version, expected));
        }
        let checksum = crate::page_checksum(&bytes[..HEADER_BYTES - 8]);
        let stored = read_u64(bytes, HEADER_BYTES - 8);
        if stored != checksum {
            return Err(FormatError::new(
                "header: checksum",
                format_args!("{stored:#018x}"),
                format_args!("{checksum:#018x}"),
            ));
        }
        let header = Self::parse(bytes)?;
        header.validate(file_bytes)?;
        Ok(header)
    }

    fn parse(bytes: &[u8; HEADER_BYTES]) -> Result<Self, FormatError> {
        if read_u32(bytes, 12) as usize != HEADER_BYTES {
            return Err(FormatError::new("header: bytes", read_u32(bytes, 12), HEADER_BYTES));
        }
        let channels = match read_u32(bytes, 16) {
            0 => Channels::Occlusion,
            3 => Channels::Rgb,
            other => return Err(FormatError::new("header: channels", other, "0 or 3")),
        };
        let f64_at = |at: usize| f64::from_bits(read_u64(bytes, at));
        let v = |at: usize| {
            Vec3::new(read_f32(bytes, at), read_f32(bytes, at + 4), read_f32(bytes, at + 8))
        };
        let reserved = &bytes[204..HEADER_BYTES - 8];
        if reserved.iter().any(|&b| b != 0) {
            return Err(FormatError::new("header: reserved", "non-zero bytes", 0));
        }
        Ok(Self {
            channels,
            flags: HeaderFlags::from_bits(read_u32(bytes, 20))?,
            surfel_count: read_u64(bytes, 24),
            node_count: read_u64(bytes, 32),
            leaf_count: read_u64(bytes, 40),
            page_count: read_u64(bytes, 48),
            page_table_offset: read_u64(bytes, 56),
            page_table_checksum: read_u64(bytes, 64),
            root_page: PageId(read_u32(bytes, 72)),
            root_offset: read_u32(bytes, 76),
            page_bytes_max: read_u32(bytes, 80),
            leaf_surfels_max: read_u32(bytes, 84),
            depth: read_u32(bytes, 88),
            radius_codec: MiniFloat { exponent_max: read_u32(bytes, 92) as i32 },
            area_codec: MiniFloat { exponent_max: read_u32(bytes, 96) as i32 },
            radiance_scale: read_f32(bytes, 100),
            origin: DVec3::new(f64_at(104), f64_at(112), f64_at(120)),
            root: RootCube { min: v(128), edge: read_f32(bytes, 140) },
            bounds: Aabb { min: v(144), max: v(156) },
            area_total: f64_at(168),
            flux_total: [f64_at(176), f64_at(184), f64_at(192)],
            spacing: read_f32(bytes, 200),
        })
    }

    fn validate(&self, file_bytes: u64) -> Result<(), FormatError> {
        let table_bytes = self.page_count.checked_mul(PAGE_ENTRY_BYTES as u64);
        let end = table_bytes.and_then(|b| b.checked_add(self.page_table_offset));
        if end != Some(file_bytes) {
            let found = end.map_or_else(|| "overflow".to_owned(), |e| e.to_string());
            return Err(FormatError::new("header: end of page table", found, file_bytes));
        }
        if u64::from(self.root_page.0) >= self.page_count {
            return Err(FormatError::new("header: root page", self.root_page, "an existing page"));
        }
        if self.surfel_count == 0 || self.leaf_count == 0 || self.leaf_count > self.node_count {
            return Err(FormatError::new("header: counts", self.leaf_count, "1 to the nodes"));
        }
        if !(1..=255).contains(&self.leaf_surfels_max) || self.depth == 0 || self.depth > 64 {
            return Err(FormatError::new("header: depth", self.depth, "1 to 64"));
        }
        let finite = self.origin.is_finite()
            && self.root.min.is_finite()
            && self.root.edge > 0.0
            && self.root.edge.is_finite()
            && self.bounds.min.is_finite()
            && self.bounds.max.is_finite()
            && !self.bounds.is_empty()
            && self.radiance_scale > 0.0
            && self.radiance_scale.is_finite()
            && self.spacing >= 0.0
            && self.area_total.is_finite()
            && self.flux_total.iter().all(|f| f.is_finite());
        if !finite || !self.radius_codec.is_valid() || !self.area_codec.is_valid() {
            return Err(FormatError::new("header: geometry", "a number out of range", "finite"));
        }
        let in_range = self.root.edge <= 2.1 * COORDINATE_MAX
            && [self.root.min, self.bounds.min, self.bounds.max]
                .iter()
                .all(|corner| corner.abs().max_element() <= COORDINATE_MAX)
            && self.radius_codec.limit() <= 2.0 * COORDINATE_MAX
            && self.area_codec.limit() <= 16.0 * COORDINATE_MAX * COORDINATE_MAX
            && self.radiance_scale <= RADIANCE_SCALE_MAX;
        if !in_range {
            let expected = format_args!("sizes within {COORDINATE_MAX}");
            return Err(FormatError::new("header: geometry", "a number out of range", expected));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Header {
        Header {
            channels: Channels::Rgb,
            flags: HeaderFlags { albedo: true, ..HeaderFlags::default() },
            surfel_count: 10,
            node_count: 4,
            leaf_count: 3,
            page_count: 2,
            page_table_offset: 12288,
            page_table_checksum: 99,
            root_page: PageId(1),
            root_offset: 32,
            page_bytes_max: 5000,
            leaf_surfels_max: 16,
            depth: 3,
            origin: DVec3::new(1e6, -2e6, 0.5),
            root: RootCube { min: Vec3::NEG_ONE, edge: 2.0 },
            bounds: Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE },
            radius_codec: MiniFloat { exponent_max: 3 },
            area_codec: MiniFloat { exponent_max: -7 },
            radiance_scale: 0.25,
            spacing: 0.01,
            area_total: 12.5,
            flux_total: [1.0, 2.0, 3.0],
        }
    }

    #[test]
    fn headers_round_trip() {
        let header = sample();
        assert_eq!(Header::from_bytes(&header.to_bytes(), 12288 + 64), Ok(header));
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let bytes = sample().to_bytes();
        for at in 0..HEADER_BYTES {
            for bit in 0..8 {
                let mut bad = bytes;
                bad[at] ^= 1 << bit;
                assert!(Header::from_bytes(&bad, 12288 + 64).is_err(), "byte {at} bit {bit}");
            }
        }
    }

    #[test]
    fn other_file_sizes_are_refused() {
        assert!(Header::from_bytes(&sample().to_bytes(), 12288 + 63).is_err());
        assert!(Header::from_bytes(&sample().to_bytes(), 12288 + 96).is_err());
    }
}
