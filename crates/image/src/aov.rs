//! Names of output channels, as different renderers and compositors know them.

use crate::Image;

/// A quantity the engine writes or reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Aov {
    /// Radiance toward the camera, with alpha: 4 channels.
    Beauty,
    /// Diffuse radiance, reflected light of surfaces: 3 channels. With the albedo, unless the name says without
    /// ([`AovNames::is_without_color`]).
    DiffuseIndirect,
    /// Diffuse radiance, reflected light of the environment, which renderers count as direct: 3 channels. With the albedo, unless the
    /// name says without.
    DiffuseDirect,
    /// Reflected indirect glossy radiance: 3 channels.
    SpecularIndirect,
    /// Irradiance, without albedo: 3 channels.
    Irradiance,
    /// Ambient occlusion, 1 = open: 1 channel.
    Occlusion,
    /// Cosine-weighted fraction of the environment that is seen: 1 channel.
    SkyVisibility,
    /// Mean open direction, world space: 3 channels.
    BentNormal,
    /// World position: 3 channels.
    Position,
    /// World-space unit normal: 3 channels.
    Normal,
    /// Distance along the view axis: 1 channel.
    Depth,
    /// Diffuse albedo: 3 channels.
    Albedo,
    /// GGX roughness, 0..=1: 1 channel.
    Roughness,
    /// Share of the surface that is metal, 0..=1: 1 channel.
    Metalness,
    /// Weight of the specular lobe, 0..=1: 1 channel.
    Specular,
    /// Unit vector from the surface to the eye, world space: 3 channels.
    View,
}

impl Aov {
    /// All quantities.
    pub const ALL: [Self; 16] = [
        Self::Beauty,
        Self::DiffuseIndirect,
        Self::DiffuseDirect,
        Self::SpecularIndirect,
        Self::Irradiance,
        Self::Occlusion,
        Self::SkyVisibility,
        Self::BentNormal,
        Self::Position,
        Self::Normal,
        Self::Depth,
        Self::Albedo,
        Self::Roughness,
        Self::Metalness,
        Self::Specular,
        Self::View,
    ];

    /// Whether the components are X, Y, Z rather than R, G, B.
    fn is_vector(self) -> bool {
        matches!(self, Self::BentNormal | Self::Position | Self::Normal | Self::View)
    }

    fn is_scalar(self) -> bool {
        matches!(
            self,
            Self::Occlusion
                | Self::SkyVisibility
                | Self::Depth
                | Self::Roughness
                | Self::Metalness
                | Self::Specular
        )
    }
}

/// Whose names to write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AovPreset {
    /// Arnold's built-in names.
    #[default]
    Arnold,
    /// The passes of Blender's Cycles.
    Blender,
    /// RenderMan's channels.
    Renderman,
}

impl AovPreset {
    /// All presets.
    pub const ALL: [Self; 3] = [Self::Arnold, Self::Blender, Self::Renderman];

    /// The preset called `name`: `arnold`, `blender` or `renderman`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "arnold" => Some(Self::Arnold),
            "blender" => Some(Self::Blender),
            "renderman" => Some(Self::Renderman),
            _ => None,
        }
    }
}

/// Layer name of each quantity. An empty name stands for bare `R`, `G`, `B`, `A`. A scalar's layer
/// name is its channel's whole name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AovNames {
    layers: [String; Aov::ALL.len()],
}

impl Default for AovNames {
    fn default() -> Self {
        Self::preset(AovPreset::Arnold)
    }
}

impl AovNames {
    /// The names of a preset, in the order of [`Aov::ALL`].
    #[must_use]
    pub fn preset(preset: AovPreset) -> Self {
        let layers = match preset {
            AovPreset::Arnold => [
                "",
                "diffuse_indirect",
                "diffuse_direct",
                "specular_indirect",
                "irradiance",
                "AO",
                "sky_visibility",
                "bent_normal",
                "P",
                "N",
                "Z",
                "albedo",
                "specular_roughness",
                "metalness",
                "specular",
                "V",
            ],
            AovPreset::Blender => [
                "Combined",
                "Diffuse Indirect",
                "Diffuse Direct",
                "Glossy Indirect with Color",
                "Irradiance",
                "Ambient Occlusion",
                "Sky Visibility",
                "Bent Normal",
                "Position",
                "Normal",
                "Depth",
                "Diffuse Color",
                "Roughness",
                "Metallic",
                "Specular",
                "View",
            ],
            AovPreset::Renderman => [
                "Ci",
                "indirectDiffuse",
                "directDiffuse",
                "indirectSpecular",
                "irradiance",
                "occlusion",
                "sky_visibility",
                "_environmentdir",
                "__Pworld",
                "__Nworld",
                "z",
                "albedo",
                "roughness",
                "metallic",
                "specular",
                "Vn",
            ],
        };
        Self { layers: layers.map(str::to_owned) }
    }

    /// Layer name of `aov`.
    #[must_use]
    pub fn layer(&self, aov: Aov) -> &str {
        &self.layers[aov as usize]
    }

    /// Gives `aov` another layer name.
    pub fn set_layer(&mut self, aov: Aov, layer: impl Into<String>) {
        self.layers[aov as usize] = layer.into();
    }

    /// A value of `aov` as its name means it: RenderMan's `occlusion` is 1 where all is covered, unlike all others' ambient occlusion,
    /// which is 1 where nothing is.
    #[must_use]
    pub fn value(&self, aov: Aov, value: f32) -> f32 {
        match aov {
            Aov::Occlusion if self.layer(aov) == "occlusion" => 1.0 - value,
            _ => value,
        }
    }

    /// Whether the name of a diffuse quantity means light without the albedo: irradiance over π. Blender's `Diffuse Direct` and `Diffuse
    /// Indirect` do; compositors multiply their sum by `Diffuse Color`.
    #[must_use]
    pub fn is_without_color(&self, aov: Aov) -> bool {
        let is_diffuse = matches!(aov, Aov::DiffuseDirect | Aov::DiffuseIndirect);
        is_diffuse && matches!(self.layer(aov), "Diffuse Direct" | "Diffuse Indirect")
    }

    /// Channel names of `aov`: 1, 3 or, for beauty, 4.
    #[must_use]
    pub fn channels(&self, aov: Aov) -> Vec<String> {
        let layer = self.layer(aov);
        let components: &[&str] = match aov {
            _ if aov.is_scalar() => return vec![layer.to_owned()],
            Aov::Beauty if layer == "Ci" => {
                return ["Ci.R", "Ci.G", "Ci.B", "a"].map(str::to_owned).into();
            }
            Aov::Beauty => &["R", "G", "B", "A"],
            _ if aov.is_vector() => &["X", "Y", "Z"],
            _ => &["R", "G", "B"],
        };
        components.iter().map(|component| join(layer, component)).collect()
    }

    /// The channels of `aov` in an image of any origin: these names first, then those of every
    /// preset and common synonyms; components `X/Y/Z`, `R/G/B` or `r/g/b`; with or without a view
    /// layer before them (`ViewLayer.Normal.X`). Beauty is found without its alpha.
    ///
    /// What renderers write in world space beside a version in camera space (`__Nworld` beside `Nn`) is found first.
    #[must_use]
    pub fn find<'a>(&self, image: &'a Image, aov: Aov) -> Option<Vec<&'a [f32]>> {
        let names: Vec<&str> = image.channels.iter().map(|c| c.name.as_str()).collect();
        let indices = self.find_among(&names, aov)?;
        Some(indices.into_iter().map(|index| image.channels[index].data.as_slice()).collect())
    }

    /// As [`AovNames::find`], among the `names` of channels: their indices.
    #[must_use]
    pub fn find_among(&self, names: &[&str], aov: Aov) -> Option<Vec<usize>> {
        let presets = AovPreset::ALL.map(Self::preset);
        let worlds = world_layers(aov).iter().copied();
        let own = worlds.chain(std::iter::once(self.layer(aov)));
        let known = presets.iter().map(|names| names.layer(aov));
        own.chain(known).chain(synonyms(aov).iter().copied()).find_map(|layer| {
            let components: &[&[&str]] = match aov {
                // A color of that name is the light of the lobe, not its weight.
                Aov::Specular => &[&[""], &["X"], &["V"], &["Y"]],
                _ if aov.is_scalar() => &[&[""], &["Z"], &["V"], &["Y"], &["X"], &["R"], &["r"]],
                _ => &[&["X", "Y", "Z"], &["x", "y", "z"], &["R", "G", "B"], &["r", "g", "b"]],
            };
            components.iter().find_map(|set| {
                set.iter().map(|component| find_name(names, &join(layer, component))).collect()
            })
        })
    }

    /// The channel among `names` that says how much of a pixel is covered.
    #[must_use]
    pub fn find_alpha(names: &[&str]) -> Option<usize> {
        let known = ["A", "a", "alpha", "Combined.A", "RGBA.A", "rgba.A", "beauty.A", "Ci.A"];
        known.iter().find_map(|name| find_name(names, name))
    }
}

/// Names that say world space, of quantities which the same file may also have in camera space.
fn world_layers(aov: Aov) -> &'static [&'static str] {
    match aov {
        Aov::Position => &["__Pworld"],
        Aov::Normal => &["__Nworld", "Nworld"],
        _ => &[],
    }
}

fn synonyms(aov: Aov) -> &'static [&'static str] {
    match aov {
        Aov::Beauty => &["rgba", "beauty"],
        Aov::Position => &["position", "Pworld", "worldP"],
        Aov::Normal => &["normal", "N_world", "normals", "Nn"],
        Aov::Depth => &["depth"],
        Aov::Albedo => &["diffuse_albedo", "DiffCol"],
        Aov::Metalness => &["Metalness"],
        Aov::View => &["view", "viewdir"],
        _ => &[],
    }
}

fn join(layer: &str, component: &str) -> String {
    match (layer, component) {
        ("", component) => component.to_owned(),
        (layer, "") => layer.to_owned(),
        _ => format!("{layer}.{component}"),
    }
}

/// Index of the channel `name`, or of the first whose name is `name` after a view layer and a dot.
fn find_name(names: &[&str], name: &str) -> Option<usize> {
    names.iter().position(|full| *full == name).or_else(|| {
        // A bare R would otherwise be found in any layer.
        let layered = name.contains('.');
        let matches = |full: &&str| {
            full.strip_suffix(name)
                .and_then(|head| head.strip_suffix('.'))
                .is_some_and(|view| !view.contains('.'))
        };
        names.iter().position(|full| layered && matches(full))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_names_are_those_compositors_expect() {
        let names = AovNames::default();
        assert_eq!(names.channels(Aov::Beauty), ["R", "G", "B", "A"]);
        assert_eq!(names.channels(Aov::DiffuseIndirect)[1], "diffuse_indirect.G");
        assert_eq!(
            names.channels(Aov::BentNormal),
            ["bent_normal.X", "bent_normal.Y", "bent_normal.Z"]
        );
        assert_eq!(names.channels(Aov::Depth), ["Z"]);
        assert_eq!(names.channels(Aov::Occlusion), ["AO"]);
    }

    #[test]
    fn occlusion_of_renderman_is_1_where_covered() {
        for (preset, expected) in
            [(AovPreset::Arnold, 0.75), (AovPreset::Blender, 0.75), (AovPreset::Renderman, 0.25)]
        {
            let names = AovNames::preset(preset);
            assert_eq!(names.value(Aov::Occlusion, 0.75), expected);
            assert_eq!(names.value(Aov::SkyVisibility, 0.75), 0.75);
        }
    }

    /// Blender's light passes are without color; `Nn` is in camera space, so that a world normal must not have that name.
    #[test]
    fn names_mean_what_their_programs_mean() {
        let blender = AovNames::preset(AovPreset::Blender);
        assert_eq!(blender.channels(Aov::DiffuseDirect)[0], "Diffuse Direct.R");
        assert_eq!(blender.channels(Aov::DiffuseIndirect)[2], "Diffuse Indirect.B");
        for aov in Aov::ALL {
            let is_light = matches!(aov, Aov::DiffuseDirect | Aov::DiffuseIndirect);
            assert_eq!(blender.is_without_color(aov), is_light, "{aov:?}");
            assert!(!AovNames::default().is_without_color(aov), "{aov:?}");
        }
        let renderman = AovNames::preset(AovPreset::Renderman);
        assert_eq!(renderman.channels(Aov::Normal)[0], "__Nworld.X");
        let found = AovNames::default().find_among(&["Nn.X", "Nn.Y", "Nn.Z"], Aov::Normal);
        assert_eq!(found, Some(vec![0, 1, 2]));
    }

    #[test]
    fn names_are_unique_in_every_preset() {
        for preset in AovPreset::ALL {
            let names = AovNames::preset(preset);
            let mut all: Vec<String> = Aov::ALL.iter().flat_map(|a| names.channels(*a)).collect();
            let count = all.len();
            all.sort();
            all.dedup();
            assert_eq!(all.len(), count, "{preset:?}");
        }
    }

    #[test]
    fn g_buffers_of_all_presets_are_understood() {
        for preset in AovPreset::ALL {
            let names = AovNames::preset(preset);
            let mut image = Image::new(1, 1);
            let mut value = 0.0;
            for aov in Aov::ALL {
                for channel in names.channels(aov) {
                    image.push(channel, vec![value]);
                    value += 1.0;
                }
            }
            let reader = AovNames::default();
            for aov in [Aov::Beauty, Aov::Position, Aov::Normal, Aov::Depth, Aov::Albedo] {
                let found = reader.find(&image, aov).unwrap();
                for (data, channel) in found.iter().zip(names.channels(aov)) {
                    assert_eq!(Some(*data), image.channel(&channel), "{preset:?} {channel}");
                }
            }
        }
    }

    #[test]
    fn view_layers_and_lower_case_components_are_found() {
        let mut image = Image::new(1, 1);
        for (i, name) in ["ViewLayer.Normal.X", "ViewLayer.Normal.Y", "ViewLayer.Normal.Z"]
            .into_iter()
            .chain(["P.r", "P.g", "P.b", "ViewLayer.Depth.Z"])
            .enumerate()
        {
            image.push(name, vec![i as f32]);
        }
        let names = AovNames::default();
        let values =
            |aov| -> Vec<f32> { names.find(&image, aov).unwrap().iter().map(|c| c[0]).collect() };
        assert_eq!(values(Aov::Normal), [0.0, 1.0, 2.0]);
        assert_eq!(values(Aov::Position), [3.0, 4.0, 5.0]);
        assert_eq!(values(Aov::Depth), [6.0]);
        assert_eq!(names.find(&image, Aov::Beauty), None);
        assert_eq!(names.find(&image, Aov::Albedo), None);
    }

    #[test]
    fn surface_properties_are_told_from_light() {
        let find = |names: &[&str], aov| AovNames::default().find_among(names, aov);
        assert_eq!(find(&["specular.R", "specular.G", "specular.B"], Aov::Specular), None);
        assert_eq!(find(&["x", "specular"], Aov::Specular), Some(vec![1]));
        assert_eq!(find(&["ViewLayer.Roughness.X"], Aov::Roughness), Some(vec![0]));
        assert_eq!(find(&["specular_roughness"], Aov::Roughness), Some(vec![0]));
        assert_eq!(find(&["ViewLayer.Metallic.V"], Aov::Metalness), Some(vec![0]));
        assert_eq!(AovNames::find_alpha(&["R", "ViewLayer.Combined.A"]), Some(1));
        assert_eq!(AovNames::find_alpha(&["albedo.A"]), None);
    }

    /// RenderMan writes both; only one is in world space.
    #[test]
    fn world_space_is_preferred() {
        let names = ["Nn.X", "Nn.Y", "Nn.Z", "__Nworld.X", "__Nworld.Y", "__Nworld.Z"];
        assert_eq!(AovNames::default().find_among(&names, Aov::Normal), Some(vec![3, 4, 5]));
    }
}
