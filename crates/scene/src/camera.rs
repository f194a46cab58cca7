//! Rays through pixels, projection, matrices for image metadata, and a camera that frames a box.

use crate::Camera;
use pbgi_math::{Aabb, Affine3A, Mat4, Vec2, Vec3, Vec4};

/// A camera and the raster it exposes.
///
/// Raster coordinates are in pixels, `u` to the right and `v` down from the top left corner of the
/// image: pixel (column, row) covers `column..column + 1 × row..row + 1`.
#[derive(Clone, Debug)]
pub struct CameraView {
    /// The camera.
    pub camera: Camera,
    /// Pixels along a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// The pyramid a camera sees: four planes through the eye.
#[derive(Clone, Copy, Debug)]
pub struct Frustum {
    /// Position of the eye.
    pub eye: Vec3,
    /// Unit inward normals of the planes at the left, right, top and bottom of the image.
    pub normals: [Vec3; 4],
}

impl Frustum {
    /// Whether a sphere touches the pyramid; may answer yes for one just outside an edge of it.
    #[must_use]
    pub fn touches_sphere(&self, center: Vec3, radius: f32) -> bool {
        self.normals.iter().all(|normal| normal.dot(center - self.eye) >= -radius)
    }
}

impl CameraView {
    /// Position of the eye in world space.
    #[must_use]
    pub fn eye(&self) -> Vec3 {
        self.camera.transform.translation.into()
    }

    /// Unit direction of the view axis in world space.
    #[must_use]
    pub fn forward(&self) -> Vec3 {
        (-self.camera.transform.matrix3.z_axis).into()
    }

    /// Half extent of the image on the plane at distance 1: along the row, then along the column.
    #[must_use]
    pub fn half_extent(&self) -> Vec2 {
        let vertical = (self.camera.yfov * 0.5).tan();
        Vec2::new(vertical * self.width as f32 / self.height as f32, vertical)
    }

    /// World direction through the raster position `(u, v)`, scaled to one unit along the view
    /// axis, so that eye + depth · direction has that depth.
    #[must_use]
    pub fn direction(&self, u: f32, v: f32) -> Vec3 {
        let half = self.half_extent();
        let x = (2.0 * u / self.width as f32 - 1.0) * half.x;
        let y = (1.0 - 2.0 * v / self.height as f32) * half.y;
        self.camera.transform.transform_vector3(Vec3::new(x, y, -1.0))
    }

    /// Origin and unit direction of the ray through the raster position `(u, v)`.
    #[must_use]
    pub fn ray(&self, u: f32, v: f32) -> (Vec3, Vec3) {
        (self.eye(), self.direction(u, v).normalize())
    }

    /// Raster position and depth along the view axis of a point; `None` when it is not in front of
    /// the eye.
    #[must_use]
    pub fn project(&self, point: Vec3) -> Option<(Vec2, f32)> {
        let local = self.world_to_camera().transform_point3(point);
        let depth = -local.z;
        if depth <= 0.0 {
            return None;
        }
        let half = self.half_extent();
        let u = (local.x / (depth * half.x) + 1.0) * 0.5 * self.width as f32;
        let v = (1.0 - local.y / (depth * half.y)) * 0.5 * self.height as f32;
        Some((Vec2::new(u, v), depth))
    }

    /// From world to camera space, which looks down −Z with +Y up; acts on column vectors.
    #[must_use]
    pub fn world_to_camera(&self) -> Mat4 {
        Mat4::from(self.camera.transform.inverse())
    }

    /// From world to normalized device coordinates in RenderMan's sense: after division by w, x
    /// runs 0..=1 from left to right and y 0..=1 from top to bottom of the image. There is no far
    /// plane: z is 1 − 1/depth. Acts on column vectors.
    #[must_use]
    pub fn world_to_ndc(&self) -> Mat4 {
        let half = self.half_extent();
        let projection = Mat4::from_cols(
            Vec4::new(0.5 / half.x, 0.0, 0.0, 0.0),
            Vec4::new(0.0, -0.5 / half.y, 0.0, 0.0),
            Vec4::new(-0.5, -0.5, -1.0, -1.0),
            Vec4::new(0.0, 0.0, -1.0, 0.0),
        );
        projection * self.world_to_camera()
    }

    /// The pyramid this view sees.
    #[must_use]
    pub fn frustum(&self) -> Frustum {
        let half = self.half_extent();
        let to_world = |normal: Vec3| self.camera.transform.transform_vector3(normal).normalize();
        Frustum {
            eye: self.eye(),
            normals: [
                to_world(Vec3::new(1.0, 0.0, -half.x)),
                to_world(Vec3::new(-1.0, 0.0, -half.x)),
                to_world(Vec3::new(0.0, -1.0, -half.y)),
                to_world(Vec3::new(0.0, 1.0, -half.y)),
            ],
        }
    }
}

impl Camera {
    /// A three-quarter view of `bounds` from a little above, far enough back that the whole box
    /// lies in an image of `aspect` = width / height. `up` is a unit axis, `yfov` the full vertical
    /// field of view in radians. An empty or unbounded box is framed like a unit cube at the
    /// origin.
    #[must_use]
    pub fn framing(bounds: &Aabb, up: Vec3, aspect: f32, yfov: f32) -> Self {
        let unit = Aabb { min: Vec3::splat(-0.5), max: Vec3::splat(0.5) };
        let usable = !bounds.is_empty() && bounds.extent().is_finite();
        let bounds = if usable { *bounds } else { unit };
        let side = up.any_orthonormal_vector();
        let front = side.cross(up);
        let toward_eye = (side * 0.6 + front * 0.8 + up * 0.45).normalize();
        let mut camera = Self::look_at(bounds.center() + toward_eye, bounds.center(), up, yfov);
        let rotation = camera.transform.matrix3.transpose();
        let vertical = (yfov * 0.5).tan() * FRAMING_FILL;
        let horizontal = vertical * aspect;
        // The eye steps back until each corner lies inside the four planes of the shrunk frustum.
        let mut distance = 0f32;
        for corner in 0..8u32 {
            let pick = |axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
            let offset = bounds.extent() * Vec3::new(pick(0), pick(1), pick(2));
            let local: Vec3 = rotation * offset;
            let reach = (local.x.abs() / horizontal).max(local.y.abs() / vertical);
            distance = distance.max(local.z + reach);
        }
        let distance = if distance > 0.0 { distance } else { 1.0 };
        camera.transform = Affine3A::from_mat3_translation(
            camera.transform.matrix3.into(),
            bounds.center() + toward_eye * distance,
        );
        camera
    }
}

/// Part of the image a framed box may fill, in each direction.
const FRAMING_FILL: f32 = 0.92;

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> CameraView {
        let camera =
            Camera::look_at(Vec3::new(3.0, 2.0, 5.0), Vec3::new(-1.0, 0.5, 0.0), Vec3::Y, 0.8);
        CameraView { camera, width: 640, height: 360 }
    }

    #[test]
    fn rays_and_projection_agree() {
        let view = view();
        for (u, v, depth) in [(0.0, 0.0, 1.0), (320.0, 180.0, 7.0), (639.5, 12.25, 0.3)] {
            let point = view.eye() + view.direction(u, v) * depth;
            let (raster, found) = view.project(point).unwrap();
            assert!((raster - Vec2::new(u, v)).abs().max_element() < 0.02, "{raster} {u} {v}");
            assert!((found / depth - 1.0).abs() < 1e-4);
        }
        assert!(view.project(view.eye() - view.forward()).is_none());
        // v grows downward.
        let above = view.eye() + view.forward() * 2.0 + Vec3::Y * 0.1;
        assert!(view.project(above).unwrap().0.y < 180.0);
    }

    #[test]
    fn ndc_matrix_matches_projection() {
        let view = view();
        for point in [Vec3::ZERO, Vec3::new(-2.0, 1.0, 0.4), Vec3::new(0.0, -3.0, -6.0)] {
            let ndc = view.world_to_ndc() * point.extend(1.0);
            let (raster, depth) = view.project(point).unwrap();
            assert!((ndc.x / ndc.w * 640.0 - raster.x).abs() < 1e-2);
            assert!((ndc.y / ndc.w * 360.0 - raster.y).abs() < 1e-2);
            assert!((ndc.w / depth - 1.0).abs() < 1e-4);
            assert!((ndc.z / ndc.w - (1.0 - 1.0 / depth)).abs() < 1e-4);
        }
    }

    #[test]
    fn frustum_keeps_what_projects_into_the_image() {
        let view = view();
        let frustum = view.frustum();
        for i in 0..2000u32 {
            let f = |k: u32| (i * k % 997) as f32 / 997.0 * 16.0 - 8.0;
            let point = Vec3::new(f(31), f(57), f(101));
            let inside = view
                .project(point)
                .is_some_and(|(p, _)| p.x >= 0.0 && p.x <= 640.0 && p.y >= 0.0 && p.y <= 360.0);
            assert_eq!(frustum.touches_sphere(point, 0.0), inside, "{point}");
        }
    }

    #[test]
    fn framed_box_lies_in_the_image() {
        for (min, max, up) in [
            (Vec3::new(-5.0, 0.0, -1.0), Vec3::new(9.0, 1.0, 2.0), Vec3::Y),
            (Vec3::new(0.0, 0.0, 0.0), Vec3::new(1.0, 1.0, 40.0), Vec3::Z),
            (Vec3::ONE, Vec3::ONE, Vec3::Y),
        ] {
            let camera = Camera::framing(&Aabb { min, max }, up, 16.0 / 9.0, 0.7);
            let view = CameraView { camera, width: 160, height: 90 };
            for corner in 0..8u32 {
                let pick = |axis: u32| corner >> axis & 1 == 0;
                let p = Vec3::new(
                    if pick(0) { min.x } else { max.x },
                    if pick(1) { min.y } else { max.y },
                    if pick(2) { min.z } else { max.z },
                );
                let (raster, _) = view.project(p).expect("in front");
                assert!(raster.x > 0.0 && raster.x < 160.0 && raster.y > 0.0 && raster.y < 90.0);
            }
        }
        let nothing = Camera::framing(&Aabb::EMPTY, Vec3::Y, 1.0, 0.7);
        assert!(nothing.transform.is_finite());
    }
}
