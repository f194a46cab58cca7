//! Hard cases: scenes that break what is not careful, each with what is right there and how far a result may be from it.
//!
//! What is right follows from closed forms in `f64` (`forms`), from another scene that must give the same, or from what must be refused. An
//! engine is judged through [`Engine`], so that this crate knows nothing of it.

mod close;
mod forms;
mod gloss;
mod invariance;
mod light;
mod scale;
mod shapes;
mod sizes;
mod sparse;

use pbgi_cloud::Surfel;
use pbgi_math::{DVec3, Vec3};

pub use forms::{above_horizon, polygon_share};
pub use shapes::{Chance, sheet};

/// What surfels a scene has, and how they are handed over.
#[derive(Clone, Debug)]
pub enum CaseCloud {
    /// Surfels relative to a place in the world.
    Surfels {
        /// The place.
        origin: DVec3,
        /// The surfels.
        surfels: Vec<Surfel>,
    },
    /// The text of a PLY file.
    Ply(String),
}

/// What a receiver reflects glossily.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CaseGloss {
    /// Color of the metal; a white one reflects all it can.
    pub color: f32,
    /// Perceptual roughness, 0..=1.
    pub roughness: f32,
    /// Unit direction to the eye.
    pub toward_eye: Vec3,
}

/// Where light is gathered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CaseReceiver {
    /// In the world.
    pub position: DVec3,
    /// Any length above 0.
    pub normal: Vec3,
    /// A metal, where not only diffuse light counts.
    pub gloss: Option<CaseGloss>,
}

impl CaseReceiver {
    /// A receiver of diffuse light.
    #[must_use]
    pub fn diffuse(position: DVec3, normal: Vec3) -> Self {
        Self { position, normal, gloss: None }
    }
}

/// Distant light.
#[derive(Clone, Debug)]
pub enum CaseSky {
    /// None.
    Black,
    /// The same radiance from everywhere.
    Uniform(f32),
    /// Rows from +Y down, the middle along +Z, a quarter from the left +X.
    Image {
        /// Texels of a row.
        width: usize,
        /// Radiance, gray, row after row.
        texels: Vec<f32>,
    },
}

/// A scene with its receivers.
#[derive(Clone, Debug)]
pub struct CaseScene {
    /// What blocks and shines.
    pub cloud: CaseCloud,
    /// Where light is gathered.
    pub receivers: Vec<CaseReceiver>,
    /// Distant light.
    pub sky: CaseSky,
    /// Solid angle of nodes in steradians, where not that of the engine's defaults.
    pub solid_angle_sr: Option<f32>,
}

impl CaseScene {
    /// Surfels around the origin without a sky.
    #[must_use]
    pub fn new(surfels: Vec<Surfel>, receivers: Vec<CaseReceiver>) -> Self {
        let cloud = CaseCloud::Surfels { origin: DVec3::ZERO, surfels };
        Self { cloud, receivers, sky: CaseSky::Black, solid_angle_sr: None }
    }

    /// The same under a sky.
    #[must_use]
    pub fn under(self, sky: CaseSky) -> Self {
        Self { sky, ..self }
    }

    /// The same with nodes of another size.
    #[must_use]
    pub fn with_solid_angle(self, solid_angle_sr: f32) -> Self {
        Self { solid_angle_sr: Some(solid_angle_sr), ..self }
    }
}

/// What a receiver received; gray scenes have three equal channels, of which this is the second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Found {
    /// Irradiance from surfels.
    pub surfaces: f64,
    /// Irradiance from the sky.
    pub sky: f64,
    /// Cosine-weighted open share of the hemisphere.
    pub open: f64,
    /// Radiance reflected glossily.
    pub reflected: f64,
}

/// Why an engine did not give results.
#[derive(Clone, Debug)]
pub struct Refusal {
    /// Of a program that says so.
    pub exit_code: i32,
    /// What it says.
    pub message: String,
}

/// What is judged.
pub trait Engine {
    /// What the receivers of a scene receive, in their order.
    ///
    /// # Errors
    ///
    /// If it refuses the scene.
    fn shade(&mut self, scene: &CaseScene) -> Result<Vec<Found>, Refusal>;
}

/// A promise that is not kept today.
#[derive(Clone, Copy, Debug)]
pub struct KnownLimit {
    /// The error today, rounded up in its second digit: a larger one is a defect.
    pub today: f64,
    /// Where it comes from.
    pub because: &'static str,
}

/// A hard case.
#[derive(Clone, Copy)]
pub struct HardCase {
    /// Its name.
    pub name: &'static str,
    /// The scene, what is right, and what is compared.
    pub about: &'static str,
    /// Largest error: absolute for shares, relative for the rest.
    pub promise: f64,
    /// Why the error can be no larger.
    pub why: &'static str,
    /// Where the promise is not kept.
    pub limit: Option<KnownLimit>,
    /// Measures the error.
    pub measure: fn(&mut dyn Engine) -> Result<f64, Refusal>,
}

/// All of them, in the order of the document.
#[must_use]
pub fn hard_cases() -> Vec<HardCase> {
    let groups: [&[HardCase]; 7] = [
        &close::CASES,
        &sizes::CASES,
        &sparse::CASES,
        &light::CASES,
        &gloss::CASES,
        &scale::CASES,
        &invariance::CASES,
    ];
    groups.concat()
}

/// Larger of two errors, where what is no number is beyond all.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// Largest difference of values from what is right.
fn largest_error(pairs: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    pairs.into_iter().map(|(found, right)| (found - right).abs()).fold(0.0, worse)
}

/// Largest difference from what is right, over that.
fn largest_relative(pairs: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    pairs.into_iter().map(|(found, right)| (found / right - 1.0).abs()).fold(0.0, worse)
}

/// 0 if a scene is refused as unreadable input whose message holds `said`; 1 if it is shaded to finite numbers, beyond all else.
fn refused(
    engine: &mut dyn Engine,
    scene: &CaseScene,
    exit_code: i32,
    said: &str,
) -> Result<f64, Refusal> {
    match engine.shade(scene) {
        Err(refusal) if refusal.exit_code == exit_code && refusal.message.contains(said) => Ok(0.0),
        Err(refusal) => Err(refusal),
        Ok(found) => {
            let sum = |f: &Found| f.surfaces + f.sky + f.open + f.reflected;
            Ok(if found.iter().all(|f| sum(f).is_finite()) { 1.0 } else { f64::INFINITY })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_is_the_largest_error() {
        assert_eq!(largest_error([(1.0, 1.5), (f64::NAN, 0.0), (2.0, 2.0)]), f64::INFINITY);
        assert_eq!(largest_relative([(1.0, 2.0), (3.0, 3.0)]), 0.5);
        assert_eq!(largest_relative([(0.0, 0.0)]), f64::INFINITY);
    }

    #[test]
    fn names_differ_and_limits_are_beyond_their_promises() {
        let cases = hard_cases();
        let names: std::collections::HashSet<&str> = cases.iter().map(|case| case.name).collect();
        assert_eq!(names.len(), cases.len());
        for case in cases {
            assert!(case.limit.is_none_or(|limit| limit.today > case.promise), "{}", case.name);
        }
    }

    /// An engine that answers all alike.
    struct Constant(Result<Found, Refusal>);

    impl Engine for Constant {
        fn shade(&mut self, scene: &CaseScene) -> Result<Vec<Found>, Refusal> {
            self.0.clone().map(|found| vec![found; scene.receivers.len()])
        }
    }

    /// No case is one that any answer passes.
    #[test]
    fn every_case_tells_wrong_from_right() {
        let (nan, odd) = (f64::NAN, 1234.5);
        let none = Found { surfaces: nan, sky: nan, open: nan, reflected: nan };
        let wrong = Found { surfaces: odd, sky: odd, open: odd, reflected: odd };
        for case in hard_cases() {
            let error = |found: Found| (case.measure)(&mut Constant(Ok(found))).unwrap();
            assert!(!(error(none) <= case.promise), "{} takes what is no number", case.name);
            assert!(!(error(wrong) <= case.promise), "{} takes the same everywhere", case.name);
            let refusal = Refusal { exit_code: 101, message: "a defect".into() };
            assert!((case.measure)(&mut Constant(Err(refusal))).is_err(), "{}", case.name);
        }
    }
}
