//! Analytic scenes made of surfels.

use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::{Frame, Vec3};
use std::f32::consts::SQRT_2;

/// Directions spread evenly over the sphere (a Fibonacci spiral).
pub fn sphere_directions(count: u32) -> impl Iterator<Item = Vec3> {
    (0..count).map(move |i| {
        let z = -1.0 + 2.0 * (i as f32 + 0.5) / count as f32;
        let phi = (f64::from(i) * 2.399_963_229_728_653 % std::f64::consts::TAU) as f32;
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize()
    })
}

/// What surfels of a wall know of themselves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfelForm {
    /// Area and covering radius.
    Disks,
    /// The rectangle they stand for.
    Rectangles,
}

/// The inside of a box of the given half-extents: `per_edge²` rectangular surfels on each wall, facing
/// inward, all with the same radiance. In it `E = πL` everywhere.
#[must_use]
pub fn closed_room(half: Vec3, per_edge: usize, radiance: f32, form: SurfelForm) -> Vec<Surfel> {
    let mut surfels = Vec::with_capacity(6 * per_edge * per_edge);
    for axis in 0..3 {
        let (ua, va) = ((axis + 1) % 3, (axis + 2) % 3);
        let (du, dv) = (2.0 * half[ua] / per_edge as f32, 2.0 * half[va] / per_edge as f32);
        for side in [-1.0f32, 1.0] {
            let mut normal = Vec3::ZERO;
            normal[axis] = -side;
            for i in 0..per_edge * per_edge {
                let mut center = Vec3::ZERO;
                center[axis] = side * half[axis];
                center[ua] = -half[ua] + ((i % per_edge) as f32 + 0.5) * du;
                center[va] = -half[va] + ((i / per_edge) as f32 + 0.5) * dv;
                let radius = 0.5 * (du * du + dv * dv).sqrt();
                let disk =
                    Surfel::new(center, normal, radius, du * dv).with_radiance([radiance; 3]);
                let (long, aspect) = if du > dv { (ua, du / dv) } else { (va, dv / du) };
                surfels.push(match form {
                    SurfelForm::Disks => disk,
                    SurfelForm::Rectangles => disk.with_tile(Vec3::AXES[long], aspect),
                });
            }
        }
    }
    surfels
}

/// Small closed boxes and double-sided cards of random place, orientation and radiance in a cube of
/// edge 2 around the origin, from a fixed seed: one square surfel for each side of a box and of a card.
#[must_use]
pub fn random_objects(count: usize, half_edge: f32, seed: u64) -> Vec<Surfel> {
    let mut random = Random(seed);
    let mut surfels = Vec::with_capacity(4 * count);
    for i in 0..count {
        let center = Vec3::new(random.unit(), random.unit(), random.unit()) * 2.0 - 1.0;
        let z = 2.0 * random.unit() - 1.0;
        let (sin, cos) = (random.unit() * std::f32::consts::TAU).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        let frame = Frame::from_normal(Vec3::new(r * cos, r * sin, z).normalize());
        let half = half_edge * (0.5 + random.unit());
        let radiance = [random.unit() * 4.0, random.unit(), 0.3];
        let mut add = |normal: Vec3, offset: f32, flags: SurfelFlags| {
            surfels.push(
                Surfel::new(center + normal * offset, normal, half * SQRT_2, 4.0 * half * half)
                    .with_radiance(radiance)
                    .with_flags(flags),
            );
        };
        if i % 2 == 0 {
            for axis in [frame.tangent, frame.bitangent, frame.normal] {
                add(axis, half, SurfelFlags::default());
                add(-axis, half, SurfelFlags::default());
            }
        } else {
            add(frame.normal, 0.0, SurfelFlags::FRONT_ONLY);
            add(-frame.normal, 0.0, SurfelFlags::FRONT_ONLY);
        }
    }
    surfels
}

/// SplitMix64 (Steele, Lea, Flood 2014).
pub(crate) struct Random(pub u64);

impl Random {
    /// From 0 to 1.
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }
}
