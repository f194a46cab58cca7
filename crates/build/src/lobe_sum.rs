//! Sums over surfels of similar normals and radiance.

use pbgi_cloud::Surfel;
use pbgi_format::Lobe;
use pbgi_math::{Aabb, DVec3, Vec3, section_area};

/// Surfels of similar normals and radiance, summed in f64. See [`Lobe`] for the function it stands for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeSum {
    /// `Σ aᵢ nᵢ`.
    pub vector: DVec3,
    /// `Σ aᵢ`; twice the area for isotropic surfels, which show half of it to *every* direction.
    pub area: f64,
    /// `Σ aᵢ xᵢ`, area counted as in `area`.
    pub moment: DVec3,
    /// `Σ aᵢ Lᵢ`, area counted as in `area`.
    pub flux: [f64; 3],
    /// Whether backs block.
    pub blocks_back: bool,
    /// Of sheets, `Σ aᵢ zᵢ²` with the heights `zᵢ` of the surfels over the plane through their centroid; 0 where backs block.
    pub scatter: f64,
}

/// Scatter of heights, over the square of how far the box reaches along the normal, from which on the leaves of a lobe lie above each other:
/// half the box's depth on the mean, a quarter of that of leaves spread evenly.
const MIXED_SCATTER: f64 = 1.0 / 12.0;

/// How many leaves lie above each other where there is one on the mean: 1 where they lie at random, more in clumps. Measured on foliage.
const CLUMPING: f64 = 1.5;

/// Area of a surfel as lobes count it: see [`LobeSum::area`].
pub(crate) fn lobe_area(surfel: &Surfel) -> f64 {
    f64::from(surfel.area) * if surfel.is_isotropic() { 2.0 } else { 1.0 }
}

impl LobeSum {
    /// The lobe of one surfel, whose normal was decoded before.
    #[must_use]
    pub fn from_surfel(surfel: &Surfel, normal: Vec3) -> Self {
        let (isotropic, area) = (surfel.is_isotropic(), lobe_area(surfel));
        Self {
            vector: if isotropic { DVec3::ZERO } else { normal.as_dvec3() * area },
            area,
            moment: surfel.center().as_dvec3() * area,
            flux: surfel.radiance.map(|c| f64::from(c) * area),
            blocks_back: !isotropic && !surfel.is_front_only(),
            scatter: 0.0,
        }
    }

    /// Adds another lobe.
    pub fn add(&mut self, other: &Self) {
        if !self.blocks_back {
            self.scatter += other.scatter + self.scatter_between(other);
        }
        self.vector += other.vector;
        self.area += other.area;
        self.moment += other.moment;
        for (sum, part) in self.flux.iter_mut().zip(other.flux) {
            *sum += part;
        }
    }

    /// What [`Self::scatter`] of the sum of two lobes is more than the sum of theirs, as their planes lie apart: Steiner's theorem.
    fn scatter_between(&self, other: &Self) -> f64 {
        let (a, b) = (self.area, other.area);
        let normal = (self.vector + other.vector).normalize_or_zero();
        let apart = normal.dot(self.moment / a - other.moment / b);
        a * b / (a + b) * apart * apart
    }

    /// Mean radiance.
    pub(crate) fn radiance(&self) -> [f32; 3] {
        self.flux.map(|f| (f / self.area) as f32)
    }

    /// The stored form, in a node whose stored box is `bounds`.
    #[must_use]
    pub fn to_lobe(self, bounds: &Aabb) -> Lobe {
        let length = self.vector.length();
        let (mut height, mut fill) = (0.0, 1.0);
        if length > 0.0 {
            let normal = self.vector / length;
            let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
            let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
            // A flat box has some thickness: normals scatter, and its corners are rounded.
            let half = half.max(DVec3::splat(1e-3 * half.max_element()));
            let reach = normal.abs().dot(half).max(f64::MIN_POSITIVE);
            height = (normal.dot(self.moment / self.area - center) / reach).clamp(-1.0, 1.0);
            let section = section_area(half, normal, height * reach);
            let layers = length / section.max(f64::MIN_POSITIVE);
            // Leaves in one plane lie side by side; at all heights of the box they cover it as random clumps do.
            let mixed = (self.scatter / (self.area * reach * reach) / MIXED_SCATTER).min(1.0);
            let clumped = (1.0 - (-CLUMPING * layers).exp()) / CLUMPING;
            fill = layers.min(1.0) * (1.0 - mixed) + clumped * mixed;
        }
        Lobe {
            vector: self.vector.as_vec3(),
            width: solve_width(length, self.area) as f32,
            blocks_back: self.blocks_back,
            radiance: self.radiance(),
            height: height as f32,
            fill: fill as f32,
        }
    }
}

/// The width `h` with which a lobe of vector area `length` shows the mean area of its surfels.
///
/// The mean of `A` over the sphere is `½ ∫₀¹ √(length² c² + h²) dc` and must be `area/4`. The integral is
/// `½ (√(l² + h²) + (h²/l) asinh(l/h))`; it rises with `h`, from `l/2` at 0, with the slope `(h/l) asinh(l/h)`, and is convex: Newton's
/// steps from above the root stay above it. `½ √(area² − l²)` is above.
fn solve_width(length: f64, area: f64) -> f64 {
    let target = area / 2.0;
    if length >= area * (1.0 - 1e-6) {
        return 0.0;
    }
    if length <= area * 1e-6 {
        return target;
    }
    let mut width = 0.5 * (area * area - length * length).sqrt();
    for _ in 0..NEWTON_STEPS_MAX {
        let slope = width / length * (length / width).asinh();
        let mean = 0.5 * ((length * length + width * width).sqrt() + width * slope);
        let step = (mean - target) / slope;
        width -= step;
        if step <= NEWTON_ACCURACY * area {
            break;
        }
    }
    width.max(0.0)
}

/// Most steps; four suffice.
const NEWTON_STEPS_MAX: usize = 8;

/// Step, as a share of the area, after which the width is accurate to the square of that.
const NEWTON_ACCURACY: f64 = 1e-7;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_show_the_mean_area() {
        let ratios = (1..1000).map(|i| f64::from(i) / 1000.0);
        for ratio in ratios.chain([1e-9, 1e-5, 0.9999, 0.999_99, 0.999_998]) {
            let (area, length) = (3.0, 3.0 * ratio);
            let h = solve_width(length, area);
            // The mean over the sphere, by the midpoint rule.
            let steps = 4000;
            let shown = |i: u32| {
                let along = length * (f64::from(i) + 0.5) / f64::from(steps);
                (along * along + h * h).sqrt()
            };
            let mean = 0.5 * (0..steps).map(shown).sum::<f64>() / f64::from(steps);
            assert!((mean / (area / 4.0) - 1.0).abs() < 1e-7, "{ratio}: {h}, {mean}");
        }
    }
}
