//! What a node's surfels show toward every direction: the truth that forms are judged by.

use pbgi_build::{LobeSum, NodeAggregate};
use pbgi_cloud::Surfel;
use pbgi_math::{SH_COUNT, Vec3, clamped_cosine_sh, evaluate_sh_basis};
use std::f32::consts::PI;

/// Directions the forms are compared in.
const DIRECTIONS: u32 = 512;

/// Area, and intensity of three channels.
pub const FUNCTIONS: usize = 4;

/// The functions of a node toward each direction.
pub type Shown = Vec<[f32; FUNCTIONS]>;

/// Coefficients of each function.
pub type Harmonics = [[f32; SH_COUNT]; FUNCTIONS];

/// Directions spread evenly over the sphere, with the harmonics there.
pub struct Sphere {
    pub directions: Vec<Vec3>,
    pub basis: Vec<[f32; SH_COUNT]>,
}

impl Sphere {
    pub fn new() -> Self {
        let direction = |i: u32| {
            let z = 1.0 - (2.0 * i as f32 + 1.0) / DIRECTIONS as f32;
            let (sin, cos) = (2.399_963_2 * i as f32).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            Vec3::new(radius * cos, radius * sin, z)
        };
        let directions: Vec<Vec3> = (0..DIRECTIONS).map(direction).collect();
        let basis = directions.iter().map(|d| evaluate_sh_basis(*d)).collect();
        Self { directions, basis }
    }
}

/// A node: what its surfels show, exactly, and what forms are fitted to.
pub struct Target {
    /// Area of its surfels.
    pub area: f64,
    pub exact: Shown,
    /// Its first nine harmonics, exactly.
    pub harmonics: Harmonics,
    /// As the build sums them.
    pub lobes: Vec<LobeSum>,
}

impl Target {
    pub fn new(surfels: &[Surfel], node: &NodeAggregate, sphere: &Sphere) -> Self {
        let mut exact = vec![[0.0; FUNCTIONS]; sphere.directions.len()];
        for surfel in surfels {
            let [front, back] = weights(surfel);
            let normal = surfel.normal();
            for (shown, d) in exact.iter_mut().zip(&sphere.directions) {
                let cosine = normal.dot(*d);
                // An isotropic surfel shows half its area everywhere.
                let seen = if surfel.is_isotropic() { 0.5 } else { cosine.max(0.0) };
                let behind = (-cosine).max(0.0);
                for f in 0..FUNCTIONS {
                    shown[f] += front[f] * seen + back[f] * behind;
                }
            }
        }
        let harmonics = harmonics_of(surfels);
        Self { area: node.area, exact, harmonics, lobes: node.lobes.to_vec() }
    }
}

/// What the functions get from the front and from the back of a surfel, per cosine.
fn weights(surfel: &Surfel) -> [[f32; FUNCTIONS]; 2] {
    let [r, g, b] = surfel.radiance;
    let blocks_back = !surfel.is_isotropic() && !surfel.is_front_only();
    let back = if blocks_back { surfel.area } else { 0.0 };
    [[1.0, r, g, b].map(|x| x * surfel.area), [back, 0.0, 0.0, 0.0]]
}

/// The first nine harmonics of what surfels show.
pub fn harmonics_of(surfels: &[Surfel]) -> Harmonics {
    let mut sums = [[0f64; SH_COUNT]; FUNCTIONS];
    for surfel in surfels {
        let [front, back] = weights(surfel);
        let (seen, behind) = if surfel.is_isotropic() {
            let mut even = [0.0; SH_COUNT];
            // Half everywhere: the integral of the first harmonic is √4π.
            even[0] = 0.5 * (4.0 * PI).sqrt();
            (even, [0.0; SH_COUNT])
        } else {
            (clamped_cosine_sh(surfel.normal()), clamped_cosine_sh(-surfel.normal()))
        };
        for f in 0..FUNCTIONS {
            for i in 0..SH_COUNT {
                sums[f][i] += f64::from(front[f] * seen[i] + back[f] * behind[i]);
            }
        }
    }
    sums.map(|sum| sum.map(|c| c as f32))
}
