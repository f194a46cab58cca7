//! Scenes far from the origin of their coordinates, as surveys have them: single floats would not tell their places apart.

use pbgi_math::{DVec3, Vec3};
use pbgi_scene::Scene;

/// Coordinates beyond this, where single floats are 1/256 apart and more, are read relative to an origin.
const FAR: f64 = 65_536.0;

/// Extents of a scene that it may be away from the origin: single floats are 10⁻⁴ of an extent apart there.
const AWAY_MAX: f32 = 840.0;

/// Positions that tell where a scene is.
const SAMPLE: usize = 1024;

/// Positions of a file, relative to an origin near the most of the first of them.
#[derive(Default)]
pub(crate) struct Places {
    /// Unknown as long as there are few.
    origin: Option<DVec3>,
    first: Vec<DVec3>,
    relative: Vec<Vec3>,
}

impl Places {
    pub fn len(&self) -> usize {
        self.first.len() + self.relative.len()
    }

    pub fn push(&mut self, place: DVec3) {
        match self.origin {
            Some(origin) => self.relative.push((place - origin).as_vec3()),
            None => self.first.push(place),
        }
        if self.first.len() == SAMPLE {
            self.settle();
        }
    }

    /// All positions so far, relative to the origin, which does not change any more.
    pub fn settle(&mut self) -> &[Vec3] {
        let first = std::mem::take(&mut self.first);
        let origin = *self.origin.get_or_insert_with(|| choose_origin(&first));
        self.relative.extend(first.into_iter().map(|place| (place - origin).as_vec3()));
        &self.relative
    }

    /// The origin, and all positions.
    pub fn finish(mut self) -> (DVec3, Vec<Vec3>) {
        self.settle();
        (self.origin.unwrap_or_default(), self.relative)
    }
}

/// The median of places, rounded, on each axis where it is far, else 0.
fn choose_origin(places: &[DVec3]) -> DVec3 {
    let median = |axis: usize| {
        let mut values: Vec<f64> =
            places.iter().map(|place| place[axis]).filter(|c| c.is_finite()).collect();
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied().filter(|c| c.abs() > FAR).map_or(0.0, f64::round)
    };
    DVec3::from_array([0, 1, 2].map(median))
}

/// Says where places have lost digits.
pub(crate) fn warn_of_lost_digits(scene: &mut Scene) {
    let bounds = scene.bounds();
    let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let size = bounds.extent().max_element();
    if size > 0.0 && farthest > AWAY_MAX * size {
        let step = farthest.next_up() - farthest;
        scene.warnings.push(format!(
            "the scene is {size} units large and reaches {farthest} units from the origin, where places are {step} units apart; move it \
             to the origin, or write it as .obj or as .ply with double coordinates, whose digits are kept"
        ));
    }
}

#[cfg(test)]
mod tests {
    use crate::read_scene;
    use pbgi_math::{DVec3, Vec3};

    /// A triangle of a survey keeps its digits where the format has them, else a warning says that it does not.
    #[test]
    fn digits_of_surveys_are_kept_or_missed() {
        let corners = [[500_000.123, 12.0, 4_600_000.777], [500_002.373, 12.0, 4_600_000.777]];
        let corners = [corners[0], corners[1], [500_000.123, 12.0, 4_599_998.527]];
        let folder = tempfile::tempdir().unwrap();
        let line = |c: [f64; 3]| format!("{} {} {}\n", c[0], c[1], c[2]);
        let obj: String = corners.iter().map(|c| format!("v {}", line(*c))).collect();
        let ply: String = corners.iter().map(|c| line(*c)).collect();
        let ply = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n{ply}3 0 1 2\n"
        );
        for (name, text) in [("a.obj", obj + "f 1 2 3\n"), ("a.ply", ply)] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            let scene = read_scene(&path).unwrap();
            assert_eq!(scene.origin, DVec3::new(500_000.0, 0.0, 4_600_001.0), "{name}");
            let edge = scene.meshes[0].positions[1] - scene.meshes[0].positions[0];
            assert!((edge - Vec3::new(2.25, 0.0, 0.0)).length() < 1e-5, "{name}: {edge}");
            assert_eq!(scene.meshes[0].positions[0].y, 12.0, "{name}");
            assert!(scene.warnings.is_empty(), "{name}: {:?}", scene.warnings);
        }
        // A vertex that no face uses may be anywhere.
        let stray = folder.path().join("stray.obj");
        std::fs::write(&stray, "v 1e30 0 0\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 2 3 4\n").unwrap();
        let scene = read_scene(&stray).unwrap();
        assert_eq!((scene.origin, scene.bounds().max), (DVec3::ZERO, Vec3::new(1.0, 1.0, 0.0)));
        let gltf = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":36,"uri":"a.bin"}],"bufferViews":[{"buffer":0,"byteLength":36}],
            "accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}],"meshes":[{"primitives":[{"attributes":
            {"POSITION":0}}]}],"nodes":[{"mesh":0,"translation":[500000.123,12,4600000.777]}]}"#;
        let near = [[0f32, 0.0, 0.0], [2.25, 0.0, 0.0], [0.0, 0.0, -2.25]];
        let bytes: Vec<u8> = near.as_flattened().iter().flat_map(|c| c.to_le_bytes()).collect();
        std::fs::write(folder.path().join("a.bin"), bytes).unwrap();
        let path = folder.path().join("a.gltf");
        std::fs::write(&path, gltf).unwrap();
        let scene = read_scene(&path).unwrap();
        assert!(scene.warnings[0].contains("places are 0.5 units apart"), "{:?}", scene.warnings);
    }
}
