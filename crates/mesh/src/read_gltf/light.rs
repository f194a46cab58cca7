//! Lights without extent: `KHR_lights_punctual`.

use gltf::json::Root;
use gltf::json::extensions::scene::khr_lights_punctual::{Light, Type};
use gltf::json::validation::Checked;
use pbgi_math::{Affine3A, Vec3};
use pbgi_scene::{PunctualLight, Scene};

/// Lights that were placed, and what of them is read differently than the file says.
#[derive(Default)]
pub(super) struct Lights {
    /// Names of spot lights.
    spots: Vec<String>,
    /// Names of lights with a range.
    ranged: Vec<String>,
}

impl Lights {
    /// Places the light of a node, if it has one. Position and axis follow the node; its scale changes no intensity.
    pub fn place(
        &mut self,
        root: &Root,
        node: &gltf::Node,
        transform: &Affine3A,
        scene: &mut Scene,
    ) {
        let Some(light) = light_of(root, node) else { return };
        let name = light.name.clone().or(node.name().map(str::to_owned));
        let name = name.unwrap_or_else(|| format!("of node {}", node.index()));
        match read_light(light, transform) {
            Ok(read) => {
                scene.lights.push(read);
                if matches!(light.type_, Checked::Valid(Type::Spot)) {
                    self.spots.push(name.clone());
                }
                if light.range.is_some() {
                    self.ranged.push(name);
                }
            }
            Err(reason) => scene.warnings.push(format!("light {name} {reason}")),
        }
    }

    /// One sentence for each kind of difference.
    pub fn warn(self, warnings: &mut Vec<String>) {
        if !self.spots.is_empty() {
            let text = "shine by the cosine of the angle to their axis, not within their cones";
            warnings.push(format!("spot lights {text}: {}", list(&self.spots)));
        }
        if !self.ranged.is_empty() {
            let text = "lights shine beyond their range";
            warnings.push(format!("{text}, by the inverse square: {}", list(&self.ranged)));
        }
    }
}

/// Names that are listed; the rest is counted.
const NAMES_LISTED: usize = 3;

fn list(names: &[String]) -> String {
    let shown = names[..names.len().min(NAMES_LISTED)].join(", ");
    match names.len().saturating_sub(NAMES_LISTED) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

fn light_of<'a>(root: &'a Root, node: &gltf::Node) -> Option<&'a Light> {
    let of_node =
        root.nodes.get(node.index())?.extensions.as_ref()?.khr_lights_punctual.as_ref()?;
    let lights = root.extensions.as_ref()?.khr_lights_punctual.as_ref()?;
    lights.lights.get(of_node.light.value())
}

/// A point or spot light in the world; the error says why there is none.
fn read_light(light: &Light, transform: &Affine3A) -> Result<PunctualLight, String> {
    let intensity = light.color.map(|c| c * light.intensity);
    if !intensity.iter().all(|i| (0.0..=f32::MAX).contains(i)) {
        let [r, g, b] = intensity;
        return Err(format!(
            "has the intensity {r}, {g}, {b} and is left out; expected 0 or more, and finite"
        ));
    }
    let axis = -Vec3::from(transform.matrix3.z_axis);
    let axis = axis.try_normalize().ok_or("has no direction and is left out".to_owned());
    let axis = match light.type_ {
        Checked::Valid(Type::Point) => None,
        Checked::Valid(Type::Spot) => Some(axis?),
        _ => return Err(describe_sun(intensity, -axis?)),
    };
    Ok(PunctualLight { position: transform.translation.into(), axis, intensity })
}

/// What to do without a directional light, which `direction` leads to.
fn describe_sun([r, g, b]: [f32; 3], direction: Vec3) -> String {
    let Vec3 { x, y, z } = direction;
    format!(
        "is infinitely far away and left out; give an environment with a sun instead (--env), of the irradiance {r}, {g}, {b} from \
         the direction {x:.3}, {y:.3}, {z:.3}"
    )
}
