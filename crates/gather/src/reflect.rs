//! What a glossy receiver reflects: the cut drawn into a raster as dense as its lobe, over the environment.

use crate::importance::nearest_to;
use crate::light::PreparedLight;
use crate::primitive::{DrawSurfel, Outline, SurfelPen, piece_ink, piece_shape, surfel_ink};
use pbgi_brdf::{GgxLobe, LobeDirections, LobePattern};
use pbgi_cut::{Cluster, CutVisitor, Kept, Piece, SurfelSeen};
use pbgi_math::Vec3;
use pbgi_raster::{Ink, Lanes, LobeInk, LobeRaster, SAMPLES, Shape};
use std::f32::consts::PI;
use std::marker::PhantomData;

/// Directions a piece would meet, by its solid angle, from which on it shines in those it does meet: below, their number says too
/// little of its size.
const COUNTED_DIRECTIONS: f32 = 8.0;

/// Directions up to which a round piece, by the solid angle of its bounds, is a particle: which of them it would meet is chance.
const PARTICLE_DIRECTIONS: f32 = 1.0;

/// Memory of reflections, reused from receiver to receiver.
#[derive(Debug)]
pub(crate) struct LobeScratch {
    pub pattern: LobePattern,
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
        let LobeDirections { directions, solid_angles, above, .. } = &self.directions;
        self.raster.clear(directions, solid_angles, above);
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
            let through = self.raster.transmittance(group);
            for i in (0..SAMPLES).filter(|i| above[group] >> i & 1 != 0) {
                if through[i] == 0.0 {
                    continue;
                }
                let direction = directions[group].each_ref().map(|axis| axis[i]);
                let sky = light.pyramid.radiance(direction.into(), solid_angles[group][i]);
                for channel in 0..3 {
                    reflected[channel] += through[i] * weights[group][channel][i] * sky[channel];
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
    pub pattern: &'a LobePattern,
    /// Which directions are above the horizon.
    pub above: &'a [u16],
    /// The lobe's mirror direction.
    pub axis: Vec3,
    /// Directions of the raster.
    pub count: f32,
    pub normal: Vec3,
    /// Of the receiver's surface.
    pub plane: Vec3,
    pub lanes: PhantomData<L>,
}

/// Where a node or a surfel lies, and what of the lobe it has: the same for all pieces of a node.
#[derive(Clone, Copy)]
struct Place {
    /// Unit vector from the receiver to its middle.
    from: Vec3,
    /// Radius over distance.
    spread: f32,
    /// Solid angle of a direction where it comes nearest to the mirror direction; 0 where nothing asks for it, as for all that follows.
    share: f32,
    /// What is reflected of light from its middle.
    reflect: [f32; 3],
    /// The direction that stands for the one to its middle, if that was asked for.
    direction: Option<Option<usize>>,
}

/// How a piece is drawn.
#[derive(Clone, Copy)]
struct Drawn {
    ink: LobeInk,
    solid_angle: f32,
    is_particle: bool,
}

impl<L: Lanes> LobeVisitor<'_, L> {
    /// The place of what is in this direction; `shines` where its share of the lobe matters: for what is dark, it does not.
    #[inline(always)]
    fn place(&self, toward: Vec3, spread: f32, shines: bool) -> Place {
        let from = toward * (1.0 / toward.length());
        let mut place = Place { from, spread, share: 0.0, reflect: [0.0; 3], direction: None };
        if shines {
            let nearest = nearest_to(self.axis, from, spread);
            place.share = self.lobe.share_solid_angle(nearest, self.count);
            place.reflect = self.lobe.reflect(from);
        }
        place
    }

    /// How a piece shines: by its solid angle where it is smaller than some directions' share of the lobe even where it comes nearest to the
    /// mirror direction. A round one faces the receiver wherever that is, and lies anywhere in its bounds.
    #[inline(always)]
    fn ink(ink: &Ink, place: &Place, is_round: bool) -> Drawn {
        let Ink { veil, tolerance, radiance, solid_angle, .. } = *ink;
        let ink = LobeInk { veil, tolerance, radiance, reflected: [0.0; 3] };
        let mut drawn = Drawn { ink, solid_angle, is_particle: false };
        let &Place { spread, share, ref reflect, .. } = place;
        drawn.is_particle = is_round && PI * spread * spread < PARTICLE_DIRECTIONS * share;
        if solid_angle <= COUNTED_DIRECTIONS * share || drawn.is_particle {
            drawn.ink.reflected = std::array::from_fn(|c| radiance[c] * reflect[c] * solid_angle);
            drawn.ink.radiance = [0.0; 3];
        }
        drawn
    }

    /// The direction that stands for the one to a place; none where that is below the horizon.
    #[inline(always)]
    fn direction(&self, place: &mut Place) -> Option<usize> {
        if let Some(known) = place.direction {
            return known;
        }
        let is_above = place.from.dot(self.normal) > 0.0;
        let found = || self.pattern.direction_at(self.lobe.place(place.from), self.above);
        let direction = if is_above { found() } else { None };
        place.direction = Some(direction);
        direction
    }

    #[inline(always)]
    fn draw_shape<S: Shape>(&mut self, shape: &S, drawn: &Drawn, place: &mut Place) {
        let Drawn { ink, solid_angle, .. } = drawn;
        if drawn.is_particle {
            if let Some(direction) = self.direction(place) {
                self.raster.scatter(ink, *solid_angle, shape.inverse(), direction);
            }
            return;
        }
        let is_met = self.raster.draw::<L, S>(shape, ink);
        if is_met || ink.reflected == [0.0; 3] {
            return;
        }
        if let Some(direction) = self.direction(place) {
            self.raster.shine(ink, shape.inverse(), direction);
        }
    }
}

impl<L: Lanes> CutVisitor for LobeVisitor<'_, L> {
    #[inline(always)]
    fn is_open(&mut self, low: Vec3, high: Vec3, _: Kept) -> bool {
        self.raster.is_open::<L>(low, high)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        let toward = (cluster.low + cluster.high) * 0.5;
        let shines = |piece: &Piece| piece.radiance != [0.0; 3] || piece.is_round;
        let shines = cluster.pieces().iter().any(shines);
        let mut place = self.place(toward, cluster.spread, shines);
        for piece in cluster.pieces() {
            let (section, veil) = piece_shape(cluster, piece);
            let drawn = Self::ink(&piece_ink(cluster, piece, veil), &place, piece.is_round);
            self.draw_shape(&section, &drawn, &mut place);
        }
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen<'_>) {
        L::run_part(DrawSurfel { seen, plane: self.plane, pen: self });
    }

    #[inline(always)]
    fn minds_order(&self) -> bool {
        true
    }
}

impl<L: Lanes> SurfelPen for LobeVisitor<'_, L> {
    #[inline(always)]
    fn draw<S: Shape>(&mut self, seen: &SurfelSeen<'_>, shape: &S, outline: &Outline) {
        let (ink, is_round) = (surfel_ink(seen, outline), seen.surfel.isotropic);
        let spread = seen.surfel.radius / seen.distance2.sqrt();
        let shines = ink.radiance != [0.0; 3] || is_round;
        let mut place = self.place(seen.center, spread, shines);
        let drawn = Self::ink(&ink, &place, is_round);
        let [low, high] = seen.bounds();
        if drawn.is_particle || self.raster.is_open::<L>(low, high) {
            self.draw_shape(shape, &drawn, &mut place);
        }
    }
}
