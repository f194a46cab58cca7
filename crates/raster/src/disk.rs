//! Near disks: intersected with the directions of each texel.

use crate::cube::{CubeRaster, Ink, LANE_NUMBERS, LANES, SOLID_WHOLE};
use crate::footprint::project_box;
use pbgi_math::{Aabb, CubeFace, Vec3};

/// An oriented disk near the receiver, relative to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    /// Center relative to the receiver.
    pub center: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Radius.
    pub radius: f32,
}

/// How a disk is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiskInk {
    /// Share of the light from behind that the disk blocks, 0..=1.
    pub opacity: f32,
    /// Does nothing where it is seen from behind.
    pub front_only: bool,
    /// Is a piece of a solid thing's surface, see [`crate::Splat::solid`].
    pub solid: bool,
    /// Radiance of the front.
    pub radiance: [f32; 3],
}

/// Directions per texel edge that are tested.
const SAMPLES: usize = 4;

impl CubeRaster {
    /// Draws a disk exactly: each texel's coverage is the share of 4 × 4 directions in it that meet
    /// the disk farther than `distance_min` away. Facing disks shine, others are black.
    #[inline(always)]
    pub fn draw_disk(&mut self, disk: &Disk, style: &DiskInk, distance_min: f32) {
        let height = disk.center.dot(disk.normal);
        // The front faces the receiver where the receiver lies on its normal's side.
        let facing = height < 0.0;
        if height == 0.0 || (style.front_only && !facing) {
            return;
        }
        let (front, back) = if facing { (style.opacity, 0.0) } else { (0.0, style.opacity) };
        let distance = disk.center.length();
        let (near, far) = (distance - disk.radius, distance + disk.radius);
        let whole = if style.solid { SOLID_WHOLE } else { 1.0 };
        let ink = Ink { front, back, whole, radiance: style.radiance, near, far };
        let aabb = Aabb::from_disk(disk.center, disk.normal, disk.radius);
        if aabb.contains(Vec3::ZERO) {
            // The receiver is within the box: any face may see the disk.
            for face in CubeFace::ALL {
                self.draw_disk_on(
                    disk,
                    height,
                    face,
                    ((0, self.edge() - 1), (0, self.edge() - 1)),
                    &ink,
                    distance_min,
                );
            }
            return;
        }
        let (rectangles, count) = project_box(aabb.min, aabb.max);
        for r in &rectangles[..count] {
            let range = self.texel_range(r);
            self.draw_disk_on(disk, height, CubeFace(r.face), range, &ink, distance_min);
        }
    }

    #[inline(always)]
    fn draw_disk_on(
        &mut self,
        disk: &Disk,
        height: f32,
        face: CubeFace,
        (columns, rows): ((usize, usize), (usize, usize)),
        ink: &Ink,
        distance_min: f32,
    ) {
        let n = self.edge();
        let [ua, va] = face.uv_axes();
        let (axis, sign) = (face.axis(), face.sign());
        let step = 2.0 / (n * SAMPLES) as f32;
        // A direction D = (±1, u, v) meets the plane at t = h / (n·D); the point is on the disk where |tD − c|² ≤ r². With
        // D·D = 1 + u² + v² and linear n·D and c·D, multiplied by (n·D)²:
        // h² D·D − 2 h (c·D)(n·D) + (|c|² − r²)(n·D)² ≤ 0.
        let slack = disk.center.length_squared() - disk.radius * disk.radius;
        let (na, nu, nv) = (disk.normal[axis] * sign, disk.normal[ua], disk.normal[va]);
        let (ca, cu, cv) = (disk.center[axis] * sign, disk.center[ua], disk.center[va]);
        let near2 = distance_min * distance_min;
        for row in rows.0..=rows.1 {
            let row_index = usize::from(face.0) * n + row;
            if self.row_is_closed(row_index) {
                continue;
            }
            for chunk in columns.0 / LANES..=columns.1 / LANES {
                let mut weights = [0.0f32; LANES];
                for i in 0..SAMPLES {
                    let v = -1.0 + ((row * SAMPLES + i) as f32 + 0.5) * step;
                    let (n_row, c_row, d_row) = (na + nv * v, ca + cv * v, 1.0 + v * v);
                    for j in 0..SAMPLES {
                        let column = (chunk * LANES * SAMPLES + j) as u32 as f32;
                        let first = -1.0 + (column + 0.5) * step;
                        for (lane, weight) in weights.iter_mut().enumerate() {
                            let u = first + LANE_NUMBERS[lane] * (SAMPLES as f32 * step);
                            let (nd, cd, dd) = (n_row + nu * u, c_row + cu * u, d_row + u * u);
                            let q = height * height * dd - 2.0 * height * cd * nd + slack * nd * nd;
                            // In front of the receiver, and not too near: t > 0, t² D·D > near².
                            // Products of zeros and ones, not booleans: they stay in vector lanes.
                            let on_disk = if q <= 0.0 { 1.0 } else { 0.0 };
                            let in_front = if nd * height > 0.0 { 1.0 } else { 0.0 };
                            let far_enough =
                                if height * height * dd > near2 * nd * nd { 1.0 } else { 0.0 };
                            *weight += on_disk * in_front * far_enough;
                        }
                    }
                }
                for weight in &mut weights {
                    *weight *= 1.0 / (SAMPLES * SAMPLES) as f32;
                }
                // Lanes beyond the row's end would wrap into the padding only.
                self.add_chunk(row_index, chunk, &weights, ink);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::CubeRasterTable;
    use std::f32::consts::PI;

    const INK: DiskInk =
        DiskInk { opacity: 1.0, front_only: false, solid: false, radiance: [1.0; 3] };

    fn irradiance(n: usize, disk: &Disk, receiver_normal: Vec3) -> f32 {
        let table = CubeRasterTable::new(n);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear(receiver_normal);
        raster.draw_disk(disk, &INK, 0.0);
        let texels = table.texels().iter().enumerate();
        texels
            .map(|(i, t)| {
                raster.chunk(i / LANES).radiance[0][i % LANES]
                    * receiver_normal.dot(t.vector).max(0.0)
            })
            .sum()
    }

    #[test]
    fn parallel_disk_has_the_analytic_form_factor() {
        for (distance, n, tolerance) in
            [(0.25, 8, 0.01), (0.5, 8, 0.01), (1.0, 8, 0.02), (3.0, 16, 0.03)]
        {
            let disk = Disk { center: Vec3::Y * distance, normal: Vec3::NEG_Y, radius: 1.0 };
            // E = π L r² / (r² + d²) for a parallel disk on the axis.
            let exact = PI / (1.0 + distance * distance);
            let found = irradiance(n, &disk, Vec3::Y);
            assert!((found / exact - 1.0).abs() < tolerance, "{distance}: {found} {exact}");
        }
    }

    #[test]
    fn perpendicular_disk_matches_quadrature() {
        // A disk standing beside the receiver, half of it below the horizon.
        let disk = Disk { center: Vec3::X * 1.3, normal: Vec3::NEG_X, radius: 1.0 };
        let mut exact = 0f64;
        let steps = 400;
        for i in 0..steps {
            for j in 0..steps {
                let (y, z) = (
                    -1.0 + 2.0 * (i as f32 + 0.5) / steps as f32,
                    -1.0 + 2.0 * (j as f32 + 0.5) / steps as f32,
                );
                if y > 0.0 && y * y + z * z <= 1.0 {
                    let p = Vec3::new(1.3, y, z);
                    let d2 = p.length_squared();
                    exact += f64::from(y * 1.3 / (d2 * d2)) * 4.0 / f64::from(steps * steps);
                }
            }
        }
        let found = f64::from(irradiance(8, &disk, Vec3::Y));
        assert!((found / exact - 1.0).abs() < 0.03, "{found} {exact}");
    }

    #[test]
    fn disks_nearer_than_the_limit_are_not_seen() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, false);
        let disk = Disk { center: Vec3::Y * 0.01, normal: Vec3::NEG_Y, radius: 1.0 };
        raster.clear(Vec3::Y);
        raster.draw_disk(&disk, &INK, 0.05);
        let up = table.texel_index(Vec3::new(0.01, 1.0, 0.01));
        assert_eq!(raster.openness(up), 1.0);
        raster.draw_disk(&disk, &INK, 0.0);
        assert_eq!(raster.openness(up), 0.0);
    }

    #[test]
    fn front_only_disks_vanish_from_behind() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear(Vec3::Y);
        let away = Disk { center: Vec3::Y, normal: Vec3::Y, radius: 1.0 };
        raster.draw_disk(&away, &DiskInk { front_only: true, ..INK }, 0.0);
        let up = table.texel_index(Vec3::new(0.01, 1.0, 0.01));
        assert_eq!(raster.openness(up), 1.0);
        raster.draw_disk(&away, &INK, 0.0);
        assert_eq!(
            (raster.openness(up), raster.chunk(up / LANES).radiance[0][up % LANES]),
            (0.0, 0.0)
        );
    }
}
