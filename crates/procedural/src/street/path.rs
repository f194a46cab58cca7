//! The line the street follows and the land around it.

use pbgi_math::{Affine3A, Mat3, Vec3};

/// Half the width of the road, in meters.
pub(super) const ROAD_HALF: f32 = 3.6;
/// From the middle of the road to the facades.
pub(super) const FACADE: f32 = 6.6;
/// Height of the curb.
pub(super) const CURB: f32 = 0.15;
/// From the middle of the road to where open land begins.
pub(super) const LOT_END: f32 = 21.0;
/// Where the street begins, in meters along it; the camera stands near 0.
pub(super) const START: f32 = -36.0;

const STEP: f32 = 0.5;

/// A road that sets out along −Z, bends to the left and climbs.
pub(super) struct StreetPath {
    points: Vec<Station>,
}

#[derive(Clone, Copy)]
struct Station {
    position: Vec3,
    heading: f32,
}

impl StreetPath {
    /// A path from [`START`] to `end`.
    pub fn new(end: f32) -> Self {
        let mut points = Vec::new();
        let mut position = Vec3::new(0.0, height_along(START), -START);
        let mut heading = 0f32;
        let count = ((end - START) / STEP) as u32 + 1;
        for i in 0..=count {
            points.push(Station { position, heading });
            let s = START + i as f32 * STEP;
            heading += smooth(14.0, 50.0, s) * STEP / 105.0;
            position += Vec3::new(-heading.sin(), 0.0, -heading.cos()) * STEP;
            position.y = height_along(s + STEP);
        }
        Self { points }
    }

    /// Frame at distance `s` along the street: X to the right, Y up, −Z ahead, origin in the middle
    /// of the road.
    pub fn frame(&self, s: f32) -> Affine3A {
        let place = ((s - START) / STEP).clamp(0.0, (self.points.len() - 1) as f32);
        let first = (place as usize).min(self.points.len() - 2);
        let (a, b) = (self.points[first], self.points[first + 1]);
        let t = place - first as f32;
        let heading = a.heading + (b.heading - a.heading) * t;
        let turn = Mat3::from_rotation_y(heading);
        Affine3A::from_mat3_translation(turn, a.position.lerp(b.position, t))
    }

    /// World position at distance `s` along, `offset` to the right of the middle, `rise` above it.
    pub fn point(&self, s: f32, offset: f32, rise: f32) -> Vec3 {
        self.frame(s).transform_point3(Vec3::new(offset, rise, 0.0))
    }

    /// Height of the road's middle.
    pub fn height(&self, s: f32) -> f32 {
        height_along(s)
    }

    /// Height of the open land. It lies under the street and its lots and rolls up to hills.
    pub fn land_height(&self, x: f32, z: f32) -> f32 {
        let here = Vec3::new(x, 0.0, z);
        let flat = |p: Vec3| Vec3::new(p.x, 0.0, p.z);
        let (nearest, distance2) = self.points.iter().fold((Vec3::ZERO, f32::MAX), |best, s| {
            let distance2 = flat(s.position).distance_squared(here);
            if distance2 < best.1 { (s.position, distance2) } else { best }
        });
        let distance = distance2.sqrt();
        let bank = nearest.y - 0.5;
        bank + (hills(x, z) - bank) * smooth(LOT_END + 4.0, 190.0, distance)
    }
}

/// Height of the road at distance `s`: level at first, then a climb of up to 6 %.
fn height_along(s: f32) -> f32 {
    0.03 * (s + (s * s + 1600.0).sqrt()) - 1.2
}

/// Rolling land that rises to a ring of hills.
fn hills(x: f32, z: f32) -> f32 {
    let r = (x * x + z * z).sqrt();
    let wave = |a: f32, b: f32, phase: f32| (x * a + z * b + phase).sin();
    let rolling = 3.0 * wave(0.011, 0.007, 0.3) + 2.0 * wave(-0.006, 0.017, 1.9) + 2.0;
    let angle = z.atan2(x);
    let ridge = 0.62
        + 0.22 * (angle * 3.0 + 0.8).sin()
        + 0.14 * (angle * 7.0 + 2.1 + r * 0.001).sin()
        + 0.07 * (angle * 17.0 + r * 0.003).sin();
    let near_ring = smooth(220.0, 800.0, r) * ridge * 62.0;
    let far_ring = smooth(900.0, 2600.0, r) * (1.25 - ridge) * 210.0;
    rolling + near_ring + far_ring
}

/// Cubic step from 0 at `low` to 1 at `high`.
pub(super) fn smooth(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
