//! The texels of a cube raster: what never changes for a resolution.

use pbgi_math::{CubeMap, CubeTexel, Vec3};

/// Texels that are convolved together; rows are padded to no fewer.
pub const LANES: usize = 8;

/// Texels of a row in memory, of `n` that are used.
#[must_use]
pub const fn row_stride(n: usize) -> usize {
    let power = n.next_power_of_two();
    if power > LANES { power } else { LANES }
}

/// Geometry of the texels, in padded rows.
#[derive(Clone, Debug)]
pub struct CubeRasterTable {
    map: CubeMap,
    stride: usize,
    texels: Vec<CubeTexel>,
}

impl CubeRasterTable {
    /// Table for `n × n` texels per face.
    ///
    /// # Panics
    ///
    /// If `n` is not in 1..=64.
    #[must_use]
    pub fn new(n: usize) -> Self {
        assert!((1..=64).contains(&n), "1 to 64 texels along a face");
        let map = CubeMap::new(n);
        let stride = row_stride(n);
        let outside = CubeTexel { direction: Vec3::Z, solid_angle_sr: 0.0, vector: Vec3::ZERO };
        let mut texels = vec![outside; 6 * n * stride];
        for index in 0..map.texel_count() {
            texels[index / n * stride + index % n] = map.texel(index);
        }
        Self { map, stride, texels }
    }

    /// Texels along a face.
    #[must_use]
    #[inline(always)]
    pub fn edge(&self) -> usize {
        self.map.edge()
    }

    /// Texels of a row in memory: a power of two, no less than `edge` and [`LANES`].
    #[must_use]
    #[inline(always)]
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Texels in memory, row by row, face by face; those beyond the edge have no solid angle.
    #[must_use]
    #[inline(always)]
    pub fn texels(&self) -> &[CubeTexel] {
        &self.texels
    }

    /// Brings values of the texels of a [`CubeMap`] of this resolution into padded rows.
    ///
    /// # Panics
    ///
    /// If there is not one value per texel.
    #[must_use]
    pub fn pad<T: Copy + Default>(&self, values: &[T]) -> Vec<T> {
        let n = self.edge();
        assert_eq!(values.len(), self.map.texel_count(), "one value per texel");
        let mut padded = vec![T::default(); self.texels.len()];
        for (row, values) in values.chunks_exact(n).enumerate() {
            padded[row * self.stride..][..n].copy_from_slice(values);
        }
        padded
    }

    /// Index in memory of the texel a direction falls into.
    #[must_use]
    pub fn texel_index(&self, direction: Vec3) -> usize {
        let (n, index) = (self.edge(), self.map.texel_index(direction));
        index / n * self.stride + index % n
    }
}
