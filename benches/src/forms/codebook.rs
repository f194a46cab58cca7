//! A codebook of shapes, as in quantized point-based global illumination: the means of clusters of nodes.

use crate::harmonics::{Ratios, Shapes};

/// Rounds of Lloyd's algorithm.
const ROUNDS: usize = 6;

/// Numbers of a shape, a power of two.
const NUMBERS: usize = 2 * size_of::<Ratios>() / size_of::<f32>();

type Entry = [f32; NUMBERS];

/// Shapes of which a node names the nearest.
pub struct Codebook {
    entries: Vec<Entry>,
}

fn to_entry(shapes: &Shapes) -> Entry {
    let half = NUMBERS / 2;
    std::array::from_fn(|i| if i < half { shapes.area[i] } else { shapes.light[i - half] })
}

fn to_shapes(entry: &Entry) -> Shapes {
    let (area, light) = entry.split_at(NUMBERS / 2);
    Shapes { area: std::array::from_fn(|i| area[i]), light: std::array::from_fn(|i| light[i]) }
}

impl Codebook {
    /// The book of at most `size` entries that Lloyd's algorithm finds, from shapes spread evenly over those given.
    pub fn learn(shapes: &[Shapes], size: usize) -> Self {
        let samples: Vec<Entry> = shapes.iter().map(to_entry).collect();
        let size = size.min(samples.len());
        let start = (0..size).map(|i| samples[i * samples.len() / size]);
        let mut book = Self { entries: start.collect() };
        for _ in 0..ROUNDS {
            let mut sums = vec![([0f64; NUMBERS], 0u32); size];
            for sample in &samples {
                let (sum, count) = &mut sums[book.nearest(sample)];
                sum.iter_mut().zip(sample).for_each(|(sum, x)| *sum += f64::from(*x));
                *count += 1;
            }
            for (entry, (sum, count)) in book.entries.iter_mut().zip(&sums) {
                if *count > 0 {
                    *entry = sum.map(|x| (x / f64::from(*count)) as f32);
                }
            }
        }
        book
    }

    /// The entry nearest to a shape: harmonics are orthonormal, so that this is the nearest function.
    pub fn look_up(&self, shapes: &Shapes) -> Shapes {
        to_shapes(&self.entries[self.nearest(&to_entry(shapes))])
    }

    fn nearest(&self, sample: &Entry) -> usize {
        let mut best = (f32::INFINITY, 0);
        for (i, entry) in self.entries.iter().enumerate() {
            let mut squares: Entry = std::array::from_fn(|k| (entry[k] - sample[k]).powi(2));
            // Summed by halves, which runs on wide registers.
            let mut half = NUMBERS / 2;
            while half > 0 {
                for k in 0..half {
                    squares[k] += squares[k + half];
                }
                half /= 2;
            }
            if squares[0] < best.0 {
                best = (squares[0], i);
            }
        }
        best.1
    }
}
