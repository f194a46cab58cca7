//! Surfels of plain shapes.

use crate::scenes::Random;
use pbgi_cloud::Surfel;
use pbgi_math::Vec3;
use std::f32::consts::PI;

/// A disk that shines from its front.
pub fn disk(center: Vec3, normal: Vec3, radius: f32, radiance: f32) -> Surfel {
    Surfel::new(center, normal, radius, PI * radius * radius).with_radiance([radiance; 3])
}

/// A rectangle of these edges, the first along `along`.
pub fn tile(center: Vec3, normal: Vec3, along: Vec3, [a, b]: [f32; 2], radiance: f32) -> Surfel {
    let (long_edge, aspect) = if a >= b { (along, a / b) } else { (normal.cross(along), b / a) };
    let radius = 0.5 * (a * a + b * b).sqrt();
    let surfel = Surfel::new(center, normal, radius, a * b).with_radiance([radiance; 3]);
    surfel.with_tile(long_edge, aspect)
}

/// A rectangle of these half edges along `u` and `normal` × `u`, of so many tiles each way.
pub fn sheet(
    center: Vec3,
    normal: Vec3,
    u: Vec3,
    half: [f32; 2],
    counts: [usize; 2],
    radiance: f32,
) -> impl Iterator<Item = Surfel> {
    let v = normal.cross(u);
    let edges = [0, 1].map(|axis| 2.0 * half[axis] / counts[axis] as f32);
    let place = move |i: usize, axis: usize| (i as f32 + 0.5) * edges[axis] - half[axis];
    (0..counts[0] * counts[1]).map(move |i| {
        let at = center + u * place(i % counts[0], 0) + v * place(i / counts[0], 1);
        tile(at, normal, u, edges, radiance)
    })
}

/// Random numbers, places and directions, the same for a seed.
pub struct Chance(Random);

impl Chance {
    /// From a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(Random(seed))
    }

    /// From −1 to 1.
    pub fn signed(&mut self) -> f32 {
        2.0 * self.0.unit() - 1.0
    }

    /// In the cube around the origin with edge 2.
    pub fn place(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }

    /// Even over the sphere.
    pub fn direction(&mut self) -> Vec3 {
        let (z, turn) = (self.signed(), PI * self.signed());
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * turn.cos(), r * turn.sin(), z).normalize()
    }
}

/// Disks of random place, direction and radiance in the cube of edge 2.
pub fn crowd(count: usize, radius: f32, seed: u64) -> Vec<Surfel> {
    let mut chance = Chance::new(seed);
    let mut some = || {
        let (place, normal) = (chance.place(), chance.direction());
        disk(place, normal, radius * (1.5 + chance.signed()), 1.0 + chance.signed())
    };
    (0..count).map(|_| some()).collect()
}
