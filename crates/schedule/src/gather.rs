//! One receiver: its cut drawn into its raster, under the environment, times its BRDF.

use crate::light::{PreparedLight, PreparedPeak};
use crate::receiver::{Receiver, Shading};
use pbgi_brdf::{ConvolutionTable, convolve_diffuse};
use pbgi_cut::{
    Cluster, CosineThreshold, CutReceiver, CutScratch, CutStats, CutVisitor, Piece, SurfelSeen,
    UniformThreshold, pick_cut,
};
use pbgi_format::LeafSurfel;
use pbgi_math::{Aabb, Vec3};
use pbgi_raster::{
    CubeRaster, CubeRasterTable, Disk, Footprint, Ink, Lanes, SHAPES_MAX, Section, SimdLevel, Tile,
    Veil, WideKernel, Window, WindowRaster, run_wide,
};
use pbgi_store::{Reader, StoreError};
use std::f32::consts::FRAC_1_PI;
use std::marker::PhantomData;

/// Which light a gather looks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GatherParts {
    /// All of it.
    #[default]
    All,
    /// What the cube raster holds: surfaces and the environment without its peaks.
    Broad,
    /// The environment's peaks alone: sun and lamps, with sharp shadows.
    Peaks,
}

/// Quality of a gather.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatherSettings {
    /// Largest solid angle of a node that is taken as one, in steradians, if it lies along the normal and is no plane (see
    /// [`pbgi_cut::CosineThreshold`]); 0 takes every surfel.
    pub solid_angle_sr: f32,
    /// Texels along a face of the cube raster, 1 to 64.
    pub raster_edge: usize,
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
            solid_angle_sr: 0.08,
            raster_edge: 8,
            bias: 0.4,
            parts: GatherParts::All,
            up: Vec3::Y,
            simd: SimdLevel::detect(),
        }
    }
}

/// Disks that lie along the receiver's own surface are not hit nearer than this many radii: the
/// neighbors of a point on a curved surface stand above its tangent plane, though the surface does not.
const OWN_SURFACE_RADII: f32 = 2.0;

/// Cosine between normals above which a near disk counts as the receiver's own surface.
const OWN_SURFACE_COSINE: f32 = 0.7;

/// Share of a window's texel that a node may span to be drawn as one.
const WINDOW_TEXEL_SHARE: f32 = 0.5;

/// Everything one thread needs to gather for receivers, one after the other.
pub struct Gatherer<'a> {
    reader: Reader<'a>,
    settings: GatherSettings,
    light: Option<&'a PreparedLight>,
    table: ConvolutionTable,
    raster: CubeRaster,
    window_raster: WindowRaster,
    scratch: CutScratch,
    stats: CutStats,
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
            reader,
            settings: *settings,
            light,
            raster: CubeRaster::new(&table, shines),
            table: ConvolutionTable::new(&table),
            window_raster: WindowRaster::default(),
            scratch: CutScratch::default(),
            stats: CutStats::default(),
        }
    }

    /// Counts of all gathers so far.
    #[must_use]
    pub fn stats(&self) -> CutStats {
        self.stats
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
        let before = self.stats.cut_size();
        let cut_receiver = CutReceiver {
            position: receiver.position,
            normal: receiver.normal,
            bias: 0.0,
            surfel_bias: self.settings.bias,
        };
        let mut shading = Shading::default();
        if self.settings.parts != GatherParts::Peaks {
            shading = self.gather_broad::<L>(&cut_receiver)?;
        }
        if self.settings.parts != GatherParts::Broad {
            for peak in self.light.map_or(&[][..], |l| &l.peaks) {
                let irradiance = self.gather_peak::<L>(peak, &cut_receiver)?;
                for (sum, part) in shading.environment_irradiance.iter_mut().zip(irradiance) {
                    *sum += part;
                }
            }
        }
        shading.cut_size = (self.stats.cut_size() - before) as u32;
        Ok(shading)
    }

    /// Everything but peaks: the cut drawn into the cube, over the environment's base.
    #[inline(always)]
    fn gather_broad<L: Lanes>(&mut self, receiver: &CutReceiver) -> Result<Shading, StoreError> {
        self.raster.clear::<L>(receiver.normal);
        let threshold = CosineThreshold::new(self.settings.solid_angle_sr, receiver.normal);
        let mut visitor = CubeVisitor::<L> {
            raster: &mut self.raster,
            footprint: Footprint::default(),
            normal: receiver.normal,
            lanes: PhantomData,
        };
        pick_cut(
            &mut self.reader,
            receiver,
            &threshold,
            &mut visitor,
            &mut self.scratch,
            &mut self.stats,
        )?;
        let base = self.light.map(|l| &l.base);
        let diffuse =
            convolve_diffuse(&self.raster, &self.table, base, receiver.normal, self.settings.up);
        Ok(Shading {
            surface_irradiance: diffuse.surface_irradiance,
            environment_irradiance: diffuse.environment_irradiance,
            ambient_occlusion: diffuse.ambient_occlusion,
            sky_visibility: diffuse.sky_visibility,
            bent_normal: diffuse.bent_normal,
            cut_size: 0,
        })
    }

    /// Irradiance from one peak: a narrow walk that draws what blocks its window.
    #[inline(always)]
    fn gather_peak<L: Lanes>(
        &mut self,
        peak: &PreparedPeak,
        receiver: &CutReceiver,
    ) -> Result<[f32; 3], StoreError> {
        let axis = peak.window.frame().normal;
        if axis.dot(receiver.normal) <= -peak.sin_half_angle {
            return Ok([0.0; 3]);
        }
        self.window_raster.clear(&peak.window);
        let sine = 0.5 * WINDOW_TEXEL_SHARE * peak.texel_width;
        let threshold = UniformThreshold::from_sine(sine);
        let mut visitor = WindowVisitor::<L> {
            raster: &mut self.window_raster,
            window: &peak.window,
            normal: receiver.normal,
            lanes: PhantomData,
        };
        pick_cut(
            &mut self.reader,
            receiver,
            &threshold,
            &mut visitor,
            &mut self.scratch,
            &mut self.stats,
        )?;
        let mut irradiance = [0.0; 3];
        for (index, (direction, light)) in peak.texels.iter().enumerate() {
            let open = if self.window_raster.is_open(index) { 1.0 } else { 0.0 };
            let weight = open * direction.dot(receiver.normal).max(0.0);
            for (sum, l) in irradiance.iter_mut().zip(light) {
                *sum += weight * l;
            }
        }
        Ok(irradiance)
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

/// Least distance at which a disk is hit, so that a surface does not shadow itself.
#[inline(always)]
fn least_distance(surfel: &LeafSurfel, normal: Vec3) -> f32 {
    let own = !surfel.isotropic && surfel.normal.dot(normal) > OWN_SURFACE_COSINE;
    if own { OWN_SURFACE_RADII * surfel.radius } else { 0.0 }
}

/// Radius of a solid surfel's disk over that of the disk of its area: covers a square lattice. Surfels at the edges of boxes and
/// boards know their rectangle and are not drawn as disks.
const SOLID_RESERVE: f32 = 1.25;

/// The same for sheets, whose edges are many: covering disks reach out of every edge of a leaf by a fifth of a
/// micropolygon, which blocks a quarter too much in foliage. At 1.1 a fortieth of a square lattice stays open.
const SHEET_RESERVE: f32 = 1.1;

/// Covering radius over area-true radius from which on a surfel is a needle: its disk keeps the covering radius and becomes
/// transparent instead.
const NEEDLE_RATIO: f32 = 2.2;

/// The same for the edges of a surfel's rectangle: rounding and the codes' errors leave no gap between neighbors.
const TILE_RESERVE: f32 = 1.02;

/// Share of a piece's extent by which planes of neighbors on the same surface may lie before its own and not hide it.
const NEIGHBOR_DEPTH: f32 = 0.15;

/// How much nearer, as a share of the distance, neighbors may be: of a piece with this extent over its distance, seen at this
/// cosine. Where the plane is seen at a grazing angle, a small step along its normal is a long one along the line of sight.
#[inline(always)]
fn neighbor_tolerance(spread: f32, cosine: f32) -> f32 {
    spread * if cosine > NEIGHBOR_DEPTH { NEIGHBOR_DEPTH / cosine } else { 1.0 }
}

/// Area that a surfel shows along its normal; an isotropic one half of its own in every direction.
#[inline(always)]
fn shown_area(surfel: &LeafSurfel) -> f32 {
    if surfel.isotropic { 0.5 * surfel.area } else { surfel.area }
}

/// The disk a surfel is drawn as, and its opacity. An isotropic one turns to the receiver.
#[inline(always)]
fn surfel_disk(seen: &SurfelSeen, receiver_normal: Vec3) -> (Disk, Vec3, f32) {
    let surfel = &seen.surfel;
    let area_true = (shown_area(surfel) * FRAC_1_PI).sqrt();
    let is_sheet = surfel.front_only || surfel.isotropic;
    let reserve = if is_sheet { SHEET_RESERVE } else { SOLID_RESERVE };
    let (mut radius, mut opacity) = (surfel.radius.min(reserve * area_true), 1.0);
    if surfel.radius > NEEDLE_RATIO * area_true {
        radius = surfel.radius;
        opacity = (SHEET_RESERVE * area_true / radius).powi(2);
    }
    let normal = if surfel.isotropic {
        surfel.center * (-1.0 / seen.distance2.sqrt())
    } else {
        surfel.normal
    };
    let inverse = normal * (1.0 / normal.dot(surfel.center));
    let distance_min = least_distance(surfel, receiver_normal);
    (Disk { inverse, center: surfel.center, radius, distance_min }, normal, opacity)
}

/// The rectangle a surfel is drawn as, if it knows one.
#[inline(always)]
fn surfel_tile(seen: &SurfelSeen, receiver_normal: Vec3) -> Option<Tile> {
    let surfel = &seen.surfel;
    surfel.tile.is_known().then(|| Tile {
        inverse: surfel.normal * (1.0 / surfel.normal.dot(surfel.center)),
        center: surfel.center,
        edges: surfel.tile.edges(surfel.normal),
        half: surfel.half_edges().map(|half| half * TILE_RESERVE),
        distance_min: least_distance(surfel, receiver_normal),
    })
}

/// Whether a surfel covers anything: neither seen along its edge nor from behind where only its front is.
#[inline(always)]
fn blocks(seen: &SurfelSeen) -> bool {
    let surfel = &seen.surfel;
    let height = surfel.normal.dot(surfel.center);
    surfel.isotropic || height < 0.0 || (height > 0.0 && !surfel.front_only)
}

/// How a surfel, drawn with this normal, opacity and extent, covers and shines.
#[inline(always)]
fn surfel_ink(seen: &SurfelSeen, normal: Vec3, opacity: f32, extent: f32) -> Ink {
    let surfel = &seen.surfel;
    let distance = seen.distance2.sqrt();
    let cosine = normal.dot(surfel.center) * (-1.0 / distance);
    Ink {
        veil: Veil { start: 0.0, end: opacity, seed: seen.seed },
        solid_angle: shown_area(surfel) * cosine.abs() / seen.distance2,
        radiance: if cosine > 0.0 { surfel.radiance } else { [0.0; 3] },
        tolerance: neighbor_tolerance(extent / distance, cosine.abs()),
    }
}

/// Where a piece of a cluster lies, and which share of it is there.
#[inline(always)]
fn piece_shape(cluster: &Cluster, piece: &Piece) -> (Section, Veil) {
    let section = Section { inverse: piece.inverse, low: cluster.low, high: cluster.high };
    (section, Veil { start: piece.start, end: piece.end, seed: cluster.seed })
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
            let ink = Ink {
                veil,
                solid_angle: piece.solid_angle,
                radiance: piece.radiance,
                tolerance: neighbor_tolerance(cluster.spread, piece.cosine),
            };
            *shape = (section, ink);
        }
        let toward = cluster.low + cluster.high;
        self.raster.draw::<L, _>(&shapes[..pieces.len()], &self.footprint, toward);
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen) {
        if !blocks(seen) {
            return;
        }
        if let Some(tile) = surfel_tile(seen, self.normal) {
            let ink = surfel_ink(seen, seen.surfel.normal, 1.0, tile.half[0]);
            let bounds = tile.bounds();
            let footprint = self.raster.footprint(bounds.min, bounds.max);
            self.raster.draw::<L, _>(&[(tile, ink)], &footprint, tile.center);
            return;
        }
        let (disk, normal, opacity) = surfel_disk(seen, self.normal);
        let ink = surfel_ink(seen, normal, opacity, disk.radius);
        let bounds = Aabb::from_disk(disk.center, normal, disk.radius);
        let footprint = self.raster.footprint(bounds.min, bounds.max);
        self.raster.draw::<L, _>(&[(disk, ink)], &footprint, disk.center);
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
        if !blocks(seen) {
            return;
        }
        if let Some(tile) = surfel_tile(seen, self.normal) {
            let bounds = tile.bounds();
            if self.window.is_met_by(bounds.min, bounds.max) {
                self.raster.draw::<L, _>(self.window, &tile, &Veil::OPAQUE);
            }
            return;
        }
        let (disk, _, opacity) = surfel_disk(seen, self.normal);
        let bounds = seen.surfel.radius;
        if self.window.is_met_by(disk.center - bounds, disk.center + bounds) {
            let veil = Veil { start: 0.0, end: opacity, seed: seen.seed };
            self.raster.draw::<L, _>(self.window, &disk, &veil);
        }
    }
}
