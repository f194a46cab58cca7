//! One receiver: its cut drawn into its raster, over what its block has drawn and the environment, times its BRDF.

use crate::importance::{CubeThreshold, ImportanceTerms, LobeThreshold, Stakes};
use crate::lamps::{LampThreshold, LampVisitor, Lamps};
use crate::light::{PreparedLight, PreparedPeak};
use crate::receiver::{Gloss, Receiver, Shading};
use crate::record::{Record, Tolerance};
use crate::reflect::{LobeScratch, LobeVisitor};
use crate::visitors::CubeVisitor;
use crate::windows::lamp_window;
use pbgi_brdf::{
    ConvolutionTable, Differential, Differentiator, GgxLobe, LobePattern, convolve_diffuse,
};
use pbgi_cut::{
    CutReceiver, CutScratch, CutStats, CutVisitor, KNOWN_BYTES, NodeReader, Threshold,
    lies_on_disks, pick_cut,
};
use pbgi_math::Vec3;
use pbgi_raster::{
    CubeRaster, CubeRasterTable, Lanes, SAMPLES, SimdLevel, WideKernel, Window, WindowRaster,
    row_stride, run_wide,
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
    /// Directions of a reflection: 16 · 4^`lobe_level`; at most [`LOBE_LEVEL_MAX`].
    pub lobe_level: u32,
    /// Disks that rise less than this share of their radius above the receiver's plane
    /// are its own surface.
    pub bias: f32,
    /// Bytes of decoded nodes to keep for the receivers that come next; results do not depend on it.
    pub node_bytes: usize,
    /// Share of what is gathered that interpolation between receivers may be wrong by; 0 gathers for each by itself.
    pub tolerance: f32,
    /// Which light is looked for; what is not is 0.
    pub parts: GatherParts,
    /// Whether [`Shading::backs`] is looked for.
    pub finds_backs: bool,
    /// Unit direction of the sky, for `sky_visibility`.
    pub up: Vec3,
    /// The instructions to use.
    pub simd: SimdLevel,
}

impl Default for GatherSettings {
    fn default() -> Self {
        Self {
            solid_angle_sr: 0.04,
            importance: ImportanceTerms::ALL,
            raster_edge: 16,
            lobe_level: 3,
            bias: 0.4,
            node_bytes: KNOWN_BYTES,
            tolerance: 0.0,
            parts: GatherParts::All,
            finds_backs: false,
            up: Vec3::Y,
            simd: SimdLevel::detect(),
        }
    }
}

/// The highest level of a reflection's directions.
pub const LOBE_LEVEL_MAX: u32 = LobePattern::LEVEL_MAX;

/// The level of so many directions of a reflection.
///
/// # Errors
///
/// With what is expected, if there is none.
pub fn lobe_level(directions: usize) -> Result<u32, &'static str> {
    const { assert!(LOBE_LEVEL_MAX == 5, "so many numbers") };
    let mut levels = 0..=LOBE_LEVEL_MAX;
    let found = levels.find(|level| lobe_directions(*level) == directions);
    found.ok_or("16, 64, 256, 1024, 4096 or 16384")
}

/// Directions of a reflection.
#[must_use]
pub fn lobe_directions(level: u32) -> usize {
    SAMPLES << (2 * level.min(LOBE_LEVEL_MAX))
}

/// Bytes per texel of a raster and of the tables that it is convolved and differentiated by, while they are made.
const TEXEL_BYTES: usize = 520;

/// Bytes per direction of a reflection.
const DIRECTION_BYTES: usize = 128;

/// Bytes of pieces that wait for others, lists of lamps and windows, whatever the raster's size.
const SCRATCH_BYTES: usize = 2 << 20;

/// Bytes that a [`Gatherer`] holds at most with `edge` texels along a face, besides decoded nodes.
#[must_use]
pub fn gatherer_bytes(edge: usize, lobe_level: u32) -> usize {
    let texels = 6 * edge * row_stride(edge);
    texels * TEXEL_BYTES + lobe_directions(lobe_level) * DIRECTION_BYTES + SCRATCH_BYTES
}

/// Everything one thread needs to gather for receivers, one after the other.
pub struct Gatherer<'a> {
    pub(crate) walker: Walker<'a>,
    pub(crate) settings: GatherSettings,
    light: Option<&'a PreparedLight>,
    table: ConvolutionTable,
    /// What records are differentiated by; none where each receiver gathers for itself.
    differentiator: Option<Differentiator>,
    pub(crate) raster: CubeRaster,
    pub(crate) window_raster: WindowRaster,
    /// The window that looks at a lamp.
    pub(crate) lamp_window: Window,
    lobe: LobeScratch,
    /// What importance weighs brightness by; found by the first gather.
    stakes: Option<Stakes<'a>>,
    /// What shines brightly around the receiver that is gathered for.
    pub(crate) lamps: Lamps,
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
        let differentiator =
            (settings.tolerance > 0.0).then(|| Differentiator::new(&table, settings.up));
        let mut raster = CubeRaster::new(&table, shines);
        if differentiator.is_some() {
            raster.keep_depths();
        }
        if settings.finds_backs {
            raster.keep_backs();
        }
        Self {
            walker: Walker {
                nodes: NodeReader::new(reader, settings.node_bytes),
                scratch: CutScratch::default(),
                stats: CutStats::default(),
            },
            settings: *settings,
            light,
            raster,
            differentiator,
            table: ConvolutionTable::new(&table, settings.up),
            lobe: LobeScratch::new(settings.lobe_level),
            stakes: None,
            lamps: Lamps::new(),
            window_raster: WindowRaster::default(),
            lamp_window: lamp_window(settings.raster_edge),
        }
    }

    /// Counts of all gathers so far.
    #[must_use]
    pub fn stats(&self) -> CutStats {
        self.walker.stats
    }

    /// Gathers for one receiver by itself. The result depends on the octree, the light, the settings and the
    /// receiver only.
    ///
    /// # Errors
    ///
    /// If a page cannot be read or contradicts itself.
    pub fn gather(&mut self, receiver: &Receiver) -> Result<Shading, StoreError> {
        let before = self.walker.stats.cut_size();
        let mut shading = Shading::default();
        if self.settings.parts != GatherParts::Sharp {
            self.gather_at(receiver, &mut shading, Self::gather_broad)?;
        }
        if self.settings.parts != GatherParts::Broad {
            self.gather_at(receiver, &mut shading, Self::gather_sharp)?;
        }
        shading.cut_size = (self.walker.stats.cut_size() - before) as u32;
        Ok(shading)
    }

    /// Adds light to what a receiver has. Disks just over it are left out as its own surface, and once more looked at where it lies on none.
    fn gather_at(
        &mut self,
        receiver: &Receiver,
        shading: &mut Shading,
        gather: impl Fn(&mut Self, &CutReceiver, &Receiver, &mut Shading) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let &Receiver { position, normal, plane, .. } = receiver;
        let place = CutReceiver::new(position, normal, plane, self.settings.bias);
        let before = *shading;
        self.walker.scratch.doubts_own_surface = false;
        gather(self, &place, receiver, shading)?;
        let Walker { nodes, scratch, stats } = &mut self.walker;
        if scratch.doubts_own_surface && !lies_on_disks(nodes, &place, stats)? {
            *shading = before;
            gather(self, &place.on_no_disks(), receiver, shading)?;
        }
        Ok(())
    }

    /// Light of surfaces and of the environment without its peaks.
    fn gather_broad(
        &mut self,
        place: &CutReceiver,
        receiver: &Receiver,
        shading: &mut Shading,
    ) -> Result<(), StoreError> {
        self.find_lamps(place)?;
        let (stakes, gatherer) = (self.stakes()?, &mut *self);
        let kernel = CubeKernel { gatherer, place, receiver, stakes };
        run_wide(kernel.gatherer.settings.simd, kernel)?;
        let kernel = ConvolutionKernel { gatherer: self, receiver, shading };
        run_wide(kernel.gatherer.settings.simd, kernel);
        self.look_at_lamps(place, shading)
    }

    /// Gathers broad light for a receiver, and how it changes around it; the settings must have a tolerance.
    ///
    /// # Errors
    ///
    /// As of [`Self::gather`].
    pub fn record(
        &mut self,
        receiver: &Receiver,
        tolerance: &Tolerance,
    ) -> Result<Record, StoreError> {
        let shading = self.broad(receiver)?;
        let kernel = RecordKernel { gatherer: self, receiver, shading: &shading, tolerance };
        Ok(run_wide(kernel.gatherer.settings.simd, kernel))
    }

    /// Gathers broad light alone.
    ///
    /// # Errors
    ///
    /// As of [`Self::gather`].
    pub fn broad(&mut self, receiver: &Receiver) -> Result<Shading, StoreError> {
        let parts = std::mem::replace(&mut self.settings.parts, GatherParts::Broad);
        let gathered = self.gather(receiver);
        self.settings.parts = parts;
        gathered
    }

    /// Adds sharp light to what a receiver has of broad light.
    ///
    /// # Errors
    ///
    /// As of [`Self::gather`].
    pub fn add_sharp(
        &mut self,
        receiver: &Receiver,
        shading: &mut Shading,
    ) -> Result<(), StoreError> {
        let before = self.walker.stats.cut_size();
        self.gather_at(receiver, shading, Self::gather_sharp)?;
        shading.cut_size += (self.walker.stats.cut_size() - before) as u32;
        Ok(())
    }

    /// Peaks of the environment and reflections, which each receiver looks for by itself.
    fn gather_sharp(
        &mut self,
        place: &CutReceiver,
        receiver: &Receiver,
        shading: &mut Shading,
    ) -> Result<(), StoreError> {
        let lobe = receiver.gloss.as_ref().and_then(|Gloss { material, toward_eye }| {
            GgxLobe::new(material, receiver.normal, *toward_eye)
        });
        let peaks = self.light.map_or(&[][..], |light| &light.peaks);
        let is_met = |peak: &PreparedPeak| {
            let axis = peak.window.frame().normal;
            axis.dot(receiver.normal) > -peak.sin_half_angle
                && axis.dot(receiver.plane) > -peak.sin_half_angle
        };
        if lobe.is_none() && !peaks.iter().any(is_met) {
            return Ok(());
        }
        if let Some(lobe) = &lobe {
            let stakes = self.stakes()?;
            let kernel = LobeKernel { gatherer: self, lobe, place, stakes, shading };
            run_wide(kernel.gatherer.settings.simd, kernel)?;
        }
        for peak in peaks.iter().filter(|peak| is_met(peak)) {
            self.gather_peak(peak, place, receiver, lobe.as_ref(), shading)?;
        }
        Ok(())
    }

    /// Finds what shines brightly around a place.
    pub(crate) fn find_lamps(&mut self, place: &CutReceiver) -> Result<(), StoreError> {
        let usual = self.stakes()?.usual;
        self.lamps.clear(usual);
        if usual == 0.0 || !self.raster.shines() || !self.settings.importance.radiance {
            return Ok(());
        }
        let threshold = LampThreshold::new(&self.lamps);
        let mut visitor = LampVisitor { lamps: &mut self.lamps, normal: place.normal() };
        self.walker.look(place, &threshold, &mut visitor)
    }

    /// What importance weighs brightness by.
    pub(crate) fn stakes(&mut self) -> Result<Stakes<'a>, StoreError> {
        if let Some(known) = self.stakes {
            return Ok(known);
        }
        let sky = self.light.map(|light| &light.pyramid);
        let surfaces = self.walker.nodes.mean_brightness()?;
        let stakes = Stakes::new(self.settings.importance, surfaces, sky);
        self.stakes = Some(stakes);
        Ok(stakes)
    }
}

/// Solid angle of the smallest texel of a cube with one texel per face, in the limit of many: those in the corners, by (1 + 1 + 1)^(−3/2)
/// of 4 in the middle.
const SMALLEST_TEXEL_SR: f32 = 4.0 / 5.196_152;

/// Picks cuts of one octree, one after the other.
pub(crate) struct Walker<'a> {
    pub nodes: NodeReader<'a>,
    scratch: CutScratch,
    pub stats: CutStats,
}

impl Walker<'_> {
    #[inline(always)]
    pub fn pick<T: Threshold, V: CutVisitor>(
        &mut self,
        receiver: &CutReceiver,
        threshold: &T,
        visitor: &mut V,
    ) -> Result<(), StoreError> {
        let Self { nodes, scratch, stats } = self;
        pick_cut(nodes, receiver, threshold, visitor, scratch, stats)
    }

    /// The same for a walk whose nodes are none of the cut; its requests for pages count.
    fn look<T: Threshold, V: CutVisitor>(
        &mut self,
        receiver: &CutReceiver,
        threshold: &T,
        visitor: &mut V,
    ) -> Result<(), StoreError> {
        let (before, doubts) = (self.stats, self.scratch.doubts_own_surface);
        self.pick(receiver, threshold, visitor)?;
        self.stats = CutStats { levels: self.stats.levels, ..before };
        self.scratch.doubts_own_surface = doubts;
        Ok(())
    }
}

/// The cut drawn into the cube, compiled for every SIMD level.
struct CubeKernel<'k, 'a> {
    gatherer: &'k mut Gatherer<'a>,
    place: &'k CutReceiver,
    receiver: &'k Receiver,
    stakes: Stakes<'a>,
}

impl WideKernel for CubeKernel<'_, '_> {
    type Output = Result<(), StoreError>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let Self { gatherer, place, receiver, stakes } = self;
        let Gatherer { walker, settings, raster, lamps, .. } = gatherer;
        raster.clear_above::<L>(receiver.normal, receiver.plane);
        let edge = settings.raster_edge as f32;
        let threshold = CubeThreshold {
            user_sr: settings.solid_angle_sr,
            texel_sr: SMALLEST_TEXEL_SR / (edge * edge),
            terms: settings.importance,
            stakes,
        };
        let (plane, lanes) = (receiver.plane, PhantomData);
        let mut visitor = CubeVisitor::<L> { raster, lamps, plane, lanes };
        walker.pick(place, &threshold, &mut visitor)?;
        raster.resolve::<L>();
        Ok(())
    }
}

/// The cube over the environment's base, times the receiver's cosine.
struct ConvolutionKernel<'k, 'a> {
    gatherer: &'k Gatherer<'a>,
    receiver: &'k Receiver,
    shading: &'k mut Shading,
}

impl WideKernel for ConvolutionKernel<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { gatherer, receiver, shading } = self;
        let Gatherer { light, table, raster, .. } = gatherer;
        let base = light.map(|light| &light.base);
        let diffuse = convolve_diffuse(raster, table, base, [receiver.normal, receiver.plane]);
        if gatherer.settings.finds_backs {
            shading.backs = raster.backs();
        }
        shading.surface_irradiance = diffuse.surface_irradiance;
        shading.environment_irradiance = diffuse.environment_irradiance;
        shading.ambient_occlusion = diffuse.ambient_occlusion;
        shading.sky_visibility = diffuse.sky_visibility;
        shading.bent_normal = diffuse.bent_normal;
    }
}

/// What the last gather has found, and how that changes around its receiver.
struct RecordKernel<'k, 'a> {
    gatherer: &'k mut Gatherer<'a>,
    receiver: &'k Receiver,
    shading: &'k Shading,
    tolerance: &'k Tolerance,
}

impl WideKernel for RecordKernel<'_, '_> {
    type Output = Record;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let Self { gatherer, receiver, shading, tolerance } = self;
        let Gatherer { differentiator, raster, light, .. } = gatherer;
        let base = light.map(|light| &light.base);
        let normals = [receiver.normal, receiver.plane];
        let mut differential = Differential::default();
        if let Some(differentiator) = differentiator {
            differential = differentiator.differentiate::<L>(raster, base, normals);
        }
        Record::new(receiver, shading, &differential, differentiator.as_ref(), tolerance)
    }
}

/// Reflections but for the environment's peaks: a walk that draws what a lobe meets.
struct LobeKernel<'k, 'a> {
    gatherer: &'k mut Gatherer<'a>,
    lobe: &'k GgxLobe,
    place: &'k CutReceiver,
    stakes: Stakes<'a>,
    shading: &'k mut Shading,
}

impl WideKernel for LobeKernel<'_, '_> {
    type Output = Result<(), StoreError>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let Self { gatherer, lobe, place, stakes, shading } = self;
        let Gatherer { walker, settings, light, lobe: scratch, .. } = gatherer;
        scratch.start(lobe);
        let (count, texel_sr) = (scratch.count(), scratch.smallest_solid_angle());
        let axis = lobe.mirror();
        let mut visitor = LobeVisitor::<L> {
            count,
            raster: &mut scratch.raster,
            lobe,
            pattern: &scratch.pattern,
            above: &scratch.directions.above,
            axis,
            normal: place.normal(),
            plane: place.plane(),
            lanes: PhantomData,
        };
        let (user_sr, terms) = (settings.solid_angle_sr, settings.importance);
        let threshold = LobeThreshold { user_sr, texel_sr, lobe, axis, terms, stakes };
        walker.pick(place, &threshold, &mut visitor)?;
        (shading.reflected, shading.gloss_albedo) = scratch.resolve(*light);
        Ok(())
    }
}
