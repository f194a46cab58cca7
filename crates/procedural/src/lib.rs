//! Scenes made from a name and a seed, for demonstrations and tests.
//!
//! This crate must never read files, nor know what scenes are used for.
#![forbid(unsafe_code)]

mod builder;
mod foliage;
mod plants;
mod random;
mod simple;
mod spec;
mod street;

pub use spec::{ProceduralError, ProceduralSpec};

use pbgi_math::Vec3;
use pbgi_scene::Scene;

/// A procedural scene and the light it was made for.
#[derive(Clone, Debug)]
pub struct ProceduralScene {
    /// The scene, with one camera.
    pub scene: Scene,
    /// Unit direction toward the sun that suits the scene.
    pub sun_direction: Vec3,
    /// Upward unit vector.
    pub up: Vec3,
}

/// Makes the scene that `spec` describes, such as `demo:street?seed=1` (see [`ProceduralSpec`]).
/// One unit is one meter, +Y is up. Equal specs give equal scenes on every machine.
///
/// | name | scene |
/// |---|---|
/// | `street` | a curved street of painted houses, trees and awnings under hills |
/// | `cornell` | the Cornell box with its measured albedos (0.555 m wide) |
/// | `spheres` | spheres and boxes on a plane, for skies |
/// | `foliage` | a small thicket on grass |
/// | `room` | a closed white box of 4 × 3 × 5 m, a lamp below its ceiling |
///
/// # Errors
///
/// [`ProceduralError`] for a text that names no scene or holds a key or value out of range.
pub fn procedural_scene(spec: &str) -> Result<ProceduralScene, ProceduralError> {
    let spec = ProceduralSpec::parse(spec)?;
    let size = |default: u32| spec.size.unwrap_or(default);
    Ok(match spec.name.as_str() {
        "street" => street::street(spec.seed, size(12)),
        "cornell" => simple::cornell(),
        "spheres" => simple::spheres(spec.seed, size(24)),
        "foliage" => foliage::foliage(spec.seed, size(7)),
        _ => simple::room(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_scene::{CameraView, HideOptions, hide};

    #[test]
    fn scenes_are_sound_and_repeatable() {
        for name in spec::SCENE_NAMES {
            let text = format!("demo:{name}?seed=5");
            let made = procedural_scene(&text).unwrap();
            let again = procedural_scene(&text).unwrap();
            assert_eq!(made.scene.meshes.len(), again.scene.meshes.len());
            assert!((made.sun_direction.length() - 1.0).abs() < 1e-5);
            assert_eq!(made.scene.cameras.len(), 1);
            for (mesh, twin) in made.scene.meshes.iter().zip(&again.scene.meshes) {
                assert_eq!(mesh.positions, twin.positions, "{name}");
                assert_eq!(mesh.triangles, twin.triangles, "{name}");
                assert_eq!(mesh.colors, twin.colors, "{name}");
                let count = mesh.positions.len();
                assert!(mesh.normals.is_empty() || mesh.normals.len() == count);
                assert!(mesh.colors.is_empty() || mesh.colors.len() == count);
                assert!(mesh.positions.iter().all(|p| p.is_finite()));
                assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-3));
                assert!((mesh.material as usize) < made.scene.materials.len());
                for triangle in &mesh.triangles {
                    let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
                    let area = (b - a).cross(c - a).length();
                    assert!(area > 1e-9, "{name}: {a} {b} {c}");
                }
                for color in &mesh.colors {
                    let base = made.scene.materials[mesh.material as usize].base_color;
                    assert!((0..3).all(|i| (0.0..=0.95).contains(&(base[i] * color[i]))));
                }
            }
        }
    }

    #[test]
    fn smooth_normals_lie_on_the_front() {
        for name in ["street", "spheres", "foliage"] {
            let made = procedural_scene(&format!("demo:{name}")).unwrap();
            let (mut agree, mut total) = (0, 0);
            for mesh in made.scene.meshes.iter().filter(|mesh| !mesh.normals.is_empty()) {
                for triangle in &mesh.triangles {
                    let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
                    let front = (b - a).cross(c - a);
                    let sum: Vec3 = triangle.iter().map(|v| mesh.normals[*v as usize]).sum();
                    agree += usize::from(front.dot(sum) > 0.0);
                    total += 1;
                }
            }
            assert_eq!(agree, total, "{name}");
        }
    }

    #[test]
    fn cameras_see_hardly_any_back_side() {
        for name in spec::SCENE_NAMES {
            let scene = procedural_scene(&format!("demo:{name}")).unwrap().scene;
            let view = CameraView { camera: scene.cameras[0].clone(), width: 480, height: 270 };
            let visible = hide(&scene, &view, &HideOptions::default()).unwrap();
            let backs = visible.micropolygons.iter().filter(|m| m.back).count();
            // Open ends of branches remain.
            assert!(backs * 1000 <= visible.micropolygons.len(), "{name}: {backs}");
        }
    }

    #[test]
    fn seeds_make_different_streets_of_a_fitting_size() {
        let one = procedural_scene("demo:street?seed=1").unwrap().scene;
        let two = procedural_scene("demo:street?seed=2").unwrap().scene;
        let count = |scene: &Scene| scene.meshes.iter().map(|m| m.triangles.len()).sum::<usize>();
        assert_ne!(count(&one), count(&two));
        assert!((150_000..400_000).contains(&count(&one)), "{}", count(&one));
    }
}
