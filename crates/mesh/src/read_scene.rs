//! Scene files of any kind.

use crate::SceneError;
use crate::origin::warn_of_lost_digits;
use crate::read_gltf::read_gltf;
use crate::read_obj::read_obj;
use crate::read_ply_mesh::read_ply_mesh;
use crate::resources::Resources;
use pbgi_file::Allowance;
use pbgi_scene::Scene;
use std::path::Path;

/// Reads a scene file by its extension: glTF 2.0 (`.glb`, `.gltf`), Wavefront OBJ (`.obj`) or a PLY
/// mesh (`.ply`).
///
/// Every index in the scene points to something, every position that a triangle uses is finite. What is left out or read
/// differently is listed in [`Scene::warnings`]. Files that it refers to may lie anywhere, as studios share textures and libraries; what is
/// no regular file is not opened.
///
/// # Errors
///
/// If the file cannot be read, is malformed or uses something unsupported; the message names file,
/// place and cure.
pub fn read_scene(path: &Path) -> Result<Scene, SceneError> {
    read_scene_within(path, &Allowance::unlimited())
}

/// As [`read_scene`], within an allowance of memory: what files hold is counted before it is read.
///
/// # Errors
///
/// As [`read_scene`]; an [`Excess`](pbgi_file::Excess) as cause where the allowance does not do.
pub fn read_scene_within(path: &Path, allowance: &Allowance) -> Result<Scene, SceneError> {
    let resources = Resources::new(allowance);
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let scene = match extension.to_ascii_lowercase().as_str() {
        "glb" | "gltf" => read_gltf(path, &resources),
        "obj" => read_obj(path, &resources),
        "ply" => read_ply_mesh(path, &resources),
        _ => Err(SceneError::unsupported(
            path,
            format!("a scene file with the extension `{extension}`"),
            "expected .glb, .gltf, .obj or .ply",
        )),
    }?;
    let mut scene = Scene { files: resources.into_files(), ..scene };
    warn_of_lost_digits(&mut scene);
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::SurfelSource;
    use pbgi_math::Vec3;
    use pbgi_scene::{DiceOptions, DicedScene, Spacing, TwoSided};
    use std::time::Instant;

    /// Reads a file of the shared test data; `None`, with a notice, if it is not there.
    fn read_shared(name: &str) -> Option<Scene> {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/");
        let path = Path::new(root).join(name);
        if !path.exists() {
            println!("skipped: {} is not there", path.display());
            return None;
        }
        let start = Instant::now();
        let scene = read_scene(&path).unwrap();
        println!("{name}: {:.2} s, warnings {:?}", start.elapsed().as_secs_f64(), scene.warnings);
        Some(scene)
    }

    fn triangle_count(scene: &Scene) -> usize {
        let count = |i: &pbgi_scene::Instance| scene.meshes[i.mesh as usize].triangles.len();
        scene.instances.iter().map(count).sum()
    }

    /// Dices to about `count` surfels and checks count, area and bounds of what comes.
    fn dice(scene: &Scene, count: u64) {
        let options = DiceOptions { spacing: Spacing::Count(count), two_sided: TwoSided::None };
        let start = Instant::now();
        let mut diced = DicedScene::new(scene, options).unwrap();
        let prepared = start.elapsed().as_secs_f64();
        let (mut chunk, mut surfels, mut area) = (vec![], 0u64, 0f64);
        let (mut thin, mut radius_max) = (0u64, 0f32);
        let mut more = true;
        while more {
            more = diced.read_chunk(&mut chunk).unwrap();
            for s in chunk.drain(..) {
                assert!(s.radius > 0.0 && s.area > 0.0 && s.center().is_finite());
                assert!(s.albedo_rgb().iter().all(|c| (0.0..=1.0).contains(c)));
                surfels += 1;
                area += f64::from(s.area);
                radius_max = radius_max.max(s.radius);
                thin += u64::from(s.area < 0.05 * std::f32::consts::PI * s.radius * s.radius);
            }
        }
        println!(
            "{surfels} of {count} surfels at spacing {:.4}, prepared in {prepared:.2} s, all in \
             {:.2} s; {:.1} % fill less than 5 % of their disk; largest radius {radius_max:.4}",
            diced.spacing(),
            start.elapsed().as_secs_f64(),
            thin as f64 / surfels as f64 * 100.0,
        );
        assert_eq!(diced.count(), Some(surfels));
        let masked = scene.materials.iter().any(|m| m.alpha_cutoff.is_some());
        assert!(if masked {
            area < diced.area()
        } else {
            (area / diced.area() - 1.0).abs() < 1e-5
        });
        assert!(area > 0.9 * diced.area());
    }

    #[test]
    fn sponza_has_its_triangles_materials_and_textures() {
        let Some(scene) = read_shared("data/sponza_crytek.glb") else { return };
        assert_eq!((triangle_count(&scene), scene.instances.len()), (262_267, 389));
        assert_eq!((scene.materials.len(), scene.textures.len()), (26, 24));
        let masked = scene.materials.iter().filter(|m| m.alpha_cutoff.is_some());
        assert_eq!(masked.count(), 3);
        // 37 m long.
        assert!((scene.bounds().extent().x - 37.0).abs() < 2.0, "{:?}", scene.bounds());
        dice(&scene, 2_000_000);
    }

    #[test]
    fn meshes_of_the_stanford_repository_are_whole() {
        for (name, vertices, triangles) in
            [("stanford_bunny", 35_947, 69_451), ("stanford_dragon_res2", 100_250, 202_520)]
        {
            let Some(scene) = read_shared(&format!("data/{name}.ply")) else { return };
            assert_eq!(scene.meshes[0].positions.len(), vertices);
            assert_eq!(triangle_count(&scene), triangles);
            dice(&scene, 500_000);
        }
    }

    #[test]
    fn objects_and_rooms_are_read() {
        let Some(boom_box) = read_shared("data/BoomBox.glb") else { return };
        assert_eq!((triangle_count(&boom_box), boom_box.textures.len()), (6036, 2));
        let material = &boom_box.materials[0];
        // Its factor is 1, but this copy of its metalness texture is black.
        assert_eq!(material.metallic, 0.0);
        assert!(material.emission_texture.is_some());
        dice(&boom_box, 100_000);
        let Some(flat) = read_shared("data/dream_apartment.glb") else { return };
        assert_eq!((triangle_count(&flat), flat.materials.len()), (177_934, 67));
        dice(&flat, 1_000_000);
    }

    #[test]
    fn ambient_color_of_the_cornell_box_does_not_shine() {
        let Some(scene) = read_shared("data/cornell_box.obj") else { return };
        assert_eq!(triangle_count(&scene), 38);
        assert!(scene.materials.iter().all(|m| m.emission == [0.0; 3]));
        assert!(scene.materials.iter().any(|m| m.base_color == [1.0, 0.0, 0.0]));
        dice(&scene, 1_000_000);
    }

    #[test]
    fn reference_room_has_its_camera_and_emitter() {
        let Some(scene) = read_shared("reference/room.glb") else { return };
        assert_eq!(triangle_count(&scene), 10_288);
        let camera = &scene.cameras[0];
        let position = Vec3::from(camera.transform.translation);
        assert!((position - Vec3::new(0.95, 1.45, 2.05)).length() < 1e-5);
        assert!((camera.yfov.to_degrees() - 64.0).abs() < 1e-3);
        let target = Vec3::new(-0.25, 0.8, -1.0) - position;
        let forward = camera.transform.transform_vector3(Vec3::NEG_Z);
        assert!(forward.dot(target.normalize()) > 0.99999);
        let lamp = scene.materials.iter().find(|m| m.emission != [0.0; 3]).unwrap();
        assert!((Vec3::from(lamp.emission) - Vec3::new(14.0, 12.0, 9.0)).length() < 1e-4);
        dice(&scene, 300_000);
        let Some(thicket) = read_shared("reference/thicket.glb") else { return };
        assert_eq!(thicket.materials.iter().filter(|m| m.double_sided).count(), 2);
        dice(&thicket, 300_000);
    }

    #[test]
    fn unknown_extensions_are_refused() {
        let error = read_scene(Path::new("scene.fbx")).unwrap_err().to_string();
        assert!(error.contains("`fbx`") && error.contains(".glb"), "{error}");
        assert!(matches!(read_scene(Path::new("none.glb")), Err(SceneError::Io { .. })));
    }
}
