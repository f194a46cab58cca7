//! Trees and shrubs: bark tubes and leaf cards.

use super::builder::{Paint, Pen, SceneBuilder};
use super::random::Random;
use pbgi_math::Vec3;

/// Paints of plants.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlantPaints {
    pub bark: Paint,
    pub leaf: Paint,
    pub blossom: Paint,
}

impl PlantPaints {
    pub fn new(builder: &mut SceneBuilder) -> Self {
        Self {
            bark: builder.paint("bark", [0.22, 0.16, 0.11]),
            leaf: builder.cloth("leaf", [0.21, 0.34, 0.07]),
            blossom: builder.cloth("blossom", [0.66, 0.12, 0.14]),
        }
    }
}

/// Measures of a tree in meters.
#[derive(Clone, Copy, Debug)]
pub(super) struct TreeShape {
    pub height: f32,
    pub crown_radius: f32,
    pub leaf_count: u32,
}

/// Draws a tree that stands at the origin.
pub(super) fn tree(pen: &mut Pen, paints: PlantPaints, random: &mut Random, shape: TreeShape) {
    let lean = random.direction() * Vec3::new(0.3, 0.0, 0.3);
    let fork = Vec3::Y * shape.height * random.range(0.34, 0.40) + lean * 0.5;
    let thickness = shape.height * 0.022;
    let bark_tint = random.shade(0.2);
    let trunk = [
        (Vec3::NEG_Y * 0.3, thickness * 1.7),
        (Vec3::Y * 0.25, thickness * 1.15),
        (fork * 0.5 + lean * 0.15, thickness * 0.95),
        (fork, thickness * 0.8),
    ];
    pen.tube(paints.bark, bark_tint, &trunk, 10);
    let crown = Crown {
        center: Vec3::new(lean.x, shape.height - shape.crown_radius * 1.05, lean.z),
        radii: Vec3::new(1.0, 1.05, 1.0) * shape.crown_radius,
    };
    let mut clusters = Vec::new();
    for _ in 0..7 {
        let tip = crown.point(random, 0.75);
        branch(pen, paints.bark, bark_tint, fork, tip, thickness * 0.55);
        for _ in 0..3 {
            let twig = crown.point(random, 0.95);
            let twig = tip + (twig - tip).clamp_length_max(shape.crown_radius * 0.7);
            branch(pen, paints.bark, bark_tint, tip.lerp(fork, 0.25), twig, thickness * 0.22);
            clusters.push(twig);
        }
    }
    for _ in 0..shape.leaf_count / 60 {
        clusters.push(crown.point(random, 0.92));
    }
    let spread = shape.crown_radius * 0.24;
    foliage_cards(pen, paints.leaf, random, &clusters, spread, shape.leaf_count);
}

/// Draws a round shrub around the origin, with blossoms if asked.
pub(super) fn shrub(
    pen: &mut Pen,
    paints: PlantPaints,
    random: &mut Random,
    radius: f32,
    blossoms: bool,
) {
    let crown = Crown { center: Vec3::Y * radius * 0.7, radii: Vec3::splat(radius) };
    let clusters: Vec<Vec3> = (0..14).map(|_| crown.point(random, 0.8)).collect();
    let leaf_count = (radius * radius * 1500.0) as u32 + 30;
    foliage_cards(pen, paints.leaf, random, &clusters, radius * 0.35, leaf_count);
    if blossoms {
        for _ in 0..leaf_count / 6 {
            let center = crown.point(random, 1.15);
            let outward = (center - crown.center).normalize_or(Vec3::Y);
            let card = Card { center, normal: outward, length: 0.06, width: 0.06 };
            card.draw(pen, paints.blossom, random.shade(0.25), random);
        }
    }
}

/// The ellipsoid a plant fills with leaves.
struct Crown {
    center: Vec3,
    radii: Vec3,
}

impl Crown {
    /// A random point, most often near the surface, at most `reach` of the way to it.
    fn point(&self, random: &mut Random, reach: f32) -> Vec3 {
        let depth = random.range(0.35, 1.0).sqrt();
        self.center + random.direction() * self.radii * depth * reach
    }
}

/// A bent, tapered branch.
fn branch(pen: &mut Pen, paint: Paint, tint: [f32; 3], from: Vec3, to: Vec3, radius: f32) {
    let sag = Vec3::Y * (to - from).length() * 0.12;
    let middle = from.lerp(to, 0.5) + sag;
    pen.tube(paint, tint, &[(from, radius), (middle, radius * 0.7), (to, radius * 0.25)], 6);
}

/// Leaves scattered about cluster centers.
fn foliage_cards(
    pen: &mut Pen,
    paint: Paint,
    random: &mut Random,
    clusters: &[Vec3],
    spread: f32,
    count: u32,
) {
    if clusters.is_empty() {
        return;
    }
    let tree_hue = random.range(-0.12, 0.12);
    let cluster_shades: Vec<f32> = clusters.iter().map(|_| random.range(0.75, 1.2)).collect();
    for _ in 0..count {
        let cluster = random.below(clusters.len());
        let outward = random.direction();
        let center = clusters[cluster] + outward * spread * random.unit().sqrt();
        let normal =
            (outward * 0.7 + Vec3::Y * 0.5 + random.direction() * 0.7).normalize_or(Vec3::Y);
        let shade = cluster_shades[cluster] * random.range(0.7, 1.25);
        // From bluish to yellowish green.
        let hue = tree_hue + random.range(-0.18, 0.22);
        let tint = [shade * (1.0 + hue), shade, shade * (1.0 - hue)];
        let length = random.range(0.10, 0.17);
        let card = Card { center, normal, length, width: length * random.range(0.55, 0.8) };
        card.draw(pen, paint, tint, random);
    }
}

/// A leaf: a rhombus.
struct Card {
    center: Vec3,
    normal: Vec3,
    length: f32,
    width: f32,
}

impl Card {
    fn draw(&self, pen: &mut Pen, paint: Paint, tint: [f32; 3], random: &mut Random) {
        let side = self.normal.any_orthonormal_vector();
        let (sin, cos) = (random.unit() * std::f32::consts::TAU).sin_cos();
        let along = side * cos + self.normal.cross(side) * sin;
        let across = self.normal.cross(along);
        let (tip, edge) = (along * self.length * 0.5, across * self.width * 0.5);
        let corners =
            [self.center - tip, self.center - edge, self.center + tip, self.center + edge];
        pen.polygon(paint, tint, &corners);
    }
}
