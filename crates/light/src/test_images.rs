//! Images and directions for tests.

use pbgi_image::{RgbImage, read_environment};
use pbgi_math::Vec3;
use std::path::Path;

fn read_shared(folder: &str, name: &str) -> Option<RgbImage> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared");
    let path = Path::new(root).join(folder).join(name);
    if !path.exists() {
        println!("skipped: no {folder}/{name}");
        return None;
    }
    Some(read_environment(&path).unwrap())
}

pub fn read_data(name: &str) -> Option<RgbImage> {
    read_shared("data", name)
}

pub fn read_reference(name: &str) -> Option<RgbImage> {
    read_shared("reference", name)
}

/// Directions spread evenly over the sphere.
pub fn sphere(count: u32) -> impl Iterator<Item = Vec3> {
    (0..count).map(move |i| {
        let z = -1.0 + 2.0 * (i as f32 + 0.5) / count as f32;
        let phi = i as f32 * 2.399_963_2;
        let r = (1.0 - z * z).sqrt();
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    })
}
