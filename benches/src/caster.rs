//! An independent ray caster over the original triangles: the truth that surfels are compared with.
//!
//! Shares with the engine the scene as read and nothing else: no surfels, no octree, no raster, no windows. Rays meet triangles
//! (`obvhs`), light is sampled along cosines, from the pixels of the environment and from the triangles that emit, and the three are
//! weighted by the balance heuristic (Veach and Guibas 1995), along Owen-scrambled Sobol points (Burley 2020).

use crate::light_sampler::{EmitterSampler, EnvironmentSampler, SkyImage};
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::{BvhBuildParams, triangle::Triangle};
use pbgi_math::{Frame, Vec2, Vec3};
use pbgi_scene::{Material, Scene, Texture};
use std::f32::consts::{PI, TAU};
use std::ops::Range;
use std::time::Duration;

/// Distance by which rays start above a place, as a share of its largest coordinate: some hundred times what coordinates are off by.
const OFFSET_SHARE: f32 = 2e-5;

/// More of it, as a share of the largest coordinate of all: a ray meets a triangle that reaches so far no better. Little, lest
/// a plain out to the horizon lift rays over window sills.
const OFFSET_SHARE_OF_REACH: f32 = 2e-7;

/// Dimensions of the sequence that one vertex of a path takes: direction, pixel, triangle, place on it.
const DIMENSIONS: u32 = 8;

/// Bounces a path may have, at most: the sequence has 256 dimensions.
pub const BOUNCES_MAX: u32 = 30;

/// Paths that may have one seed, at most: the points of the sequence.
pub const PATHS_MAX: u32 = 1 << 16;

/// What a triangle looks like.
#[derive(Clone, Copy)]
struct Face {
    material: u32,
    normal: Vec3,
    uvs: [Vec2; 3],
    colors: [[f32; 3]; 3],
}

/// What a ray meets.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Distance along the ray.
    pub distance: f32,
    /// Index of the triangle.
    pub triangle: usize,
    /// The triangle's own normal, on the side the ray comes from.
    pub normal: Vec3,
    /// Whether that is a side that shines and reflects: the front, or either of a double-sided material.
    pub is_front: bool,
    /// Barycentric coordinates of the place.
    place: Vec3,
}

/// How light reaches a place: by how many bounces, of all kinds of sources.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gathered {
    /// Cosine-weighted share of the hemisphere that is open.
    pub openness: f64,
    /// Irradiance of light that has bounced 0, 1, … times, W·m⁻².
    pub irradiance: Vec<[f64; 3]>,
}

impl Gathered {
    /// Irradiance of light that has bounced `from` times to as often as was gathered.
    #[must_use]
    pub fn irradiance_from(&self, from: usize) -> [f32; 3] {
        let later = self.irradiance.iter().skip(from);
        let sum = later.fold([0.0; 3], |sum, e| std::array::from_fn(|c| sum[c] + e[c]));
        sum.map(|c| c as f32)
    }
}

/// Triangles of a scene with what they reflect and emit.
pub struct Caster<'a> {
    scene: &'a Scene,
    triangles: Vec<Triangle>,
    faces: Vec<Face>,
    tree: CwBvh,
    /// Largest coordinate.
    reach: f32,
    emitters: Option<EmitterSampler>,
    sky: Option<EnvironmentSampler<'a>>,
}

impl<'a> Caster<'a> {
    /// A caster for all instances of a scene, under an environment if there is one.
    #[must_use]
    pub fn new(scene: &'a Scene, sky: Option<&'a SkyImage>) -> Self {
        let (mut triangles, mut faces, mut powers) = (Vec::new(), Vec::new(), Vec::new());
        for instance in &scene.instances {
            let mesh = &scene.meshes[instance.mesh as usize];
            let material = &scene.materials[mesh.material as usize];
            let flips = instance.flips();
            for corners in &mesh.triangles {
                let v = corners.map(|v| v as usize);
                let p = v.map(|v| instance.transform.transform_point3(mesh.positions[v]));
                let cross = (p[1] - p[0]).cross(p[2] - p[0]) * if flips { -1.0 } else { 1.0 };
                let Some(normal) = cross.try_normalize() else { continue };
                triangles.push(Triangle { v0: p[0].into(), v1: p[1].into(), v2: p[2].into() });
                let uvs = v.map(|v| mesh.uvs.get(v).copied().unwrap_or(Vec2::ZERO));
                let colors = v.map(|v| mesh.colors.get(v).copied().unwrap_or([1.0; 3]));
                faces.push(Face { material: mesh.material, normal, uvs, colors });
                let sides = if material.double_sided { 2.0 } else { 1.0 };
                powers.push(0.5 * cross.length() * sides * brightness(material.emission));
            }
        }
        let reach = triangles.iter().flat_map(|t| [t.v0, t.v1, t.v2]);
        let reach = reach.map(|p| p.abs().max_element()).fold(0f32, f32::max);
        let tree = build_cwbvh_from_tris(
            &triangles,
            BvhBuildParams::medium_build(),
            &mut Duration::default(),
        );
        let emitters = EmitterSampler::new(&powers);
        let sky = sky.and_then(EnvironmentSampler::new);
        Self { scene, triangles, faces, tree, reach, emitters, sky }
    }

    fn material(&self, face: &Face) -> &'a Material {
        &self.scene.materials[face.material as usize]
    }

    /// Texel of a texture at a place of a triangle, white without one.
    fn texel(&self, texture: Option<u32>, face: &Face, place: Vec3) -> [f32; 4] {
        let texture: Option<&Texture> = texture.and_then(|t| self.scene.textures.get(t as usize));
        texture.map_or([1.0; 4], |t| t.sample(at(place, face.uvs)))
    }

    /// Distance along the ray at which a triangle is met, infinite where it is not or has a hole.
    fn meet(&self, ray: &Ray, index: usize) -> f32 {
        let distance = self.triangles[index].intersect(ray);
        let face = &self.faces[index];
        let material = self.material(face);
        let (Some(cutoff), true) = (material.alpha_cutoff, distance.is_finite()) else {
            return distance;
        };
        let place = self.place(ray, index, distance);
        let alpha = self.texel(material.base_color_texture, face, place)[3];
        if alpha >= cutoff { distance } else { f32::INFINITY }
    }

    /// Barycentric coordinates of a point of a ray on a triangle.
    fn place(&self, ray: &Ray, index: usize, distance: f32) -> Vec3 {
        let Triangle { v0, v1, v2 } = self.triangles[index];
        let p = ray.origin + ray.direction * distance;
        let (a, b, d) = (v1 - v0, v2 - v0, p - v0);
        let normal = a.cross(b);
        let scale = 1.0 / normal.length_squared();
        let (v, w) = (d.cross(b).dot(normal) * scale, a.cross(d).dot(normal) * scale);
        Vec3::new(1.0 - v - w, v, w)
    }

    /// The first triangle along a ray.
    #[must_use]
    pub fn cast(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let ray = Ray::new_inf(origin.into(), direction.into());
        let mut hit = RayHit::none();
        let index = |id: usize| self.tree.primitive_indices[id] as usize;
        if !self.tree.ray_traverse(ray, &mut hit, |ray, id| self.meet(ray, index(id))) {
            return None;
        }
        let triangle = index(hit.primitive_id as usize);
        let face = &self.faces[triangle];
        let from_front = face.normal.dot(direction) < 0.0;
        Some(Hit {
            distance: hit.t,
            triangle,
            normal: if from_front { face.normal } else { -face.normal },
            is_front: from_front || self.material(face).double_sided,
            place: self.place(&ray, triangle, hit.t),
        })
    }

    fn offset(&self, place: Vec3) -> f32 {
        OFFSET_SHARE * place.abs().max_element() + OFFSET_SHARE_OF_REACH * self.reach
    }

    /// Where rays from a place of a surface start.
    fn above(&self, place: Vec3, normal: Vec3) -> Vec3 {
        place + normal * self.offset(place)
    }

    /// Whether nothing lies along a direction before `distance`.
    fn is_open(&self, origin: Vec3, direction: Vec3, distance: f32) -> bool {
        let ray = Ray::new(origin.into(), direction.into(), 0.0, distance);
        let index = |id: usize| self.tree.primitive_indices[id] as usize;
        self.tree.ray_traverse_miss(ray, |ray, id| self.meet(ray, index(id)))
    }

    /// The material of what was met.
    #[must_use]
    pub fn material_of(&self, hit: &Hit) -> &'a Material {
        self.material(&self.faces[hit.triangle])
    }

    /// Emitted radiance of the side that was met, W·m⁻²·sr⁻¹.
    #[must_use]
    pub fn emission(&self, hit: &Hit) -> [f32; 3] {
        let face = &self.faces[hit.triangle];
        let material = self.material(face);
        if !hit.is_front || material.emission == [0.0; 3] {
            return [0.0; 3];
        }
        let glow = self.texel(material.emission_texture, face, hit.place);
        std::array::from_fn(|c| material.emission[c] * glow[c])
    }

    /// Diffuse albedo of the side that was met; backs are black.
    #[must_use]
    pub fn albedo(&self, hit: &Hit) -> [f32; 3] {
        if !hit.is_front {
            return [0.0; 3];
        }
        let face = &self.faces[hit.triangle];
        let material = self.material(face);
        let texel = self.texel(material.base_color_texture, face, hit.place);
        let diffuse = 1.0 - material.metallic.clamp(0.0, 1.0);
        std::array::from_fn(|c| {
            let color = hit.place.dot(Vec3::from(face.colors.map(|vertex| vertex[c])));
            (material.base_color[c] * texel[c] * color * diffuse).clamp(0.0, 1.0)
        })
    }

    /// Solid-angle density with which the emitters' sampler finds a place that was met.
    fn emitter_density(&self, hit: &Hit, direction: Vec3) -> f32 {
        let Some(emitters) = &self.emitters else { return 0.0 };
        let cosine = hit.normal.dot(direction).abs();
        let per_area = emitters.probability(hit.triangle) / self.area(hit.triangle);
        per_area * hit.distance * hit.distance / cosine.max(1e-9)
    }

    fn area(&self, triangle: usize) -> f32 {
        let Triangle { v0, v1, v2 } = self.triangles[triangle];
        0.5 * (v1 - v0).cross(v2 - v0).length()
    }

    /// Light at a place with a unit normal, by the paths `paths` (below [`PATHS_MAX`]) of up to `bounces` bounces ([`BOUNCES_MAX`]);
    /// `seed` makes the estimates of different places and runs independent, and the mean of successive ranges is that of all of them.
    #[must_use]
    pub fn gather(
        &self,
        position: Vec3,
        normal: Vec3,
        bounces: u32,
        paths: Range<u32>,
        seed: u32,
    ) -> Gathered {
        let bounces = bounces.min(BOUNCES_MAX);
        let mut sums = vec![[0f64; 3]; bounces as usize + 1];
        let (mut open, samples) = (0u32, paths.len());
        for index in paths {
            let (mut position, mut normal, mut throughput) = (position, normal, [1f32; 3]);
            for bounce in 0..=bounces {
                let random =
                    |dimension| sobol_burley::sample(index, bounce * DIMENSIONS + dimension, seed);
                let mut light = self.sample_sky(position, normal, &random);
                add(&mut light, self.sample_emitters(position, normal, &random));
                let direction = cosine_direction(normal, random(0), random(1));
                let start = self.above(position, normal);
                let hit = self.cast(start, direction);
                add(&mut light, self.arriving(hit.as_ref(), normal, direction));
                for c in 0..3 {
                    sums[bounce as usize][c] += f64::from(throughput[c] * light[c]);
                }
                open += u32::from(bounce == 0 && hit.is_none());
                let Some(hit) = hit else { break };
                let albedo = self.albedo(&hit);
                throughput = std::array::from_fn(|c| throughput[c] * albedo[c]);
                if throughput == [0.0; 3] {
                    break;
                }
                position = start + direction * hit.distance;
                normal = hit.normal;
            }
        }
        let scale = 1.0 / samples.max(1) as f64;
        let irradiance = sums.into_iter().map(|sum| sum.map(|c| c * scale)).collect();
        Gathered { openness: f64::from(open) * scale, irradiance }
    }

    /// Irradiance by a direction that was drawn by its cosine.
    fn arriving(&self, hit: Option<&Hit>, normal: Vec3, direction: Vec3) -> [f32; 3] {
        let density = normal.dot(direction).max(0.0) / PI;
        let (radiance, other) = match hit {
            Some(hit) => (self.emission(hit), self.emitter_density(hit, direction)),
            None => self.sky.as_ref().map_or(([0.0; 3], 0.0), |sky| sky.look_up(direction)),
        };
        let weight = PI * density / (density + other).max(1e-30);
        radiance.map(|c| c * weight)
    }

    /// Irradiance by a direction drawn from the environment.
    fn sample_sky(&self, position: Vec3, normal: Vec3, random: &dyn Fn(u32) -> f32) -> [f32; 3] {
        let Some(sky) = &self.sky else { return [0.0; 3] };
        let sample = sky.sample([random(2), random(3)]);
        let cosine = normal.dot(sample.direction);
        let start = self.above(position, normal);
        if cosine <= 0.0 || !self.is_open(start, sample.direction, f32::INFINITY) {
            return [0.0; 3];
        }
        let weight = cosine / (sample.density + cosine / PI);
        sample.radiance.map(|c| c * weight)
    }

    /// Irradiance by a point drawn from the triangles that emit.
    fn sample_emitters(
        &self,
        position: Vec3,
        normal: Vec3,
        random: &dyn Fn(u32) -> f32,
    ) -> [f32; 3] {
        let Some((direction, light, density)) = self.draw_emitter(position, normal, random) else {
            return [0.0; 3];
        };
        let cosine = normal.dot(direction);
        let weight = cosine / (density + cosine / PI);
        light.map(|c| c * weight)
    }

    /// Direction, radiance and density of a point drawn from the triangles that emit, if it shines on the place.
    fn draw_emitter(
        &self,
        position: Vec3,
        normal: Vec3,
        random: &dyn Fn(u32) -> f32,
    ) -> Option<(Vec3, [f32; 3], f32)> {
        let triangle = self.emitters.as_ref()?.sample(random(4));
        let (root, v) = (random(5).sqrt(), random(6));
        let place = Vec3::new(1.0 - root, root * (1.0 - v), root * v);
        let Triangle { v0, v1, v2 } = self.triangles[triangle];
        let target = Vec3::from(v0 * place.x + v1 * place.y + v2 * place.z);
        let start = self.above(position, normal);
        let way = target - start;
        let distance = way.length();
        let direction = way / distance;
        let face = &self.faces[triangle];
        let from_front = face.normal.dot(direction) < 0.0;
        let hit = Hit {
            distance,
            triangle,
            normal: if from_front { face.normal } else { -face.normal },
            is_front: from_front || self.material(face).double_sided,
            place,
        };
        let light = self.emission(&hit);
        let before = distance - 2.0 * self.offset(target);
        let shines = normal.dot(direction) > 0.0 && light != [0.0; 3];
        if !shines || !self.is_open(start, direction, before) {
            return None;
        }
        Some((direction, light, self.emitter_density(&hit, direction)))
    }

    /// Radiance that white microfacets of width α reflect toward the unit direction `eye`, once or several times, of light that comes
    /// straight from emitters and sky: what is lost at the first bounce is put back by a factor, so that uniform light comes back whole; paths and seed as in [`Caster::gather`]. Half vectors are drawn by their density, and where there are
    /// emitters, points on them; the two are weighted by the balance heuristic.
    #[must_use]
    pub fn reflect(
        &self,
        position: Vec3,
        normal: Vec3,
        eye: Vec3,
        alpha: f32,
        paths: Range<u32>,
        seed: u32,
    ) -> [f32; 3] {
        let frame = Frame::from_normal(normal);
        let start = self.above(position, normal);
        let lobe = MicrofacetLobe { normal, eye, alpha };
        let (mut sum, count) = ([0f64; 3], paths.len());
        for index in paths {
            let random = |dimension| sobol_burley::sample(index, dimension, seed);
            let direction = lobe.draw(&frame, random(0), random(1));
            if let Some((value, density)) = lobe.reflectance(direction) {
                let (radiance, other) = match self.cast(start, direction) {
                    Some(hit) => (self.emission(&hit), self.emitter_density(&hit, direction)),
                    None => (self.sky.as_ref().map_or([0.0; 3], |s| s.look_up(direction).0), 0.0),
                };
                let weight = value / (density + other);
                (0..3).for_each(|c| sum[c] += f64::from(radiance[c] * weight));
            }
            let drawn = self.draw_emitter(position, normal, &random);
            if let Some((direction, radiance, density)) = drawn
                && let Some((value, other)) = lobe.reflectance(direction)
            {
                let weight = value / (density + other);
                (0..3).for_each(|c| sum[c] += f64::from(radiance[c] * weight));
            }
        }
        let whole = lobe.first_bounce() * count.max(1) as f64;
        sum.map(|c| (c / whole) as f32)
    }
}

/// Share of uniform light that white microfacets of width α reflect at the first bounce. The engine puts back the rest.
#[must_use]
pub fn first_bounce(normal: Vec3, eye: Vec3, alpha: f32) -> f32 {
    MicrofacetLobe { normal, eye, alpha }.first_bounce() as f32
}

/// What microfacets reflect toward an eye.
struct MicrofacetLobe {
    normal: Vec3,
    eye: Vec3,
    alpha: f32,
}

impl MicrofacetLobe {
    /// A direction whose half vector is drawn by D (n·h).
    fn draw(&self, frame: &Frame, u: f32, v: f32) -> Vec3 {
        let (sin, cos) = (TAU * u).sin_cos();
        let tan2 = self.alpha * self.alpha * v / (1.0 - v);
        let cos_half = 1.0 / (1.0 + tan2).sqrt();
        let sin_half = (1.0 - cos_half * cos_half).max(0.0).sqrt();
        let half = frame.to_world(Vec3::new(sin_half * cos, sin_half * sin, cos_half));
        half * (2.0 * self.eye.dot(half)) - self.eye
    }

    /// What is reflected of uniform light of radiance 1 at the first bounce: a sum over directions of an even grid of half vectors. A grid of
    /// 128 × 128 is within 0.1 % of a finer one at cosines above 0.1.
    fn first_bounce(&self) -> f64 {
        let frame = Frame::from_normal(self.normal);
        let at = |i: u32| (i as f32 + 0.5) / 128.0;
        let cells = (0..128 * 128).map(|i| self.draw(&frame, at(i % 128), at(i / 128)));
        let shares =
            cells.filter_map(|d| self.reflectance(d)).map(|(value, density)| value / density);
        shares.map(f64::from).sum::<f64>() / f64::from(128 * 128)
    }

    /// Reflectance times cosine of a direction, and the density with which it is drawn; none where nothing is reflected.
    fn reflectance(&self, direction: Vec3) -> Option<(f32, f32)> {
        let (cosine, toward) = (self.normal.dot(direction), self.normal.dot(self.eye));
        let half = (direction + self.eye).try_normalize()?;
        let (cos_half, eye_half) = (self.normal.dot(half), self.eye.dot(half));
        if cosine <= 0.0 || toward <= 0.0 || eye_half <= 0.0 || cos_half <= 0.0 {
            return None;
        }
        let a2 = self.alpha * self.alpha;
        let spread = cos_half * cos_half * (a2 - 1.0) + 1.0;
        let facets = a2 / (PI * spread * spread);
        let shadowing = smith(self.alpha, cosine) * smith(self.alpha, toward);
        let value = facets * shadowing / (4.0 * toward);
        let density = facets * cos_half / (4.0 * eye_half);
        (density > 0.0).then_some((value, density))
    }
}

/// Share of microfacets of width α that are seen at a cosine (Smith).
fn smith(alpha: f32, cosine: f32) -> f32 {
    let a2 = alpha * alpha;
    2.0 * cosine / (cosine + (a2 + (1.0 - a2) * cosine * cosine).sqrt())
}

fn add(sum: &mut [f32; 3], light: [f32; 3]) {
    for (sum, light) in sum.iter_mut().zip(light) {
        *sum += light;
    }
}

fn brightness(rgb: [f32; 3]) -> f32 {
    rgb.iter().sum()
}

/// Interpolates texture coordinates.
fn at(place: Vec3, uvs: [Vec2; 3]) -> Vec2 {
    uvs[0] * place.x + uvs[1] * place.y + uvs[2] * place.z
}

/// A direction over the horizon of a unit normal, with density cosine/π.
fn cosine_direction(normal: Vec3, u: f32, v: f32) -> Vec3 {
    let (sin, cos) = (TAU * v).sin_cos();
    let radius = u.sqrt();
    let local = Vec3::new(radius * cos, radius * sin, (1.0 - u).max(0.0).sqrt());
    Frame::from_normal(normal).to_world(local)
}

#[cfg(test)]
mod tests;
