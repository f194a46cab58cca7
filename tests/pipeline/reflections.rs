//! Glossy receivers and directional importance against closed forms.

use crate::support::bake_and_open;
use pbgi_brdf::GgxLobe;
use pbgi_build::BuildOptions;
use pbgi_cloud::Surfel;
use pbgi_gather::{
    GatherSettings, Gatherer, Gloss, ImportanceTerms, Material, PreparedLight, Receiver, lobe_level,
};
use pbgi_light::{Environment, EnvironmentOptions, SkyParameters, synthetic_sky};
use pbgi_math::Vec3;
use pbgi_store::Octree;
use pbgi_testkit::{SurfelForm, closed_room, random_objects, sphere_directions};
use std::f32::consts::{PI, SQRT_2};

/// A metal that reflects all it can, of a width of slopes.
fn metal(alpha: f32) -> Material {
    let roughness = alpha.sqrt();
    Material { base_color: [1.0; 3], metalness: 1.0, roughness, ..Material::default() }
}

fn glossy(position: Vec3, normal: Vec3, eye: Vec3, alpha: f32) -> Receiver {
    let toward_eye = (eye - position).normalize();
    let gloss = Some(Gloss { material: metal(alpha), toward_eye });
    Receiver { gloss, ..Receiver::diffuse(position, normal) }
}

/// The plane y = −1, diced into rectangles 0.1 wide, with a radiance by place.
fn plane(radiance: impl Fn(Vec3) -> f32) -> Vec<Surfel> {
    let piece = |i: i32, j: i32| {
        let at = Vec3::new(0.1 * i as f32 + 0.05, -1.0, 0.1 * j as f32 + 0.05);
        let surfel = Surfel::new(at, Vec3::Y, 0.0707, 0.01).with_tile(Vec3::X, 1.0);
        surfel.with_radiance([radiance(at); 3])
    };
    (-60..60).flat_map(|i| (-60..60).map(move |j| (i, j))).map(|(i, j)| piece(i, j)).collect()
}

/// In a closed room of uniform radiance a receiver reflects that radiance times its albedo, at every roughness and angle.
#[test]
fn a_closed_room_is_a_white_furnace() {
    let half = Vec3::new(2.0, 1.3, 1.7);
    let surfels = closed_room(half, 40, 2.0, SurfelForm::Rectangles);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    for solid_angle_sr in [0.3, 0.03] {
        let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
        let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
        let (mut squares, mut worst, mut count) = (0.0, 0f32, 0.0);
        for (i, normal) in sphere_directions(40).enumerate() {
            let f = |k: usize| ((i * k) % 37) as f32 / 37.0 * 1.6 - 0.8;
            let position = half * Vec3::new(f(5), f(11), f(17));
            let toward = (normal + normal.any_orthonormal_vector() * (i % 4) as f32).normalize();
            for alpha in [0.002, 0.05, 0.3, 1.0] {
                let receiver = glossy(position, normal, position + toward, alpha);
                let found = gatherer.gather(&receiver).unwrap();
                let error = found.reflected[1] / (2.0 * found.gloss_albedo[1]) - 1.0;
                squares += error * error;
                worst = worst.max(error.abs());
                count += 1.0;
            }
        }
        let rms = (squares / count).sqrt();
        println!("{solid_angle_sr}: rms {rms}, worst {worst}");
        // Pieces at the rim of a lobe shine by the reflectance in their middle, which is as good as they are small.
        assert!(rms < 0.03 && worst < 0.1, "{solid_angle_sr}: {rms}, {worst}");
    }
}

/// A nearly perfect mirror shows an edge sharply: what lies a degree beside it does not mix.
#[test]
fn smooth_surfaces_show_sharp_edges() {
    let (_folder, octree) =
        bake_and_open(&plane(|at| if at.x > 0.0 { 5.0 } else { 1.0 }), &BuildOptions::default());
    let settings = GatherSettings::default();
    let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
    // Looking down at the plane through a mirror that faces it; the seen point moves over the edge at x = 0.
    let mut shown = |x: f32, alpha: f32| {
        let position = Vec3::new(x, 0.0, 0.0);
        let eye = position + Vec3::NEG_Y;
        let found = gatherer.gather(&glossy(position, Vec3::NEG_Y, eye, alpha)).unwrap();
        found.reflected[0] / found.gloss_albedo[0]
    };
    for x in [0.02, 0.3, 1.0] {
        assert!((shown(x, 0.001) - 5.0).abs() < 0.1, "{x}: {}", shown(x, 0.001));
        assert!((shown(-x, 0.001) - 1.0).abs() < 0.1, "{x}: {}", shown(-x, 0.001));
    }
    // A rough one does not.
    assert!((1.5..4.5).contains(&shown(0.02, 0.3)) && (1.5..4.5).contains(&shown(-0.02, 0.3)));
}

/// The sun's reflection in an open plane is its irradiance times the reflectance, summed over its square.
#[test]
fn the_suns_reflection_has_its_flux() {
    let (_folder, octree) = bake_and_open(&plane(|_| 0.0), &BuildOptions::default());
    let sun = Vec3::new(0.6, 0.8, 0.0);
    let parameters = SkyParameters {
        sun_direction: sun,
        sun_irradiance: [1000.0; 3],
        ..SkyParameters::default()
    };
    let image = synthetic_sky(2048, 1024, &parameters);
    let environment = Environment::from_image(image, EnvironmentOptions::default()).unwrap();
    let light = PreparedLight::for_reflections(&environment, GatherSettings::default().raster_edge);
    let settings = GatherSettings::default();
    let mut gatherer = Gatherer::new(octree.reader(), &settings, Some(&light));
    let position = Vec3::new(0.0, -0.9, 0.0);
    for alpha in [0.1f32, 0.3] {
        let eye = position + Vec3::new(-0.6, 0.8, 0.0);
        let found = gatherer.gather(&glossy(position, Vec3::Y, eye, alpha)).unwrap();
        // At the mirror direction D = 1/(πα²), and both Smith terms are those of a cosine of 0.8.
        let a2 = alpha * alpha;
        let smith = 2.0 * 0.8 / (0.8 + (a2 + (1.0 - a2) * 0.64f32).sqrt());
        // Of uniform light, so much would come back at the first bounce; the rest does at later ones.
        let first = if alpha == 0.1 { 0.9846 } else { 0.8560 };
        let expected = 1000.0 * smith * smith / (PI * a2 * 4.0 * 0.8 * first);
        assert!((found.reflected[0] / expected - 1.0).abs() < 0.02, "{alpha}: {found:?}");
    }
}

/// Coarse cuts near fine ones, nearer with importance than without, and exact ones at a solid angle of 0.
#[test]
fn importance_of_the_lobe_brings_reflections_nearer_to_the_truth() {
    let surfels = random_objects(4000, 0.02, 5);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let reflected = |solid_angle_sr: f32, importance: ImportanceTerms| -> Vec<f32> {
        let settings = GatherSettings { solid_angle_sr, importance, ..GatherSettings::default() };
        let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
        let receivers = sphere_directions(60).map(|d| {
            let eye = d * 1.4 + (-d + d.any_orthonormal_vector() * 0.7);
            glossy(d * 1.4, -d, eye, 0.05)
        });
        receivers.map(|r| gatherer.gather(&r).unwrap().reflected[0]).collect()
    };
    let truth = reflected(0.0, ImportanceTerms::ALL);
    assert_eq!(truth, reflected(0.0, ImportanceTerms::OFF));
    let error = |found: Vec<f32>| -> f32 {
        let squares = found.iter().zip(&truth).map(|(a, b)| (a - b) * (a - b));
        squares.sum::<f32>().sqrt()
    };
    let (off, lobe) = (ImportanceTerms::OFF, "lobe".parse().unwrap());
    let (without, with) = (error(reflected(0.1, off)), error(reflected(0.1, lobe)));
    assert!(with < 0.5 * without, "{with} {without}");
}

/// Every SIMD level gives the same bits for glossy receivers, too.
#[test]
fn reflections_are_the_same_at_every_simd_level() {
    let surfels = random_objects(1500, 0.03, 2);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let at = |simd| {
        let settings = GatherSettings { simd, ..GatherSettings::default() };
        let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
        let receivers = sphere_directions(30).map(|d| glossy(d * 1.4, -d, Vec3::ZERO, 0.1));
        receivers.map(|r| gatherer.gather(&r).unwrap()).collect::<Vec<_>>()
    };
    let levels = pbgi_gather::SimdLevel::available();
    for level in &levels[1..] {
        assert_eq!(at(*level), at(levels[0]), "{level:?}");
    }
}

/// Largest second difference of a row of values, relative to their mean.
fn roughness_of(values: &[f32]) -> f32 {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    let second = values.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs());
    second.fold(0.0, f32::max) / mean
}

/// Results with a setting and exhaustively along twenty steps: largest second differences of both, and the error.
fn steps(octree: &Octree, gather: impl Fn(&Octree, &GatherSettings, usize) -> f32) -> [f32; 3] {
    let settings = GatherSettings { solid_angle_sr: 0.02, ..GatherSettings::default() };
    let exact = GatherSettings { solid_angle_sr: 0.0, ..settings };
    let found: Vec<f32> = (0..20).map(|i| gather(octree, &settings, i)).collect();
    let truth: Vec<f32> = (0..20).map(|i| gather(octree, &exact, i)).collect();
    let mean = truth.iter().sum::<f32>() / 20.0;
    let squares = found.iter().zip(&truth).map(|(a, b)| (a - b).powi(2) / 20.0);
    [roughness_of(&found), roughness_of(&truth), squares.sum::<f32>().sqrt() / mean]
}

/// A slowly rotated environment and a slowly moved camera change results smoothly: second differences are those of the exhaustive
/// gather and the error of the cut, no more. A node that pops in or out would add its own.
#[test]
fn results_change_smoothly_from_frame_to_frame() {
    let mut surfels = plane(|_| 0.3);
    surfels.extend(random_objects(2000, 0.03, 9));
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let position = Vec3::new(0.9, -0.999, 0.2);
    let rotated = |octree: &Octree, settings: &GatherSettings, step: usize| {
        let parameters =
            SkyParameters { sun_direction: Vec3::new(-0.6, 0.7, 0.1), ..SkyParameters::default() };
        let image = synthetic_sky(512, 256, &parameters);
        let options =
            EnvironmentOptions { rotate_degrees: 0.25 * step as f32, ..Default::default() };
        let environment = Environment::from_image(image, options).unwrap();
        let light =
            PreparedLight::for_reflections(&environment, GatherSettings::default().raster_edge);
        let mut gatherer = Gatherer::new(octree.reader(), settings, Some(&light));
        let receiver = glossy(position, Vec3::Y, Vec3::new(3.0, 0.5, 0.0), 0.1);
        let found = gatherer.gather(&receiver).unwrap();
        found.environment_irradiance[1] + found.reflected[1]
    };
    let moved = |octree: &Octree, settings: &GatherSettings, step: usize| {
        let eye = Vec3::new(3.0 + 0.01 * step as f32, 0.5, 0.0);
        let mut gatherer = Gatherer::new(octree.reader(), settings, None);
        gatherer.gather(&glossy(position, Vec3::Y, eye, 0.1)).unwrap().reflected[1]
    };
    for (name, [found, truth, error]) in
        [("rotated", steps(&octree, rotated)), ("moved", steps(&octree, moved))]
    {
        println!("{name}: second difference {found}, exhaustive {truth}, error {error}");
        assert!(found < truth + 3.0 * error + 0.02, "{name}: {found} {truth} {error}");
        assert!(error < 0.1, "{name}: {error}");
    }
}

/// Sparks that hide each other, some of them dark, as a rough metal reflects them: against rays to all of them, the error falls with the number of
/// directions, and is below 2 % with the most there are.
#[test]
fn reflections_of_sparks_fall_with_the_number_of_directions() {
    const SPARKS: usize = 400;
    const HALF_EDGE: f32 = 0.03;
    let directions: Vec<Vec3> = sphere_directions(SPARKS as u32).collect();
    let sparks: Vec<Surfel> = (0..SPARKS)
        .map(|i| {
            let share = (i * 389 % SPARKS) as f32 / SPARKS as f32;
            let center = directions[i] * 0.5 * share.cbrt() + Vec3::Y * 1.2;
            let normal = directions[i * 617 % SPARKS];
            let light = [8.0, 1.0, 0.0][i % 3];
            Surfel::new(center, normal, HALF_EDGE * SQRT_2, 4.0 * HALF_EDGE * HALF_EDGE)
                .with_tile(normal.any_orthonormal_vector(), 1.0)
                .with_radiance([light; 3])
        })
        .collect();
    let (_folder, octree) = bake_and_open(&sparks, &BuildOptions::default());
    let receivers: Vec<Receiver> = (0..8)
        .map(|i| {
            let at = Vec3::new(0.05 * (i % 4) as f32 - 0.1, 0.0, 0.02 * i as f32);
            let eye = Vec3::new(-0.3, 2.0, 0.1 * i as f32 - 0.4);
            glossy(at, Vec3::Y, eye, 0.3)
        })
        .collect();
    let truth: Vec<f32> = receivers.iter().map(|r| reflected_of_rays(r, &sparks)).collect();
    let mean = truth.iter().sum::<f32>() / truth.len() as f32;
    let errors = [1024, 16_384].map(|directions| {
        let lobe_level = lobe_level(directions).unwrap();
        let settings =
            GatherSettings { lobe_level, solid_angle_sr: 0.0, ..GatherSettings::default() };
        let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
        let found = receivers.iter().map(|r| gatherer.gather(r).unwrap().reflected[1]);
        let squares = found.zip(&truth).map(|(found, truth)| ((found - truth) / mean).powi(2));
        (squares.sum::<f32>() / truth.len() as f32).sqrt()
    });
    println!("{errors:?}");
    assert!(errors[1] < 0.02 && errors[1] < 0.7 * errors[0], "{errors:?}");
}

/// What a receiver reflects of squares that hide on both sides and shine on one, by rays in evenly spread directions around +y.
fn reflected_of_rays(receiver: &Receiver, squares: &[Surfel]) -> f32 {
    const RAYS: u32 = 300_000;
    let gloss = receiver.gloss.unwrap();
    let lobe = GgxLobe::new(&gloss.material, receiver.normal, gloss.toward_eye).unwrap();
    let radiance = |direction: Vec3| {
        let hit = |square: &&Surfel| {
            let (toward, normal) = (square.center() - receiver.position, square.normal());
            let cosine = normal.dot(direction);
            let distance = normal.dot(toward) / cosine;
            let off = direction * distance - toward;
            let is_met = square
                .half_edges()
                .unwrap()
                .iter()
                .all(|edge| off.dot(*edge).abs() <= edge.length_squared());
            (distance > 0.0 && is_met).then_some((distance, cosine))
        };
        let hits = squares.iter().filter_map(|square| Some((hit(&square)?, square.radiance[1])));
        let nearest = hits.min_by(|a, b| a.0.0.total_cmp(&b.0.0));
        nearest.map_or(0.0, |((_, cosine), light)| if cosine < 0.0 { light } else { 0.0 })
    };
    let above = sphere_directions(RAYS).filter(|direction| direction.y > 0.8);
    let sum: f32 = above.map(|d| radiance(d) * lobe.reflect(d)[1]).sum();
    sum * 4.0 * PI / RAYS as f32
}
