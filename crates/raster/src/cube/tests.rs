//! Closed forms of the cube raster, and its bits at every SIMD level.

use super::*;
use crate::lanes::Plain;
use crate::shape::Met;
use crate::{Disk, Place, Section, SimdLevel, Tile, Triangle, WideKernel, run_wide};
use pbgi_math::Aabb;
use std::f32::consts::PI;

fn ink(solid_angle: f32, light: f32) -> Ink {
    let radiance = [light; 3];
    Ink { veil: Veil::OPAQUE, solid_angle, radiance, tolerance: 0.01, ..Ink::default() }
}

/// Draws the part of the plane through `point` with `normal` in a box.
fn draw_section(raster: &mut CubeRaster, (low, high): (Vec3, Vec3), normal: Vec3, ink: &Ink) {
    let point = (low + high) * 0.5;
    let section = Section::new(normal / normal.dot(point), low, high);
    raster.look_at_box(low, high);
    raster.draw::<Plain, _>(&section, ink, point);
    raster.resolve::<Plain>();
}

fn irradiance(raster: &CubeRaster, table: &CubeRasterTable, normal: Vec3) -> f32 {
    let texels = table.texels().iter().enumerate();
    texels
        .map(|(i, t)| {
            raster.chunk(i / LANES).unwrap_or_default().radiance[0][i % LANES]
                * normal.dot(t.vector).max(0.0)
        })
        .sum()
}

/// Irradiance of a disk of radiance 1; its solid angle by counting samples.
fn disk_irradiance(n: usize, center: Vec3, normal: Vec3, receiver_normal: Vec3) -> f32 {
    let table = CubeRasterTable::new(n);
    let mut raster = CubeRaster::new(&table, true);
    raster.clear::<Plain>(receiver_normal);
    let inverse = normal / normal.dot(center);
    let disk = Disk { inverse, center, radius: 1.0, reach: 1.0, ..Disk::default() };
    let aabb = Aabb::from_disk(center, normal, 1.0);
    raster.look_at_box(aabb.min, aabb.max);
    raster.draw::<Plain, _>(&disk, &ink(1.0, 1.0), center);
    raster.resolve::<Plain>();
    irradiance(&raster, &table, receiver_normal)
}

#[test]
fn a_parallel_disk_has_the_analytic_form_factor() {
    for (distance, n, tolerance) in
        [(0.25, 8, 0.01), (0.5, 8, 0.01), (1.0, 8, 0.02), (3.0, 16, 0.03)]
    {
        // E = π L r² / (r² + d²) for a parallel disk on the axis.
        let exact = PI / (1.0 + distance * distance);
        let found = disk_irradiance(n, Vec3::Y * distance, Vec3::NEG_Y, Vec3::Y);
        assert!((found / exact - 1.0).abs() < tolerance, "{distance}: {found} {exact}");
    }
}

#[test]
fn a_perpendicular_disk_matches_quadrature() {
    // A disk standing beside the receiver, half of it below the horizon.
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
    let found = f64::from(disk_irradiance(8, Vec3::X * 1.3, Vec3::NEG_X, Vec3::Y));
    assert!((found / exact - 1.0).abs() < 0.03, "{found} {exact}");
}

/// What the light of a small piece, which lies `toward` and hits these samples, weighs in a texel.
fn weight_of(raster: &CubeRaster, hits: &[Hit], index: usize, toward: Vec3) -> f32 {
    let (column, row) = (index % raster.stride, index / raster.stride % raster.n);
    let face = CubeFace((index / raster.stride / raster.n) as u8);
    let tilt = raster.tilt(face, row, column, raster.above[index]).cosine;
    if let Some(hit) = hits.iter().find(|hit| hit.index as usize == index) {
        return tilt.mean(hit.visible);
    }
    let (_, u, v) = CubeFace::from_direction(toward);
    tilt.at([u, v].map(|c| 2.0 * ((c + 1.0) * raster.scale).fract() - 1.0))
}

#[test]
fn small_pieces_carry_their_solid_angle_wherever_they_fall() {
    let table = CubeRasterTable::new(8);
    let mut raster = CubeRaster::new(&table, true);
    // Tiny ones exactly; where one covers a texel wholly, its share of it is rounded to 1. What they weigh is right up to the place of a sample.
    for (radius, tolerance, weight_tolerance) in
        [(0.02f32, 1e-3, 0.025), (0.1, 1e-3, 0.025), (0.4, 0.1, 0.1)]
    {
        for i in 0..400u32 {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 400.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let d = Vec3::new(r * phi.cos(), r * phi.sin(), z);
            raster.clear::<Plain>(d);
            let (center, solid_angle) = (d * 5.0, PI * radius * radius / 25.0);
            let disk = Disk { inverse: d / 5.0, center, radius, reach: radius, ..Disk::default() };
            let aabb = Aabb::from_disk(center, d, radius);
            raster.look_at_box(aabb.min, aabb.max);
            raster.draw::<Plain, _>(&disk, &ink(solid_angle, 1.0), center);
            let hits = raster.hits.clone();
            raster.resolve::<Plain>();
            let texels = table.texels().iter().enumerate();
            let is_lit = |i: usize| raster.lit.contains(i);
            let lit = texels.filter(|(i, _)| is_lit(*i) && raster.lights[*i].radiance[0] > 0.0);
            let found: f32 = lit
                .map(|(i, t)| {
                    let light = raster.chunk(i / LANES).unwrap_or_default().radiance[0][i % LANES];
                    light / weight_of(&raster, &hits, i, d) * t.solid_angle_sr
                })
                .sum();
            let error = found / solid_angle - 1.0;
            assert!(error.abs() < tolerance, "{i} {radius}: {error}");
            let error = irradiance(&raster, &table, d) / solid_angle - 1.0;
            assert!(error.abs() < weight_tolerance, "{i} {radius}: {error}");
        }
    }
}

#[test]
fn tiles_of_a_closed_box_leave_no_sample_open() {
    let table = CubeRasterTable::new(8);
    let mut raster = CubeRaster::new(&table, true);
    raster.clear::<Plain>(Vec3::Y);
    let (cells, mut sum) = (12, 0.0);
    for axis in 0..3 {
        for side in [-1.0f32, 1.0] {
            for i in 0..cells * cells {
                let at = |i: i32| -1.0 + 2.0 * i as f32 / cells as f32;
                let mut low = Vec3::ZERO;
                low[axis] = side;
                low[(axis + 1) % 3] = at(i % cells);
                low[(axis + 2) % 3] = at(i / cells);
                let mut high = low;
                high[(axis + 1) % 3] += 2.0 / cells as f32;
                high[(axis + 2) % 3] += 2.0 / cells as f32;
                let normal = Vec3::AXES[axis] * side;
                let center = (low + high) * 0.5;
                let d2 = center.length_squared();
                let solid_angle = 4.0 / (cells * cells) as f32 / (d2 * d2.sqrt());
                let margin = 1e-4;
                let bounds = (low - margin, high + margin);
                draw_section(&mut raster, bounds, normal, &ink(solid_angle, 2.0));
                sum += solid_angle;
            }
        }
    }
    assert!((sum / (4.0 * PI) - 1.0).abs() < 0.01);
    for (i, texel) in table.texels().iter().enumerate() {
        if texel.direction.y > 0.0 {
            assert!(raster.openness(i) == 0.0, "texel {i} is open");
        }
    }
    let found = irradiance(&raster, &table, Vec3::Y);
    assert!((found / (2.0 * PI) - 1.0).abs() < 2e-3, "{found}");
    assert!(!raster.look_at_box(Vec3::splat(3.0), Vec3::splat(3.5)));
}

/// Draws an opaque tile of radiance 1, its edges scaled by `scale`, with a rim of this share of them.
fn draw_tile(raster: &mut CubeRaster, center: Vec3, halves: [Vec3; 2], [scale, rim]: [f32; 2]) {
    let edges = halves.map(Vec3::normalize);
    let normal = edges[0].cross(edges[1]);
    let tile = Tile {
        inverse: normal / normal.dot(center),
        center,
        edges,
        half: halves.map(|half| half.length() * scale),
        reach: halves.map(|half| half.length() * scale * (1.0 + rim)),
        ground: Vec3::splat(f32::MAX),
        side: 0,
    };
    let (d2, area) = (center.length_squared(), 4.0 * halves[0].length() * halves[1].length());
    let ink = ink(area * normal.dot(center).abs() / (d2 * d2.sqrt()), 1.0);
    let reach = edges[0].abs() * tile.reach[0] + edges[1].abs() * tile.reach[1];
    raster.look_at_box(center - reach, center + reach);
    raster.draw::<Plain, _>(&tile, &ink, center);
    raster.resolve::<Plain>();
}

#[test]
fn rectangles_that_tile_a_plane_leave_no_sample_open() {
    let table = CubeRasterTable::new(16);
    let mut raster = CubeRaster::new(&table, true);
    // A ceiling of oblong tiles, turned in its plane and tilted.
    let normal = Vec3::new(0.2, -1.0, 0.1).normalize();
    let first = Vec3::new(0.8, 0.0, -0.5).cross(normal).normalize();
    let halves = [first * 0.3, normal.cross(first) * 0.12];
    // Larger by nothing but arithmetic; smaller, with rims that reach over the gaps, or that do not.
    for (outline, complete) in
        [([1.001, 0.0], true), ([0.98, 0.05], true), ([0.98, 0.03], false), ([0.9, 0.0], false)]
    {
        raster.clear::<Plain>(Vec3::Y);
        for i in -30..=30 {
            for j in -80..=80 {
                let (i, j) = (i as f32 * 2.0, j as f32 * 2.0);
                let center = normal * -1.0 + halves[0] * i + halves[1] * j;
                draw_tile(&mut raster, center, halves, outline);
            }
        }
        let mut open = 0.0;
        for (i, texel) in table.texels().iter().enumerate() {
            if texel.direction.dot(normal) < -0.25 {
                open += raster.openness(i);
            }
        }
        assert_eq!(open == 0.0, complete, "{outline:?}: {open}");
    }
}

/// Rims close gaps between neighbors and reach over no end of their surface; the faces of a solid at its outline, of which one is seen from behind, are
/// no neighbors.
#[test]
fn rims_end_where_the_surface_does() {
    let table = CubeRasterTable::new(32);
    let halves = [Vec3::X * 0.1, Vec3::Z * 0.1];
    let draw = |outline: [f32; 2]| {
        let mut raster = CubeRaster::new(&table, false);
        raster.clear::<Plain>(Vec3::Y);
        for i in -3..=3 {
            for j in -3..=3 {
                let center = Vec3::new(0.2 * i as f32 + 0.013, 0.5, 0.2 * j as f32 - 0.007);
                draw_tile(&mut raster, center, halves, outline);
            }
        }
        raster
    };
    // The corners of neighbors' rims meet over the end, a twentieth of it.
    let (exact, rimmed) = (draw([1.0001, 0.0]), draw([1.0001, 0.05]));
    let count = |r: &CubeRaster| r.covered.iter().map(|c| c.count_ones()).sum::<u32>();
    let (exact, over) = (count(&exact), count(&rimmed) - count(&exact));
    assert!(over * 500 < exact, "{over} of {exact}");

    // A wall's upper end, and its top, seen from below: over both is the same strip of sky.
    let met = |side: u8, place: Place, rims: &mut Rims| {
        Met { inside: 1, rim: 2 }.close(&Disk { side, place, ..Disk::default() }, rims)
    };
    let mut rims = Rims::default();
    assert_eq!([0, 1, 0].map(|side| met(side, Place::ANY, &mut rims)), [1, 1, 3]);
    // What lies at the same place is no neighbor, what lies at another is; what is far behind both is none.
    let mut rims = Rims::default();
    let place = |number: u32| Place { number, distance: 5.0 + 0.01 * number as f32, apart: 0.2 };
    let places = [7, 7, 8, 8, 7, 90, 91].map(|number| met(0, place(number), &mut rims));
    assert_eq!(places, [1, 1, 3, 3, 3, 1, 3]);
}

/// Disks of a square lattice, each with the area of its cell, leave no gap; over the ends of the lattice they reach by less than half of what disks
/// without gaps would.
#[test]
fn a_lattice_of_disks_is_closed_and_ends_where_it_ends() {
    let table = CubeRasterTable::new(16);
    let (step, count) = (0.25f32, 8);
    let own = step / PI.sqrt();
    // Samples of the face above, which the lattice fills, and of the others.
    let covered = |radius: f32, reach: f32| {
        let mut raster = CubeRaster::new(&table, false);
        raster.clear::<Plain>(Vec3::Y);
        for cell in 0..count * count {
            let [x, z] = [cell % count, cell / count].map(|i| (i as f32 - 3.5) * step);
            let center = Vec3::new(x, 1.0, z);
            let ground = Vec3::Y * 1e9;
            let place = Place { number: cell + 1, distance: center.length(), apart: 2.0 * reach };
            let inverse = Vec3::Y;
            let disk = Disk { inverse, center, radius, reach, ground, place, ..Disk::default() };
            raster.look_at_box(center - reach, center + reach);
            raster.draw::<Plain, _>(&disk, &ink(0.01, 0.0), center);
        }
        let start = usize::from(CubeFace::from_direction(Vec3::Y).0.0) * 16 * table.stride();
        let samples = raster.covered.iter().zip(&raster.above).map(|(c, a)| (c & a).count_ones());
        let all: u32 = samples.clone().sum();
        let above: u32 = samples.skip(start).take(16 * table.stride()).sum();
        [above, all - above]
    };
    let [bare, closed, large] = [[1.0, 1.0], [1.0, 1.4], [1.26, 1.26]]
        .map(|[radius, reach]| covered(radius * own, reach * own));
    let whole = 16 * 16 * 16;
    assert!(bare[0] < whole * 97 / 100, "{bare:?}");
    // Its four corners are in one rim each.
    assert_eq!([closed[0], large[0]], [whole - 4, whole]);
    assert!(2 * closed[1] < large[1], "{bare:?} {closed:?} {large:?}");
}

#[test]
fn a_rectangle_has_the_analytic_form_factor_and_no_point_beyond_its_edges() {
    let table = CubeRasterTable::new(16);
    let mut raster = CubeRaster::new(&table, true);
    let (a, b) = (2.0f32, 0.25);
    for turn in [0.0f32, 0.4, 1.2] {
        raster.clear::<Plain>(Vec3::Y);
        let (sin, cos) = turn.sin_cos();
        let halves = [Vec3::new(cos, 0.0, sin) * a, Vec3::new(-sin, 0.0, cos) * b];
        draw_tile(&mut raster, Vec3::Y, halves, [1.0, 0.0]);
        // E = 2 L (a/√(1+a²) atan(b/√(1+a²)) + b/√(1+b²) atan(a/√(1+b²))), four quarters.
        let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
        let exact = 2.0 * (a / p * (b / p).atan() + b / q * (a / q).atan());
        let found = irradiance(&raster, &table, Vec3::Y);
        assert!((found / exact - 1.0).abs() < 0.02, "{turn}: {found} {exact}");
        for (i, texel) in table.texels().iter().enumerate() {
            let at = texel.direction / texel.direction.y;
            let beyond = |half: Vec3| at.dot(half) > 1.3 * half.length_squared() + 0.3;
            if texel.direction.y <= 0.0 || beyond(halves[0]) || beyond(halves[1]) {
                let open = raster.openness(i);
                assert!(texel.direction.y < 0.2 || open == 1.0, "{turn} {at}: {open}");
            }
        }
    }
}

#[test]
fn nearer_pieces_hide_farther_ones_but_not_their_neighbors() {
    let table = CubeRasterTable::new(8);
    let mut raster = CubeRaster::new(&table, true);
    let (low, high) = (Vec3::new(-0.6, 0.99, -0.6), Vec3::new(0.6, 1.01, 0.6));
    let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
    // Of the second, at the first's depth or far behind it, all or nothing is seen.
    for (scale, expected) in [(1.0, 0.7), (2.0, 0.2)] {
        raster.clear::<Plain>(Vec3::Y);
        let whole = table.texels()[up].solid_angle_sr;
        draw_section(&mut raster, (low, high), Vec3::Y, &ink(1.0, 0.0));
        let light = raster.chunk(up / LANES).unwrap_or_default().radiance[0][up % LANES];
        assert_eq!(light, 0.0);
        let small = Vec3::new(0.05, 1.0, 0.05) * scale;
        let piece = (small - 0.01, small + 0.01);
        // Tiny: met by no sample.
        draw_section(&mut raster, piece, Vec3::Y, &ink(0.5 * whole, 1.4));
        let weight = weight_of(&raster, &[], up, small);
        draw_section(&mut raster, (low * 3.0, high * 3.0), Vec3::Y, &ink(2.0, 9.0));
        let found = raster.lights[up].radiance[0];
        let expected = if scale == 1.0 { expected } else { 0.0 };
        assert!((found / weight - expected).abs() < 1e-4, "{scale}: {found}");
    }
}

/// A wall of tiles and a bright one close behind it, as things in walls are, in any order.
#[test]
fn what_is_hidden_does_not_shine_for_being_drawn_first() {
    let table = CubeRasterTable::new(8);
    let tile = |y: f32, index: u32| {
        let center = Vec3::new((index % 8) as f32 * 0.3 - 1.05, y, (index / 8) as f32 * 0.3 - 1.05);
        (center - Vec3::new(0.15, 0.0, 0.15), center + Vec3::new(0.15, 0.0, 0.15))
    };
    let mut found = Vec::new();
    for heights in [[1.0, 1.05], [1.05, 1.0]] {
        let mut raster = CubeRaster::new(&table, true);
        raster.clear::<Plain>(Vec3::Y);
        for y in heights {
            for (low, high) in (0..64).map(|index| tile(y, index)) {
                let ink = Ink { tolerance: 0.01, ..ink(0.09 / y.powi(2), y * 100.0 - 100.0) };
                let section = Section::new(Vec3::Y / y, low - 1e-3, high + 1e-3);
                raster.look_at_box(low - 1e-3, high + 1e-3);
                raster.draw::<Plain, _>(&section, &ink, (low + high) * 0.5);
            }
        }
        raster.resolve::<Plain>();
        found.push(irradiance(&raster, &table, Vec3::Y));
    }
    assert_eq!(found[0], found[1]);
    // A little of the farther one shows over the rim.
    assert!(found[0] < 0.3, "{found:?}");
}

/// A texel covered wholly, by half by a black back: what shines in the other half keeps its share, whichever comes first.
#[test]
fn backs_that_show_keep_their_share_of_a_covered_texel() {
    let table = CubeRasterTable::new(8);
    let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
    let whole = table.texels()[up].solid_angle_sr;
    // The texel's halves along x, at one height.
    let half = |x: f32| (Vec3::new(x, 0.999, -0.01), Vec3::new(x + 0.125, 1.001, 0.26));
    let back = Ink { is_back: true, ..ink(0.5 * whole, 0.0) };
    let front = ink(0.5 * whole, 3.0);
    for order in [[0, 1], [1, 0]] {
        let mut raster = CubeRaster::new(&table, true);
        raster.clear::<Plain>(Vec3::Y);
        for piece in order {
            let (bounds, ink) = [(half(0.0), &back), (half(0.125), &front)][piece];
            draw_section(&mut raster, bounds, Vec3::Y, ink);
        }
        let light = raster.chunk(up / LANES).unwrap_or_default().radiance[0][up % LANES];
        assert!((light - 1.5).abs() < 0.1, "{light}");
    }
}

#[test]
fn shares_of_a_covered_texel_sum_to_one() {
    let table = CubeRasterTable::new(8);
    let mut raster = CubeRaster::new(&table, true);
    raster.clear::<Plain>(Vec3::Y);
    let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
    let whole = table.texels()[up].solid_angle_sr;
    let (low, high) = (Vec3::new(0.0, 1.0, 0.0), Vec3::new(0.25, 1.0, 0.25));
    for share in [0.5, 0.2] {
        let bounds = (low - 1e-3, high + 1e-3);
        draw_section(&mut raster, bounds, Vec3::Y, &ink(share * whole, 3.0));
    }
    let light = raster.chunk(up / LANES).unwrap_or_default().radiance[0][up % LANES];
    assert!((light - 3.0).abs() < 1e-3, "{light}");
}

/// Pieces far smaller than the gaps between samples that tile the sky: in texels that the horizon crosses, too, their shares
/// are of the part above it.
#[test]
fn tiny_pieces_over_the_horizon_fill_the_sky() {
    let table = CubeRasterTable::new(8);
    let mut raster = CubeRaster::new(&table, true);
    let normal = Vec3::new(0.3, 1.0, 0.45).normalize();
    raster.clear::<Plain>(normal);
    let count = 60_000u32;
    for i in 0..count {
        let z = -1.0 + 2.0 * (i as f32 + 0.5) / count as f32;
        let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let center = Vec3::new(r * cos as f32, r * sin as f32, z);
        if center.dot(normal) > 0.0 {
            let piece = (center - 1e-3, center + 1e-3);
            draw_section(&mut raster, piece, center, &ink(4.0 * PI / count as f32, 1.0));
        }
    }
    let (mut crossed, mut shares) = (0f32, 0f32);
    for (above, light) in raster.above.iter().zip(&raster.lights) {
        if *above == ALL {
            assert!((light.radiance[0] - 1.0).abs() < 0.1, "{}", light.radiance[0]);
        } else if *above != 0 {
            let above = above.count_ones() as f32;
            crossed += above;
            shares += light.radiance[0] * above;
        }
    }
    assert!(crossed > 200.0 && (shares / crossed - 1.0).abs() < 0.1, "{shares} {crossed}");
}

#[test]
fn samples_below_the_horizon_do_not_count() {
    let table = CubeRasterTable::new(8);
    let mut raster = CubeRaster::new(&table, false);
    let normal = Vec3::new(0.3, 0.8, -0.2).normalize();
    raster.clear::<Plain>(normal);
    assert!(!raster.look_at_box(Vec3::new(-0.1, -3.0, -0.1), Vec3::new(0.1, -2.0, 0.1)));
    assert!(raster.look_at_box(Vec3::new(-0.1, 2.0, -0.1), Vec3::new(0.1, 3.0, 0.1)));
    for (i, texel) in table.texels().iter().enumerate() {
        let above = f32::from(texel.direction.dot(normal) > 0.2);
        let below = f32::from(texel.direction.dot(normal) < -0.2);
        let open = raster.openness(i);
        assert!(open >= above && open <= 1.0 - below && (open == 0.0 || open == 1.0));
    }
}

/// The halves of a rectangle cover what it does, each sample once, from either side and however their corners are ordered.
#[test]
fn two_triangles_are_their_rectangle() {
    let table = CubeRasterTable::new(16);
    let covered = |draw: &dyn Fn(&mut CubeRaster)| {
        let mut raster = CubeRaster::new(&table, false);
        raster.clear::<Plain>(Vec3::Y);
        raster.look_at_box(Vec3::NEG_ONE, Vec3::ONE);
        draw(&mut raster);
        raster.covered.iter().zip(&raster.above).map(|(c, a)| c & a).collect::<Vec<u16>>()
    };
    for i in 0..60u32 {
        let f = |k: u32| (i.wrapping_mul(k) >> 7) as f32 % 1009.0 / 504.0 - 1.0;
        let center = Vec3::new(f(2_654_435_761), 0.6 + 0.5 * f(40_503_227), f(1_442_695_041));
        let n = Vec3::new(f(97_531), f(1_357_911), f(86_028_121)).normalize();
        let tangent = n.any_orthonormal_vector();
        let (edges, half) = ([tangent, n.cross(tangent)], [0.7, 0.2 + 0.1 * f(77_777)]);
        let (u, v) = (edges[0] * half[0], edges[1] * half[1]);
        let inverse = n / n.dot(center);
        let [a, b, c, d] = [center - u - v, center + u - v, center + u + v, center - u + v];
        let tile = Tile { inverse, center, edges, half, reach: half, ground: Vec3::Y, side: 0 };
        let whole = covered(&|r| r.draw::<Plain, _>(&tile, &ink(0.1, 0.0), center));
        let triangle = |corners: [Vec3; 3]| {
            let triangle = Triangle::new(inverse, corners, 0.0, Vec3::Y, 0);
            covered(&|r| r.draw::<Plain, _>(&triangle, &ink(0.1, 0.0), center))
        };
        let (first, second) = (triangle([a, b, c]), triangle([d, c, a]));
        let count = |texels: &[u16]| texels.iter().map(|t| t.count_ones()).sum::<u32>();
        let both: Vec<u16> = first.iter().zip(&second).map(|(a, b)| a | b).collect();
        // But for samples on an edge, by rounding.
        let off: Vec<u16> = both.iter().zip(&whole).map(|(a, b)| a ^ b).collect();
        assert!(count(&off) <= 2, "{i}: {} of {}", count(&off), count(&whole));
        assert!(count(&first) + count(&second) <= count(&both) + 2, "{i}");
        assert!(count(&first) > 0 && count(&second) > 0, "{i}");
    }
}

/// Draws pieces of all kinds and gives every number of the raster.
struct Everything;

impl WideKernel for Everything {
    type Output = Vec<u32>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Vec<u32> {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear::<L>(Vec3::new(0.1, 0.9, 0.3).normalize());
        for i in 0..500u32 {
            let f = |k: u32| (i.wrapping_mul(k) >> 7) as f32 % 1009.0 / 504.0 - 1.0;
            let d = Vec3::new(f(2_654_435_761), f(40_503_227), f(1_442_695_041)).normalize();
            let n = Vec3::new(f(97_531), f(1_357_911), f(86_028_121)).normalize();
            let (center, radius) = (d * (1.0 + 0.01 * i as f32), 0.3);
            let inverse = n / n.dot(center);
            let veil = Veil { start: 0.0, end: 0.6, seed: i };
            let ink = Ink { veil, ..ink(0.03, i as f32) };
            let aabb = Aabb::from_disk(center, n, radius);
            raster.look_at_box(aabb.min, aabb.max);
            let ground = Vec3::new(0.2, 3.0, 0.4);
            if i % 7 == 3 {
                let corners = [center, center + n.any_orthonormal_vector() * 0.3, aabb.max];
                let normal = (corners[1] - center).cross(corners[2] - center);
                let inverse = normal / normal.dot(center);
                let triangle = Triangle::new(inverse, corners, 0.2, ground, (i % 2) as u8);
                raster.draw::<L, _>(&triangle, &ink, center);
            } else if i % 3 == 2 {
                let tangent = n.any_orthonormal_vector();
                let (edges, half) = ([tangent, n.cross(tangent)], [0.2, 0.1]);
                let reach = [0.25, 0.12];
                let tile =
                    Tile { inverse, center, edges, half, reach, ground, side: (i % 2) as u8 };
                raster.draw::<L, _>(&tile, &ink, center);
            } else if i % 3 == 1 {
                let disk = Disk {
                    inverse,
                    center,
                    radius,
                    reach: radius,
                    distance_min: 0.5,
                    ..Disk::default()
                };
                raster.draw::<L, _>(&disk, &ink, center);
            } else {
                let section = Section::new(inverse, aabb.min, aabb.max);
                raster.draw::<L, _>(&section, &ink, center);
            }
        }
        raster.resolve::<L>();
        let chunks = (0..48).map(|i| raster.chunk(i).unwrap_or_default());
        chunks
            .flat_map(|c| c.covered.into_iter().chain(c.radiance.into_iter().flatten()))
            .map(f32::to_bits)
            .collect()
    }
}

#[test]
fn every_level_gives_the_same_bits() {
    let expected = Everything.run::<Plain>();
    for level in SimdLevel::available() {
        assert_eq!(run_wide(level, Everything), expected, "{level:?}");
    }
}
