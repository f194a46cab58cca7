//! What a glossy receiver reflects: the cut drawn into a raster as dense as its lobe, over the environment.

use crate::drawing::{blocks, piece_ink, piece_shape, surfel_disk, surfel_ink, surfel_tile};
use crate::importance::nearest_to;
use crate::light::PreparedLight;
use pbgi_brdf::{GgxLobe, LobeDirections, LobePattern};
use pbgi_cut::{Cluster, CutVisitor, SurfelSeen};
use pbgi_math::{Aabb, Vec3};
use pbgi_raster::{Ink, Lanes, LobeInk, LobeRaster, SAMPLES, Shape};
use std::marker::PhantomData;

/// Directions a piece would meet, by its solid angle, from which on it shines in those it does meet: below, their number says too
/// little of its size.
const COUNTED_DIRECTIONS: f32 = 4.0;

/// Memory of reflections, reused from receiver to receiver.
#[derive(Debug)]
pub(crate) struct LobeScratch {
    pattern: LobePattern,
    pub directions: LobeDirections,
    pub raster: LobeRaster,
}

impl LobeScratch {
    /// For 16 · 4^`level` directions.
    pub fn new(level: u32) -> Self {
        Self {
            pattern: LobePattern::new(level),
            directions: LobeDirections::default(),
            raster: LobeRaster::default(),
        }
    }

    /// Directions of all lobes.
    pub fn count(&self) -> f32 {
        (self.pattern.group_count() * SAMPLES) as f32
    }

    /// Empties the raster for a lobe.
    #[inline(always)]
    pub fn start(&mut self, lobe: &GgxLobe) {
        lobe.directions(&self.pattern, &mut self.directions);
        self.raster.clear(&self.directions.directions, &self.directions.above);
    }

    /// Solid angle of the densest direction.
    #[inline(always)]
    pub fn smallest_solid_angle(&self) -> f32 {
        let all = self.directions.solid_angles.iter().flatten();
        all.fold(f32::INFINITY, |least, sr| if *sr < least { *sr } else { least })
    }

    /// What is reflected, without the environment's peaks, and what would be reflected of uniform light.
    #[inline(always)]
    pub fn resolve(&self, light: Option<&PreparedLight>) -> ([f32; 3], [f32; 3]) {
        let mut reflected = self.raster.reflected();
        let mut albedo = [0.0; 3];
        let LobeDirections { directions, weights, solid_angles, above } = &self.directions;
        for group in 0..directions.len() {
            let radiance = self.raster.radiance(group);
            for channel in 0..3 {
                let weights = &weights[group][channel];
                for i in 0..SAMPLES {
                    reflected[channel] += weights[i] * radiance[channel][i];
                    albedo[channel] += weights[i];
                }
            }
            let Some(light) = light else { continue };
            let mut open = self.raster.open_directions(group) & above[group];
            while open != 0 {
                let i = open.trailing_zeros() as usize;
                open &= open - 1;
                let direction = directions[group].each_ref().map(|axis| axis[i]);
                let sky = light.pyramid.radiance(direction.into(), solid_angles[group][i]);
                for channel in 0..3 {
                    reflected[channel] += weights[group][channel][i] * sky[channel];
                }
            }
        }
        (reflected, albedo)
    }
}

/// Draws the cut into a lobe.
pub(crate) struct LobeVisitor<'a, L> {
    pub raster: &'a mut LobeRaster,
    pub lobe: &'a GgxLobe,
    /// Its mirror direction.
    pub axis: Vec3,
    /// Directions of the raster.
    pub count: f32,
    pub normal: Vec3,
    pub lanes: PhantomData<L>,
}

impl<L: Lanes> LobeVisitor<'_, L> {
    /// How a piece around `toward`, of this radius over its distance, shines: by its solid angle where it is smaller than some directions'
    /// share of the lobe even where it comes nearest to the mirror direction.
    #[inline(always)]
    fn ink(&self, ink: &Ink, spread: f32, toward: Vec3) -> LobeInk {
        let Ink { veil, tolerance, radiance, solid_angle } = *ink;
        let counted = LobeInk { veil, tolerance, radiance, reflected: [0.0; 3] };
        if radiance == [0.0; 3] {
            return counted;
        }
        let from = toward * (1.0 / toward.length());
        let nearest = nearest_to(self.axis, from, spread);
        if solid_angle > COUNTED_DIRECTIONS * self.lobe.share_solid_angle(nearest, self.count) {
            return counted;
        }
        let reflect = self.lobe.reflect(from);
        let reflected = std::array::from_fn(|c| radiance[c] * reflect[c] * solid_angle);
        LobeInk { radiance: [0.0; 3], reflected, ..counted }
    }

    #[inline(always)]
    fn draw_surfel<S: Shape>(&mut self, shape: &S, bounds: &Aabb, ink: &LobeInk, toward: Vec3) {
        if self.raster.is_open::<L>(bounds.min, bounds.max) {
            self.raster.draw::<L, S>(shape, ink, toward);
        }
    }
}

impl<L: Lanes> CutVisitor for LobeVisitor<'_, L> {
    #[inline(always)]
    fn is_open(&mut self, low: Vec3, high: Vec3) -> bool {
        self.raster.is_open::<L>(low, high)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        for piece in cluster.pieces() {
            let (section, veil) = piece_shape(cluster, piece);
            let toward = (cluster.low + cluster.high) * 0.5;
            let ink = self.ink(&piece_ink(cluster, piece, veil), cluster.spread, toward);
            self.raster.draw::<L, _>(&section, &ink, toward);
        }
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen) {
        if !blocks(seen) {
            return;
        }
        let toward = seen.surfel.center;
        let spread = seen.surfel.radius / seen.distance2.sqrt();
        if let Some(tile) = surfel_tile(seen, self.normal) {
            let ink = surfel_ink(seen, seen.surfel.normal, 1.0, tile.half[0]);
            let ink = self.ink(&ink, spread, toward);
            self.draw_surfel(&tile, &tile.bounds(), &ink, toward);
            return;
        }
        let (disk, normal, opacity) = surfel_disk(seen, self.normal);
        let ink = surfel_ink(seen, normal, opacity, disk.radius);
        let ink = self.ink(&ink, spread, toward);
        let bounds = Aabb::from_disk(disk.center, normal, disk.radius);
        self.draw_surfel(&disk, &bounds, &ink, toward);
    }
}
