//! How what a diffuse receiver gathers changes when it moves and turns, from one raster.

use crate::diffuse::EnvironmentTexels;
use crate::obstacles::Obstacles;
use pbgi_math::{CubeFace, CubeTexel, Frame, Vec3, larger};
use pbgi_raster::{CubeRaster, CubeRasterTable, LANES, Lanes, SAMPLES};
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

/// Share of what things hide that counts as if it changed by itself when the receiver moves by their distance: what lies behind them may be seen then, though
/// no border tells of it. With it a street gathers for 28.0 % of its receivers with 1.65 % of error from interpolation; with half of it for 27.2 % with 2.0 %.
const UNSEEN: f32 = 0.1;

/// Sine of the elevation below which texels are asked what stands on the receiver's plane: that of [`Obstacles::SLOPES`], and a texel.
const STANDING_SINE: f32 = 0.5;

/// Share of the distance to a thing at which it is near enough for anything: what looms is not followed farther.
const NEARNESS_MIN: f32 = 0.05;

/// Variance of how many of a texel's samples a straight border through it leaves on one side, in samples²; of leaves it is three times that.
const EDGE_VARIANCE: f32 = 0.5;

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

impl Border {
    /// The larger inverse distance of what is in the two texels, by their inverse depths.
    #[inline(always)]
    fn inverse_distance(&self, depths: &[f32]) -> f32 {
        let [a, b] = self.texels.map(|index| depths[index as usize]);
        larger(a * self.cosines[0], b * self.cosines[1])
    }
}

/// Change of what is gathered by a receiver, to the first order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Differential {
    /// By movement along the axes, per unit of length.
    pub translation: [Vec3; QUANTITIES],
    /// By what the components of the unit normal change.
    pub rotation: [Vec3; QUANTITIES],
    /// Sum of what all borders change, per unit of length, as if each changed it for the better, and of a share of what things hide: of ambient occlusion,
    /// and of the sum of all irradiance.
    pub slope_sums: [f32; 2],
    /// What stands on the receiver's plane.
    pub obstacles: Obstacles,
    /// Variance of ambient occlusion, and of the sum of all irradiance, as the borders of what is open meet samples here or there: surfaces shine by their
    /// own solid angle.
    pub variances: [f32; 2],
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
}

/// Eight borders that loom.
#[derive(Clone, Copy, Debug, Default)]
struct EightLooming {
    /// What changes across each, of openness times π and of the sum of all light, times what of the hemisphere, weighted by cosine, lies below it.
    changes: [[f32; LANES]; 2],
    /// Inverse distance along the receiver's plane.
    inverse_distance: [f32; LANES],
    /// Square of the tangent of the elevation over the plane.
    tan2: [f32; LANES],
}

/// Borders that loom.
#[derive(Clone, Debug, Default)]
struct Looming {
    eights: Vec<EightLooming>,
    count: usize,
}

impl Looming {
    #[inline(always)]
    fn clear(&mut self) {
        self.eights.clear();
        self.count = 0;
    }

    /// Adds a border at this sine of elevation, so many radians wide as seen from below, at an inverse distance.
    #[inline(always)]
    fn push(&mut self, sine: f32, rise: f32, inverse_distance: f32, changes: [f32; 2]) {
        let lane = self.count % LANES;
        if lane == 0 {
            self.eights.push(EightLooming::default());
        }
        let eight = &mut self.eights[self.count / LANES];
        self.count += 1;
        let cosine2 = larger(1.0 - sine * sine, 1e-6);
        eight.tan2[lane] = sine * sine / cosine2;
        eight.inverse_distance[lane] = inverse_distance / cosine2.sqrt();
        // As wide in azimuth as the border's part along the horizon over the cosine of its elevation; below it lies half of sin² of that.
        let below = 0.5 * rise * eight.tan2[lane];
        for (of_all, change) in eight.changes.iter_mut().zip(changes) {
            of_all[lane] = change * below;
        }
    }
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
    /// The same where a texel is open in part: where what is in it ends.
    outlines: Vec<f32>,
    /// Tangent of half the width of a texel.
    half_width: f32,
    looming: Looming,
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
            outlines: vec![0.0; count],
            half_width: 1.0 / n as f32,
            looming: Looming::default(),
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
        let mut found = Differential::default();
        let mut rotation = VectorSums::default();
        self.read::<L>(raster, environment, [normal, plane], &mut found, &mut rotation);
        let (mut translation, mut sky) = (VectorSums::default(), Vec3::ZERO);
        self.looming.clear();
        for border in &self.borders {
            let [a, b] = border.texels.map(|index| index as usize);
            let of_outlines = border.inverse_distance(&self.outlines);
            let near = match of_outlines > 0.0 {
                true => of_outlines,
                false => border.inverse_distance(&self.nearest),
            };
            let (cosine, sine) = (border.middle.dot(normal), border.middle.dot(plane));
            if near == 0.0 || cosine <= 0.0 || sine <= 0.0 {
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
            let changes = [change[OCCLUSION].abs(), sum_of_light(&change).abs()];
            if changes == [0.0; 2] {
                continue;
            }
            let length = weighted.length();
            for (sum, change) in found.slope_sums.iter_mut().zip(changes) {
                *sum += change * length;
            }
            self.looming.push(sine, border.across.dot(plane).abs(), near, changes);
        }
        (found.translation, found.rotation) = (translation.vectors(), rotation.vectors());
        found.translation[OCCLUSION] /= PI;
        found.rotation[OCCLUSION] /= PI;
        found.slope_sums[0] /= PI;
        found.variances[0] /= PI * PI;
        found.translation[SKY] = sky / self.sky_sum_sr;
        // Turning the receiver turns no sky.
        found.rotation[SKY] = Vec3::ZERO;
        found
    }

    /// What extrapolation to a distance may be wrong by as things there loom: of ambient occlusion, and of the sum of all irradiance.
    ///
    /// The border of a thing at the horizontal distance *d*, whose elevation θ has the squared tangent *T*, hides sin²θ = *T*/(1 + *T*) of its side. Nearer by
    /// *t* it hides *T*/(*T* + (1 − *t*/*d*)²); what that is more than the first order tells is summed over all borders, times what changes across each.
    #[inline(always)]
    #[must_use]
    pub fn looming(&self, distance: f32) -> [f32; 2] {
        let mut sums = [[0.0; LANES]; 2];
        for eight in &self.looming.eights {
            for lane in 0..LANES {
                let nearness = larger(1.0 - distance * eight.inverse_distance[lane], NEARNESS_MIN);
                let tan2 = eight.tan2[lane];
                let start = tan2 + 1.0;
                let grown = start / (tan2 + nearness * nearness);
                let more = larger(grown - 1.0 - 2.0 * (1.0 - nearness) / start, 0.0);
                for (sums, changes) in sums.iter_mut().zip(&eight.changes) {
                    sums[lane] += changes[lane] * more;
                }
            }
        }
        let [openness, light] = &sums;
        [openness.iter().sum::<f32>() / PI, light.iter().sum()]
    }

    /// Reads a raster's texels: how they turn, what they hide, and what stands around.
    #[inline(always)]
    fn read<L: Lanes>(
        &mut self,
        raster: &CubeRaster,
        environment: Option<&EnvironmentTexels>,
        [normal, plane]: [Vec3; 2],
        found: &mut Differential,
        rotation: &mut VectorSums,
    ) {
        let frame = Frame::from_normal(plane);
        self.values.fill([0.0; QUANTITIES]);
        self.nearest.fill(0.0);
        self.outlines.fill(0.0);
        for number in 0..self.values.len() / LANES {
            let Some(chunk) = raster.chunk(number) else { continue };
            let texels = &self.texels[number];
            let distant = environment.map(|environment| environment.seen(number, &chunk));
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
                if let Some(distant) = &distant {
                    for c in 0..3 {
                        values[3 + c] = distant[c][lane] * open;
                    }
                }
                (values[OCCLUSION], values[SKY]) = (open, open);
                let [x, y, z] = &texels.directions;
                let direction = Vec3::new(x[lane], y[lane], z[lane]);
                let weight = texels.lengths[lane] * above;
                rotation.add(direction * weight, values);
                let cosine = larger(direction.dot(normal), 0.0);
                if open > 0.0 && open < 1.0 {
                    let behind = distant.map_or(0.0, |light| sum_of_channels(&light, lane));
                    for (variance, change) in found.variances.iter_mut().zip([1.0, behind]) {
                        let of_sample = cosine * weight * change * (1.0 / SAMPLES as f32);
                        *variance += EDGE_VARIANCE * of_sample * of_sample;
                    }
                }
                let nearest = raster.nearest::<L>(index);
                if nearest == 0.0 {
                    continue;
                }
                self.nearest[index] = nearest;
                self.outlines[index] = if open > 0.0 { nearest } else { 0.0 };
                let hidden = cosine * weight * (1.0 - open);
                let unseen = UNSEEN * hidden * nearest * texels.axial[lane];
                found.slope_sums[0] += unseen;
                found.slope_sums[1] += unseen * sum_of_light(values);
                if direction.dot(plane) < STANDING_SINE {
                    let inverse = raster.standing::<L>(index, plane, Obstacles::SLOPES);
                    found.obstacles.add(&frame, direction, self.half_width, inverse);
                }
            }
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

/// Sum of the channels of one of eight texels.
#[inline(always)]
fn sum_of_channels(light: &[[f32; LANES]; 3], lane: usize) -> f32 {
    light[0][lane] + light[1][lane] + light[2][lane]
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
    struct Differentiate<'a>(
        &'a mut Differentiator,
        &'a CubeRaster,
        Vec3,
        Option<&'a EnvironmentTexels>,
    );

    impl WideKernel for Differentiate<'_> {
        type Output = Differential;

        #[inline(always)]
        fn run<L: Lanes>(self) -> Differential {
            self.0.differentiate::<L>(self.1, self.3, [self.2; 2])
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
        let mut differentials = SimdLevel::available().into_iter().map(|level| {
            run_wide(level, Differentiate(&mut differentiator, &raster, normal, None))
        });
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

    /// Plates all around at random, found by rasters of 8 and of 64 texels a face: how far the two are apart is what the coarse one's variance tells.
    #[test]
    fn variances_tell_how_samples_fall() {
        let tables = [CubeRasterTable::new(8), CubeRasterTable::new(64)];
        let mut seed = 1u32;
        let mut random = || {
            seed = pbgi_math::scramble(seed);
            (seed >> 8) as f32 / (1 << 24) as f32
        };
        let (mut error2, mut variance) = (0.0, 0.0);
        for _ in 0..40 {
            let plates: Vec<_> = (0..60)
                .map(|_| {
                    let [x, y, size] = [(); 3].map(|()| random());
                    let center = Vec3::new(4.0 * x - 2.0, 4.0 * y - 2.0, 1.0);
                    let half = Vec3::new(0.05 + 0.2 * size, 0.05 + 0.1 * size, 0.01);
                    (Vec3::Z, center - half, center + half)
                })
                .collect();
            let found = tables.each_ref().map(|table| {
                let sums = ConvolutionTable::new(table, Vec3::Z);
                let sky = vec![[2.0; 3]; 6 * table.edge() * table.edge() * SAMPLES];
                let sky = EnvironmentTexels::new(table, &sky);
                let mut raster = CubeRaster::new(table, true);
                run_wide(SimdLevel::Baseline, Draw(&mut raster, Vec3::Z, &plates));
                let mut differentiator = Differentiator::new(table, Vec3::Z);
                let kernel = Differentiate(&mut differentiator, &raster, Vec3::Z, Some(&sky));
                let [openness, light] = run_wide(SimdLevel::Baseline, kernel).variances;
                // Three channels of 2, over π.
                let radiance = (light / openness).sqrt() / PI;
                assert!((radiance / 6.0 - 1.0).abs() < 1e-4, "{radiance} {light} {openness}");
                (convolve_diffuse(&raster, &sums, None, [Vec3::Z; 2]).ambient_occlusion, openness)
            });
            error2 += (found[0].0 - found[1].0).powi(2);
            variance += found[0].1;
        }
        let share = (error2 / variance).sqrt();
        assert!(share > 0.8 && share < 1.4, "{share}");
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
        let found = differentiator.looming(0.5)[0];
        // All that is around is taken to come nearer, and what is beside comes less near: a bound within a factor.
        assert!(found > 0.6 * truth && found < 4.0 * truth, "{found} {truth}");
        assert_eq!(differentiator.looming(0.0)[0], 0.0);
    }

    /// What fills its side up to the zenith cannot grow, but nobody goes through it; over what is lower than a tenth of its distance the way is free.
    #[test]
    fn tall_walls_do_not_loom_and_stand_in_the_way() {
        let (_, tall, of_tall) = beside_wall(Vec3::Z, 100.0);
        let (_, low, of_low) = beside_wall(Vec3::Z, 0.05);
        assert!(of_tall.looming(0.8)[0] < 0.002, "{}", of_tall.looming(0.8)[0]);
        assert!(of_low.looming(0.8)[0] > 0.004, "{}", of_low.looming(0.8)[0]);
        let reach = |found: &Differential, x: f32, y: f32| {
            found.obstacles.are_reached(Vec3::Z, Vec3::new(x, y, 0.0), 0.8)
        };
        assert!(reach(&tall, 0.9, 0.1) && reach(&tall, 0.9, -0.5), "{:?}", tall.obstacles);
        assert!(!reach(&tall, 0.7, 0.1) && !reach(&tall, -3.0, 0.5) && !reach(&low, 0.9, 0.1));
    }
}
