//! Building scenes from boxes, strips and cylinders.

use pbgi_math::{Affine3A, Vec3};
use pbgi_scene::{Camera, Instance, Material, Mesh, Scene};
use std::f32::consts::TAU;

/// A material of the scene under construction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Paint(u32);

/// A tint that leaves the paint as it is.
pub(super) const PLAIN: [f32; 3] = [1.0; 3];

/// A scene under construction: one flat and one smooth mesh per material.
#[derive(Debug, Default)]
pub(super) struct SceneBuilder {
    materials: Vec<Material>,
    flat: Vec<Mesh>,
    smooth: Vec<Mesh>,
}

impl SceneBuilder {
    /// A matte, single-sided material.
    pub fn paint(&mut self, name: &str, base_color: [f32; 3]) -> Paint {
        self.add(Material { name: name.to_owned(), base_color, ..Material::default() })
    }

    /// A matte, single-sided material of a backdrop, diced `factor` times as coarsely as others.
    pub fn coarse_paint(&mut self, name: &str, base_color: [f32; 3], factor: f32) -> Paint {
        let name = name.to_owned();
        self.add(Material { name, base_color, spacing_factor: factor, ..Material::default() })
    }

    /// A matte material seen and lit from both sides.
    pub fn cloth(&mut self, name: &str, base_color: [f32; 3]) -> Paint {
        let name = name.to_owned();
        self.add(Material { name, base_color, double_sided: true, ..Material::default() })
    }

    /// A black material that emits radiance (W·m⁻²·sr⁻¹) from its front.
    pub fn lamp(&mut self, name: &str, emission: [f32; 3]) -> Paint {
        let name = name.to_owned();
        self.add(Material { name, base_color: [0.0; 3], emission, ..Material::default() })
    }

    fn add(&mut self, material: Material) -> Paint {
        let index = self.materials.len() as u32;
        self.materials.push(material);
        for list in [&mut self.flat, &mut self.smooth] {
            list.push(Mesh { material: index, ..Mesh::default() });
        }
        Paint(index)
    }

    /// Draws in the coordinates of `frame`, which must not mirror.
    pub fn pen(&mut self, frame: Affine3A) -> Pen<'_> {
        Pen { builder: self, frame }
    }

    /// The scene of all meshes that have triangles.
    pub fn finish(self, camera: Camera) -> Scene {
        let mut scene = Scene { materials: self.materials, ..Scene::default() };
        for mesh in self.flat.into_iter().chain(self.smooth) {
            if !mesh.triangles.is_empty() {
                let mesh_index = scene.meshes.len() as u32;
                scene.instances.push(Instance { mesh: mesh_index, transform: Affine3A::IDENTITY });
                scene.meshes.push(mesh);
            }
        }
        scene.cameras.push(camera);
        scene
    }
}

/// Draws into a [`SceneBuilder`] in local coordinates.
pub(super) struct Pen<'a> {
    builder: &'a mut SceneBuilder,
    frame: Affine3A,
}

impl Pen<'_> {
    /// A pen for coordinates nested in these.
    pub fn within(&mut self, frame: Affine3A) -> Pen<'_> {
        Pen { frame: self.frame * frame, builder: self.builder }
    }

    /// A convex polygon, counterclockwise seen from the front; pieces without area are left out.
    pub fn polygon(&mut self, paint: Paint, tint: [f32; 3], corners: &[Vec3]) {
        let mesh = &mut self.builder.flat[paint.0 as usize];
        let first = mesh.positions.len() as u32;
        let world: Vec<Vec3> =
            corners.iter().map(|corner| self.frame.transform_point3(*corner)).collect();
        let mut used = false;
        for i in 2..world.len() {
            let (a, b, c) = (world[0], world[i - 1], world[i]);
            if (b - a).cross(c - a).length_squared() > 1e-16 {
                mesh.triangles.push([first, first + i as u32 - 1, first + i as u32]);
                used = true;
            }
        }
        if used {
            mesh.colors.extend(std::iter::repeat_n(tint, world.len()));
            mesh.positions.extend(world);
        }
    }

    /// A rectangle from a corner along two edges; its front is where `edge_a × edge_b` points.
    pub fn rectangle(&mut self, paint: Paint, corner: Vec3, edge_a: Vec3, edge_b: Vec3) {
        let corners = [corner, corner + edge_a, corner + edge_a + edge_b, corner + edge_b];
        self.polygon(paint, PLAIN, &corners);
    }

    /// A box between two corners.
    pub fn block(&mut self, paint: Paint, min: Vec3, max: Vec3) {
        self.tinted_block(paint, PLAIN, min, max);
    }

    /// A box between two corners with a tint.
    pub fn tinted_block(&mut self, paint: Paint, tint: [f32; 3], min: Vec3, max: Vec3) {
        let corner = |i: usize| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { min[axis] } else { max[axis] };
            Vec3::new(pick(0), pick(1), pick(2))
        };
        for face in
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
        {
            self.polygon(paint, tint, &face.map(corner));
        }
    }

    /// A smooth tapered tube through `rings` of (center, radius), open at both ends.
    pub fn tube(&mut self, paint: Paint, tint: [f32; 3], rings: &[(Vec3, f32)], sides: u32) {
        let (Some(first), Some(last)) = (rings.first(), rings.last()) else { return };
        let axis = (last.0 - first.0).try_normalize().unwrap_or(Vec3::Y);
        let side = axis.any_orthonormal_vector();
        let across = axis.cross(side);
        let mesh = &mut self.builder.smooth[paint.0 as usize];
        let start = mesh.positions.len() as u32;
        for (center, radius) in rings {
            for k in 0..sides {
                let (sin, cos) = (k as f32 / sides as f32 * TAU).sin_cos();
                let out = side * cos + across * sin;
                mesh.positions.push(self.frame.transform_point3(*center + out * *radius));
                mesh.normals.push(self.frame.transform_vector3(out).normalize());
                mesh.colors.push(tint);
            }
        }
        for ring in 0..rings.len() as u32 - 1 {
            for k in 0..sides {
                let at = |r: u32, k: u32| start + (ring + r) * sides + k % sides;
                let [a, b, c, d] = [at(0, k), at(0, k + 1), at(1, k + 1), at(1, k)];
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }

    /// A flat disk of `sides` corners facing `normal`.
    pub fn disk(&mut self, paint: Paint, center: Vec3, normal: Vec3, radius: f32, sides: u32) {
        let side = normal.any_orthonormal_vector();
        let across = normal.cross(side);
        let rim: Vec<Vec3> = (0..sides)
            .map(|k| {
                let (sin, cos) = (k as f32 / sides as f32 * TAU).sin_cos();
                center + (side * cos + across * sin) * radius
            })
            .collect();
        self.polygon(paint, PLAIN, &rim);
    }

    /// A smooth ellipsoid with `rows` bands of latitude and twice as many of longitude.
    pub fn ellipsoid(
        &mut self,
        paint: Paint,
        tint: [f32; 3],
        center: Vec3,
        radii: Vec3,
        rows: u32,
    ) {
        let mesh = &mut self.builder.smooth[paint.0 as usize];
        let start = mesh.positions.len() as u32;
        let columns = rows * 2;
        let mut add = |unit: Vec3| {
            mesh.positions.push(self.frame.transform_point3(center + unit * radii));
            mesh.normals.push(self.frame.transform_vector3(unit / radii).normalize());
            mesh.colors.push(tint);
        };
        add(Vec3::Y);
        for row in 1..rows {
            let (sin, cos) = (row as f32 / rows as f32 * TAU * 0.5).sin_cos();
            for column in 0..columns {
                let (s, c) = (column as f32 / columns as f32 * TAU).sin_cos();
                add(Vec3::new(sin * s, cos, sin * c));
            }
        }
        add(Vec3::NEG_Y);
        let bottom = start + 1 + (rows - 1) * columns;
        let at = |row: u32, column: u32| start + 1 + (row - 1) * columns + column % columns;
        for column in 0..columns {
            mesh.triangles.push([start, at(1, column), at(1, column + 1)]);
            for row in 1..rows - 1 {
                let [a, b] = [at(row, column), at(row + 1, column)];
                let [c, d] = [at(row + 1, column + 1), at(row, column + 1)];
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
            mesh.triangles.push([bottom, at(rows - 1, column + 1), at(rows - 1, column)]);
        }
    }

    /// A smooth strip between rows of points of equal length; its front is where
    /// `along the row × to the next row` points. Rows hold (position, tint).
    pub fn surface(&mut self, paint: Paint, rows: &[Vec<(Vec3, [f32; 3])>]) {
        let mesh = &mut self.builder.smooth[paint.0 as usize];
        let start = mesh.positions.len();
        let width = rows.first().map_or(0, Vec::len);
        for (position, tint) in rows.iter().flatten() {
            mesh.positions.push(self.frame.transform_point3(*position));
            mesh.normals.push(Vec3::ZERO);
            mesh.colors.push(*tint);
        }
        for row in 1..rows.len() {
            for column in 1..width {
                let at = |r: usize, c: usize| start + (row - 1 + r) * width + column - 1 + c;
                let [a, b, c, d] = [at(0, 0), at(0, 1), at(1, 1), at(1, 0)];
                for triangle in [[a, b, c], [a, c, d]] {
                    let [p, q, r] = triangle.map(|vertex| mesh.positions[vertex]);
                    let normal = (q - p).cross(r - p);
                    if normal.length_squared() > 1e-16 {
                        triangle.iter().for_each(|vertex| mesh.normals[*vertex] += normal);
                        mesh.triangles.push(triangle.map(|vertex| vertex as u32));
                    }
                }
            }
        }
        for normal in &mut mesh.normals[start..] {
            *normal = normal.try_normalize().unwrap_or(Vec3::Y);
        }
    }
}
