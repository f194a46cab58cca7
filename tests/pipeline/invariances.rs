//! What changes nothing of a scene must change nothing of its light, for scenes of many kinds.

use crate::support::bake;
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{GatherSettings, Gatherer, Receiver, Shading};
use pbgi_math::Vec3;
use pbgi_store::{Octree, OpenOptions};
use pbgi_testkit::hard::Chance;

/// Scenes of each property, by their seeds.
const SEEDS: u64 = 12;

/// Places on a grid of 2⁻¹⁴, on which moves by a few units round nothing.
const GRID: f32 = 16384.0;

/// Surfels of one seed: disks, tiles, sheets and particles, few or many, small or large; and receivers among them.
fn scene(seed: u64) -> (Vec<Surfel>, Vec<Receiver>) {
    println!("seed {seed}");
    let mut chance = Chance::new(seed);
    let place = |chance: &mut Chance| (chance.place() * GRID).round() / GRID;
    let count = 30 << (seed % 4 * 2);
    let radius = 0.4 / (count as f32).sqrt() * (1.5 + chance.signed());
    let mut some = |i: usize| {
        let (center, normal) = (place(&mut chance), chance.direction());
        let radius = radius * (1.5 + chance.signed());
        let light = [1.0 + chance.signed(), 1.0, 0.2];
        let surfel = Surfel::new(center, normal, radius, 2.0 * radius * radius);
        let surfel = surfel.with_radiance(light);
        match (i % 4, seed % 3) {
            (1, _) => {
                surfel.with_tile(normal.any_orthonormal_vector(), 1.5 + 0.5 * chance.signed())
            }
            (2, 1) => surfel.with_flags(SurfelFlags::FRONT_ONLY),
            (3, 2) => surfel.with_flags(SurfelFlags::ISOTROPIC),
            _ => surfel,
        }
    };
    let surfels = (0..count).map(&mut some).collect();
    let receivers =
        (0..12).map(|_| Receiver::diffuse(place(&mut chance), chance.direction())).collect();
    (surfels, receivers)
}

/// What the receivers receive, and the bytes of the file.
fn shade(
    surfels: &[Surfel],
    receivers: &[Receiver],
    settings: &GatherSettings,
) -> (Vec<Shading>, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    bake(surfels, &BuildOptions::default(), &path);
    let octree = Octree::open(&path, &OpenOptions::default()).unwrap();
    let mut gatherer = Gatherer::new(octree.reader(), settings, None);
    let found = receivers.iter().map(|r| gatherer.gather(r).unwrap()).collect();
    (found, std::fs::read(&path).unwrap())
}

fn plain() -> GatherSettings {
    GatherSettings::default()
}

/// Powers of two change exponents only.
#[test]
fn powers_of_two_change_no_bit() {
    for seed in 0..SEEDS {
        let (surfels, receivers) = scene(seed);
        let (right, _) = shade(&surfels, &receivers, &plain());
        for exponent in [-20 + seed as i32 % 3, 1, 13, 28 - seed as i32 % 3] {
            let scale = 2f32.powi(exponent);
            let larger = |s: &Surfel| Surfel {
                position: s.position.map(|x| x * scale),
                radius: s.radius * scale,
                area: s.area * scale * scale,
                ..*s
            };
            let surfels: Vec<Surfel> = surfels.iter().map(larger).collect();
            let moved = |r: &Receiver| Receiver { position: r.position * scale, ..*r };
            let receivers: Vec<Receiver> = receivers.iter().map(moved).collect();
            assert_eq!(shade(&surfels, &receivers, &plain()).0, right, "2^{exponent}");
        }
    }
}

/// Light is stored and summed relative to its scale.
#[test]
fn doubled_radiance_doubles_light_and_nothing_else() {
    for seed in 0..SEEDS {
        let (surfels, receivers) = scene(seed);
        let (right, _) = shade(&surfels, &receivers, &plain());
        assert!(right.iter().any(|s| s.surface_irradiance[0] > 0.01), "nothing is lit");
        let bright = |s: &Surfel| s.with_radiance(s.radiance.map(|c| 2.0 * c));
        let bright: Vec<Surfel> = surfels.iter().map(bright).collect();
        let doubled = |s: &Shading| Shading {
            surface_irradiance: s.surface_irradiance.map(|c| 2.0 * c),
            ..*s
        };
        let right: Vec<Shading> = right.iter().map(doubled).collect();
        assert_eq!(shade(&bright, &receivers, &plain()).0, right);
    }
}

/// Surfels are sorted by their places, of which no two are one.
#[test]
fn the_order_of_the_input_changes_no_byte() {
    for seed in 0..SEEDS {
        let (mut surfels, receivers) = scene(seed);
        let right = shade(&surfels, &receivers, &plain());
        let mut chance = Chance::new(seed + 1000);
        for i in (1..surfels.len()).rev() {
            let other = (0.5 + 0.5 * chance.signed()) * (i + 1) as f32;
            surfels.swap(i, (other as usize).min(i));
        }
        assert!(shade(&surfels, &receivers, &plain()) == right);
    }
}

/// Largest differences of openness, and of irradiance over that of a hemisphere of the largest radiance, 2.
fn differences(found: &[Shading], right: &[Shading]) -> [f32; 2] {
    let light = |s: &Shading| s.surface_irradiance[0];
    let largest = 2.0 * std::f32::consts::PI;
    let pairs = || found.iter().zip(right);
    let open = pairs().map(|(a, b)| (a.ambient_occlusion - b.ambient_occlusion).abs());
    let lit = pairs().map(|(a, b)| (light(a) - light(b)).abs() / largest);
    [open.fold(0.0, f32::max), lit.fold(0.0, f32::max)]
}

/// Cells move with the scene, and places on the grid round nothing: what is rounded otherwise is the corner of the root's cube, and codes of
/// places with it.
#[test]
fn moved_scenes_have_the_same_light() {
    for seed in 0..SEEDS {
        let (surfels, receivers) = scene(seed);
        let (right, _) = shade(&surfels, &receivers, &plain());
        let by = Vec3::new(3.0, -5.0, 2.0);
        let moved = |s: &Surfel| Surfel { position: (s.center() + by).to_array(), ..*s };
        let surfels: Vec<Surfel> = surfels.iter().map(moved).collect();
        let moved = |r: &Receiver| Receiver { position: r.position + by, ..*r };
        let receivers: Vec<Receiver> = receivers.iter().map(moved).collect();
        let [open, lit] = differences(&shade(&surfels, &receivers, &plain()).0, &right);
        println!("{open} {lit}");
        // Three samples that fall to the other side of an outline: 3/(16 · 64 π).
        assert!(open < 1e-3 && lit < 1e-3, "{open} {lit}");
    }
}

/// What two placements of an outline differ by: one of 2π rad crosses 50 texels of 1/64 sr, and is placed within half a sample, 1/32 of a texel, in
/// each: 50/(32 · 64 π) = 0.008; twice that, and 0.002 of quadrature each.
const OUTLINES: f32 = 0.02;

/// Along each axis all is the same, but for the places of samples in texels.
#[test]
fn axes_are_alike() {
    let exact = GatherSettings { solid_angle_sr: 0.0, ..plain() };
    let turns: [fn(Vec3) -> Vec3; 3] = [
        |v| Vec3::new(v.y, v.z, v.x),
        |v| Vec3::new(v.z, v.y, v.x),
        |v| Vec3::new(-v.x, v.y, -v.z),
    ];
    for seed in 0..SEEDS {
        let (surfels, receivers) = scene(seed);
        let (right, _) = shade(&surfels, &receivers, &exact);
        for turn in turns {
            let turned = |s: &Surfel| {
                let turned = Surfel::new(turn(s.center()), turn(s.normal()), s.radius, s.area);
                let turned = turned.with_radiance(s.radiance).with_flags(s.flags);
                match s.half_edges() {
                    Some([long, short]) => {
                        turned.with_tile(turn(long).normalize(), long.length() / short.length())
                    }
                    None => turned,
                }
            };
            let surfels: Vec<Surfel> = surfels.iter().map(turned).collect();
            let turned =
                |r: &Receiver| Receiver::diffuse(turn(r.position), turn(r.normal).normalize());
            let receivers: Vec<Receiver> = receivers.iter().map(turned).collect();
            let [open, lit] = differences(&shade(&surfels, &receivers, &exact).0, &right);
            println!("{open} {lit}");
            assert!(open < OUTLINES && lit < OUTLINES, "{open} {lit}");
        }
    }
}

/// A tile is its two halves side by side.
#[test]
fn halves_of_tiles_are_the_tile() {
    let exact = GatherSettings { solid_angle_sr: 0.0, ..plain() };
    for seed in 0..SEEDS {
        let (surfels, receivers) = scene(seed);
        let tiles: Vec<Surfel> = surfels.into_iter().filter(|s| s.half_edges().is_some()).collect();
        let (right, _) = shade(&tiles, &receivers, &exact);
        let halves = |s: &Surfel| {
            let [long, short] = s.half_edges().unwrap();
            let (a, b) = (0.5 * long.length(), short.length());
            let (edge, aspect) = if a > b { (long, a / b) } else { (short, b / a) };
            [-0.5, 0.5].map(|side| {
                let center = s.center() + long * side;
                let half = Surfel::new(center, s.normal(), 0.5 * s.radius, 0.5 * s.area);
                half.with_radiance(s.radiance)
                    .with_flags(s.flags)
                    .with_tile(edge.normalize(), aspect)
            })
        };
        let halves: Vec<Surfel> = tiles.iter().flat_map(halves).collect();
        let [open, lit] = differences(&shade(&halves, &receivers, &exact).0, &right);
        println!("{open} {lit}");
        assert!(open < OUTLINES && lit < OUTLINES, "{open} {lit}");
    }
}
