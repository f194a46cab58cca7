//! Textures and their filtered lookup.

use pbgi_math::Vec2;
use rayon::prelude::*;
use std::sync::{LazyLock, OnceLock};

/// Linear value of each sRGB byte (IEC 61966-2-1).
static SRGB_TO_LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| display_to_linear(i as f32 / 255.0)));

/// Linear value of each linear byte.
static BYTE_TO_LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| i as f32 / 255.0));

/// Linear value of an sRGB code from 0 to 1.
#[must_use]
pub fn display_to_linear(code: f32) -> f32 {
    if code <= 0.040_45 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) }
}

/// Linear value of an sRGB-encoded byte.
#[must_use]
pub fn srgb_to_linear(byte: u8) -> f32 {
    SRGB_TO_LINEAR[usize::from(byte)]
}

/// Nearest sRGB byte of a linear value.
fn linear_to_srgb(linear: f32) -> u8 {
    let c = linear.clamp(0.0, 1.0);
    let encoded = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0 + 0.5) as u8
}

/// What lies beyond the edges of a texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The texture again.
    #[default]
    Repeat,
    /// Its edge.
    Clamp,
    /// Its mirror image, and so on in turns.
    Mirror,
}

/// A texture: linear RGB and alpha in 0..=1, row 0 at the top, repeated in both directions unless it is told to do otherwise
/// ([`Texture::with_wrap`]).
///
/// Colors are averaged with their alpha as weight, so that what is cut away does not bleed into
/// what is left. A pyramid of half-size levels (box filter on linear values, stored in bytes like
/// the texels) is made at the first filtered lookup and adds a third to the memory.
#[derive(Clone, Debug, Default)]
pub struct Texture {
    base: Level,
    srgb: bool,
    /// Along rows, and along columns.
    wrap: [Wrap; 2],
    pyramid: OnceLock<Vec<Level>>,
    alpha_peaks: OnceLock<Vec<AlphaPeaks>>,
}

/// The largest alpha of each square of texels.
#[derive(Clone, Debug)]
struct AlphaPeaks {
    width: usize,
    peaks: Vec<u8>,
}

/// One level of the pyramid.
#[derive(Clone, Debug, Default)]
struct Level {
    width: u32,
    height: u32,
    texels: Vec<[u8; 4]>,
}

impl Texture {
    /// A texture of RGBA bytes in rows from the top; color bytes are sRGB-encoded if `srgb`, alpha
    /// is always linear. `None` if an edge is 0 or the texel count is not `width · height`.
    #[must_use]
    pub fn new(width: u32, height: u32, texels: Vec<[u8; 4]>, srgb: bool) -> Option<Self> {
        let count = usize::try_from(u64::from(width) * u64::from(height)).ok()?;
        if count == 0 || texels.len() != count {
            return None;
        }
        let base = Level { width, height, texels };
        let (pyramid, alpha_peaks) = (OnceLock::new(), OnceLock::new());
        Some(Self { base, srgb, wrap: [Wrap::Repeat; 2], pyramid, alpha_peaks })
    }

    /// The texture with other edges: along rows (u), and along columns (v).
    #[must_use]
    pub fn with_wrap(self, wrap: [Wrap; 2]) -> Self {
        Self { wrap, ..self }
    }

    /// Texels along a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.base.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.base.height
    }

    /// RGBA bytes in rows from the top, as given to [`Texture::new`].
    #[must_use]
    pub fn texels(&self) -> &[[u8; 4]] {
        &self.base.texels
    }

    /// Smallest alpha of all texels.
    #[must_use]
    pub fn alpha_min(&self) -> f32 {
        self.base.texels.iter().map(|t| t[3]).min().map_or(1.0, |a| f32::from(a) / 255.0)
    }

    /// Largest alpha of all texels.
    #[must_use]
    pub fn alpha_max(&self) -> f32 {
        self.base.texels.iter().map(|t| t[3]).max().map_or(1.0, |a| f32::from(a) / 255.0)
    }

    /// Linear color and alpha at `uv`, bilinear between texel centers. (0, 0) is the top left corner
    /// of the image, (1, 1) its bottom right corner.
    #[must_use]
    pub fn sample(&self, uv: Vec2) -> [f32; 4] {
        self.base.sample(uv, self.wrap, self.decoder())
    }

    /// Alpha alone of [`Texture::sample`].
    #[must_use]
    pub fn sample_alpha(&self, uv: Vec2) -> f32 {
        self.base.sample_alpha(uv, self.wrap)
    }

    /// Linear color and alpha at `uv` averaged over about `texel_footprint` × `texel_footprint`
    /// texels: trilinear in the pyramid. A footprint up to 1 is [`Texture::sample`].
    #[must_use]
    pub fn sample_level(&self, uv: Vec2, texel_footprint: f32) -> [f32; 4] {
        let level = texel_footprint.log2();
        if level.is_nan() || level <= 0.0 {
            return self.sample(uv);
        }
        let pyramid = self.pyramid();
        let level = level.min(pyramid.len() as f32);
        let (below, fraction) = (level as usize, level.fract());
        let finer = self.level(pyramid, below).sample(uv, self.wrap, self.decoder());
        if fraction == 0.0 {
            return finer;
        }
        let coarser = self.level(pyramid, below + 1).sample(uv, self.wrap, self.decoder());
        std::array::from_fn(|c| finer[c] + (coarser[c] - finer[c]) * fraction)
    }

    /// No smaller than any alpha of [`Texture::sample_alpha`] between two corners, and hardly larger. The first call makes a
    /// pyramid of a third of a byte per texel.
    #[must_use]
    pub fn alpha_max_within(&self, min: Vec2, max: Vec2) -> f32 {
        let columns = texel_range([min.x, max.x], self.base.width, self.wrap[0]);
        let rows = texel_range([min.y, max.y], self.base.height, self.wrap[1]);
        let levels = self.alpha_peaks();
        // The level at which a range has a few squares.
        let longest = columns.iter().chain(&rows).map(|r| r[1] - r[0]).max().unwrap_or(0);
        let level = (longest / 4 + 1).ilog2() as usize;
        let level = level.min(levels.len());
        let mut peak = 0;
        for [top, bottom] in rows {
            for [left, right] in &columns {
                for y in top >> level..=bottom >> level {
                    for x in left >> level..=right >> level {
                        peak = peak.max(match level.checked_sub(1).map(|k| &levels[k]) {
                            Some(AlphaPeaks { width, peaks }) => peaks[y * width + x],
                            None => self.base.texels[y * self.base.width as usize + x][3],
                        });
                    }
                }
            }
        }
        f32::from(peak) / 255.0
    }

    /// Largest alphas of squares of 2, 4, 8 … texels.
    fn alpha_peaks(&self) -> &[AlphaPeaks] {
        self.alpha_peaks.get_or_init(|| {
            let (mut width, mut height) = (self.base.width as usize, self.base.height as usize);
            let mut finest: Vec<u8> = self.base.texels.iter().map(|texel| texel[3]).collect();
            let mut levels = Vec::new();
            while width > 1 || height > 1 {
                let (columns, rows) = (width.div_ceil(2), height.div_ceil(2));
                let peak = |i: usize| {
                    let (x, y) = (i % columns * 2, i / columns * 2);
                    let right = (x + 1).min(width - 1);
                    let bottom = (y + 1).min(height - 1);
                    let at = |x: usize, y: usize| finest[y * width + x];
                    at(x, y).max(at(right, y)).max(at(x, bottom)).max(at(right, bottom))
                };
                let peaks: Vec<u8> = (0..columns * rows).map(peak).collect();
                levels.push(AlphaPeaks { width: columns, peaks: peaks.clone() });
                (finest, width, height) = (peaks, columns, rows);
            }
            levels
        })
    }

    fn level<'a>(&'a self, pyramid: &'a [Level], index: usize) -> &'a Level {
        if index == 0 { &self.base } else { &pyramid[(index - 1).min(pyramid.len() - 1)] }
    }

    fn decoder(&self) -> &'static [f32; 256] {
        if self.srgb { &SRGB_TO_LINEAR } else { &BYTE_TO_LINEAR }
    }

    fn pyramid(&self) -> &[Level] {
        self.pyramid.get_or_init(|| {
            let mut levels = Vec::new();
            if self.base.width == 1 && self.base.height == 1 {
                return levels;
            }
            let mut finest = self.base.halved(self.decoder());
            levels.push(finest.to_level(self.srgb));
            while finest.width > 1 || finest.height > 1 {
                finest = finest.halved();
                levels.push(finest.to_level(self.srgb));
            }
            levels
        })
    }
}

impl Level {
    fn sample(&self, uv: Vec2, wrap: [Wrap; 2], decoder: &[f32; 256]) -> [f32; 4] {
        let mut weighted = [0.0; 3];
        let mut plain = [0.0; 3];
        let mut alpha = 0.0;
        for (index, weight) in self.taps(uv, wrap) {
            let Some(texel) = self.texels.get(index) else { continue };
            let opacity = weight * f32::from(texel[3]) * (1.0 / 255.0);
            alpha += opacity;
            for c in 0..3 {
                let value = decoder[usize::from(texel[c])];
                weighted[c] += value * opacity;
                plain[c] += value * weight;
            }
        }
        let [r, g, b] = if alpha > 0.0 { weighted.map(|v| v / alpha) } else { plain };
        [r, g, b, alpha]
    }

    fn sample_alpha(&self, uv: Vec2, wrap: [Wrap; 2]) -> f32 {
        let texel_alpha = |index: usize| self.texels.get(index).map_or(255, |t| t[3]);
        self.taps(uv, wrap)
            .iter()
            .map(|&(i, weight)| weight * f32::from(texel_alpha(i)) / 255.0)
            .sum()
    }

    /// The four texels around `uv` and their bilinear weights.
    fn taps(&self, uv: Vec2, [along_u, along_v]: [Wrap; 2]) -> [(usize, f32); 4] {
        let [x0, x1, fx] = find_texels(uv.x, self.width, along_u);
        let [y0, y1, fy] = find_texels(uv.y, self.height, along_v);
        let at = |x: f32, y: f32| y as usize * self.width as usize + x as usize;
        [
            (at(x0, y0), (1.0 - fx) * (1.0 - fy)),
            (at(x1, y0), fx * (1.0 - fy)),
            (at(x0, y1), (1.0 - fx) * fy),
            (at(x1, y1), fx * fy),
        ]
    }

    /// The level above, decoded texel by texel: as floats this one would take four times its bytes.
    fn halved(&self, decoder: &[f32; 256]) -> LinearLevel {
        halve([self.width, self.height], |index| {
            let [r, g, b, a] = self.texels[index];
            let color = [r, g, b].map(|c| decoder[usize::from(c)]);
            [color[0], color[1], color[2], f32::from(a) / 255.0]
        })
    }
}

/// Neighboring texels `[first, second, fraction]` of a coordinate on an axis of `size` texels.
fn find_texels(coordinate: f32, size: u32, wrap: Wrap) -> [f32; 3] {
    let size = size as f32;
    let unit = match wrap {
        Wrap::Repeat => coordinate - coordinate.floor(),
        Wrap::Clamp => coordinate.clamp(0.0, 1.0),
        // There and back again takes 2.
        Wrap::Mirror => 1.0 - (coordinate - 2.0 * (coordinate * 0.5).floor() - 1.0).abs(),
    };
    let position = if unit.is_finite() { unit * size - 0.5 } else { 0.0 };
    let first = position.floor();
    let fraction = position - first;
    let into = |x: f32| match wrap {
        Wrap::Repeat if x < 0.0 => x + size,
        Wrap::Repeat if x >= size => x - size,
        _ => x.clamp(0.0, size - 1.0),
    };
    [into(first), into(first + 1.0), fraction]
}

/// First and last texels that coordinates from one to another can reach on an axis of `size` texels; two ranges where these go
/// over the edge.
fn texel_range([from, to]: [f32; 2], size: u32, wrap: Wrap) -> Vec<[usize; 2]> {
    let last = i64::from(size) - 1;
    let whole = vec![[0, last as usize]];
    let (from, to) = (f64::from(from) * f64::from(size), f64::from(to) * f64::from(size));
    if !(from <= to && from.abs() < 1e12 && to.abs() < 1e12) {
        return whole;
    }
    // A texel more to each side: lookups round.
    let (first, end) = ((from - 1.5).floor() as i64, (to + 1.5).floor() as i64);
    if end - first >= last {
        return whole;
    }
    let inside = |texel: i64| texel.clamp(0, last) as usize;
    match wrap {
        _ if first >= 0 && end <= last => vec![[first as usize, end as usize]],
        Wrap::Clamp => vec![[inside(first), inside(end)]],
        Wrap::Mirror => whole,
        Wrap::Repeat => {
            let size = i64::from(size);
            let (first, end) = (first.rem_euclid(size), end.rem_euclid(size));
            match first <= end {
                true => vec![[first as usize, end as usize]],
                false => vec![[first as usize, last as usize], [0, end as usize]],
            }
        }
    }
}

/// A level while the pyramid is made: linear color, alpha.
struct LinearLevel {
    width: u32,
    height: u32,
    texels: Vec<[f32; 4]>,
}

impl LinearLevel {
    fn halved(&self) -> Self {
        halve([self.width, self.height], |index| self.texels[index])
    }

    fn to_level(&self, srgb: bool) -> Level {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let color = |v: f32| if srgb { linear_to_srgb(v) } else { byte(v) };
        let encode = |t: &[f32; 4]| [color(t[0]), color(t[1]), color(t[2]), byte(t[3])];
        let texels = self.texels.par_iter().map(encode).collect();
        Level { width: self.width, height: self.height, texels }
    }
}

/// The level above one of this size: each texel is the exact box average of what it covers, also of odd sizes.
fn halve(
    [fine_width, fine_height]: [u32; 2],
    texel: impl Fn(usize) -> [f32; 4] + Sync,
) -> LinearLevel {
    let (width, height) = ((fine_width / 2).max(1), (fine_height / 2).max(1));
    let average = |i: usize| {
        let (x, y) = (i as u32 % width, i as u32 / width);
        let (columns, rows) = (box_taps(x, fine_width, width), box_taps(y, fine_height, height));
        box_average(columns, rows, |x, y| texel(y as usize * fine_width as usize + x as usize))
    };
    let texels = (0..width as usize * height as usize).into_par_iter().map(average).collect();
    LinearLevel { width, height, texels }
}

fn box_average(
    columns: [(u32, f32); 3],
    rows: [(u32, f32); 3],
    texel: impl Fn(u32, u32) -> [f32; 4],
) -> [f32; 4] {
    let mut weighted = [0.0; 3];
    let mut plain = [0.0; 3];
    let mut alpha = 0.0;
    for (y, wy) in rows {
        for (x, wx) in columns {
            let texel = texel(x, y);
            let weight = wx * wy;
            alpha += weight * texel[3];
            for c in 0..3 {
                weighted[c] += weight * texel[3] * texel[c];
                plain[c] += weight * texel[c];
            }
        }
    }
    let [r, g, b] = if alpha > 0.0 { weighted.map(|v| v / alpha) } else { plain };
    [r, g, b, alpha]
}

/// The up to three texels of a `fine` axis that texel `index` of a `coarse` axis covers, and their
/// shares. Unused taps have weight 0.
fn box_taps(index: u32, fine: u32, coarse: u32) -> [(u32, f32); 3] {
    let scale = f64::from(fine) / f64::from(coarse);
    let (start, end) = (f64::from(index) * scale, f64::from(index + 1) * scale);
    let first = start as u32;
    std::array::from_fn(|k| {
        let texel = first + k as u32;
        let covered = end.min(f64::from(texel) + 1.0) - start.max(f64::from(texel));
        (texel.min(fine - 1), (covered.max(0.0) / scale) as f32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkers(width: u32, height: u32) -> Texture {
        let texels = (0..width * height)
            .map(|i| {
                let byte = if (i % width + i / width).is_multiple_of(2) { 255 } else { 0 };
                [byte, byte, byte, 255]
            })
            .collect();
        Texture::new(width, height, texels, true).unwrap()
    }

    #[test]
    fn texel_centers_give_texels_back() {
        let texels = (0..12u8).map(|i| [i * 20, 255 - i, i, 100 + i]).collect::<Vec<_>>();
        let texture = Texture::new(4, 3, texels.clone(), true).unwrap();
        for (i, texel) in texels.iter().enumerate() {
            let uv = Vec2::new((i % 4) as f32 + 0.5 + 8.0, (i / 4) as f32 + 0.5 - 6.0);
            let sample = texture.sample(uv / Vec2::new(4.0, 3.0));
            for c in 0..3 {
                assert!((sample[c] - srgb_to_linear(texel[c])).abs() < 1e-3);
            }
            assert!((sample[3] - f32::from(texel[3]) / 255.0).abs() < 1e-3);
        }
    }

    #[test]
    fn sampling_wraps_across_both_edges() {
        let texels = vec![[0, 0, 0, 255], [255, 255, 255, 255]];
        let texture = Texture::new(2, 1, texels, false).unwrap();
        for u in [0.0, 1.0, -3.0, 0.5] {
            assert!((texture.sample(Vec2::new(u, 0.3))[0] - 0.5).abs() < 1e-5, "{u}");
        }
        assert!(texture.sample(Vec2::new(f32::NAN, f32::INFINITY))[0].is_finite());
        assert!(texture.sample(Vec2::new(-1e-9, 1.0 - 1e-8))[0].is_finite());
    }

    #[test]
    fn clamped_and_mirrored_textures_keep_their_edges_apart() {
        let texels = vec![[0, 0, 0, 255], [0, 0, 0, 255], [255, 255, 255, 255], [255; 4]];
        let texture = |wrap| {
            Texture::new(4, 1, texels.clone(), false).unwrap().with_wrap([wrap, Wrap::Clamp])
        };
        let sample = |texture: &Texture, u: f32| texture.sample(Vec2::new(u, 7.5))[0];
        let (clamped, mirrored) = (texture(Wrap::Clamp), texture(Wrap::Mirror));
        for (u, at_clamped, at_mirrored) in [
            (0.0, 0.0, 0.0),
            (1.0, 1.0, 1.0),
            (1.2, 1.0, 1.0),
            (1.9, 1.0, 0.0),
            (-0.2, 0.0, 0.0),
            (-0.9, 0.0, 1.0),
            (2.1, 1.0, 0.0),
            (-1e20, 0.0, 0.0),
        ] {
            assert!((sample(&clamped, u) - at_clamped).abs() < 1e-5, "{u}");
            assert!((sample(&mirrored, u) - at_mirrored).abs() < 1e-5, "{u}");
            let wide = clamped.sample_level(Vec2::new(u, 0.0), 1.5)[0];
            assert!((wide - at_clamped).abs() < 1e-2, "{u}: {wide}");
        }
        for texture in [clamped, mirrored] {
            assert!(sample(&texture, f32::NAN).is_finite());
            assert!(sample(&texture, f32::NEG_INFINITY).is_finite());
        }
    }

    #[test]
    fn no_alpha_is_above_the_largest_within() {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let (mut tight, mut total) = (0, 0);
        for (width, height) in [(1, 1), (2, 3), (33, 17), (64, 128)] {
            let texels = (0..width * height)
                .map(|_| [0, 0, 0, if next() > 0.97 { (next() * 255.0) as u8 } else { 0 }])
                .collect();
            let texture = Texture::new(width, height, texels, true).unwrap();
            for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
                let texture = texture.clone().with_wrap([wrap, Wrap::Repeat]);
                for _ in 0..200 {
                    let min = Vec2::new(next() * 4.0 - 2.0, next() * 4.0 - 2.0);
                    let size = Vec2::new(next(), next()) * if next() > 0.5 { 0.1 } else { 1.2 };
                    let bound = texture.alpha_max_within(min, min + size);
                    for _ in 0..30 {
                        let at = min + size * Vec2::new(next(), next());
                        assert!(texture.sample_alpha(at) <= bound + 1e-6, "{wrap:?} {at}");
                    }
                    (tight, total) = (tight + u32::from(bound == 0.0), total + 1);
                }
            }
        }
        // It tells of holes, too.
        assert!(tight * 10 > total, "{tight} of {total}");
        let texture = Texture::new(1, 1, vec![[0; 4]], true).unwrap();
        assert_eq!(texture.alpha_max_within(Vec2::NAN, Vec2::INFINITY), 0.0);
    }

    #[test]
    fn srgb_bytes_round_trip() {
        for byte in 0..=255u8 {
            assert_eq!(linear_to_srgb(srgb_to_linear(byte)), byte);
        }
        assert!((srgb_to_linear(188) - 0.502_886).abs() < 1e-4);
    }

    #[test]
    fn pyramid_averages_linear_values() {
        for (width, height) in [(64, 64), (33, 17), (7, 1), (1, 9)] {
            let texture = checkers(width, height);
            let mean = texture.texels().iter().map(|t| f32::from(t[0]) / 255.0).sum::<f32>()
                / (width * height) as f32;
            let top = texture.sample_level(Vec2::new(0.3, 0.7), 1e9);
            assert!((top[0] - mean).abs() < 0.02, "{width} x {height}: {} {mean}", top[0]);
        }
    }

    #[test]
    fn filtered_lookup_is_continuous_in_the_footprint() {
        let texture = checkers(64, 64);
        let mut previous = texture.sample_level(Vec2::new(0.507, 0.508), 1.0)[0];
        for i in 1..800 {
            let footprint = 2f32.powf(i as f32 * 0.01);
            let value = texture.sample_level(Vec2::new(0.507, 0.508), footprint)[0];
            assert!((value - previous).abs() < 0.02, "{footprint}");
            previous = value;
        }
    }

    #[test]
    fn transparent_texels_do_not_bleed() {
        let texels = vec![[255, 0, 0, 255], [0, 0, 0, 0], [0, 0, 0, 0], [255, 0, 0, 255]];
        let texture = Texture::new(2, 2, texels, true).unwrap();
        for sample in [
            texture.sample(Vec2::splat(0.5)),
            texture.sample_level(Vec2::splat(0.1), 2.0),
            texture.sample_level(Vec2::splat(0.4), 64.0),
        ] {
            assert!((sample[0] - 1.0).abs() < 1e-3 && (sample[3] - 0.5).abs() < 0.3, "{sample:?}");
        }
        assert!((texture.sample_alpha(Vec2::splat(0.5)) - 0.5).abs() < 1e-5);
        assert_eq!(texture.alpha_min(), 0.0);
    }

    #[test]
    fn wrong_sizes_are_refused() {
        assert!(Texture::new(0, 4, vec![], true).is_none());
        assert!(Texture::new(2, 2, vec![[0; 4]; 3], true).is_none());
        assert!(Texture::new(u32::MAX, u32::MAX, vec![[0; 4]; 3], true).is_none());
    }
}
