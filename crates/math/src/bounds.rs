//! Axis-aligned boxes and cones of directions.

use glam::Vec3;

/// An axis-aligned box. Empty when any `min` component exceeds its `max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Smallest corner.
    pub min: Vec3,
    /// Largest corner.
    pub max: Vec3,
}

/// The empty box.
impl Default for Aabb {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Aabb {
    /// The box that holds nothing; the neutral element of [`Aabb::union`].
    pub const EMPTY: Self =
        Self { min: Vec3::splat(f32::INFINITY), max: Vec3::splat(f32::NEG_INFINITY) };

    /// Smallest box around `points`.
    #[must_use]
    pub fn from_points(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |aabb, p| aabb.with_point(p))
    }

    /// Tight box of a disk: along each axis it reaches `radius·√(1 − nᵢ²)` from the center.
    #[must_use]
    #[inline]
    pub fn from_disk(center: Vec3, normal: Vec3, radius: f32) -> Self {
        let reach = (Vec3::ONE - normal * normal).max(Vec3::ZERO).map(f32::sqrt) * radius;
        Self { min: center - reach, max: center + reach }
    }

    /// Whether the box holds no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        !(self.min.cmple(self.max).all())
    }

    /// Smallest box around this one and `point`.
    #[must_use]
    #[inline]
    pub fn with_point(self, point: Vec3) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Smallest box around both.
    #[must_use]
    #[inline]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Box grown by `margin` on every side.
    #[must_use]
    #[inline]
    pub fn inflated(self, margin: f32) -> Self {
        Self { min: self.min - Vec3::splat(margin), max: self.max + Vec3::splat(margin) }
    }

    /// Midpoint.
    #[must_use]
    #[inline]
    pub fn center(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }

    /// Edge lengths.
    #[must_use]
    #[inline]
    pub fn extent(&self) -> Vec3 {
        self.max - self.min
    }

    /// Whether `point` lies in the closed box.
    #[must_use]
    pub fn contains(&self, point: Vec3) -> bool {
        self.min.cmple(point).all() && point.cmple(self.max).all()
    }

    /// Whether `other` lies in the closed box.
    #[must_use]
    pub fn contains_box(&self, other: &Self) -> bool {
        self.min.cmple(other.min).all() && other.max.cmple(self.max).all()
    }
}

/// A cone of directions around a unit axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Unit direction in the middle of the cone.
    pub axis: Vec3,
    /// Cosine of the half-angle.
    pub cos_half_angle: f32,
}

impl Cone {
    /// Solid angle in steradians, `2π (1 − cos θ)`.
    #[must_use]
    pub fn solid_angle(&self) -> f32 {
        2.0 * std::f32::consts::PI * (1.0 - self.cos_half_angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disk_box_touches_the_disk_on_every_side() {
        let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
        let center = Vec3::new(1.0, 2.0, 3.0);
        let aabb = Aabb::from_disk(center, normal, 0.7);
        let tangent = normal.any_orthonormal_vector();
        let bitangent = normal.cross(tangent);
        let rim = (0..4096).map(|i| {
            let (sin, cos) = (i as f32 * std::f32::consts::TAU / 4096.0).sin_cos();
            center + (tangent * cos + bitangent * sin) * 0.7
        });
        let sampled = Aabb::from_points(rim);
        assert!((sampled.min - aabb.min).abs().max_element() < 1e-5);
        assert!((sampled.max - aabb.max).abs().max_element() < 1e-5);
    }

    #[test]
    fn empty_box_is_neutral() {
        let aabb = Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE };
        assert!(Aabb::EMPTY.is_empty());
        assert_eq!(Aabb::EMPTY.union(aabb), aabb);
    }
}
