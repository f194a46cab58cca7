//! An ambient cube: a value for each of six directions, weighted by the squares of the direction's coordinates.

use crate::harmonics::{mean_radiance, round_size};
use crate::target::{FUNCTIONS, Shown, Sphere};
use pbgi_math::{Vec3, luminance};

type Sides = [f32; 6];

/// Weights of the six sides toward a direction; they sum to 1.
fn weights(d: Vec3) -> Sides {
    let axis = |i: usize, sign: f32| if d[i] * sign > 0.0 { d[i] * d[i] } else { 0.0 };
    [axis(0, 1.0), axis(0, -1.0), axis(1, 1.0), axis(1, -1.0), axis(2, 1.0), axis(2, -1.0)]
}

/// Fits cubes to functions by least squares.
pub struct CubeFit {
    weights: Vec<Sides>,
    /// Inverse of the sums of products of two weights.
    inverse: [[f64; 6]; 6],
}

impl CubeFit {
    pub fn new(sphere: &Sphere) -> Self {
        let weights: Vec<Sides> = sphere.directions.iter().map(|d| weights(*d)).collect();
        let mut gram = [[0f64; 6]; 6];
        for w in &weights {
            for i in 0..6 {
                for j in 0..6 {
                    gram[i][j] += f64::from(w[i] * w[j]);
                }
            }
        }
        Self { weights, inverse: invert(gram) }
    }

    /// The best sides for a function given toward all directions, none negative, in 16 bits for the largest and 8 for the share of it.
    fn sides(&self, values: impl Iterator<Item = f32>) -> Sides {
        let mut right = [0f64; 6];
        for (w, value) in self.weights.iter().zip(values) {
            for i in 0..6 {
                right[i] += f64::from(w[i] * value);
            }
        }
        let side = |row: &[f64; 6]| row.iter().zip(right).map(|(a, b)| a * b).sum::<f64>() as f32;
        let sides = self.inverse.each_ref().map(side);
        let largest = round_size(sides.into_iter().fold(0.0, f32::max));
        let step = largest.max(f32::MIN_POSITIVE) / 255.0;
        sides.map(|s| (s / step).round().clamp(0.0, 255.0) * step)
    }

    fn show(&self, cubes: [Sides; FUNCTIONS]) -> Shown {
        let value = |w: &Sides, sides: &Sides| w.iter().zip(sides).map(|(w, s)| w * s).sum();
        self.weights.iter().map(|w| cubes.each_ref().map(|sides| value(w, sides))).collect()
    }

    /// A cube for each function.
    pub fn show_all(&self, exact: &Shown) -> Shown {
        let cube = |f: usize| self.sides(exact.iter().map(|shown| shown[f]));
        self.show(std::array::from_fn(cube))
    }

    /// A cube for area, one for luminance, and one color for all directions.
    pub fn show_one_color(&self, exact: &Shown) -> Shown {
        let light = |&[_, r, g, b]: &[f32; FUNCTIONS]| luminance([r, g, b]);
        let sum = |f: fn(&[f32; FUNCTIONS]) -> f32| exact.iter().map(|s| f64::from(f(s))).sum();
        let mean_light: f64 = exact.iter().map(|s| f64::from(light(s))).sum();
        let totals: [f64; FUNCTIONS] = [sum(|s| s[0]), sum(|s| s[1]), sum(|s| s[2]), sum(|s| s[3])];
        let color = mean_radiance(totals.map(|x| x as f32));
        let scale = totals[0] / mean_light.max(f64::MIN_POSITIVE);
        let shape = self.sides(exact.iter().map(|s| (f64::from(light(s)) * scale) as f32));
        let area = self.sides(exact.iter().map(|s| s[0]));
        self.show([
            area,
            shape.map(|s| s * color[0]),
            shape.map(|s| s * color[1]),
            shape.map(|s| s * color[2]),
        ])
    }
}

/// Inverse of a positive definite matrix, by elimination.
fn invert(mut a: [[f64; 6]; 6]) -> [[f64; 6]; 6] {
    let mut inverse = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    for pivot in 0..6 {
        let scale = 1.0 / a[pivot][pivot];
        for j in 0..6 {
            a[pivot][j] *= scale;
            inverse[pivot][j] *= scale;
        }
        let (row, other): ([f64; 6], [f64; 6]) = (a[pivot], inverse[pivot]);
        for i in (0..6).filter(|i| *i != pivot) {
            let factor = a[i][pivot];
            for j in 0..6 {
                a[i][j] -= factor * row[j];
                inverse[i][j] -= factor * other[j];
            }
        }
    }
    inverse
}
