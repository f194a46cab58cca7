//! How what a diffuse receiver gathers changes when it moves and turns, from one raster.

use crate::diffuse::EnvironmentTexels;
use pbgi_math::{CubeFace, Vec3, larger};
use pbgi_raster::{CubeRaster, CubeRasterTable, LANES};
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

/// A texel with something in it that hides: how it grows as the receiver comes nearer.
#[derive(Clone, Copy, Debug)]
struct Looming {
    /// Of the hemisphere, weighted by cosine, what it hides; and the irradiance it would replace or bring.
    weights: [f32; 2],
    inverse_distance: f32,
    /// Square of the tangent of its elevation over the receiver's plane.
    tan2: f32,
}

/// Differentiates what is in cube rasters of one resolution.
#[derive(Clone, Debug)]
pub struct Differentiator {
    borders: Vec<Border>,
    /// `∫ d dω` per texel.
    vectors: Vec<Vec3>,
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
            vectors: table.texels().iter().map(|t| t.vector).collect(),
            up,
            sky_sum_sr: sky.map(|t| t.solid_angle_sr).sum(),
            values: vec![[0.0; QUANTITIES]; count],
            nearest: vec![0.0; count],
            looming: Vec::with_capacity(count),
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
    pub fn differentiate(
        &mut self,
        raster: &CubeRaster,
        environment: Option<&EnvironmentTexels>,
        [normal, plane]: [Vec3; 2],
    ) -> Differential {
        let mut found = Differential::default();
        self.read(raster, environment, [normal, plane], &mut found.rotation);
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
            for i in 0..SKY {
                found.translation[i] += weighted * change[i];
            }
            if border.middle.dot(self.up) > 0.0 {
                found.translation[SKY] += across * change[SKY];
            }
            let length = weighted.length();
            found.slope_sums[0] += change[OCCLUSION].abs() * length;
            found.slope_sums[1] += change[LIGHT].iter().sum::<f32>().abs() * length;
        }
        found.translation[OCCLUSION] /= PI;
        found.rotation[OCCLUSION] /= PI;
        found.slope_sums[0] /= PI;
        found.translation[SKY] /= self.sky_sum_sr;
        found
    }

    /// What extrapolation to a distance may be wrong by as things there loom: of ambient occlusion, and of irradiance where there is `mean` irradiance.
    #[must_use]
    pub fn looming(&self, distance: f32, mean: f32) -> [f32; 2] {
        let mut sums = [0.0; 2];
        for thing in &self.looming {
            let nearness = larger(1.0 - distance * thing.inverse_distance, NEARNESS_MIN);
            let start = thing.tan2 + 1.0;
            let grown = start / (thing.tan2 + nearness * nearness);
            let more = larger(grown - 1.0 - 2.0 * (1.0 - nearness) / start, 0.0);
            sums[0] += thing.weights[0] * more;
            sums[1] += larger(thing.weights[1], thing.weights[0] * mean) * more;
        }
        sums.map(|sum| APPROACHED * sum)
    }

    /// Reads a raster's texels, and sums how they turn.
    #[inline(always)]
    fn read(
        &mut self,
        raster: &CubeRaster,
        environment: Option<&EnvironmentTexels>,
        [normal, plane]: [Vec3; 2],
        rotation: &mut [Vec3; QUANTITIES],
    ) {
        self.values.fill([0.0; QUANTITIES]);
        self.nearest.fill(0.0);
        self.looming.clear();
        for number in 0..self.values.len() / LANES {
            let Some(chunk) = raster.chunk(number) else { continue };
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
                self.nearest[index] = raster.nearest(index);
                let vector = self.vectors[index] * above;
                for i in 0..SKY {
                    rotation[i] += vector * values[i];
                }
                if self.nearest[index] > 0.0 {
                    let length = vector.length();
                    let sine = vector.dot(plane) / length;
                    let hidden = larger(vector.dot(normal), 0.0) * (1.0 - open);
                    let brightness = values[LIGHT].iter().sum::<f32>();
                    let direction = vector / length;
                    self.looming.push(Looming {
                        weights: [hidden / PI, hidden * brightness],
                        inverse_distance: self.nearest[index] * direction.abs().max_element(),
                        tan2: sine * sine / larger(1.0 - sine * sine, 1e-6),
                    });
                }
            }
        }
    }
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
    use pbgi_raster::{SimdLevel, run_wide};

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
        let differential = differentiator.differentiate(&raster, None, [normal; 2]);
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
