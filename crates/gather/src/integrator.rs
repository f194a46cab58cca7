//! One receiver: its cut drawn into its raster, under the environment, times its BRDF.

use crate::importance::{CubeThreshold, ImportanceTerms, LobeThreshold, Stakes};
use crate::lamps::{LampThreshold, LampVisitor, Lamps};
use crate::light::{PreparedLight, PreparedPeak};
use crate::primitive::{Outline, SurfelPen, draw_surfel, piece_ink, piece_shape, surfel_ink};
use crate::receiver::{Gloss, Receiver, Shading};
use crate::reflect::{LobeScratch, LobeVisitor};
use pbgi_brdf::{ConvolutionTable, GgxLobe, convolve_diffuse};
use pbgi_cut::{
    Cluster, CutReceiver, CutScratch, CutStats, CutVisitor, SurfelSeen, Threshold,
    UniformThreshold, mean_brightness, pick_cut,
};
use pbgi_math::{Vec3, sphere_sin2_for_solid_angle};
use pbgi_raster::{
    CubeRaster, CubeRasterTable, Footprint, Ink, Lanes, SHAPES_MAX, Section, Shape, SimdLevel,
    Veil, WideKernel, Window, WindowRaster, run_wide,
};
use pbgi_store::{Reader, StoreError};
use std::marker::PhantomData;

/// Which light a gather looks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GatherParts {
    /// All of it.
    #[default]
    All,
    /// What the cube raster holds: surfaces and the environment without its peaks.
    Broad,
    /// What varies fast over a surface: the environment's peaks, with sharp shadows, and glossy reflections.
    Sharp,
}

/// Quality of a gather.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatherSettings {
    /// Largest solid angle of a node that is taken as one, in steradians, before `importance` makes it smaller or larger; 0 takes every
    /// surfel.
    pub solid_angle_sr: f32,
    /// What makes nodes in some directions smaller or larger than in others.
    pub importance: ImportanceTerms,
    /// Texels along a face of the cube raster, 1 to 64.
    pub raster_edge: usize,
    /// Directions of a reflection: 16 · 4^`lobe_level`; at most 4.
    pub lobe_level: u32,
    /// Surfels that rise less than this share of their radius above the receiver's tangent plane
    /// are its own surface.
    pub bias: f32,
    /// Which light is looked for; what is not is 0.
    pub parts: GatherParts,
    /// Unit direction of the sky, for `sky_visibility`.
    pub up: Vec3,
    /// The instructions to use.
    pub simd: SimdLevel,
}

impl Default for GatherSettings {
    fn default() -> Self {
        Self {
            solid_angle_sr: 0.03,
            importance: ImportanceTerms::ALL,
            raster_edge: 16,
            lobe_level: 3,
            bias: 0.4,
            parts: GatherParts::All,
            up: Vec3::Y,
            simd: SimdLevel::detect(),
        }
    }
}

/// Share of a window's texel that a node may span to be drawn as one.
const WINDOW_TEXEL_SHARE: f32 = 0.5;

/// Everything one thread needs to gather for receivers, one after the other.
pub struct Gatherer<'a> {
    walker: Walker<'a>,
    settings: GatherSettings,
    light: Option<&'a PreparedLight>,
    table: ConvolutionTable,
    raster: CubeRaster,
    window_raster: WindowRaster,
    lobe: LobeScratch,
    /// What importance weighs brightness by; found by the first gather.
    stakes: Option<Stakes<'a>>,
    /// Of the receiver that is gathered for.
    lamps: Lamps,
}

impl<'a> Gatherer<'a> {
    /// A gatherer over `reader`'s octree; `light` must be prepared for `settings.raster_edge`.
    #[must_use]
    pub fn new(
        reader: Reader<'a>,
        settings: &GatherSettings,
        light: Option<&'a PreparedLight>,
    ) -> Self {
        let table = CubeRasterTable::new(settings.raster_edge);
        let shines = reader.octree().header().channels.count() > 0;
        Self {
            walker: Walker { reader, scratch: CutScratch::default(), stats: CutStats::default() },
            settings: *settings,
            light,
            raster: CubeRaster::new(&table, shines),
            table: ConvolutionTable::new(&table),
            lobe: LobeScratch::new(settings.lobe_level),
            stakes: None,
            lamps: Lamps::new(),
            window_raster: WindowRaster::default(),
        }
    }

    /// Counts of all gathers so far.
    #[must_use]
    pub fn stats(&self) -> CutStats {
        self.walker.stats
    }

    /// Gathers for one receiver. The result depends on the octree, the light, the settings and the
    /// receiver only.
    ///
    /// # Errors
    ///
    /// If a page cannot be read or contradicts itself.
    pub fn gather(&mut self, receiver: &Receiver) -> Result<Shading, StoreError> {
        run_wide(self.settings.simd, GatherKernel { gatherer: self, receiver })
    }

    #[inline(always)]
    fn gather_kernel<L: Lanes>(&mut self, receiver: &Receiver) -> Result<Shading, StoreError> {
        let before = self.walker.stats.cut_size();
        let cut_receiver = CutReceiver {
            position: receiver.position,
            normal: receiver.normal,
            bias: 0.0,
            surfel_bias: self.settings.bias,
        };
        let mut shading = Shading::default();
        if self.settings.parts != GatherParts::Sharp {
            // Only the cube asks for them.
            self.find_lamps(&cut_receiver)?;
            shading = self.gather_broad::<L>(&cut_receiver)?;
        }
        if self.settings.parts != GatherParts::Broad {
            let lobe = receiver.gloss.as_ref().and_then(|Gloss { material, toward_eye }| {
                GgxLobe::new(material, receiver.normal, *toward_eye)
            });
            if let Some(lobe) = &lobe {
                self.gather_lobe::<L>(lobe, &cut_receiver, &mut shading)?;
            }
            for peak in self.light.map_or(&[][..], |l| &l.peaks) {
                self.gather_peak::<L>(peak, &cut_receiver, lobe.as_ref(), &mut shading)?;
            }
        }
        shading.cut_size = (self.walker.stats.cut_size() - before) as u32;
        Ok(shading)
    }

    /// Finds what shines brightly around the receiver, for importance.
    #[inline(always)]
    fn find_lamps(&mut self, receiver: &CutReceiver) -> Result<(), StoreError> {
        let usual = self.stakes()?.usual;
        self.lamps.clear(usual);
        if usual == 0.0 || !self.raster.shines() {
            return Ok(());
        }
        self.raster.set_lamp_radiance(self.lamps.least);
        if !self.settings.importance.radiance {
            return Ok(());
        }
        let threshold = LampThreshold::new(&self.lamps);
        let mut visitor = LampVisitor { lamps: &mut self.lamps };
        self.walker.look(receiver, &threshold, &mut visitor)?;
        self.lamps.finish();
        Ok(())
    }

    /// Everything but peaks and reflections: the cut drawn into the cube, over the environment's base.
    #[inline(always)]
    fn gather_broad<L: Lanes>(&mut self, receiver: &CutReceiver) -> Result<Shading, StoreError> {
        self.raster.clear::<L>(receiver.normal);
        let terms = self.settings.importance;
        let stakes = self.stakes()?;
        let lamps = &self.lamps;
        let mut visitor = CubeVisitor::<L> {
            raster: &mut self.raster,
            footprint: Footprint::default(),
            normal: receiver.normal,
            lanes: PhantomData,
        };
        let user_sr = self.settings.solid_angle_sr;
        let edge = self.settings.raster_edge as f32;
        let texel_sr = SMALLEST_TEXEL_SR / (edge * edge);
        let normal = receiver.normal;
        let threshold = CubeThreshold { user_sr, texel_sr, normal, terms, stakes, lamps };
        if !stakes.are_even() {
            self.walker.pick(receiver, &threshold, &mut visitor)?;
        } else if terms.cosine || terms.quality {
            self.walker.pick(receiver, &threshold.of_even_light(), &mut visitor)?;
        } else {
            self.walker.pick(receiver, &uniform(user_sr), &mut visitor)?;
        }
        let base = self.light.map(|l| &l.base);
        let diffuse =
            convolve_diffuse(&self.raster, &self.table, base, receiver.normal, self.settings.up);
        Ok(Shading {
            surface_irradiance: diffuse.surface_irradiance,
            environment_irradiance: diffuse.environment_irradiance,
            ambient_occlusion: diffuse.ambient_occlusion,
            sky_visibility: diffuse.sky_visibility,
            bent_normal: diffuse.bent_normal,
            ..Shading::default()
        })
    }

    /// What importance weighs brightness by.
    fn stakes(&mut self) -> Result<Stakes<'a>, StoreError> {
        if let Some(known) = self.stakes {
            return Ok(known);
        }
        let sky = self.light.map(|light| &light.pyramid);
        let surfaces = mean_brightness(&mut self.walker.reader)?;
        let stakes = Stakes::new(self.settings.importance, surfaces, sky);
        self.stakes = Some(stakes);
        Ok(stakes)
    }

    /// Reflections but for the environment's peaks: a walk that draws what a lobe meets.
    #[inline(always)]
    fn gather_lobe<L: Lanes>(
        &mut self,
        lobe: &GgxLobe,
        receiver: &CutReceiver,
        shading: &mut Shading,
    ) -> Result<(), StoreError> {
        let stakes = self.stakes()?;
        self.lobe.start(lobe);
        let (count, texel_sr) = (self.lobe.count(), self.lobe.smallest_solid_angle());
        let axis = lobe.mirror();
        let mut visitor = LobeVisitor::<L> {
            count,
            raster: &mut self.lobe.raster,
            lobe,
            pattern: &self.lobe.pattern,
            above: &self.lobe.directions.above,
            axis,
            normal: receiver.normal,
            lanes: PhantomData,
        };
        let user_sr = self.settings.solid_angle_sr;
        let terms = self.settings.importance;
        if terms == ImportanceTerms::OFF {
            self.walker.pick(receiver, &uniform(user_sr), &mut visitor)?;
        } else {
            let threshold = LobeThreshold { user_sr, texel_sr, lobe, axis, terms, stakes };
            self.walker.pick(receiver, &threshold, &mut visitor)?;
        }
        (shading.reflected, shading.gloss_albedo) = self.lobe.resolve(self.light);
        Ok(())
    }

    /// Light from one peak: a narrow walk that draws what blocks its window.
    #[inline(always)]
    fn gather_peak<L: Lanes>(
        &mut self,
        peak: &PreparedPeak,
        receiver: &CutReceiver,
        lobe: Option<&GgxLobe>,
        shading: &mut Shading,
    ) -> Result<(), StoreError> {
        let axis = peak.window.frame().normal;
        if axis.dot(receiver.normal) <= -peak.sin_half_angle {
            return Ok(());
        }
        self.window_raster.clear(&peak.window);
        let user_sr = self.settings.solid_angle_sr;
        let threshold = if self.settings.importance.env {
            let sine = 0.5 * WINDOW_TEXEL_SHARE * peak.texel_width;
            UniformThreshold::from_sine(sine.min(sphere_sin2_for_solid_angle(user_sr).sqrt()))
        } else {
            uniform(user_sr)
        };
        let mut visitor = WindowVisitor::<L> {
            raster: &mut self.window_raster,
            window: &peak.window,
            normal: receiver.normal,
            lanes: PhantomData,
        };
        self.walker.pick(receiver, &threshold, &mut visitor)?;
        for (index, (direction, light)) in peak.texels.iter().enumerate() {
            if !self.window_raster.is_open(index) {
                continue;
            }
            let cosine = direction.dot(receiver.normal).max(0.0);
            let reflect = lobe.map_or([0.0; 3], |lobe| lobe.reflect(*direction));
            for channel in 0..3 {
                shading.environment_irradiance[channel] += cosine * light[channel];
                shading.reflected[channel] += reflect[channel] * light[channel];
            }
        }
        Ok(())
    }
}

/// Solid angle of the smallest texel of a cube with one texel per face, in the limit of many: those in the corners, by (1 + 1 + 1)^(−3/2)
/// of 4 in the middle.
const SMALLEST_TEXEL_SR: f32 = 4.0 / 5.196_152;

/// The same threshold everywhere.
fn uniform(solid_angle_sr: f32) -> UniformThreshold {
    UniformThreshold::from_sine(sphere_sin2_for_solid_angle(solid_angle_sr).sqrt())
}

/// Picks cuts of one octree, one after the other.
struct Walker<'a> {
    reader: Reader<'a>,
    scratch: CutScratch,
    stats: CutStats,
}

impl Walker<'_> {
    #[inline(always)]
    fn pick<T: Threshold, V: CutVisitor>(
        &mut self,
        receiver: &CutReceiver,
        threshold: &T,
        visitor: &mut V,
    ) -> Result<(), StoreError> {
        let Self { reader, scratch, stats } = self;
        pick_cut(reader, receiver, threshold, visitor, scratch, stats)
    }

    /// The same for a walk whose nodes are none of the cut; its requests for pages count.
    #[inline(always)]
    fn look<T: Threshold, V: CutVisitor>(
        &mut self,
        receiver: &CutReceiver,
        threshold: &T,
        visitor: &mut V,
    ) -> Result<(), StoreError> {
        let before = self.stats;
        self.pick(receiver, threshold, visitor)?;
        self.stats = CutStats { levels: self.stats.levels, ..before };
        Ok(())
    }
}

/// A gather, compiled for every SIMD level.
struct GatherKernel<'k, 'a> {
    gatherer: &'k mut Gatherer<'a>,
    receiver: &'k Receiver,
}

impl WideKernel for GatherKernel<'_, '_> {
    type Output = Result<Shading, StoreError>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        self.gatherer.gather_kernel::<L>(self.receiver)
    }
}

/// Draws the cut into the cube.
struct CubeVisitor<'a, L> {
    raster: &'a mut CubeRaster,
    /// Of the box that was asked about last.
    footprint: Footprint,
    normal: Vec3,
    lanes: PhantomData<L>,
}

impl<L: Lanes> CutVisitor for CubeVisitor<'_, L> {
    #[inline(always)]
    fn is_open(&mut self, low: Vec3, high: Vec3) -> bool {
        self.footprint = self.raster.footprint(low, high);
        self.raster.is_open(&self.footprint)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        let mut shapes = [(Section::default(), Ink::default()); SHAPES_MAX];
        let pieces = cluster.pieces();
        for (shape, piece) in shapes.iter_mut().zip(pieces) {
            let (section, veil) = piece_shape(cluster, piece);
            *shape = (section, piece_ink(cluster, piece, veil));
        }
        let toward = cluster.low + cluster.high;
        self.raster.draw::<L, _>(&shapes[..pieces.len()], &self.footprint, toward);
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen) {
        draw_surfel(seen, self.normal, self);
    }
}

impl<L: Lanes> SurfelPen for CubeVisitor<'_, L> {
    #[inline(always)]
    fn draw<S: Shape>(&mut self, seen: &SurfelSeen, shape: &S, outline: &Outline) {
        let footprint = self.raster.footprint(outline.bounds.min, outline.bounds.max);
        let ink = surfel_ink(seen, outline);
        self.raster.draw::<L, S>(&[(*shape, ink)], &footprint, seen.surfel.center);
    }
}

/// Draws what blocks a window.
struct WindowVisitor<'a, L> {
    raster: &'a mut WindowRaster,
    window: &'a Window,
    normal: Vec3,
    lanes: PhantomData<L>,
}

impl<L: Lanes> CutVisitor for WindowVisitor<'_, L> {
    #[inline(always)]
    fn is_open(&mut self, low: Vec3, high: Vec3) -> bool {
        !self.raster.is_closed() && self.window.is_met_by(low, high)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        for piece in cluster.pieces() {
            let (section, veil) = piece_shape(cluster, piece);
            self.raster.draw::<L, _>(self.window, &section, &veil);
        }
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen) {
        draw_surfel(seen, self.normal, self);
    }
}

impl<L: Lanes> SurfelPen for WindowVisitor<'_, L> {
    #[inline(always)]
    fn draw<S: Shape>(&mut self, seen: &SurfelSeen, shape: &S, outline: &Outline) {
        if self.window.is_met_by(outline.bounds.min, outline.bounds.max) {
            let veil = Veil { start: 0.0, end: outline.opacity, seed: seen.seed };
            self.raster.draw::<L, S>(self.window, shape, &veil);
        }
    }
}
