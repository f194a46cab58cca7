//! Where light comes from, drawn by its power: pixels of an environment, triangles that emit.

use pbgi_image::RgbImage;
use pbgi_math::Vec3;
use std::f64::consts::{PI, TAU};

/// An equirectangular image, up along +Y, whose pixels are areas of even radiance.
pub struct SkyImage {
    image: RgbImage,
}

/// A direction of the environment.
#[derive(Clone, Copy, Debug)]
pub struct SkySample {
    /// Unit direction.
    pub direction: Vec3,
    /// Its radiance.
    pub radiance: [f32; 3],
    /// Probability per steradian with which it was drawn.
    pub density: f32,
}

impl SkyImage {
    /// The sky of an image.
    #[must_use]
    pub fn new(image: RgbImage) -> Self {
        Self { image }
    }

    /// Row and column of a unit direction.
    fn pixel(&self, direction: Vec3) -> (usize, usize) {
        let image = &self.image;
        let theta = f64::from(direction.y.clamp(-1.0, 1.0)).acos();
        let phi = f64::from(direction.x).atan2(f64::from(-direction.z)).rem_euclid(TAU);
        let row = ((theta / PI * image.height as f64) as usize).min(image.height - 1);
        let column = ((phi / TAU * image.width as f64) as usize).min(image.width - 1);
        (row, column)
    }

    /// Radiance of a unit direction.
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> [f32; 3] {
        let (row, column) = self.pixel(direction);
        self.image.pixels[row * self.image.width + column]
    }

    /// Solid angle of the pixels of a row.
    fn pixel_sr(&self, row: usize) -> f64 {
        let edge = |row: usize| (PI * row as f64 / self.image.height as f64).cos();
        TAU / self.image.width as f64 * (edge(row) - edge(row + 1))
    }
}

/// Chooses among weights: index by a number in 0..1.
struct Choice {
    /// Sums of the weights up to each, the last one 1.
    sums: Vec<f64>,
}

impl Choice {
    /// None if no weight is above 0.
    fn new(weights: impl Iterator<Item = f64>) -> Option<Self> {
        let mut total = 0.0;
        let mut sums: Vec<f64> = weights
            .map(|w| {
                total += w;
                total
            })
            .collect();
        sums.iter_mut().for_each(|sum| *sum /= total);
        (total > 0.0).then_some(Self { sums })
    }

    fn probability(&self, index: usize) -> f64 {
        self.sums[index] - index.checked_sub(1).map_or(0.0, |before| self.sums[before])
    }

    /// The index, and where within its share the number lies, 0..1.
    fn pick(&self, number: f64) -> (usize, f64) {
        let last = self.sums.len() - 1;
        let index = self.sums.partition_point(|&sum| sum <= number).min(last);
        let start = index.checked_sub(1).map_or(0.0, |before| self.sums[before]);
        let width = self.sums[index] - start;
        (index, if width > 0.0 { ((number - start) / width).clamp(0.0, 1.0) } else { 0.5 })
    }
}

/// Draws pixels of an environment by their light: a row, then a column.
pub struct EnvironmentSampler<'a> {
    sky: &'a SkyImage,
    rows: Choice,
    columns: Vec<Option<Choice>>,
}

impl<'a> EnvironmentSampler<'a> {
    /// None if the sky is black.
    #[must_use]
    pub fn new(sky: &'a SkyImage) -> Option<Self> {
        let image = &sky.image;
        let light = |rgb: &[f32; 3]| f64::from(rgb.iter().sum::<f32>());
        let rows: Vec<&[[f32; 3]]> = image.pixels.chunks(image.width.max(1)).collect();
        let columns = rows.iter().map(|row| Choice::new(row.iter().map(light))).collect();
        let sum = |(row, pixels): (usize, &&[[f32; 3]])| {
            pixels.iter().map(light).sum::<f64>() * sky.pixel_sr(row)
        };
        Some(Self { sky, rows: Choice::new(rows.iter().enumerate().map(sum))?, columns })
    }

    fn density(&self, row: usize, column: usize) -> f32 {
        let Some(columns) = &self.columns[row] else { return 0.0 };
        let probability = self.rows.probability(row) * columns.probability(column);
        (probability / self.sky.pixel_sr(row)) as f32
    }

    /// A direction by two numbers in 0..1.
    #[must_use]
    pub fn sample(&self, numbers: [f32; 2]) -> SkySample {
        let image = &self.sky.image;
        let (row, down) = self.rows.pick(f64::from(numbers[0]));
        let columns = self.columns[row].as_ref();
        let (column, right) = columns.map_or((0, 0.5), |c| c.pick(f64::from(numbers[1])));
        // Evenly over the pixel's area on the sphere.
        let edge = |row: usize| (PI * row as f64 / image.height as f64).cos();
        let y = edge(row) + (edge(row + 1) - edge(row)) * down;
        let (sin, cos) = (TAU * (column as f64 + right) / image.width as f64).sin_cos();
        let radius = (1.0 - y * y).max(0.0).sqrt();
        SkySample {
            direction: Vec3::new((sin * radius) as f32, y as f32, (-cos * radius) as f32),
            radiance: image.pixels[row * image.width + column],
            density: self.density(row, column),
        }
    }

    /// Radiance of a unit direction, and the density with which it is drawn.
    #[must_use]
    pub fn look_up(&self, direction: Vec3) -> ([f32; 3], f32) {
        let (row, column) = self.sky.pixel(direction);
        (self.sky.radiance(direction), self.density(row, column))
    }
}

/// Draws triangles by their power.
pub struct EmitterSampler {
    choice: Choice,
}

impl EmitterSampler {
    /// None if no power is above 0.
    #[must_use]
    pub fn new(powers: &[f32]) -> Option<Self> {
        Some(Self { choice: Choice::new(powers.iter().map(|&p| f64::from(p)))? })
    }

    /// A triangle by a number in 0..1.
    #[must_use]
    pub fn sample(&self, number: f32) -> usize {
        self.choice.pick(f64::from(number)).0
    }

    /// The probability of a triangle.
    #[must_use]
    pub fn probability(&self, triangle: usize) -> f32 {
        self.choice.probability(triangle) as f32
    }
}
