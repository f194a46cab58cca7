//! What a surface reflects.

/// Reflectance at normal incidence of a dielectric whose `specular` is 1.
const SPECULAR_SCALE: f32 = 0.08;

/// Least roughness: a lobe of 0.05°, narrower than any sun.
const ROUGHNESS_MIN: f32 = 0.02;

/// A surface as glTF and film renderers describe it: a diffuse base under a glossy coat, or a metal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Linear color: the diffuse albedo of a dielectric, the mirror color of a metal; 0..=1.
    pub base_color: [f32; 3],
    /// 0 for dielectrics, 1 for metals.
    pub metalness: f32,
    /// Perceptual roughness, 0..=1; the width α of the microfacets' slopes is its square.
    pub roughness: f32,
    /// Strength of a dielectric's gloss, 0..=1: it reflects 0.08 of it at normal incidence; 0.5 stands for an index of refraction of 1.5.
    pub specular: f32,
}

impl Default for Material {
    fn default() -> Self {
        Self { base_color: [0.8; 3], metalness: 0.0, roughness: 1.0, specular: 0.5 }
    }
}

impl Material {
    /// Share of the irradiance that the diffuse base reflects where nothing is lost to gloss, 0..=1.
    #[must_use]
    pub fn diffuse_albedo(&self) -> [f32; 3] {
        self.base_color.map(|c| c * (1.0 - self.metalness))
    }

    /// Reflectance at normal incidence, per channel.
    #[must_use]
    #[inline]
    pub fn normal_reflectance(&self) -> [f32; 3] {
        let dielectric = SPECULAR_SCALE * self.specular;
        self.base_color.map(|c| dielectric + (c - dielectric) * self.metalness)
    }

    /// Width α of the GGX distribution of slopes, at least 0.0004.
    #[must_use]
    #[inline]
    pub fn alpha(&self) -> f32 {
        let roughness = self.roughness.clamp(ROUGHNESS_MIN, 1.0);
        roughness * roughness
    }

    /// Whether all numbers lie in their ranges.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let numbers = [self.metalness, self.roughness, self.specular];
        numbers.iter().chain(&self.base_color).all(|x| (0.0..=1.0).contains(x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metals_reflect_their_color_and_dielectrics_four_percent() {
        let plastic = Material { base_color: [0.9, 0.1, 0.0], ..Material::default() };
        assert_eq!(plastic.normal_reflectance(), [0.04; 3]);
        assert_eq!(plastic.diffuse_albedo(), plastic.base_color);
        let metal = Material { metalness: 1.0, ..plastic };
        for (found, expected) in metal.normal_reflectance().into_iter().zip(plastic.base_color) {
            assert!((found - expected).abs() < 1e-6);
        }
        assert_eq!(metal.diffuse_albedo(), [0.0; 3]);
        let smooth = Material { roughness: 0.0, ..metal };
        assert!(smooth.alpha() > 3e-4 && smooth.alpha() < 5e-4);
    }

    #[test]
    fn what_is_out_of_range_is_not_valid() {
        assert!(Material::default().is_valid());
        for bad in [
            Material { roughness: 1.1, ..Material::default() },
            Material { metalness: f32::NAN, ..Material::default() },
            Material { base_color: [0.0, -0.1, 0.0], ..Material::default() },
        ] {
            assert!(!bad.is_valid(), "{bad:?}");
        }
    }
}
