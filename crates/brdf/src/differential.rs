//! How what a diffuse receiver gathers changes when it moves and turns, from one raster.

use crate::diffuse::EnvironmentTexels;
use pbgi_math::{CubeFace, CubeTexel, Vec3, larger};
use pbgi_raster::{CubeRaster, CubeRasterTable, LANES, Lanes};
use std::f32::consts::PI;

/// Quantities that are differentiated: irradiance from surfaces and from the environment, three channels each, ambient occlusion and sky
/// visibility.
pub const QUANTITIES: usize = 8;

/// Of the quantities, those that are light.
pub const LIGHT: std::ops::Range<usize> = 0..6;

/// Index of ambient occlusion.
pub const OCCLUSION: usize = 6;

/// Index of sky visibility.
pub const SKY: usize = 7;

/// Share of what is around that comes nearer when a receiver moves any way: what lies behind it recedes.
const APPROACHED: f32 = 0.5;

/// Share of the distance to a thing at which it is near enough for anything: what looms is not followed farther.
const NEARNESS_MIN: f32 = 0.05;

/// The border between two texels.
#[derive(Clone, Copy, Debug)]
struct Border {
    texels: [u32; 2],
    /// Unit direction of its middle.
    middle: Vec3,
    /// Its length in radians, along the direction from the first texel to the second.
    across: Vec3,
    /// Depth along the axis of each texel's face over distance, at the middle.
    cosines: [f32; 2],
}

/// Change of what is gathered by a receiver, to the first order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Differential {
    /// By movement along the axes, per unit of length.
    pub translation: [Vec3; QUANTITIES],
    /// By what the components of the unit normal change.
    pub rotation: [Vec3; QUANTITIES],
    /// Sum of what all borders change, per unit of length, as if each changed it for the better: of ambient occlusion, and of the sum of all
    /// irradiance.
    pub slope_sums: [f32; 2],
}

/// Eight texels.
#[derive(Clone, Copy, Debug, Default)]
struct Texels {
    /// Unit directions.
    directions: [[f32; LANES]; 3],
    /// Length of `∫ d dω`.
    lengths: [f32; LANES],
    /// Depth along the axis of their face over distance.
    axial: [f32; LANES],
}

impl Texels {
    fn of(texels: &[CubeTexel]) -> Self {
        let mut found = Self::default();
        for (lane, texel) in texels.iter().enumerate() {
            let direction = texel.vector.normalize_or_zero();
            for (plane, along) in found.directions.iter_mut().zip(direction.to_array()) {
                plane[lane] = along;
            }
            found.lengths[lane] = texel.vector.length();
            found.axial[lane] = direction.abs().max_element();
        }
        found
    }

    /// Cosines to a normal.
    #[inline(always)]
    fn along(&self, normal: Vec3) -> [f32; LANES] {
        let [x, y, z] = &self.directions;
        let mut cosines = [0.0; LANES];
        for lane in 0..LANES {
            cosines[lane] = x[lane] * normal.x + y[lane] * normal.y + z[lane] * normal.z;
        }
        cosines
    }
}

/// What hides in eight texels, and how it grows as the receiver comes nearer; 0 where there is nothing.
#[derive(Clone, Copy, Debug, Default)]
struct Looming {
    /// Of the hemisphere, weighted by cosine, what it hides; and the irradiance it would replace or bring.
    weights: [[f32; LANES]; 2],
    inverse_distance: [f32; LANES],
    /// Square of the tangent of its elevation over the receiver's plane.
    tan2: [f32; LANES],
}

/// A sum of vectors, for each quantity.
#[derive(Clone, Copy, Debug, Default)]
struct VectorSums([[f32; QUANTITIES]; 3]);

impl VectorSums {
    /// Adds a vector times a value of each quantity.
    #[inline(always)]
    fn add(&mut self, vector: Vec3, values: &[f32; QUANTITIES]) {
        for (sums, along) in self.0.iter_mut().zip(vector.to_array()) {
            for i in 0..QUANTITIES {
                sums[i] += along * values[i];
            }
        }
    }

    #[inline(always)]
    fn vectors(&self) -> [Vec3; QUANTITIES] {
        let [x, y, z] = &self.0;
        let mut vectors = [Vec3::ZERO; QUANTITIES];
        for i in 0..QUANTITIES {
            vectors[i] = Vec3::new(x[i], y[i], z[i]);
        }
        vectors
    }
}

/// Differentiates what is in cube rasters of one resolution.
#[derive(Clone, Debug)]
pub struct Differentiator {
    borders: Vec<Border>,
    /// Eight texels each.
    texels: Vec<Texels>,
    up: Vec3,
    sky_sum_sr: f32,
    /// What each texel adds to each quantity per projected solid angle, and the inverse depth of the nearest thing in it: of one raster.
    values: Vec<[f32; QUANTITIES]>,
    nearest: Vec<f32>,
    looming: Vec<Looming>,
}

impl Differentiator {
    /// For the texels of `table`; `up` is the direction of the sky.
    #[must_use]
    pub fn new(table: &CubeRasterTable, up: Vec3) -> Self {
        let (n, count) = (table.edge(), table.texels().len());
        let texels = CubeFace::ALL.into_iter().flat_map(|face| {
            (0..n).flat_map(move |row| (0..n).map(move |column| (face, row, column)))
        });
        let sky = table.texels().iter().filter(|t| t.vector.dot(up) > 0.0);
        Self {
            borders: texels.flat_map(|texel| borders_of(table, texel)).collect(),
            texels: table.texels().chunks(LANES).map(Texels::of).collect(),
            up,
            sky_sum_sr: sky.map(|t| t.solid_angle_sr).sum(),
            values: vec![[0.0; QUANTITIES]; count],
            nearest: vec![0.0; count],
            looming: Vec::with_capacity(count / LANES),
        }
    }

    /// Differentiates what [`convolve_diffuse`](crate::convolve_diffuse) finds in a raster, which must keep depths
    /// ([`CubeRaster::keep_depths`]).
    ///
    /// Irradiance is a sum over texels. When the receiver moves by **t**, the border between two texels, which lies on the nearer of what they
    /// show, at the distance *d*, moves over the sphere by −**t**/*d*, so that the irradiance changes by *(L₂ − L₁) cos θ ℓ* **u**·**t**/*d*, with ℓ the
    /// border's length and **u** the direction across it from the first to the second (Ward and Heckbert 1992). When the normal turns, each texel's cosine does.
    #[inline(always)]
    #[must_use]
    pub fn differentiate<L: Lanes>(
        &mut self,
        raster: &CubeRaster,
        environment: Option<&EnvironmentTexels>,
        [normal, plane]: [Vec3; 2],
    ) -> Differential {
        let mut rotation = VectorSums::default();
        self.read::<L>(raster, environment, [normal, plane], &mut rotation);
        let (mut translation, mut sky) = (VectorSums::default(), Vec3::ZERO);
        let mut slope_sums = [0.0; 2];
        for border in &self.borders {
            let [a, b] = border.texels.map(|index| index as usize);
            let near =
                larger(self.nearest[a] * border.cosines[0], self.nearest[b] * border.cosines[1]);
            let cosine = border.middle.dot(normal);
            if near == 0.0 || cosine <= 0.0 || border.middle.dot(plane) <= 0.0 {
                continue;
            }
            let across = border.across * near;
            let weighted = across * cosine;
            let mut change = [0.0; QUANTITIES];
            for i in 0..QUANTITIES {
                change[i] = self.values[b][i] - self.values[a][i];
            }
            translation.add(weighted, &change);
            if border.middle.dot(self.up) > 0.0 {
                sky += across * change[SKY];
            }
            let length = weighted.length();
            slope_sums[0] += change[OCCLUSION].abs() * length;
            slope_sums[1] += sum_of_light(&change).abs() * length;
        }
        let (mut translation, mut rotation) = (translation.vectors(), rotation.vectors());
        translation[OCCLUSION] /= PI;
        rotation[OCCLUSION] /= PI;
        slope_sums[0] /= PI;
        translation[SKY] = sky / self.sky_sum_sr;
        // Turning the receiver turns no sky.
        rotation[SKY] = Vec3::ZERO;
        Differential { translation, rotation, slope_sums }
    }

    /// What extrapolation to a distance may be wrong by as things there loom: of ambient occlusion, and of irradiance where there is `mean` irradiance.
    #[inline(always)]
    #[must_use]
    pub fn looming(&self, distance: f32, mean: f32) -> [f32; 2] {
        let mut sums = [[0.0; LANES]; 2];
        for things in &self.looming {
            for lane in 0..LANES {
                let nearness = larger(1.0 - distance * things.inverse_distance[lane], NEARNESS_MIN);
                let (tan2, [hidden, light]) = (things.tan2[lane], things.weights);
                let start = tan2 + 1.0;
                let grown = start / (tan2 + nearness * nearness);
                let more = larger(grown - 1.0 - 2.0 * (1.0 - nearness) / start, 0.0);
                sums[0][lane] += hidden[lane] * more;
                sums[1][lane] += larger(light[lane], hidden[lane] * mean) * more;
            }
        }
        let [openness, light] = &sums;
        [APPROACHED * openness.iter().sum::<f32>(), APPROACHED * light.iter().sum::<f32>()]
    }

    /// Reads a raster's texels, and sums how they turn.
    #[inline(always)]
    fn read<L: Lanes>(
        &mut self,
        raster: &CubeRaster,
        environment: Option<&EnvironmentTexels>,
        [normal, plane]: [Vec3; 2],
        rotation: &mut VectorSums,
    ) {
        self.values.fill([0.0; QUANTITIES]);
        self.nearest.fill(0.0);
        self.looming.clear();
        for number in 0..self.values.len() / LANES {
            let Some(chunk) = raster.chunk(number) else { continue };
            let texels = &self.texels[number];
            // What is hidden of each texel above the horizon, and how bright it is.
            let (mut hidden, mut brightness) = ([0.0; LANES], [0.0; LANES]);
            let mut nearest = [0.0; LANES];
            for lane in 0..LANES {
                let index = number * LANES + lane;
                let above = raster.share_above(index);
                if above == 0.0 {
                    continue;
                }
                let open = if chunk.is_open { 1.0 - chunk.covered[lane] } else { 0.0 };
                let values = &mut self.values[index];
                if raster.shines() {
                    let lamp = raster.lamp_radiance(index);
                    for c in 0..3 {
                        values[c] = chunk.radiance[c][lane] + lamp[c];
                    }
                }
                if let Some(environment) = environment {
                    for c in 0..3 {
                        values[3 + c] = environment.channel(c)[index] * open;
                    }
                }
                (values[OCCLUSION], values[SKY]) = (open, open);
                let [x, y, z] = &texels.directions;
                let direction = Vec3::new(x[lane], y[lane], z[lane]);
                rotation.add(direction * (texels.lengths[lane] * above), values);
                nearest[lane] = raster.nearest::<L>(index);
                self.nearest[index] = nearest[lane];
                let is_thing = if nearest[lane] > 0.0 { above } else { 0.0 };
                (hidden[lane], brightness[lane]) = (is_thing * (1.0 - open), sum_of_light(values));
            }
            let (cosines, sines) = (texels.along(normal), texels.along(plane));
            let mut looming = Looming::default();
            for lane in 0..LANES {
                let hidden = larger(cosines[lane], 0.0) * texels.lengths[lane] * hidden[lane];
                looming.weights[0][lane] = hidden / PI;
                looming.weights[1][lane] = hidden * brightness[lane];
                looming.inverse_distance[lane] = nearest[lane] * texels.axial[lane];
                let sine2 = sines[lane] * sines[lane];
                looming.tan2[lane] = sine2 / larger(1.0 - sine2, 1e-6);
            }
            self.looming.push(looming);
        }
    }
}

/// Sum of the quantities that are light.
#[inline(always)]
fn sum_of_light(values: &[f32; QUANTITIES]) -> f32 {
    let mut sum = 0.0;
    for value in &values[LIGHT] {
        sum += value;
    }
    sum
}

/// The borders of a texel to those with larger indices.
fn borders_of(
    table: &CubeRasterTable,
    (face, row, column): (CubeFace, usize, usize),
) -> impl Iterator<Item = Border> {
    let (n, stride) = (table.edge(), table.stride());
    let half = 1.0 / n as f32;
    let [u, v] = [column, row].map(|i| (2 * i + 1) as f32 * half - 1.0);
    let index = (usize::from(face.0) * n + row) * stride + column;
    let sides = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
    sides.into_iter().filter_map(move |(du, dv)| {
        let at = |out: f32, along: f32| {
            let (du, dv) = (du * out + dv * along, dv * out + du * along);
            face.direction(u + half * du, v + half * dv).normalize()
        };
        // Just beyond the border, on another face perhaps.
        let other = table.texel_index(at(1.01, 0.0));
        if other <= index {
            return None;
        }
        let middle = at(1.0, 0.0);
        let across = middle.cross(at(1.0, 1.0) - at(1.0, -1.0));
        let toward = table.texels()[other].direction - table.texels()[index].direction;
        let across = if across.dot(toward) < 0.0 { -across } else { across };
        let cosine = |index: usize| middle[CubeFace((index / (n * stride)) as u8).axis()].abs();
        let cosines = [cosine(index), cosine(other)];
        Some(Border { texels: [index as u32, other as u32], middle, across, cosines })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diffuse::tests::Draw;
    use crate::{ConvolutionTable, Diffuse, convolve_diffuse};
    use pbgi_raster::{SimdLevel, WideKernel, run_wide};

    /// Differentiates what is in a raster for a receiver with this normal.
    struct Differentiate<'a>(&'a mut Differentiator, &'a CubeRaster, Vec3);

    impl WideKernel for Differentiate<'_> {
        type Output = Differential;

        #[inline(always)]
        fn run<L: Lanes>(self) -> Differential {
            self.0.differentiate::<L>(self.1, None, [self.2; 2])
        }
    }

    const EDGE: usize = 32;

    /// What a receiver of a normal gathers beside a wall at distance 1, wide without end, whose edge is `height` above it; how that changes, and by what
    /// it was found.
    fn beside_wall(normal: Vec3, height: f32) -> (Diffuse, Differential, Differentiator) {
        let table = CubeRasterTable::new(EDGE);
        let sums = ConvolutionTable::new(&table, Vec3::Z);
        let mut raster = CubeRaster::new(&table, true);
        let [low, high] = [Vec3::new(0.999, -2000.0, -2000.0), Vec3::new(1.001, 2000.0, height)];
        run_wide(SimdLevel::Baseline, Draw(&mut raster, normal, &[(Vec3::X, low, high)]));
        let found = convolve_diffuse(&raster, &sums, None, [normal; 2]);
        let mut differentiator = Differentiator::new(&table, Vec3::Z);
        let mut differentials = SimdLevel::available()
            .into_iter()
            .map(|level| run_wide(level, Differentiate(&mut differentiator, &raster, normal)));
        let differential = differentials.next().unwrap();
        assert!(differentials.all(|other| other == differential));
        drop(differentials);
        (found, differential, differentiator)
    }

    /// The wall hides (1 − 1/√(1 + h²))/2 of the hemisphere where it is h times as high as far; in units of its distance.
    #[test]
    fn moving_toward_a_wall_hides_what_it_should() {
        for height in [0.3, 0.7, 1.0, 2.5] {
            let (_, found, _) = beside_wall(Vec3::Z, height);
            let slope = -0.5 * height * height / (1.0 + height * height).powf(1.5);
            let moved = found.translation[OCCLUSION];
            assert!(
                (moved.x - slope).abs() < 0.2 * slope.abs() + 0.003,
                "{height}: {moved} {slope}"
            );
            assert!(moved.y.abs() < 0.003, "{height}: {moved}");
            // The wall has radiance 3.
            let lit = found.translation[0].x;
            assert!(
                (lit / (-3.0 * PI) - slope).abs() < 0.2 * slope.abs() + 0.003,
                "{height}: {lit}"
            );
            // More than that where the edge, which is level, goes through texels in steps.
            let sum = found.slope_sums[0] / slope.abs();
            assert!(sum > 0.9 && sum < 4.0, "{height}: {sum}");
        }
    }

    #[test]
    fn turning_changes_what_it_should() {
        let (before, found, _) = beside_wall(Vec3::Z, 1.0);
        for turn in [-0.05f32, 0.05] {
            let normal = Vec3::new(turn.sin(), 0.0, turn.cos());
            let (after, ..) = beside_wall(normal, 1.0);
            let expected =
                before.ambient_occlusion + found.rotation[OCCLUSION].dot(normal - Vec3::Z);
            let error = expected - after.ambient_occlusion;
            assert!(error.abs() < 0.002, "{turn}: {error}");
            let change = after.ambient_occlusion - before.ambient_occlusion;
            assert!(change.abs() > 0.01, "{turn}: {change}");
        }
    }

    /// At half the distance of a low wall, hidden is four times as much; of that, the first order tells two parts.
    #[test]
    fn what_is_low_looms() {
        let height = 0.1f32;
        let (_, _, differentiator) = beside_wall(Vec3::Z, height);
        let hidden = |h: f32| 0.5 * (1.0 - 1.0 / (1.0 + h * h).sqrt());
        let slope = 0.5 * height * height / (1.0 + height * height).powf(1.5);
        let truth = hidden(2.0 * height) - hidden(height) - 0.5 * slope;
        let found = differentiator.looming(0.5, 0.0)[0];
        // Half of what is around is taken to come nearer, and what is beside comes less near: a bound within a factor.
        assert!(found > 0.3 * truth && found < 2.0 * truth, "{found} {truth}");
        assert_eq!(differentiator.looming(0.0, 0.0)[0], 0.0);
    }
}
