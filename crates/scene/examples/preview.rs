//! Hides a procedural scene and writes a picture of its direct light: sun with hard shadows and an
//! even sky. A quick look without the engine: `cargo run --release --example preview -- demo:street
//! out.png`.

use pbgi_scene::{Camera, CameraView, HideOptions, VisibleSet, hide, procedural_scene};
use std::error::Error;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let spec = arguments.next().unwrap_or_else(|| "demo:street".to_owned());
    let path = arguments.next().unwrap_or_else(|| "preview.png".to_owned());
    let start = Instant::now();
    let made = procedural_scene(&spec)?;
    let triangles: usize = made.scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum();
    println!("{triangles} triangles, made in {:.0?}", start.elapsed());
    for mesh in &made.scene.meshes {
        let name = &made.scene.materials[mesh.material as usize].name;
        println!("{:>8} {name}", mesh.triangles.len());
    }

    let view = CameraView { camera: made.scene.cameras[0].clone(), width: 960, height: 540 };
    let start = Instant::now();
    let visible = hide(&made.scene, &view, &HideOptions::default())?;
    println!("{} micropolygons, hidden in {:.0?}", visible.micropolygons.len(), start.elapsed());

    // The sun's shadows: a far, narrow camera that looks along the light.
    let focus = view.eye() + view.forward() * 55.0;
    let sun_camera = Camera::look_at(focus + made.sun_direction * 2000.0, focus, made.up, 0.075);
    let sun_view = CameraView { camera: sun_camera, width: 4096, height: 4096 };
    let options = HideOptions { samples: 1, ..HideOptions::default() };
    let seen_by_sun = hide(&made.scene, &sun_view, &options)?;
    let depths = seen_by_sun
        .resolve_nearest(|index| [seen_by_sun.micropolygons[index].depth], [f32::INFINITY]);
    let lit = |point: pbgi_math::Vec3| {
        let Some((raster, depth)) = sun_view.project(point) else { return true };
        let (x, y) = (raster.x as usize, raster.y as usize);
        let outside = raster.x < 0.0 || raster.y < 0.0 || x >= 4096 || y >= 4096;
        outside || depth < depths[y * 4096 + x][0] + 0.12
    };
    let shade = |index: usize| {
        let m = &visible.micropolygons[index];
        let sun = if lit(m.position + m.normal * 0.03) {
            m.normal.dot(made.sun_direction).max(0.0)
        } else {
            0.0
        };
        let sky = 0.5 + 0.5 * m.normal.dot(made.up);
        let light = [2.6 * sun + 0.32 * sky, 2.2 * sun + 0.38 * sky, 1.7 * sun + 0.52 * sky];
        if m.back { [1.0, 0.0, 1.0] } else { std::array::from_fn(|i| m.albedo[i] * light[i]) }
    };
    write_picture(&path, &view, &visible, shade)?;
    Ok(())
}

fn write_picture(
    path: &str,
    view: &CameraView,
    visible: &VisibleSet,
    shade: impl Fn(usize) -> [f32; 3] + Sync,
) -> Result<(), Box<dyn Error>> {
    let pixels = visible.resolve(shade, |direction| {
        let t = direction.y.max(0.0).sqrt();
        [0.85 - 0.5 * t, 0.85 - 0.35 * t, 0.9 - 0.1 * t]
    });
    let encode = |x: f32| {
        let toned = 1.0 - (-1.3 * x).exp();
        (toned.powf(1.0 / 2.2) * 255.0 + 0.5) as u8
    };
    let bytes: Vec<u8> = pixels.iter().flatten().map(|x| encode(*x)).collect();
    image::save_buffer(path, &bytes, view.width, view.height, image::ColorType::Rgb8)?;
    Ok(())
}
