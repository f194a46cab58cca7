//! Where in a pixel the samples lie.

/// Largest supported number of samples per pixel.
pub(super) const SAMPLES_MAX: usize = 16;

/// Sample positions inside a pixel, the same in every pixel.
#[derive(Clone, Debug)]
pub(super) struct SamplePattern {
    /// Offsets from the pixel's top left corner, 0..1.
    pub offsets: Vec<[f64; 2]>,
}

impl SamplePattern {
    /// Pattern of 1, 4, 8 or 16 samples; `None` for other counts.
    ///
    /// Hammersley points with the top bit of the radical inverse flipped: a (0, m, 2)-net, so that
    /// each row, column and dyadic box holds equally many samples. For 4 this is the rotated grid.
    pub fn new(samples: u32) -> Option<Self> {
        if !matches!(samples, 1 | 4 | 8 | 16) {
            return None;
        }
        let bits = samples.trailing_zeros();
        let place = |step: u32| (f64::from(step) + 0.5) / f64::from(samples);
        let offsets = (0..samples).map(|i| {
            let inverse = if bits == 0 { 0 } else { i.reverse_bits() >> (32 - bits) };
            [place(i), place(inverse ^ (samples / 2))]
        });
        Some(Self { offsets: offsets.collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_stratified_and_centered() {
        for count in [1u32, 4, 8, 16] {
            let pattern = SamplePattern::new(count).unwrap();
            assert_eq!(pattern.offsets.len(), count as usize);
            for axis in 0..2 {
                let mut cells: Vec<u32> =
                    pattern.offsets.iter().map(|o| (o[axis] * f64::from(count)) as u32).collect();
                cells.sort_unstable();
                assert_eq!(cells, (0..count).collect::<Vec<_>>());
                let mean = pattern.offsets.iter().map(|o| o[axis]).sum::<f64>() / f64::from(count);
                assert!((mean - 0.5).abs() < 1e-12);
            }
            // Each box of 1/a × a/count holds one sample.
            for a in [1, 2, 4, 8].into_iter().filter(|a| *a <= count) {
                let of = |o: &[f64; 2]| {
                    ((o[0] * f64::from(a)) as u32, (o[1] * f64::from(count / a)) as u32)
                };
                let boxes: std::collections::HashSet<(u32, u32)> =
                    pattern.offsets.iter().map(of).collect();
                assert_eq!(boxes.len(), count as usize, "{count} {a}");
            }
        }
        assert!(SamplePattern::new(2).is_none() && SamplePattern::new(0).is_none());
    }
}
