//! Lambertian irradiance, ambient occlusion, sky visibility and bent normal.

use pbgi_math::{CubeFace, CubeMap, CubeTexel, Vec3};
use pbgi_raster::{
    CubeRaster, CubeRasterTable, LANES, SAMPLE_CELLS, SAMPLE_OF_CELL, SAMPLES, TexelChunk,
};
use std::f32::consts::PI;

/// Distant light in the texels of a cube raster's memory layout, as they are seen whole and in part; three channels.
///
/// What is seen in part is an opening, and whatever is bright lies at a place of it: with the texel's mean instead, Sponza's floor under a roof that opens
/// to the glare around the sun gets up to 70 % too much at 8 × 8 texels a face.
#[derive(Clone, Debug)]
pub struct EnvironmentTexels {
    /// Mean radiance of each texel.
    channels: [Vec<f32>; 3],
    /// Radiance at its samples, whose mean is that of the texel; none where they are as one.
    samples: Vec<[[f32; SAMPLES]; 3]>,
}

impl EnvironmentTexels {
    /// From the mean radiance of each texel of `CubeMap::new(SAMPLE_CELLS * n)`, in its index order, for `n` texels a face in `table`; or of `CubeMap::new(n)`,
    /// whose texels are then as one.
    #[must_use]
    pub fn new(table: &CubeRasterTable, cells: &[[f32; 3]]) -> Self {
        let n = table.edge();
        let texel_count = CubeMap::new(n).texel_count();
        if cells.len() == texel_count {
            return Self::of_means(table, cells);
        }
        let map = CubeMap::new(SAMPLE_CELLS * n);
        let of_texel = |index: usize| {
            let (row, column) = (index / n * SAMPLE_CELLS, index % n * SAMPLE_CELLS);
            let (mut samples, mut flux, mut solid_angle) = ([[0.0; SAMPLES]; 3], [0.0; 3], 0.0);
            for (i, of_row) in SAMPLE_OF_CELL.iter().enumerate() {
                for (j, sample) in of_row.iter().enumerate() {
                    let cell = (row + i) * map.edge() + column + j;
                    let cell_sr = map.texel(cell).solid_angle_sr;
                    solid_angle += cell_sr;
                    for c in 0..3 {
                        samples[c][usize::from(*sample)] = cells[cell][c];
                        flux[c] += cells[cell][c] * cell_sr;
                    }
                }
            }
            let mean = flux.map(|flux| flux / solid_angle);
            for (samples, mean) in samples.iter_mut().zip(mean) {
                let of_samples: f32 = samples.iter().map(|x| x * (1.0 / SAMPLES as f32)).sum();
                let scale = if of_samples > 0.0 { mean / of_samples } else { 0.0 };
                *samples = samples.map(|radiance| radiance * scale);
            }
            (mean, samples)
        };
        let (means, samples): (Vec<_>, Vec<_>) = (0..texel_count).map(of_texel).unzip();
        Self { samples: table.pad(&samples), ..Self::of_means(table, &means) }
    }

    /// From the mean radiance of each texel.
    fn of_means(table: &CubeRasterTable, means: &[[f32; 3]]) -> Self {
        let means = table.pad(means);
        let channels = std::array::from_fn(|c| means.iter().map(|mean| mean[c]).collect());
        Self { channels, samples: Vec::new() }
    }

    /// Radiance of what is open in the texels `8 number ..` in memory, by channel; of texels that are closed, their mean.
    #[inline(always)]
    pub(crate) fn seen(&self, number: usize, chunk: &TexelChunk) -> [[f32; LANES]; 3] {
        let start = number * LANES;
        let mut seen = [[0.0; LANES]; 3];
        for (seen, channel) in seen.iter_mut().zip(&self.channels) {
            seen.copy_from_slice(&channel[start..start + LANES]);
        }
        let Some(of_samples) = self.samples.get(start..start + LANES) else { return seen };
        for ((lane, &open), samples) in chunk.open_samples.iter().enumerate().zip(of_samples) {
            if open != 0 && open != u16::MAX {
                let inverse = 1.0 / open.count_ones() as f32;
                for (seen, samples) in seen.iter_mut().zip(samples) {
                    seen[lane] = sum_where(samples, open) * inverse;
                }
            }
        }
        seen
    }
}

/// Sum of the lanes whose bits are set: halves, which fit into registers, then their halves.
#[inline(always)]
fn sum_where(lanes: &[f32; SAMPLES], bits: u16) -> f32 {
    let mut sums = [0.0; SAMPLES];
    for (lane, sum) in sums.iter_mut().enumerate() {
        *sum = if bits >> lane & 1 != 0 { lanes[lane] } else { 0.0 };
    }
    for half in [8, 4, 2, 1] {
        for lane in 0..half {
            sums[lane] += sums[lane + half];
        }
    }
    sums[0]
}

/// Integrals over eight texels of a row.
#[derive(Clone, Copy, Debug, Default)]
struct TableChunk {
    /// `∫ d dω` per texel.
    vector: [[f32; LANES]; 3],
    /// The same over the texel's solid angle: its mean direction.
    mean: [[f32; LANES]; 3],
    /// How far `d` moves from a texel's middle to its border along u and along v, times the texel's
    /// solid angle.
    reach_u: [[f32; LANES]; 3],
    reach_v: [[f32; LANES]; 3],
    /// How much `d dω` changes from a texel's middle to its border along u and v, as `vector` is scaled.
    tilt_u: [[f32; LANES]; 3],
    tilt_v: [[f32; LANES]; 3],
    /// Solid angle of texels in the sky, 0 elsewhere.
    sky_sr: [f32; LANES],
}

/// Texel integrals in the shape the convolution reads them.
#[derive(Clone, Debug)]
pub struct ConvolutionTable {
    chunks: Vec<TableChunk>,
    /// Solid angle of all texels in the sky.
    sky_sum_sr: f32,
}

impl ConvolutionTable {
    /// Table for the texels of `table`; `up` is the direction of the sky.
    #[must_use]
    pub fn new(table: &CubeRasterTable, up: Vec3) -> Self {
        let (n, stride) = (table.edge(), table.stride());
        let half = 1.0 / n as f32;
        // Half of what `value` of a direction on the cube changes by over a texel.
        let change = |index: usize, along_u: bool, value: &dyn Fn(Vec3) -> Vec3| {
            let (column, row, face) = (index % stride, index / stride % n, index / (stride * n));
            let coordinate = |i: usize| -1.0 + (2 * i + 1) as f32 / n as f32;
            let at = |by: f32| {
                let (du, dv) = if along_u { (by, 0.0) } else { (0.0, by) };
                let face = CubeFace(face as u8);
                value(face.direction(coordinate(column) + du, coordinate(row) + dv))
            };
            (at(half) - at(-half)) * 0.5
        };
        let reach = |index: usize, along_u: bool| {
            change(index, along_u, &Vec3::normalize) * table.texels()[index].solid_angle_sr
        };
        // d dω = D/|D|⁴ du dv.
        let tilt = |index: usize, along_u: bool| {
            let texel_area = 4.0 * half * half;
            change(index, along_u, &|d| d / d.length_squared().powi(2)) * texel_area
        };
        let in_sky = |texel: &CubeTexel| {
            if texel.vector.dot(up) > 0.0 { texel.solid_angle_sr } else { 0.0 }
        };
        let mut chunks = vec![TableChunk::default(); 6 * n * stride / LANES];
        for (index, texel) in table.texels().iter().enumerate() {
            let (chunk, lane) = (&mut chunks[index / LANES], index % LANES);
            let mean = texel.vector / texel.solid_angle_sr.max(f32::MIN_POSITIVE);
            let vectors = [
                (&mut chunk.vector, texel.vector),
                (&mut chunk.mean, mean),
                (&mut chunk.reach_u, reach(index, true)),
                (&mut chunk.reach_v, reach(index, false)),
                (&mut chunk.tilt_u, tilt(index, true)),
                (&mut chunk.tilt_v, tilt(index, false)),
            ];
            for (planes, vector) in vectors {
                for (plane, along) in planes.iter_mut().zip(vector.to_array()) {
                    plane[lane] = along;
                }
            }
            chunk.sky_sr[lane] = in_sky(texel);
        }
        Self { chunks, sky_sum_sr: table.texels().iter().map(in_sky).sum() }
    }
}

/// What a diffuse receiver gathers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Diffuse {
    /// Irradiance from surfaces, W·m⁻².
    pub surface_irradiance: [f32; 3],
    /// Irradiance from the distant environment, W·m⁻².
    pub environment_irradiance: [f32; 3],
    /// Cosine-weighted share of the hemisphere that is open: 1 where nothing is near.
    pub ambient_occlusion: f32,
    /// Share of the sky's hemisphere (around `up`) that is open.
    pub sky_visibility: f32,
    /// Cosine-weighted mean open direction, unit length; the normal where all is closed.
    pub bent_normal: Vec3,
}

/// Projected solid angle of a texel over the horizon.
///
/// `c` is `n·∫d dω`, exact where the texel is wholly above; `reach` how much `n·d` varies over it,
/// times its solid angle. A texel the horizon crosses keeps the positive part of a cosine that is
/// spread evenly over `c ± reach`: `(c + reach)²/(4 reach)`.
#[inline(always)]
fn clamped_weight(c: f32, reach: f32) -> f32 {
    let partial = (c + reach) * (c + reach) / (4.0 * reach + 1e-30);
    let above = if c >= reach { c } else { partial };
    if c <= -reach { 0.0 } else { above }
}

/// `x` between 0 and `most`.
#[inline(always)]
fn clamp_below(x: f32, most: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < most { x } else { most }
}

/// Products with a vector.
#[inline(always)]
fn dot(planes: &[[f32; LANES]; 3], n: Vec3) -> [f32; LANES] {
    let mut sum = [0.0; LANES];
    for i in 0..LANES {
        sum[i] = planes[0][i] * n.x + planes[1][i] * n.y + planes[2][i] * n.z;
    }
    sum
}

/// Sums a raster over the hemisphere around `normal`: `E = Σ L (n·d) dω`, with the environment where texels are open. `plane` is the normal of the receiver's own surface, below which the raster counts samples as covered.
///
/// Within a texel, the cosine times the solid angle of what is seen there, `n·d dω`, is taken as linear: the open share `o` of a texel weighs
/// `o c + t·m`, where `c` is its integral, `t` its change toward the borders ([`ConvolutionTable`]) and `m` how far the open samples lie
/// from the middle, on the mean ([`TexelChunk::open_offset`](pbgi_raster::TexelChunk)). Surfaces mostly stand on the horizon: with the mean for all
/// samples of a texel they would hide too much. What shines is weighted so when it is drawn.
///
/// With nothing in the raster a uniform environment of radiance `L` gives `πL` within 0.2 % at
/// 8 × 8 texels per face (`tests::an_open_uniform_sky_gives_pi`).
#[inline(always)]
#[must_use]
pub fn convolve_diffuse(
    raster: &CubeRaster,
    table: &ConvolutionTable,
    environment: Option<&EnvironmentTexels>,
    [normal, plane]: [Vec3; 2],
) -> Diffuse {
    let mut surface = [[0.0f32; LANES]; 3];
    let mut distant = [[0.0f32; LANES]; 3];
    let mut bent = [[0.0f32; LANES]; 3];
    let (mut open_sum, mut weight_sum) = ([0.0f32; LANES], [0.0f32; LANES]);
    let mut sky = [0.0f32; LANES];
    for (index, texels) in table.chunks.iter().enumerate() {
        let Some(chunk) = raster.chunk(index) else { continue };
        let cosine = dot(&texels.vector, normal);
        let (ru, rv) = (dot(&texels.reach_u, normal), dot(&texels.reach_v, normal));
        let mut weight = [0.0; LANES];
        for i in 0..LANES {
            weight[i] = clamped_weight(cosine[i], ru[i].abs() + rv[i].abs());
            weight_sum[i] += weight[i];
        }
        if chunk.is_open {
            let (tu, tv) = (dot(&texels.tilt_u, normal), dot(&texels.tilt_v, normal));
            let mut open_weight = [0.0; LANES];
            for i in 0..LANES {
                let open = 1.0 - chunk.covered[i];
                let tilt = tu[i] * chunk.open_offset[0][i] + tv[i] * chunk.open_offset[1][i];
                open_weight[i] = clamp_below(open * weight[i] + tilt, weight[i]);
                open_sum[i] += open_weight[i];
                // The sky seen over the receiver's own horizon, as far as texels resolve it.
                sky[i] += if cosine[i] > 0.0 { texels.sky_sr[i] * open } else { 0.0 };
            }
            for (sum, mean) in bent.iter_mut().zip(&texels.mean) {
                // The texel's mean direction, weighted by its mean cosine.
                for i in 0..LANES {
                    sum[i] += mean[i] * open_weight[i];
                }
            }
            if let Some(environment) = environment {
                for (sum, light) in distant.iter_mut().zip(environment.seen(index, &chunk)) {
                    for i in 0..LANES {
                        sum[i] += light[i] * open_weight[i];
                    }
                }
            }
        }
        if chunk.is_lit {
            for (sum, near) in surface.iter_mut().zip(&chunk.radiance) {
                for i in 0..LANES {
                    sum[i] += near[i] * weight[i];
                }
            }
        }
    }
    let total = |lanes: &[f32; LANES]| lanes.iter().sum::<f32>();
    // The quadrature's own error, the same for every receiver of this normal, cancels here; what an own plane hides does not.
    let whole = if plane == normal { total(&weight_sum) } else { PI };
    let scale = PI / whole;
    let bent = Vec3::from_array(bent.each_ref().map(total));
    let lamps = raster.lamp_irradiance();
    Diffuse {
        surface_irradiance: std::array::from_fn(|c| total(&surface[c]) * scale + lamps[c]),
        environment_irradiance: distant.each_ref().map(|s| total(s) * scale),
        ambient_occlusion: (total(&open_sum) * scale / PI).clamp(0.0, 1.0),
        sky_visibility: (total(&sky) / table.sky_sum_sr).clamp(0.0, 1.0),
        bent_normal: if bent.length_squared() > 1e-12 { bent.normalize() } else { normal },
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use pbgi_raster::{Ink, Lanes, Section, SimdLevel, Veil, WideKernel, run_wide};

    fn normals() -> impl Iterator<Item = Vec3> {
        (0..200u32).map(|i| {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 200.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize()
        })
    }

    #[test]
    fn quadrature_of_the_cosine_is_of_second_order() {
        for n in [4usize, 8, 16] {
            // Second order in the texel's size.
            let tolerance = 0.2 / (n * n) as f32;
            let table = CubeRasterTable::new(n);
            let sums = ConvolutionTable::new(&table, Vec3::Z);
            for normal in normals() {
                let total: f32 = (0..table.texels().len())
                    .map(|i| {
                        let (chunk, lane) = (&sums.chunks[i / LANES], i % LANES);
                        let along = |planes| dot(planes, normal)[lane];
                        let reach = along(&chunk.reach_u).abs() + along(&chunk.reach_v).abs();
                        clamped_weight(along(&chunk.vector), reach)
                    })
                    .sum();
                assert!((total / PI - 1.0).abs() < tolerance, "{n} {normal}: {}", total / PI);
            }
        }
    }

    /// Empties the raster for a normal and draws planes at distance 1, in boxes, with radiance 3.
    pub(crate) struct Draw<'a>(pub &'a mut CubeRaster, pub Vec3, pub &'a [(Vec3, Vec3, Vec3)]);

    impl WideKernel for Draw<'_> {
        type Output = ();

        fn run<L: Lanes>(self) {
            let (veil, radiance) = (Veil::OPAQUE, [3.0; 3]);
            let ink = Ink { veil, radiance, solid_angle: 1.0, tolerance: 0.01, ..Ink::default() };
            self.0.clear::<L>(self.1);
            for &(inverse, low, high) in self.2 {
                self.0.look_at_box(low, high);
                self.0.draw::<L, _>(&Section::new(inverse, low, high), &ink, low + high);
            }
            self.0.resolve::<L>();
        }
    }

    #[test]
    fn an_open_uniform_sky_gives_pi() {
        let table = CubeRasterTable::new(8);
        let sky = EnvironmentTexels::new(&table, &vec![[2.0, 1.0, 0.5]; 384 * SAMPLES]);
        let mut raster = CubeRaster::new(&table, true);
        for normal in normals() {
            run_wide(SimdLevel::Baseline, Draw(&mut raster, normal, &[]));
            let sums = ConvolutionTable::new(&table, normal);
            let found = convolve_diffuse(&raster, &sums, Some(&sky), [normal; 2]);
            assert!((found.environment_irradiance[0] / (2.0 * PI) - 1.0).abs() < 1e-4);
            assert!((found.ambient_occlusion - 1.0).abs() < 1e-4);
            assert!(found.bent_normal.dot(normal) > 0.9999, "{}", found.bent_normal.dot(normal));
            assert!(found.sky_visibility > 0.93);
        }
    }

    /// A wall beside the receiver, wide without end, whose edge is seen at the angle θ above the horizon, hides (1 − cos θ)/2, wherever in its texel the
    /// edge lies.
    #[test]
    fn walls_of_any_height_hide_what_they_should() {
        let table = CubeRasterTable::new(8);
        let sums = ConvolutionTable::new(&table, Vec3::Z);
        let mut raster = CubeRaster::new(&table, true);
        let (mut error_sum, mut worst) = (0.0, 0.0f32);
        for step in 1..=40 {
            let height = 0.05 * step as f32;
            let wall = (Vec3::X, Vec3::new(0.9, -2000.0, -1.0), Vec3::new(1.1, 2000.0, height));
            run_wide(SimdLevel::Baseline, Draw(&mut raster, Vec3::Z, &[wall]));
            let found = convolve_diffuse(&raster, &sums, None, [Vec3::Z; 2]);
            let hidden = 0.5 * (1.0 - 1.0 / (1.0 + height * height).sqrt());
            let error = found.ambient_occlusion - (1.0 - hidden);
            let light = found.surface_irradiance[0] / (3.0 * PI) - hidden;
            assert!((error + light).abs() < 1e-3, "what is not open shines: {error} {light}");
            error_sum += error;
            worst = worst.max(error.abs());
        }
        let bias = error_sum / 40.0;
        assert!(bias.abs() < 3e-4 && worst < 0.005, "{bias} {worst}");
    }

    #[test]
    fn a_sky_covered_by_half_gives_half() {
        let table = CubeRasterTable::new(8);
        let sums = ConvolutionTable::new(&table, Vec3::Y);
        let mut raster = CubeRaster::new(&table, true);
        // A wall over everything with x > 0, shining with radiance 3.
        let walls = [
            (Vec3::Y, Vec3::new(0.0, 0.9, -50.0), Vec3::new(50.0, 1.1, 50.0)),
            (Vec3::X, Vec3::new(0.9, 0.0, -50.0), Vec3::new(1.1, 50.0, 50.0)),
            (Vec3::Z, Vec3::new(0.0, 0.0, 0.9), Vec3::new(50.0, 50.0, 1.1)),
            (Vec3::NEG_Z, Vec3::new(0.0, 0.0, -1.1), Vec3::new(50.0, 50.0, -0.9)),
        ];
        run_wide(SimdLevel::Baseline, Draw(&mut raster, Vec3::Y, &walls));
        // Texels whose samples see the sky each by itself, or as one.
        let found = [384 * SAMPLES, 384].map(|count| {
            let sky = EnvironmentTexels::new(&table, &vec![[1.0; 3]; count]);
            convolve_diffuse(&raster, &sums, Some(&sky), [Vec3::Y; 2])
        });
        assert_eq!(found[0], found[1]);
        let [found, _] = found;
        assert!((found.ambient_occlusion - 0.5).abs() < 0.01, "{found:?}");
        assert!((found.environment_irradiance[0] - PI / 2.0).abs() < 0.03);
        assert!((found.surface_irradiance[0] - 3.0 * PI / 2.0).abs() < 0.06);
        assert!((found.sky_visibility - 0.5).abs() < 0.01);
        assert!(found.bent_normal.x < -0.4);
    }

    /// Under a lid that is drawn away, a glare as wide as a sample's cell is seen from where the lid's edge passes it, not by the share of its texel
    /// that is open.
    #[test]
    fn a_glare_smaller_than_a_texel_is_seen_where_it_is() {
        let (table, fine) = (CubeRasterTable::new(8), CubeMap::new(32));
        let sums = ConvolutionTable::new(&table, Vec3::Z);
        let glare = 0.0625..0.125;
        let shines = |d: Vec3| d.z > d.x.abs().max(d.y.abs()) && glare.contains(&(d.x / d.z));
        let cells = (0..fine.texel_count()).map(|i| fine.texel(i));
        let light = |texel: &CubeTexel| if shines(texel.direction) { texel.vector.z } else { 0.0 };
        let whole: f32 = cells.clone().map(|texel| light(&texel)).sum();
        let texels = cells.map(|texel| [f32::from(shines(texel.direction)); 3]);
        let sky = EnvironmentTexels::new(&table, &texels.collect::<Vec<_>>());
        let mut raster = CubeRaster::new(&table, true);
        for (edge, share) in [(-0.1, 1.0), (0.03, 1.0), (0.0625, 1.0), (0.125, 0.0), (0.2, 0.0)] {
            let lid = (Vec3::Z, Vec3::new(-50.0, -50.0, 0.9), Vec3::new(edge, 50.0, 1.1));
            run_wide(SimdLevel::Baseline, Draw(&mut raster, Vec3::Z, &[lid]));
            let found = convolve_diffuse(&raster, &sums, Some(&sky), [Vec3::Z; 2]);
            let seen = found.environment_irradiance[0] / whole;
            assert!((seen - share).abs() < 0.02, "{edge}: {seen} of {share}");
        }
    }
}
