//! From world space to edge functions over the raster.

use super::tiles::PixelRect;
use crate::CameraView;
use pbgi_math::{DVec3, Vec3};

/// World to camera space and camera space to raster, in double precision.
#[derive(Clone, Debug)]
pub(super) struct Projector {
    eye: DVec3,
    axes: [DVec3; 3],
    /// Half extent of the image on the plane at distance 1.
    half: [f64; 2],
    /// That extent per pixel.
    step: [f64; 2],
}

impl Projector {
    pub fn new(view: &CameraView) -> Self {
        let matrix = view.camera.transform.matrix3;
        let axis = |column: Vec3| column.as_dvec3();
        let vertical = (f64::from(view.camera.yfov) * 0.5).tan();
        let half = [vertical * f64::from(view.width) / f64::from(view.height), vertical];
        Self {
            eye: view.eye().as_dvec3(),
            axes: [
                axis(matrix.x_axis.into()),
                axis(matrix.y_axis.into()),
                axis(matrix.z_axis.into()),
            ],
            half,
            step: [2.0 * half[0] / f64::from(view.width), 2.0 * half[1] / f64::from(view.height)],
        }
    }

    /// A direction in camera space, its third coordinate turned so that depth is positive.
    pub fn turn(&self, direction: DVec3) -> DVec3 {
        let [x, y, z] = self.axes;
        DVec3::new(x.dot(direction), y.dot(direction), -z.dot(direction))
    }

    /// A point as (right, up, depth).
    pub fn point(&self, world: Vec3) -> DVec3 {
        self.turn(world.as_dvec3() - self.eye)
    }

    /// Raster position of a point at positive depth.
    pub fn raster(&self, local: DVec3) -> [f64; 2] {
        [
            (local.x / local.z + self.half[0]) / self.step[0],
            (self.half[1] - local.y / local.z) / self.step[1],
        ]
    }

    /// Camera-space direction of depth 1 through a raster position.
    pub fn direction(&self, raster: [f64; 2]) -> DVec3 {
        DVec3::new(
            raster[0] * self.step[0] - self.half[0],
            self.half[1] - raster[1] * self.step[1],
            1.0,
        )
    }

    /// Length in pixels of a unit vector at depth 1, along the row and along the column.
    pub fn pixels_per_unit(&self) -> [f64; 2] {
        [1.0 / self.step[0], 1.0 / self.step[1]]
    }

    /// The linear function `normal · direction(u, v)` over the raster. Odd in `normal` to the last
    /// bit: each of its roundings is.
    fn linear(&self, normal: DVec3) -> Linear {
        Linear {
            u: normal.x * self.step[0],
            v: -(normal.y * self.step[1]),
            constant: normal.y * self.half[1] - normal.x * self.half[0] + normal.z,
        }
    }
}

/// A linear function of the raster position: `u·x + (v·y + constant)`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Linear {
    pub u: f64,
    pub v: f64,
    pub constant: f64,
}

impl Linear {
    /// Value at a pixel's top left corner.
    #[inline]
    pub fn at_pixel(&self, x: u32, y: u32) -> f64 {
        self.u * f64::from(x) + (self.v * f64::from(y) + self.constant)
    }

    /// What a sample offset adds to it.
    #[inline]
    pub fn at_offset(&self, offset: [f64; 2]) -> f64 {
        self.u * offset[0] + self.v * offset[1]
    }

    fn scaled(&self, factor: f64) -> Self {
        Self { u: self.u * factor, v: self.v * factor, constant: self.constant * factor }
    }
}

/// A triangle on the screen: homogeneous edge functions, one per vertex (Olano and Greer, "Triangle
/// Scan Conversion using 2D Homogeneous Coordinates", 1997), so that nothing needs clipping.
///
/// With camera-space vertices a, b, c the edge function of a is `(b × c)·d` for the sample's
/// direction d; divided by `a·(b × c)` the three are the barycentric coordinates over depth. The
/// triangle is hit where none is negative. Two triangles that share an edge compute the same
/// function with opposite sign, bit for bit, so no sample falls between them.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScreenTriangle {
    pub edges: [Linear; 3],
    pub inverse_determinant: f64,
    /// Whether the camera sees the front, where the vertices run counterclockwise.
    pub front: bool,
}

impl ScreenTriangle {
    /// Edge functions of three camera-space vertices; `None` for a triangle seen edge-on.
    pub fn new(projector: &Projector, [a, b, c]: [DVec3; 3]) -> Option<Self> {
        let normals = [b.cross(c), c.cross(a), a.cross(b)];
        let determinant = a.dot(normals[0]);
        if determinant == 0.0 || !determinant.is_finite() {
            return None;
        }
        let sign = determinant.signum();
        Some(Self {
            edges: normals.map(|normal| projector.linear(normal).scaled(sign)),
            inverse_determinant: 1.0 / determinant.abs(),
            // Camera space is left-handed here (right, up, depth): a front shows a positive one.
            front: determinant > 0.0,
        })
    }

    /// Barycentric coordinates over depth, at a sample of a pixel; their sum is 1/depth.
    #[inline]
    pub fn weights(&self, x: u32, y: u32, offset: [f64; 2]) -> [f64; 3] {
        self.edges
            .map(|edge| (edge.at_pixel(x, y) + edge.at_offset(offset)) * self.inverse_determinant)
    }
}

/// Pixels within `within` that a camera-space triangle may touch: the box of its part in front of
/// the eye. `None` if there is none.
pub(super) fn screen_box(
    projector: &Projector,
    vertices: &[DVec3; 3],
    within: &PixelRect,
) -> Option<PixelRect> {
    let deepest = vertices[0].z.max(vertices[1].z).max(vertices[2].z);
    let finite = vertices.iter().all(|vertex| vertex.is_finite());
    if !finite || deepest <= 0.0 {
        return None;
    }
    // What is a billionth as deep as the deepest vertex or nearer may go unseen.
    let near = deepest * 1e-9;
    let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut include = |point: DVec3| {
        let raster = projector.raster(point);
        for axis in 0..2 {
            min[axis] = min[axis].min(raster[axis]);
            max[axis] = max[axis].max(raster[axis]);
        }
    };
    for i in 0..3 {
        let (a, b) = (vertices[i], vertices[(i + 1) % 3]);
        if a.z >= near {
            include(a);
        }
        if (a.z >= near) != (b.z >= near) {
            let mut cut = a + (b - a) * ((near - a.z) / (b.z - a.z));
            cut.z = near;
            include(cut);
        }
    }
    let rect = within.clamp_box(min, max);
    (!rect.is_empty()).then_some(rect)
}
