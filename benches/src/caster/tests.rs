use super::*;
use pbgi_image::RgbImage;
use pbgi_math::Affine3A;
use pbgi_scene::{Instance, Mesh};

/// A cube from −1 to 1 whose sides face inward.
fn cube(material: Material) -> Scene {
    let corner = |i: u32| {
        let side = |bit: u32| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
        Vec3::new(side(0), side(1), side(2))
    };
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for far in 0..2u32 {
            let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
            let base = far << axis;
            let [a, b, c, d] = [base, base | u, base | u | v, base | v];
            let inward = |t: [u32; 3]| if far == 0 { t } else { [t[0], t[2], t[1]] };
            triangles.extend([inward([a, b, c]), inward([a, c, d])]);
        }
    }
    let mesh = Mesh { positions: (0..8).map(corner).collect(), triangles, ..Mesh::default() };
    Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, transform: Affine3A::IDENTITY }],
        materials: vec![material],
        ..Scene::default()
    }
}

#[test]
fn a_glowing_room_is_a_geometric_series() {
    let room = Material { base_color: [0.5; 3], emission: [2.0; 3], ..Material::default() };
    let scene = cube(room);
    let caster = Caster::new(&scene, None);
    let found = caster.gather(Vec3::new(0.3, -1.0, 0.2), Vec3::Y, 3, 0..1 << 14, 1);
    for (bounce, irradiance) in found.irradiance.iter().enumerate() {
        let expected = f64::from(2.0 * PI) * 0.5f64.powi(bounce as i32);
        assert!((irradiance[1] / expected - 1.0).abs() < 1e-2, "{bounce}: {irradiance:?}");
    }
    assert_eq!(found.openness, 0.0);
}

#[test]
fn an_even_sky_gives_pi_and_what_hides_it_less() {
    let image = RgbImage { width: 16, height: 8, pixels: vec![[1.0, 2.0, 0.0]; 128] };
    let sky = SkyImage::new(image);
    let empty = Scene::default();
    let open = Caster::new(&empty, Some(&sky)).gather(Vec3::ZERO, Vec3::X, 0, 0..1024, 7);
    let expected = f64::from(PI);
    assert!((open.irradiance[0][0] / expected - 1.0).abs() < 2e-3, "{open:?}");
    assert!((open.irradiance[0][1] / expected - 2.0).abs() < 4e-3);
    assert_eq!(open.openness, 1.0);
    // Half the sky behind a wall of the cube's side: the rest of the cube is left out.
    let mut wall = cube(Material::default());
    wall.meshes[0].triangles.truncate(2);
    let stretch = Affine3A::from_scale(Vec3::new(1.0, 1e4, 1e4));
    wall.instances[0].transform = stretch;
    let hidden = Caster::new(&wall, Some(&sky)).gather(Vec3::ZERO, Vec3::Y, 0, 0..4096, 7);
    assert!((hidden.irradiance[0][0] / expected - 0.5).abs() < 5e-3, "{hidden:?}");
    assert!((hidden.openness - 0.5).abs() < 5e-3);
}

#[test]
fn a_parallel_lamp_has_its_closed_form() {
    // The ceiling of the cube, 2 x 2 at distance 1 over the middle of a small place.
    let lamp = Material { base_color: [0.0; 3], emission: [3.0; 3], ..Material::default() };
    let mut scene = cube(lamp);
    let triangles = &mut scene.meshes[0].triangles;
    *triangles = triangles[6..8].to_vec();
    let found = Caster::new(&scene, None).gather(Vec3::ZERO, Vec3::Y, 0, 0..4096, 3);
    // Four corners of a rectangle a × b at distance 1: (1/2π) [a/√(1+a²) atan(b/√(1+a²)) + …].
    let root = 2f64.sqrt();
    let factor = 4.0 / (2.0 * std::f64::consts::PI) * (2.0 / root * (1.0 / root).atan());
    let expected = 3.0 * std::f64::consts::PI * factor;
    assert!((found.irradiance[0][0] / expected - 1.0).abs() < 2e-3, "{found:?} {expected}");
}

/// One radiance from everywhere, of a sky and of walls that shine: the second is also drawn from, and both are found alike. All of it comes
/// back from white metals, and of the roughest a third at the first bounce.
#[test]
fn reflections_of_sky_and_walls_of_one_radiance_agree() {
    let image = RgbImage { width: 16, height: 8, pixels: vec![[1.0; 3]; 128] };
    let (sky, empty) = (SkyImage::new(image), Scene::default());
    let open = Caster::new(&empty, Some(&sky));
    let walls = cube(Material { base_color: [0.0; 3], emission: [1.0; 3], ..Material::default() });
    let walled = Caster::new(&walls, None);
    let eye = Vec3::new(0.6, 0.8, 0.0);
    for alpha in [0.3, 1.0] {
        let of =
            |caster: &Caster| caster.reflect(Vec3::ZERO, Vec3::Y, eye, alpha, 0..1 << 14, 5)[1];
        let (sky, walls) = (of(&open), of(&walled));
        assert!((sky / walls - 1.0).abs() < 5e-3, "{alpha}: {sky} {walls}");
        assert!((sky - 1.0).abs() < 5e-3, "{alpha}: {sky}");
        // By a sum over 400 000 directions of the hemisphere, drawn evenly.
        let expected = if alpha == 1.0 { 0.3407 } else { 0.856 };
        let first = MicrofacetLobe { normal: Vec3::Y, eye, alpha }.first_bounce();
        assert!((first / expected - 1.0).abs() < 5e-3, "{alpha}: {first}");
    }
}
