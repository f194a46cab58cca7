//! Shading of points that are in memory, for programs that hold them already.

use crate::budget::split::MemorySplit;
use crate::points::table_receivers::no_eye;
use crate::shade::nearness::FarReceivers;
use crate::shade::target::spread;
use crate::shade::{
    CHUNK_RECEIVERS, GlossSettings, Session, ShadeReport, ShadeSettings, chunk_bytes, gloss_toward,
    read_header,
};
use crate::{PbgiError, Progress};
use pbgi_gather::{Material, Receiver, Shading};
use pbgi_math::{DVec3, Vec3};
use pbgi_store::Octree;
use std::borrow::Cow;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Places in the world, in the octree's units.
#[derive(Clone, Copy, Debug)]
pub enum Positions<'a> {
    /// In single precision.
    F32(&'a [[f32; 3]]),
    /// In double precision, for coordinates far from 0.
    F64(&'a [[f64; 3]]),
}

impl Positions<'_> {
    fn len(&self) -> usize {
        match self {
            Self::F32(positions) => positions.len(),
            Self::F64(positions) => positions.len(),
        }
    }

    fn get(&self, index: usize) -> DVec3 {
        match self {
            Self::F32(positions) => DVec3::from_array(positions[index].map(f64::from)),
            Self::F64(positions) => DVec3::from_array(positions[index]),
        }
    }
}

/// Which points in memory to shade.
#[derive(Clone, Debug)]
pub struct ReceiversRequest<'a> {
    /// The octree file that lights and blocks.
    pub octree: &'a Path,
    /// Where to gather light.
    pub positions: Positions<'a>,
    /// Normals there, of any length above 0; as many as positions.
    pub normals: &'a [[f32; 3]],
    /// Whether a point whose normal is 0, or whose position or normal is not finite, is left out as one without a surface. Else it is an
    /// error.
    pub skip_empty: bool,
    /// Place of the eye that glossy reflections are seen from, in the world. Materials are those of [`Material::default`]
    /// but for the numbers in [`ShadeSettings::gloss`].
    pub eye: Option<DVec3>,
    /// Quality, light and resources.
    pub settings: ShadeSettings,
}

/// Shades points that are in memory and hands each result with the point's index to `take`, in the order of the points, on
/// the calling thread. Points left out ([`ReceiversRequest::skip_empty`]) are not handed over; [`ShadeReport::empty_pixels`] counts them.
///
/// The limit [`ShadeSettings::memory_bytes`] is that of the process, so that the caller's points count.
/// Warnings are in the report only.
///
/// # Errors
///
/// If the octree or the environment cannot be read, or is damaged, or a setting is out of range; if there are not as many normals as
/// positions, or one is no normal; on cancellation.
///
/// ```no_run
/// use pbgi::{Positions, Progress, ReceiversRequest, ShadeSettings};
/// let request = ReceiversRequest {
///     octree: "room.pbgi".as_ref(),
///     positions: Positions::F32(&[[0.0, 1.0, 0.0]]),
///     normals: &[[0.0, 1.0, 0.0]],
///     skip_empty: false,
///     eye: None,
///     settings: ShadeSettings::default(),
/// };
/// let mut open = [0.0];
/// let take = |index: usize, shading: &pbgi::Shading| open[index] = shading.ambient_occlusion;
/// pbgi::shade_receivers(&request, take, &Progress::silent(), &false.into())?;
/// # Ok::<(), pbgi::PbgiError>(())
/// ```
pub fn shade_receivers(
    request: &ReceiversRequest<'_>,
    mut take: impl FnMut(usize, &Shading),
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<ShadeReport, PbgiError> {
    let start = Instant::now();
    let settings = &request.settings;
    settings.validate()?;
    request.check()?;
    let header = read_header(request.octree)?;
    let environment = settings.load_environment(&header)?;
    let points = Points::new(request, header.origin);
    let bytes = chunk_bytes(size_of::<u32>(), settings);
    let split = MemorySplit::measure(settings).grant(bytes, bytes)?;
    let mut session = Session::open(request.octree, settings, environment, split, 0, cancel)?;
    let extra =
        u32::from(settings.target_error.is_some()) + u32::from(settings.check_receivers > 0);
    progress.set_phase_count(1 + extra);
    let far = points.warn_of_far(&session.octree)?;
    session.warnings.extend(far);
    if session.wants_calibration() {
        let sample = spread(points.len()).map(|index| points.receiver(index));
        let sample = sample.filter_map(Result::transpose).collect::<Result<Vec<_>, _>>()?;
        session.calibrate(&sample, progress)?;
    }
    let phase = progress.start_phase("shade", "receivers", Some(points.len() as u64));
    let mut shaded = 0;
    session.stream(
        &|done| phase.set_done(done),
        |feed| {
            (0..points.len()).step_by(CHUNK_RECEIVERS).try_for_each(|first| {
                let (mut receivers, mut offsets) = (Vec::new(), Vec::new());
                for index in first..(first + CHUNK_RECEIVERS).min(points.len()) {
                    if let Some(receiver) = points.receiver(index)? {
                        receivers.push(receiver);
                        offsets.push((index - first) as u32);
                    }
                }
                feed.push(Cow::Owned(receivers), (first, offsets))
            })
        },
        |chunk| {
            let (first, offsets) = &chunk.attached;
            for (offset, shading) in offsets.iter().zip(&chunk.shadings) {
                take(first + *offset as usize, shading);
            }
            shaded += offsets.len();
            Ok(())
        },
    )?;
    drop(phase);
    let mut report = session.finish(progress)?;
    report.empty_pixels = (points.len() - shaded) as u64;
    report.total_seconds = start.elapsed().as_secs_f64();
    Ok(report)
}

impl ReceiversRequest<'_> {
    fn check(&self) -> Result<(), PbgiError> {
        let (positions, normals) = (self.positions.len(), self.normals.len());
        if positions != normals {
            return Err(PbgiError::usage(format!(
                "there are {positions} positions and {normals} normals; expected one normal for each position"
            )));
        }
        if self.settings.gloss.is_some() && self.eye.is_none() {
            return Err(no_eye());
        }
        Ok(())
    }
}

/// Points that become receivers.
struct Points<'a> {
    positions: Positions<'a>,
    normals: &'a [[f32; 3]],
    skip_empty: bool,
    origin: DVec3,
    gloss: Option<GlossSettings>,
    /// Relative to the octree's origin.
    eye: Vec3,
}

impl<'a> Points<'a> {
    fn new(request: &ReceiversRequest<'a>, origin: DVec3) -> Self {
        Self {
            positions: request.positions,
            normals: request.normals,
            skip_empty: request.skip_empty,
            origin,
            gloss: request.settings.gloss,
            eye: request.eye.map_or(Vec3::ZERO, |eye| (eye - origin).as_vec3()),
        }
    }

    fn len(&self) -> usize {
        self.normals.len()
    }

    /// What to say where the points are not where the surfels are.
    fn warn_of_far(&self, octree: &Octree) -> Result<Option<String>, PbgiError> {
        let places = spread(self.len()).map(|index| self.positions.get(index));
        let places: Vec<DVec3> = places.filter(|place| place.is_finite()).collect();
        FarReceivers::warn_of_points(octree, "the points given", &places)
    }

    /// The receiver of a point, none where it is left out.
    fn receiver(&self, index: usize) -> Result<Option<Receiver>, PbgiError> {
        let world = self.positions.get(index);
        let position = (world - self.origin).as_vec3();
        let normal = DVec3::from_array(self.normals[index].map(f64::from)).normalize();
        if position.is_finite() && normal.is_finite() {
            let gloss = gloss_toward(self.gloss, Material::default(), position, self.eye);
            return Ok(Some(Receiver { gloss, ..Receiver::diffuse(position, normal.as_vec3()) }));
        }
        if self.skip_empty {
            return Ok(None);
        }
        let [x, y, z] = self.normals[index];
        Err(PbgiError::input(format!(
            "point {index} has position {world} and normal [{x}, {y}, {z}]; expected finite numbers and a normal longer than 0"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BakeRequest, EnvironmentSpec, LightSource, Sampling, bake};
    use std::f32::consts::PI;
    use std::path::PathBuf;

    /// The Cornell box, 2000 surfels.
    fn octree(folder: &Path) -> PathBuf {
        let output = folder.join("box.pbgi");
        let request = BakeRequest {
            inputs: vec!["demo:cornell".into()],
            output: output.clone(),
            sampling: Sampling::Surfels(2000),
            ..BakeRequest::default()
        };
        bake(&request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
        output
    }

    fn request<'a>(
        octree: &'a Path,
        positions: Positions<'a>,
        normals: &'a [[f32; 3]],
    ) -> ReceiversRequest<'a> {
        let source = LightSource::Uniform([1.0, 2.0, 3.0]);
        let environment = Some(EnvironmentSpec { source, rotate_degrees: 0.0, scale: 1.0 });
        let settings = ShadeSettings { environment, ..ShadeSettings::default() };
        ReceiversRequest { octree, positions, normals, skip_empty: false, eye: None, settings }
    }

    fn shade(request: &ReceiversRequest<'_>) -> Result<(Vec<(usize, Shading)>, u64), PbgiError> {
        let mut results = Vec::new();
        let take = |index: usize, shading: &Shading| results.push((index, *shading));
        let cancel = AtomicBool::new(false);
        let report = shade_receivers(request, take, &Progress::silent(), &cancel)?;
        Ok((results, report.empty_pixels))
    }

    /// Far above the box, looking up, all is sky: E = πL. Normals may have any length, positions either precision.
    #[test]
    fn open_points_receive_the_whole_sky() {
        let folder = tempfile::tempdir().unwrap();
        let octree = octree(folder.path());
        let normals = [[0.0, 4.0, 0.0], [0.0, 1.0, 0.0]];
        let (single, double) = ([[0.0, 100.0, 0.0f32]; 2], [[0.0, 100.0, 0.0f64]; 2]);
        for positions in [Positions::F32(&single), Positions::F64(&double)] {
            let (results, _) = shade(&request(&octree, positions, &normals)).unwrap();
            assert_eq!(results.iter().map(|(index, _)| *index).collect::<Vec<_>>(), [0, 1]);
            for (_, shading) in results {
                for (found, radiance) in shading.irradiance().into_iter().zip([1.0, 2.0, 3.0]) {
                    assert!((found - PI * radiance).abs() < 1e-3 * PI * radiance, "{found}");
                }
                assert!((shading.ambient_occlusion - 1.0).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn points_without_a_normal_are_named_or_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let octree = octree(folder.path());
        let normals = [[0.0, 1.0, 0.0], [0.0; 3], [f32::NAN, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let positions = [[0.0, 100.0, 0.0f32]; 4];
        let mut request = request(&octree, Positions::F32(&positions), &normals);
        let error = shade(&request).unwrap_err();
        assert!(error.to_string().starts_with("point 1 has"), "{error}");
        assert_eq!(error.exit_code(), 3);
        request.skip_empty = true;
        let (results, empty) = shade(&request).unwrap();
        assert_eq!(results.iter().map(|(index, _)| *index).collect::<Vec<_>>(), [0, 3]);
        assert_eq!(empty, 2);
    }

    #[test]
    fn each_position_needs_a_normal() {
        let positions = [[0.0; 3]; 2];
        let request = request("none.pbgi".as_ref(), Positions::F64(&positions), &[]);
        let error = shade(&request).unwrap_err();
        assert!(error.to_string().contains("2 positions and 0 normals"), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}
