//! Directional importance: how fine the cut is in each direction (Tabellion 2012, with more terms).
//!
//! Every threshold has the same form. Each term has a *factor* by which it would scale the user's largest solid angle: below 1 where a
//! direction is important, above 1 where detail cannot show. With *F* their product, importance is 1 − min(*F*, 1) and *relief* is max(*F*, 1),
//! and a node may have the solid angle
//!
//! ```text
//! texel + (relief · user − texel) · (1 − importance)
//! ```
//!
//! where *texel* is that of the smallest texel of the raster that is drawn into: nothing smaller shows.

use pbgi_brdf::GgxLobe;
use pbgi_cut::{NodeSeen, Threshold};
use pbgi_light::{EnvironmentPyramid, Variation};
use pbgi_math::Vec3;
use std::f32::consts::PI;
use std::fmt;
use std::str::FromStr;

/// Which terms shape the thresholds. Without any, nodes may have the same solid angle in every direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImportanceTerms {
    /// Finer before bright parts of the environment, and as fine as their windows before its peaks.
    pub env: bool,
    /// Finer toward what a glossy receiver reflects most of.
    pub lobe: bool,
    /// Coarser toward the horizon of a diffuse receiver, by the cosine.
    pub cosine: bool,
    /// Finer where nodes shine brightly.
    pub radiance: bool,
    /// Coarser where a node is a piece of a plane, which as one looks as its surfels do.
    pub quality: bool,
}

impl ImportanceTerms {
    /// All terms.
    pub const ALL: Self =
        Self { env: true, lobe: true, cosine: true, radiance: true, quality: true };
    /// None: uniform thresholds.
    pub const OFF: Self =
        Self { env: false, lobe: false, cosine: false, radiance: false, quality: false };

    fn named(&mut self) -> [(&'static str, &mut bool); 5] {
        [
            ("env", &mut self.env),
            ("lobe", &mut self.lobe),
            ("cosine", &mut self.cosine),
            ("radiance", &mut self.radiance),
            ("quality", &mut self.quality),
        ]
    }
}

impl Default for ImportanceTerms {
    fn default() -> Self {
        Self::ALL
    }
}

/// Names of the terms, separated by commas, or `off`.
impl fmt::Display for ImportanceTerms {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut copy = *self;
        let on: Vec<&str> = copy.named().iter().filter(|t| *t.1).map(|t| t.0).collect();
        f.write_str(if on.is_empty() { "off".to_owned() } else { on.join(",") }.as_str())
    }
}

/// Reads what [`fmt::Display`] writes, and `all`.
impl FromStr for ImportanceTerms {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => return Ok(Self::ALL),
            "off" => return Ok(Self::OFF),
            _ => {}
        }
        let mut terms = Self::OFF;
        for name in text.split(',').map(str::trim) {
            let mut named = terms.named();
            let known = named.iter_mut().find(|t| t.0 == name);
            let Some((_, flag)) = known else {
                return Err(format!(
                    "`{name}` is no term of importance; expected some of env,lobe,cosine,radiance,quality, or `all` or `off`"
                ));
            };
            **flag = true;
        }
        Ok(terms)
    }
}

/// Squared sine of the half-angle of a cone of this solid angle, at most that of half a sphere.
#[inline(always)]
fn sin2_of(solid_angle_sr: f32) -> f32 {
    let x = solid_angle_sr * (0.5 / PI);
    let x = if x < 1.0 { x } else { 1.0 };
    x * (2.0 - x)
}

/// Largest squared sine, whatever the relief: beyond, receivers within a node's sphere would take it.
const SIN2_MAX: f32 = 0.7;

/// Largest product of all factors.
const RELIEF_MAX: f32 = 16.0;

/// The one formula of all thresholds, by the product of all factors; solid angles in steradians.
#[inline(always)]
fn slide(texel_sr: f32, user_sr: f32, factor: f32) -> f32 {
    // A user who wants it finer than the texel gets that everywhere.
    let texel = if texel_sr < user_sr { texel_sr } else { user_sr };
    let (relief, rest) = (factor.clamp(1.0, RELIEF_MAX), factor.clamp(0.0, 1.0));
    let sin2 = sin2_of(texel + (relief * user_sr - texel) * rest);
    if sin2 < SIN2_MAX { sin2 } else { SIN2_MAX }
}

/// Cosine below which the factor toward the horizon rises no further.
const COSINE_MIN: f32 = 0.3;

/// Factor of a plane: its outline is exact, its light a mean.
const PLANE_FACTOR: f32 = 4.0;

/// Smallest factor of what is bright.
const BRIGHT_FACTOR_MIN: f32 = 0.01;

/// Largest factor of what is dark.
const DARK_FACTOR_MAX: f32 = 4.0;

/// [`Variation::gain`] of a sky from which on nodes are weighed by it. Weighing takes a fifth of a gather: in the street, skies of 1.33 and 1.34 cost as
/// much at the same error with it as without, one of 1.7 a fifth less.
const GAIN_MIN: f32 = 1.5;

/// How much light is at stake in a direction: what a node shines, or what of the sky it hides.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stakes<'a> {
    /// 1 over the brightness that counts as usual, the larger of the means of surfaces and sky; 0 where all is dark.
    inverse: f32,
    /// Brightness that counts as usual.
    pub usual: f32,
    /// What nodes count for without the term of radiance.
    surfaces: Option<f32>,
    /// The sky, by direction; without the term of the environment its mean.
    sky: Option<&'a EnvironmentPyramid>,
    sky_mean: f32,
}

impl<'a> Stakes<'a> {
    /// For surfaces of this mean brightness under an environment.
    pub fn new(terms: ImportanceTerms, surfaces: f32, sky: Option<&'a EnvironmentPyramid>) -> Self {
        let variation = sky.map_or(Variation::default(), EnvironmentPyramid::variation);
        let usual = surfaces.max(variation.usual);
        Self {
            inverse: if usual > 0.0 { 1.0 / usual } else { 0.0 },
            usual,
            surfaces: (!terms.radiance).then_some(surfaces),
            sky: sky.filter(|_| terms.env && variation.gain >= GAIN_MIN),
            sky_mean: variation.mean,
        }
    }

    /// Whether every direction is like any other.
    pub fn are_even(&self) -> bool {
        self.inverse == 0.0 || (self.surfaces.is_some() && self.sky.is_none())
    }

    /// Factor of light so many times as bright as usual.
    ///
    /// Where a node lies is known to about its half-angle, so the error of the light that it sends or hides is as its radiance times its
    /// solid angle to the power 3/2: errors are equal where solid angles are as the radiance to the power −2/3.
    #[inline(always)]
    fn factor(&self, node: &NodeSeen) -> f32 {
        if self.are_even() {
            return 1.0;
        }
        let shines = self.surfaces.unwrap_or(node.brightness);
        let hides = match self.sky {
            Some(sky) => sky.brightness(node.to_center, node.radius2 / node.distance2),
            None => self.sky_mean,
        };
        let at_stake = if shines > hides { shines } else { hides };
        let factor = power_minus_two_thirds(at_stake * self.inverse);
        factor.clamp(BRIGHT_FACTOR_MIN, DARK_FACTOR_MAX)
    }
}

/// x to the power −2/3 within 12 %, for x of at least 0: the exponent is scaled with the mantissa behind it, which is linear
/// between powers of two.
#[inline(always)]
fn power_minus_two_thirds(x: f32) -> f32 {
    const ONE: u32 = 1f32.to_bits();
    f32::from_bits(ONE / 3 * 5 - x.to_bits() / 3 * 2)
}

/// Thresholds of the cube raster.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CubeThreshold<'a> {
    pub user_sr: f32,
    pub texel_sr: f32,
    pub terms: ImportanceTerms,
    pub stakes: Stakes<'a>,
}

impl Threshold for CubeThreshold<'_> {
    #[inline(always)]
    fn sin2_max(&self, node: &NodeSeen) -> f32 {
        let mut factor = self.stakes.factor(node);
        if self.terms.cosine {
            factor /= (node.top / node.distance2.sqrt()).clamp(COSINE_MIN, 1.0);
        }
        if self.terms.quality && node.is_plane {
            factor *= PLANE_FACTOR;
        }
        slide(self.texel_sr, self.user_sr, factor)
    }
}

/// The unit direction in which a cone around `toward`, whose half-angle is `spread`, comes nearest to `axis`.
#[inline(always)]
pub(crate) fn nearest_to(axis: Vec3, toward: Vec3, spread: f32) -> Vec3 {
    let apart = axis - toward;
    let share = spread / (apart.length_squared() + 1e-12).sqrt();
    let nearest = toward + apart * if share < 1.0 { share } else { 1.0 };
    nearest * (1.0 / (nearest.length_squared() + 1e-12).sqrt())
}

/// Thresholds of a lobe's raster.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LobeThreshold<'a> {
    pub user_sr: f32,
    /// Solid angle of the densest direction.
    pub texel_sr: f32,
    pub lobe: &'a GgxLobe,
    /// Where the lobe is densest.
    pub axis: Vec3,
    pub terms: ImportanceTerms,
    pub stakes: Stakes<'a>,
}

impl Threshold for LobeThreshold<'_> {
    /// A node may have the share of the lobe that the user's solid angle has of a hemisphere: its importance is inversely proportional to the solid
    /// angle that this share has where the node comes nearest to the mirror direction.
    #[inline(always)]
    fn sin2_max(&self, node: &NodeSeen) -> f32 {
        let mut factor = self.stakes.factor(node);
        if self.terms.quality && node.is_plane {
            factor *= PLANE_FACTOR;
        }
        if self.terms.lobe {
            let inverse = 1.0 / (node.distance2 + 1e-30).sqrt();
            let spread = (node.radius2 * inverse * inverse + 1e-12).sqrt();
            let nearest = nearest_to(self.axis, node.to_center * inverse, spread);
            // Of a lobe as wide as a hemisphere, the user's solid angle is this share.
            factor *= self.lobe.share_solid_angle(nearest, 2.0 * PI);
        }
        slide(self.texel_sr, self.user_sr, factor)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use pbgi_light::{Environment, EnvironmentOptions, SkyParameters, synthetic_sky};

    pub(crate) fn node(to_center: Vec3, radius: f32) -> NodeSeen {
        NodeSeen {
            to_center,
            distance2: to_center.length_squared(),
            radius2: radius * radius,
            top: to_center.y + radius,
            is_plane: false,
            brightness: 0.0,
        }
    }

    fn cube(terms: ImportanceTerms, surfaces: f32) -> CubeThreshold<'static> {
        let stakes = Stakes::new(terms, surfaces, None);
        CubeThreshold { user_sr: 0.1, texel_sr: 0.01, terms, stakes }
    }

    fn only(name: &str) -> ImportanceTerms {
        name.parse().unwrap()
    }

    #[test]
    fn terms_are_read_and_written() {
        assert_eq!(only("off"), ImportanceTerms::OFF);
        assert_eq!(only("all"), ImportanceTerms::ALL);
        let some = only("lobe, env");
        assert!(some.lobe && some.env && !some.cosine && !some.radiance && !some.quality);
        assert_eq!(some.to_string(), "env,lobe");
        assert_eq!(only(&ImportanceTerms::ALL.to_string()), ImportanceTerms::ALL);
        assert_eq!(ImportanceTerms::OFF.to_string(), "off");
        assert!("env,shine".parse::<ImportanceTerms>().unwrap_err().contains("`shine`"));
    }

    #[test]
    fn without_terms_every_direction_has_the_users_solid_angle() {
        let threshold = cube(ImportanceTerms::OFF, 1.0);
        for direction in [Vec3::X, Vec3::Y, Vec3::new(0.3, 0.2, -4.0)] {
            let bright = NodeSeen { brightness: 50.0, is_plane: true, ..node(direction, 0.01) };
            assert_eq!(threshold.sin2_max(&bright), sin2_of(0.1));
        }
        // Whoever wants every surfel gets it.
        for terms in [ImportanceTerms::OFF, ImportanceTerms::ALL] {
            let threshold = CubeThreshold { user_sr: 0.0, ..cube(terms, 1.0) };
            assert_eq!(threshold.sin2_max(&node(Vec3::X, 0.1)), 0.0);
        }
    }

    #[test]
    fn thresholds_rise_toward_the_horizon_and_for_planes() {
        let threshold = cube(only("cosine,quality"), 0.0);
        let above = threshold.sin2_max(&node(Vec3::Y * 4.0, 1e-3));
        assert!((above / sin2_of(0.1) - 1.0).abs() < 1e-3);
        for (x, expected) in [(1.0, 2f32.sqrt()), (1e3, 1.0 / COSINE_MIN)] {
            let tilted = threshold.sin2_max(&node(Vec3::new(x, 1.0, 0.0), 1e-3));
            // The squared sine is not quite as the solid angle.
            assert!((tilted / sin2_of(0.1 * expected) - 1.0).abs() < 2e-3, "{x}: {tilted}");
        }
        let plane = NodeSeen { is_plane: true, ..node(Vec3::Y, 1e-3) };
        assert!((threshold.sin2_max(&plane) / sin2_of(0.1 * PLANE_FACTOR) - 1.0).abs() < 5e-3);
        // Never so large that a receiver inside the sphere would take it.
        let wide = CubeThreshold { user_sr: 6.0, ..threshold };
        assert_eq!(wide.sin2_max(&plane), SIN2_MAX);
    }

    #[test]
    fn the_brighter_the_finer_and_never_finer_than_a_texel() {
        let threshold = cube(only("radiance"), 2.0);
        let mut last = f32::INFINITY;
        for step in 0..200 {
            let brightness = 1e-3 * 1.1f32.powi(step);
            let sin2 = threshold.sin2_max(&NodeSeen { brightness, ..node(Vec3::X, 0.01) });
            assert!(sin2 <= last && sin2 >= sin2_of(0.01), "{brightness}");
            last = sin2;
        }
        let usual = threshold.sin2_max(&NodeSeen { brightness: 2.0, ..node(Vec3::X, 0.01) });
        assert!((usual / sin2_of(0.1) - 1.0).abs() < 1e-3, "{usual}");
        // Nearly the texel's.
        assert!(last < sin2_of(0.012), "{last}");
    }

    #[test]
    fn the_nearest_direction_lies_between() {
        // The direction itself, the axis where the cone holds it, and between them.
        let (axis, toward) = (Vec3::Z, Vec3::X);
        for (spread, expected) in
            [(0.0, toward), (9.0, axis), (0.5f32.sqrt(), Vec3::new(0.5, 0.0, 0.5))]
        {
            let nearest = nearest_to(axis, toward, spread);
            assert!((nearest - expected.normalize()).length() < 1e-4, "{spread}: {nearest}");
        }
        assert!((nearest_to(axis, axis, 0.1) - axis).length() < 1e-4);
    }

    #[test]
    fn the_power_is_that_of_equal_errors() {
        for step in -60..60 {
            let x = 1.37f32.powi(step);
            let relative = power_minus_two_thirds(x) / x.powf(-2.0 / 3.0);
            assert!((relative - 1.0).abs() < 0.12, "{x}: {relative}");
        }
        assert!((power_minus_two_thirds(1.0) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_bright_sky_refines_what_hides_it() {
        // Bright toward the sun, dark below.
        let parameters = SkyParameters {
            sun_direction: Vec3::X,
            sun_irradiance: [0.0; 3],
            glow: [9.0; 3],
            ..SkyParameters::default()
        };
        let image = synthetic_sky(64, 32, &parameters);
        let environment = Environment::from_image(image, EnvironmentOptions::default()).unwrap();
        let pyramid = EnvironmentPyramid::new(&environment, 32);
        let terms = only("env");
        let stakes = Stakes::new(terms, 0.0, Some(&pyramid));
        let threshold = CubeThreshold { stakes, ..cube(terms, 0.0) };
        let at = |d: Vec3| threshold.sin2_max(&node(d, 0.01));
        let up = Vec3::new(1.0, 0.1, 0.0);
        assert!(at(up) < 0.8 * sin2_of(0.1) && at(Vec3::NEG_Y) > 1.2 * sin2_of(0.1));
        let off = CubeThreshold {
            stakes: Stakes::new(ImportanceTerms::OFF, 0.0, Some(&pyramid)),
            ..threshold
        };
        assert_eq!(off.sin2_max(&node(Vec3::X, 0.01)), sin2_of(0.1));
    }

    #[test]
    fn the_narrower_the_lobe_and_the_nearer_to_it_the_finer() {
        let eye = Vec3::new(0.6, 0.8, 0.0);
        let terms = only("lobe");
        let at = |alpha: f32, direction: Vec3| {
            let lobe = GgxLobe::with_alpha(alpha, [1.0; 3], Vec3::Y, eye).unwrap();
            let stakes = Stakes::new(terms, 0.0, None);
            let axis = lobe.mirror();
            let threshold =
                LobeThreshold { user_sr: 0.1, texel_sr: 1e-6, lobe: &lobe, axis, terms, stakes };
            threshold.sin2_max(&node(direction, 1e-3))
        };
        let mirror = Vec3::new(-0.6, 0.8, 0.0);
        let mut last = 0.0;
        for alpha in [0.01, 0.03, 0.1, 0.3] {
            let sin2 = at(alpha, mirror);
            assert!(sin2 > 3.0 * last, "{alpha}: {sin2}");
            last = sin2;
        }
        let mut last = 0.0;
        for turn in [0.0f32, 0.1, 0.2, 0.4] {
            let (sin, cos) = turn.sin_cos();
            let direction = mirror * cos + Vec3::Z * sin;
            let sin2 = at(0.1, direction);
            assert!(sin2 > 1.05 * last, "{turn}: {sin2}");
            last = sin2;
        }
        // A node that holds the mirror direction is seen as if it lay there.
        let wide = at(0.1, mirror);
        let lobe = GgxLobe::with_alpha(0.1, [1.0; 3], Vec3::Y, eye).unwrap();
        let stakes = Stakes::new(terms, 0.0, None);
        let axis = lobe.mirror();
        let threshold =
            LobeThreshold { user_sr: 0.1, texel_sr: 1e-6, lobe: &lobe, axis, terms, stakes };
        let beside = mirror * 0.2f32.cos() + Vec3::Z * 0.2f32.sin();
        assert!((threshold.sin2_max(&node(beside, 0.3)) / wide - 1.0).abs() < 1e-3);
    }
}
