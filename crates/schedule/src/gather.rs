//! One receiver: its cut drawn into its raster, under the environment, times its BRDF.

use crate::light::{PreparedLight, PreparedPeak};
use crate::receiver::{Receiver, Shading};
use pbgi_brdf::{ConvolutionTable, convolve_diffuse};
use pbgi_cut::{
    Cluster, CutReceiver, CutScratch, CutStats, CutVisitor, SurfelSeen, Threshold,
    UniformThreshold, pick_cut,
};
use pbgi_format::LeafSurfel;
use pbgi_math::{Aabb, Vec3, box_silhouette};
use pbgi_raster::{
    CubeRaster, CubeRasterTable, Disk, DiskInk, SimdLevel, Splat, Window, WindowRaster, run_wide,
};
use pbgi_store::{Reader, StoreError};
use std::f32::consts::{FRAC_1_PI, PI};

/// Quality of a gather.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatherSettings {
    /// Largest solid angle of a node that is taken as one, in steradians; 0 takes every surfel.
    pub solid_angle_sr: f32,
    /// Texels along a face of the cube raster, 1 to 64.
    pub raster_edge: usize,
    /// Surfels nearer than this many of their radii are intersected texel by texel.
    pub near_radii: f32,
    /// Surfels that rise less than this share of their radius above the receiver's tangent plane
    /// are its own surface.
    pub bias: f32,
    /// Unit direction of the sky, for `sky_visibility`.
    pub up: Vec3,
    /// The instructions to use.
    pub simd: SimdLevel,
}

impl Default for GatherSettings {
    fn default() -> Self {
        Self {
            solid_angle_sr: 0.03,
            raster_edge: 8,
            near_radii: 5.0,
            bias: 0.4,
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
    threshold: UniformThreshold,
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
            threshold: UniformThreshold::new(settings.solid_angle_sr),
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
        run_wide(
            self.settings.simd,
            #[inline(always)]
            || self.gather_kernel(receiver),
        )
    }

    #[inline(always)]
    fn gather_kernel(&mut self, receiver: &Receiver) -> Result<Shading, StoreError> {
        let before = self.stats.cut_size();
        let cut_receiver = CutReceiver {
            position: receiver.position,
            normal: receiver.normal,
            bias: 0.0,
            surfel_bias: self.settings.bias,
        };
        self.raster.clear(receiver.normal);
        let mut visitor = CubeVisitor {
            raster: &mut self.raster,
            normal: receiver.normal,
            near2: self.settings.near_radii * self.settings.near_radii,
        };
        pick_cut(
            &mut self.reader,
            &cut_receiver,
            &self.threshold,
            &mut visitor,
            &mut self.scratch,
            &mut self.stats,
        )?;
        let base = self.light.map(|l| &l.base);
        let diffuse =
            convolve_diffuse(&self.raster, &self.table, base, receiver.normal, self.settings.up);
        let mut environment_irradiance = diffuse.environment_irradiance;
        for peak in self.light.map_or(&[][..], |l| &l.peaks) {
            let irradiance = self.gather_peak(peak, &cut_receiver)?;
            for (sum, part) in environment_irradiance.iter_mut().zip(irradiance) {
                *sum += part;
            }
        }
        Ok(Shading {
            surface_irradiance: diffuse.surface_irradiance,
            environment_irradiance,
            ambient_occlusion: diffuse.ambient_occlusion,
            sky_visibility: diffuse.sky_visibility,
            bent_normal: diffuse.bent_normal,
            cut_size: (self.stats.cut_size() - before) as u32,
        })
    }

    /// Irradiance from one peak: a narrow walk that draws what blocks its window.
    #[inline(always)]
    fn gather_peak(
        &mut self,
        peak: &PreparedPeak,
        receiver: &CutReceiver,
    ) -> Result<[f32; 3], StoreError> {
        let axis = peak.window.frame.normal;
        if axis.dot(receiver.normal) <= -peak.sin_half_angle {
            return Ok([0.0; 3]);
        }
        self.window_raster.clear(&peak.window);
        let texel = 2.0 * peak.window.half_width / peak.window.n as f32;
        let threshold = WindowThreshold { sin2_max: (0.5 * WINDOW_TEXEL_SHARE * texel).powi(2) };
        let mut visitor = WindowVisitor {
            raster: &mut self.window_raster,
            window: &peak.window,
            normal: receiver.normal,
            texel2: texel * texel,
        };
        pick_cut(
            &mut self.reader,
            receiver,
            &threshold,
            &mut visitor,
            &mut self.scratch,
            &mut self.stats,
        )?;
        let n = peak.window.n;
        let mut irradiance = [0.0; 3];
        for (i, (direction, light)) in peak.texels.iter().enumerate() {
            let open = self.window_raster.openness(i / n, i % n);
            let weight = open * direction.dot(receiver.normal).max(0.0);
            for (sum, l) in irradiance.iter_mut().zip(light) {
                *sum += weight * l;
            }
        }
        Ok(irradiance)
    }
}

/// Nodes as fine as a window's texels, whatever their direction: only what meets the window is
/// visited.
struct WindowThreshold {
    sin2_max: f32,
}

impl Threshold for WindowThreshold {
    #[inline(always)]
    fn sin2_max(&self, _: Vec3, _: f32, _: f32) -> f32 {
        self.sin2_max
    }
}

/// Least distance at which a disk is hit, so that a surface does not shadow itself.
#[inline(always)]
fn least_distance(surfel: &LeafSurfel, normal: Vec3) -> f32 {
    let own = !surfel.isotropic && surfel.normal.dot(normal) > OWN_SURFACE_COSINE;
    if own { OWN_SURFACE_RADII * surfel.radius } else { 0.0 }
}

/// A surfel as the cluster it is by itself: box of its area-true square, exact projected area.
#[inline(always)]
fn surfel_cluster(seen: &SurfelSeen) -> Cluster {
    let surfel = &seen.surfel;
    let distance = seen.distance2.sqrt();
    let shown_area = if surfel.isotropic { 0.5 * surfel.area } else { surfel.area };
    let half_edge = 0.5 * shown_area.sqrt();
    let toward_receiver = surfel.center * (-1.0 / distance);
    let (half, shown) = if surfel.isotropic {
        (Vec3::splat(half_edge), shown_area)
    } else {
        let half = Aabb::from_disk(Vec3::ZERO, surfel.normal, half_edge).max;
        (half, shown_area * surfel.normal.dot(toward_receiver))
    };
    let silhouette = box_silhouette(half, toward_receiver);
    let opacity = (shown.abs() / silhouette.max(1e-30)).min(1.0);
    Cluster {
        low: surfel.center - half,
        high: surfel.center + half,
        silhouette,
        front: if shown > 0.0 { opacity } else { 0.0 },
        back: if shown > 0.0 || surfel.front_only { 0.0 } else { opacity },
        solid: !surfel.front_only && !surfel.isotropic,
        radiance: surfel.radiance,
        near: distance - surfel.radius,
        far: distance + surfel.radius,
    }
}

/// Radius of a near disk over that of the disk of the surfel's area.
///
/// Disks of the true area leave a tenth of a square lattice open, disks that cover it (1.25) reach out of every edge
/// of leaves and boards by a fifth of a micropolygon, which blocks a quarter too much in foliage. At 1.1 holes are below what
/// counts as a whole layer of solid pieces.
const DISK_RESERVE: f32 = 1.1;

/// Covering radius over area-true radius from which on a surfel is a needle: its disk keeps the covering radius and becomes
/// transparent instead.
const NEEDLE_RATIO: f32 = 2.2;

/// The disk a near surfel is drawn as and its opacity. An isotropic one turns to the receiver.
#[inline(always)]
fn near_disk(seen: &SurfelSeen) -> (Disk, f32) {
    let surfel = &seen.surfel;
    let shown = if surfel.isotropic { 0.5 * surfel.area } else { surfel.area };
    let area_true = (shown * FRAC_1_PI).sqrt();
    let (mut radius, mut opacity) = (surfel.radius.min(DISK_RESERVE * area_true), 1.0);
    if surfel.radius > NEEDLE_RATIO * area_true {
        radius = surfel.radius;
        opacity = (DISK_RESERVE * area_true / radius).powi(2);
    }
    let normal = if surfel.isotropic {
        surfel.center * (-1.0 / seen.distance2.sqrt())
    } else {
        surfel.normal
    };
    (Disk { center: surfel.center, normal, radius }, opacity)
}

/// Draws the cut into the cube.
struct CubeVisitor<'a> {
    raster: &'a mut CubeRaster,
    normal: Vec3,
    near2: f32,
}

impl CutVisitor for CubeVisitor<'_> {
    #[inline(always)]
    fn is_open(&self, low: Vec3, high: Vec3) -> bool {
        self.raster.is_box_open(low, high)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        let splat = Splat {
            front: cluster.front,
            back: cluster.back,
            solid: cluster.solid,
            radiance: cluster.radiance,
            near: if cluster.solid { cluster.near } else { 0.5 * (cluster.near + cluster.far) },
            far: cluster.far,
        };
        self.raster.draw_box(cluster.low, cluster.high, &splat);
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen) {
        let surfel = &seen.surfel;
        if seen.distance2 >= self.near2 * surfel.radius * surfel.radius {
            self.take_cluster(&surfel_cluster(seen));
            return;
        }
        let distance_min = least_distance(surfel, self.normal);
        let (disk, opacity) = near_disk(seen);
        let ink = DiskInk {
            opacity,
            front_only: surfel.front_only,
            solid: !surfel.front_only && !surfel.isotropic,
            radiance: surfel.radiance,
        };
        self.raster.draw_disk(&disk, &ink, distance_min);
    }
}

/// Draws what blocks a window.
struct WindowVisitor<'a> {
    raster: &'a mut WindowRaster,
    window: &'a Window,
    normal: Vec3,
    /// Squared width of a texel, as the tangent of an angle.
    texel2: f32,
}

impl CutVisitor for WindowVisitor<'_> {
    #[inline(always)]
    fn is_open(&self, low: Vec3, high: Vec3) -> bool {
        self.raster.is_box_open(self.window, low, high)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        let Cluster { low, high, silhouette, front, back, .. } = *cluster;
        self.raster.draw_box(self.window, low, high, silhouette, (front, back));
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen) {
        let surfel = &seen.surfel;
        if PI * surfel.radius * surfel.radius < self.texel2 * seen.distance2 {
            self.take_cluster(&surfel_cluster(seen));
            return;
        }
        let distance_min = least_distance(surfel, self.normal);
        let (disk, opacity) = near_disk(seen);
        self.raster.draw_disk(self.window, &disk, opacity, surfel.front_only, distance_min);
    }
}
