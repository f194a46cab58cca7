//! Tests of hiding against closed forms and against itself.

use super::*;
use crate::{Camera, Instance, Material, Mesh, Scene, Texture};
use pbgi_math::{Affine3A, Mat3, Vec2, Vec3};

fn view(eye: Vec3, target: Vec3, yfov: f32, width: u32, height: u32) -> CameraView {
    CameraView { camera: Camera::look_at(eye, target, Vec3::Y, yfov), width, height }
}

fn scene(mesh: Mesh, material: Material) -> Scene {
    Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, transform: Affine3A::IDENTITY }],
        materials: vec![material],
        ..Scene::default()
    }
}

/// A rectangle in the plane z = 0 that faces +z.
fn quad(half_width: f32, half_height: f32) -> Mesh {
    let corner = |x: f32, y: f32| Vec3::new(x * half_width, y * half_height, 0.0);
    Mesh {
        positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        uvs: vec![Vec2::new(0.0, 1.0), Vec2::ONE, Vec2::new(1.0, 0.0), Vec2::ZERO],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// A closed bumpy sphere of irregular triangles, thin ones at the poles among them.
fn bumpy_sphere(rows: u32, columns: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let at = |row: u32, column: u32| row * columns + column % columns;
    for row in 0..=rows {
        for column in 0..columns {
            let theta = row as f32 / rows as f32 * std::f32::consts::PI;
            let phi = column as f32 / columns as f32 * std::f32::consts::TAU;
            let theta = theta.clamp(1e-4, std::f32::consts::PI - 1e-4);
            let r = 1.0 + 0.2 * (5.0 * theta).sin() * (7.0 * phi).sin();
            let (s, c) = theta.sin_cos();
            mesh.positions.push(Vec3::new(s * phi.sin(), c, s * phi.cos()) * r);
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [at(row, column), at(row + 1, column)];
            let [c, d] = [at(row + 1, column + 1), at(row, column + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    for (row, flip) in [(0, false), (rows, true)] {
        for column in 1..columns - 1 {
            let [a, b, c] = [at(row, 0), at(row, column), at(row, column + 1)];
            mesh.triangles.push(if flip { [a, c, b] } else { [a, b, c] });
        }
    }
    mesh
}

#[test]
fn closed_mesh_seen_from_inside_covers_every_sample() {
    for (rows, columns) in [(4, 5), (40, 70), (400, 500)] {
        let scene = scene(bumpy_sphere(rows, columns), Material::default());
        for (i, yfov) in [0.3f32, 1.2, 2.4].into_iter().enumerate() {
            let eye = Vec3::new(0.11, -0.07 * i as f32, 0.05);
            let target = eye + Vec3::new(0.3 - i as f32, 0.21, 1.0 - 0.7 * i as f32);
            let view = view(eye, target, yfov, 200, 130);
            let visible = hide(&scene, &view, &HideOptions::default()).unwrap();
            let open = visible.coverage.alpha().iter().filter(|alpha| **alpha < 1.0).count();
            assert_eq!(open, 0, "{rows} x {columns}, {yfov}");
            assert!(visible.micropolygons.iter().all(|m| m.depth > 0.0 && m.back));
        }
    }
}

#[test]
fn floor_around_the_eye_reaches_from_horizon_to_bottom() {
    let mut scene = scene(quad(500.0, 500.0), Material::default());
    let level = Mat3::from_rotation_x(-std::f32::consts::FRAC_PI_2);
    scene.instances[0].transform = Affine3A::from_mat3(level);
    let eye = Vec3::new(0.3, 0.1, -0.2);
    let view = view(eye, eye + Vec3::new(0.7, 0.0, -1.0), 1.2, 120, 80);
    let visible = hide(&scene, &view, &HideOptions::default()).unwrap();
    for (pixel, alpha) in visible.coverage.alpha().iter().enumerate() {
        // The floor ends within a pixel of the horizon, which is the middle row's upper edge.
        let expected = if pixel / 120 < 40 { 0.0 } else { 1.0 };
        assert!(*alpha == expected || pixel / 120 == 40, "{pixel}: {alpha}");
    }
    for m in &visible.micropolygons {
        assert!(m.position.y.abs() < 1e-4 && m.normal.y > 0.999);
    }
}

#[test]
fn quad_covers_exactly_its_projection() {
    // 4 × 2 at distance 5 under a half extent of 5·tan(0.5) per half height.
    let scene = scene(quad(2.0, 1.0), Material::default());
    let view = view(Vec3::new(0.0, 0.0, 5.0), Vec3::ZERO, 1.0, 320, 180);
    for samples in [1, 4, 8, 16] {
        let options = HideOptions { samples, ..HideOptions::default() };
        let visible = hide(&scene, &view, &options).unwrap();
        let scale = 90.0 / (5.0 * 0.5f32.tan());
        let area: f32 = visible.coverage.alpha().iter().sum();
        let exact = 4.0 * scale * 2.0 * scale;
        // Each of the four sides is off by at most one step of the pattern.
        let bound = 2.0 * (4.0 + 2.0) * scale / samples as f32;
        assert!((area - exact).abs() < bound, "{samples}: {area} {exact}");
        for m in &visible.micropolygons {
            assert!(m.position.z.abs() < 1e-5 && (m.depth - 5.0).abs() < 1e-4);
            assert!((m.normal - Vec3::Z).length() < 1e-6 && !m.back);
        }
    }
}

#[test]
fn micropolygons_have_the_size_of_the_shading_rate() {
    let scene = scene(quad(2.0, 1.0), Material::default());
    let straight = view(Vec3::new(0.0, 0.0, 5.0), Vec3::ZERO, 1.0, 640, 360);
    let grazing = view(Vec3::new(-3.0, -1.0, 0.5), Vec3::ZERO, 0.8, 640, 360);
    for view in [straight, grazing] {
        for rate in [1.0f32, 4.0, 16.0] {
            let options = HideOptions { shading_rate: rate, ..HideOptions::default() };
            let visible = hide(&scene, &view, &options).unwrap();
            let pixels: f32 = visible.coverage.alpha().iter().sum();
            let per_cell = pixels / visible.micropolygons.len() as f32;
            // Levels are rounded to powers of two on both axes: within a factor of two, and cells
            // are cut at edges and where the level changes.
            assert!(per_cell > rate * 0.4 && per_cell < rate * 2.1, "{rate}: {per_cell}");
        }
    }
}

#[test]
fn cells_seen_edge_on_do_not_become_slivers() {
    // Along the diagonal both axes of a square fall nearly together on the screen.
    let scene = scene(quad(2.0, 2.0), Material::default());
    let diagonal = view(Vec3::new(-3.0, -3.0, 0.15), Vec3::ZERO, 0.8, 640, 360);
    let visible = hide(&scene, &diagonal, &HideOptions::default()).unwrap();
    let pixels: f32 = visible.coverage.alpha().iter().sum();
    let ratio = visible.micropolygons.len() as f32 / pixels;
    println!("{ratio} micropolygons per pixel");
    assert!(ratio < 2.5, "{ratio}");
}

#[test]
fn needles_share_their_pixels_sparingly() {
    // A fan of needles fills a disk; its cells must follow the pixels, not the 4000 triangles.
    let mut mesh = Mesh { positions: vec![Vec3::ZERO], ..Mesh::default() };
    for k in 0..64u32 {
        let (s, c) = (k as f32 / 64.0 * std::f32::consts::TAU).sin_cos();
        mesh.positions.push(Vec3::new(c, s, 0.0));
        mesh.triangles.push([0, k + 1, (k + 1) % 64 + 1]);
    }
    let view = view(Vec3::new(0.0, 0.0, 2.5), Vec3::ZERO, 1.0, 300, 300);
    let visible = hide(&scene(mesh, Material::default()), &view, &HideOptions::default()).unwrap();
    let pixels: f32 = visible.coverage.alpha().iter().sum();
    let ratio = visible.micropolygons.len() as f32 / pixels;
    assert!((0.4..2.0).contains(&ratio), "{ratio}");
}

#[test]
fn windows_and_threads_change_nothing() {
    let scene = scene(bumpy_sphere(40, 70), Material::default());
    let view = view(Vec3::new(0.4, 1.5, 2.2), Vec3::ZERO, 0.9, 210, 170);
    let whole = hide(&scene, &view, &HideOptions::default()).unwrap();
    let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let alone = single.install(|| hide(&scene, &view, &HideOptions::default()).unwrap());
    assert_eq!(whole.micropolygons, alone.micropolygons);
    let window = PixelWindow { x: 50, y: 33, width: 90, height: 101 };
    let options = HideOptions { window: Some(window), ..HideOptions::default() };
    let part = hide(&scene, &view, &options).unwrap();
    for pixel in 0..part.coverage.pixel_count() {
        let (x, y) = (pixel as u32 % 90 + 50, pixel as u32 / 90 + 33);
        let same = (y * 210 + x) as usize;
        let of = |set: &VisibleSet, pixel: usize| -> Vec<(u32, Micropolygon)> {
            let fragments = set.coverage.fragments(pixel);
            fragments.iter().map(|f| (f.samples, set.micropolygons[f.index as usize])).collect()
        };
        assert_eq!(of(&part, pixel), of(&whole, same));
        assert_eq!(of(&alone, same), of(&whole, same));
        let turn = part.coverage.pixel_direction(pixel) - whole.coverage.pixel_direction(same);
        assert_eq!(turn, Vec3::ZERO);
    }
    assert!(part.micropolygons.len() < whole.micropolygons.len());
}

#[test]
fn nearer_surfaces_hide_farther_ones() {
    let mut scene = scene(quad(1.0, 1.0), Material::default());
    let near = Affine3A::from_translation(Vec3::Z);
    let mirrored = Affine3A::from_scale(Vec3::new(-0.5, 0.5, 0.5));
    scene.instances.push(Instance { mesh: 0, transform: near * mirrored });
    scene.materials.push(Material::default());
    let view = view(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 0.9, 128, 128);
    let visible = hide(&scene, &view, &HideOptions::default()).unwrap();
    let depths = visible.resolve_nearest(|i| [visible.micropolygons[i].depth], [0.0]);
    assert!((depths[64 * 128 + 64][0] - 3.0).abs() < 1e-5);
    assert_eq!(depths[0][0], 0.0);
    // A mirrored front stays a front.
    assert!(visible.micropolygons.iter().all(|m| !m.back && m.normal.z > 0.99));
}

#[test]
fn holes_show_what_is_behind() {
    let texels: Vec<[u8; 4]> =
        (0..64 * 64).map(|i| [255, 255, 255, if i % 64 < 32 { 0 } else { 255 }]).collect();
    let material =
        Material { base_color_texture: Some(0), alpha_cutoff: Some(0.5), ..Material::default() };
    let mut scene = scene(quad(1.0, 1.0), material);
    scene.textures.push(Texture::new(64, 64, texels, false).unwrap());
    let view = view(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 0.9, 128, 128);
    let visible = hide(&scene, &view, &HideOptions::default()).unwrap();
    // Bilinear wrapping softens both edges by half a texel.
    let left_most = visible.micropolygons.iter().map(|m| m.position.x).fold(1.0, f32::min);
    assert!(left_most.abs() < 0.05, "{left_most}");
    let area: f32 = visible.coverage.alpha().iter().sum();
    let exact = 2.0 * (64.0 / (4.0 * 0.45f32.tan())).powi(2);
    assert!((area / exact - 1.0).abs() < 0.05, "{area} {exact}");
}

#[test]
fn resolved_images_average_values_and_background() {
    let scene = scene(quad(1.0, 1.0), Material::default());
    let view = view(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 0.9, 100, 100);
    let visible = hide(&scene, &view, &HideOptions::default()).unwrap();
    let alpha = visible.coverage.alpha();
    let image = visible.resolve(|_| [1.0, 3.0], |direction| [0.0, direction.length()]);
    for (pixel, alpha) in image.iter().zip(&alpha) {
        assert!((pixel[0] - alpha).abs() < 1e-6);
        assert!((pixel[1] - (1.0 + 2.0 * alpha)).abs() < 1e-5);
    }
    assert!(alpha.iter().any(|a| *a > 0.0 && *a < 1.0));
}

#[test]
fn odd_scenes_and_options_are_survived() {
    let mut broken = quad(1.0, 1.0);
    broken.positions.extend([Vec3::NAN, Vec3::splat(f32::INFINITY), Vec3::splat(1e30)]);
    broken.triangles.extend([[0, 1, 99], [0, 1, 4], [1, 2, 5], [0, 0, 1], [2, 3, 6]]);
    broken.material = 7;
    let mut scene = scene(broken, Material::default());
    scene.instances.push(Instance { mesh: 9, transform: Affine3A::IDENTITY });
    let flat = Affine3A::from_mat3(Mat3::ZERO);
    scene.instances.push(Instance { mesh: 0, transform: flat });
    // The eye lies in the plane of the quad, and on it.
    for eye in [Vec3::new(0.2, 0.1, 0.0), Vec3::new(3.0, 0.0, 0.0), Vec3::new(0.0, 0.0, 2.0)] {
        let view = view(eye, Vec3::new(0.0, 0.0, -0.5), 0.9, 33, 17);
        let visible = hide(&scene, &view, &HideOptions::default()).unwrap();
        assert!(visible.micropolygons.iter().all(|m| m.position.is_finite()));
        assert!(visible.micropolygons.iter().all(|m| (m.normal.length() - 1.0).abs() < 1e-3));
    }
    let good = view(Vec3::Z, Vec3::ZERO, 0.9, 16, 16);
    let fails = |view: &CameraView, options: HideOptions| hide(&scene, view, &options).unwrap_err();
    let options = HideOptions::default();
    fails(&good, HideOptions { samples: 3, ..options });
    fails(&good, HideOptions { shading_rate: f32::NAN, ..options });
    fails(&CameraView { width: 0, ..good.clone() }, options);
    fails(&CameraView { height: 1 << 20, ..good.clone() }, options);
    let window = PixelWindow { x: 9, y: 0, width: 8, height: u32::MAX };
    fails(&good, HideOptions { window: Some(window), ..options });
    let mut blind = good.clone();
    blind.camera.yfov = f32::NAN;
    fails(&blind, options);
}

fn disk(id: u64, center: Vec3, normal: Vec3, radius: f32) -> Disk {
    Disk { id, center, normal, radius, isotropic: false, front_only: false }
}

#[test]
fn disk_covers_its_ellipse() {
    // A small tilted disk on the axis projects to an ellipse of area π r² cos θ / d² (in units of
    // the plane at distance 1), up to terms of order (r/d)².
    let view = view(Vec3::new(0.0, 0.0, 10.0), Vec3::ZERO, 0.2, 600, 600);
    let scale = 300.0 / 0.1f32.tan();
    for tilt in [0.0f32, 0.6, 1.2] {
        let normal = Vec3::new(tilt.sin(), 0.0, tilt.cos());
        let disks = [disk(7, Vec3::ZERO, normal, 0.5)];
        let visible = hide_disks(&view, &HideOptions::default(), [disks]).unwrap();
        let area: f32 = visible.coverage.alpha().iter().sum();
        let exact = std::f32::consts::PI * (0.5 * scale / 10.0).powi(2) * tilt.cos();
        assert!((area / exact - 1.0).abs() < 0.006, "{tilt}: {area} {exact}");
        assert_eq!(visible.ids, [7]);
    }
}

#[test]
fn isotropic_disks_face_the_camera_and_sheets_show_one_side() {
    let view = view(Vec3::new(0.0, 0.0, 10.0), Vec3::ZERO, 0.2, 200, 200);
    let edge_on = Disk { isotropic: true, ..disk(1, Vec3::ZERO, Vec3::X, 0.5) };
    let round = hide_disks(&view, &HideOptions::default(), [[edge_on]]).unwrap();
    let area: f32 = round.coverage.alpha().iter().sum();
    let exact = std::f32::consts::PI * (0.5 * 100.0 / (10.0 * 0.1f32.tan())).powi(2);
    assert!((area / exact - 1.0).abs() < 0.01);
    let sheet = [Vec3::NEG_Z, Vec3::Z].map(|normal| Disk {
        front_only: true,
        ..disk(if normal.z > 0.0 { 5 } else { 4 }, Vec3::ZERO, normal, 0.5)
    });
    assert_eq!(hide_disks(&view, &HideOptions::default(), [sheet]).unwrap().ids, [5]);
}

#[test]
fn chunks_of_disks_change_nothing() {
    let disks: Vec<Disk> = (0..3000u64)
        .map(|i| {
            // Two disks in each place: of the pair only the first may show.
            let f = |k: u64| (i / 2 * k % 991) as f32 / 991.0 * 2.0 - 1.0;
            let normal = Vec3::new(f(17), f(29), f(43)).normalize_or(Vec3::X);
            disk(1_000_000_000_000 + i, Vec3::new(f(7), f(13), f(23)), normal, 0.06)
        })
        .collect();
    let view = view(Vec3::new(0.5, 0.3, 2.0), Vec3::ZERO, 1.3, 150, 100);
    let options = HideOptions { samples: 4, ..HideOptions::default() };
    let whole = hide_disks(&view, &options, [&disks]).unwrap();
    let reversed: Vec<Disk> = disks.iter().rev().copied().collect();
    let pieces = hide_disks(&view, &options, reversed.chunks(77)).unwrap();
    assert_eq!(whole.ids, pieces.ids);
    assert!(whole.ids.len() > 100 && whole.ids.iter().all(|id| id % 2 == 0));
    for pixel in 0..whole.coverage.pixel_count() {
        assert_eq!(whole.coverage.fragments(pixel), pieces.coverage.fragments(pixel));
    }
    let window = PixelWindow { x: 60, y: 40, width: 50, height: 60 };
    let part =
        hide_disks(&view, &HideOptions { window: Some(window), ..options }, [&disks]).unwrap();
    for pixel in 0..part.coverage.pixel_count() {
        let same = (pixel / 50 + 40) * 150 + pixel % 50 + 60;
        let of = |set: &VisibleSurfels, pixel: usize| -> Vec<(u32, u64)> {
            let fragments = set.coverage.fragments(pixel);
            fragments.iter().map(|f| (f.samples, set.ids[f.index as usize])).collect()
        };
        assert_eq!(of(&part, pixel), of(&whole, same));
    }
}

#[test]
fn disks_around_and_behind_the_eye_are_survived() {
    let eye = Vec3::new(0.0, 0.0, 2.0);
    let view = view(eye, Vec3::ZERO, 1.3, 60, 40);
    let disks = [
        disk(1, eye + Vec3::Z, Vec3::Z, 0.5),
        disk(2, eye - Vec3::Y * 0.1, Vec3::Y, 50.0),
        disk(3, eye, Vec3::Y, 1.0),
        Disk { isotropic: true, ..disk(4, eye, Vec3::ZERO, 1.0) },
        disk(5, Vec3::NAN, Vec3::Y, 1.0),
        disk(6, Vec3::ZERO, Vec3::Z, f32::NAN),
        disk(7, Vec3::ZERO, Vec3::Z, -1.0),
    ];
    let visible = hide_disks(&view, &HideOptions::default(), [disks]).unwrap();
    // A floor under the eye reaches the horizon's row, less its rim.
    assert_eq!(visible.ids, [2]);
    let area: f32 = visible.coverage.alpha().iter().sum();
    assert!((area / (60.0 * 20.0) - 1.0).abs() < 0.02, "{area}");
}
