//! What is read while light is gathered: octrees, G-buffers and cameras.

use crate::mend::mend_checksums;
use crate::targets::{check_error, with_files};
use pbgi::{
    Aov, AovNames, BakeRequest, CameraChoice, FrameRequest, GBufferRequest, GBufferSpace,
    PbgiError, Positions, Progress, ReceiversRequest, Sampling, ShadeSettings, Shading,
};
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

/// Bytes granted beyond what the process holds.
const GRANTED: u64 = 64 << 20;

/// An octree file of a few hundred surfels.
pub fn small_octree() -> &'static [u8] {
    static OCTREE: OnceLock<Vec<u8>> = OnceLock::new();
    OCTREE.get_or_init(|| bake_octree(300, false).expect("a procedural scene can be baked"))
}

/// An octree file of about so many surfels, its pages compressed or not.
///
/// # Errors
///
/// If no files can be made.
pub fn bake_octree(surfels: u64, compress: bool) -> Result<Vec<u8>, PbgiError> {
    let folder = tempfile::tempdir().map_err(|e| PbgiError::input(e.to_string()))?;
    let output = folder.path().join("a.pbgi");
    let request = BakeRequest {
        inputs: vec!["demo:room".into()],
        output: output.clone(),
        sampling: Sampling::Surfels(surfels),
        memory_limit: 1 << 30,
        threads: 1,
        compress,
        leaf_surfels_max: 8,
        page_bytes: 4096,
        ..BakeRequest::default()
    };
    pbgi::bake(&request, &Progress::silent(), &AtomicBool::new(false))?;
    std::fs::read(output).map_err(|e| PbgiError::input(e.to_string()))
}

fn settings() -> ShadeSettings {
    ShadeSettings {
        raster_edge: 4,
        memory_bytes: pbgi::resident_bytes().unwrap_or(0) + GRANTED,
        ..ShadeSettings::default()
    }
}

/// Shades a few receivers by an octree file with mended checksums.
pub fn shade_octree(data: &[u8]) {
    with_files(&[("a.pbgi", &mend_checksums(data))], |folder| {
        let octree = &folder.join("a.pbgi");
        for (solid_angle_sr, skip_damaged) in [(0.03, false), (0.0, true)] {
            let mut settings = ShadeSettings { solid_angle_sr, ..settings() };
            settings.io.skip_damaged = skip_damaged;
            let request = ReceiversRequest {
                octree,
                positions: Positions::F32(&[[0.0; 3], [0.5, 1.0, -0.5], [30.0, 2.0, 7.0]]),
                normals: &[[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.3]],
                skip_empty: false,
                eye: None,
                settings,
            };
            let check = |_, shading: &Shading| {
                assert!((0.0..=1.0).contains(&shading.ambient_occlusion), "{shading:?}");
                assert!(shading.irradiance().iter().all(|v| v.is_finite()), "{shading:?}");
            };
            let shaded = pbgi::shade_receivers(
                &request,
                check,
                &Progress::silent(),
                &AtomicBool::new(false),
            );
            // A point may be too far from the file's origin to be one.
            if let Err(error) = shaded
                && !error.to_string().starts_with("point ")
            {
                check_error(octree, &error);
            }
        }
    });
}

/// Reads a G-buffer, and the camera of its attributes; nothing is shaded.
pub fn read_gbuffer(data: &[u8]) {
    with_files(&[("a.exr", data), ("a.pbgi", small_octree())], |folder| {
        for space in [GBufferSpace::World, GBufferSpace::Camera] {
            shade_gbuffer(folder, space, CameraChoice::Default);
        }
        shade_gbuffer(folder, GBufferSpace::World, camera_of(&folder.join("a.exr")));
    });
}

fn camera_of(path: &Path) -> CameraChoice {
    CameraChoice::File { path: path.to_owned(), fov_degrees: None }
}

fn shade_gbuffer(folder: &Path, space: GBufferSpace, camera: CameraChoice) {
    let request = GBufferRequest {
        octree: &folder.join("a.pbgi"),
        gbuffer: &folder.join("a.exr"),
        camera,
        space,
        up: None,
        scale: 1.0,
        pass_through: true,
        aovs: vec![Aov::Irradiance],
        names: AovNames::default(),
        settings: settings(),
    };
    // Cancelled from the start: what is read is read before.
    let _ = pbgi::shade_gbuffer(&request, &Progress::silent(), &AtomicBool::new(true));
}

/// Reads a camera, and sees four pixels through it.
pub fn read_camera(data: &[u8]) {
    with_files(&[("a.json", data), ("a.pbgi", small_octree())], |folder| {
        let request = FrameRequest {
            octree: &folder.join("a.pbgi"),
            scene: None,
            camera: camera_of(&folder.join("a.json")),
            width: 2,
            height: 2,
            samples: 1,
            shading_rate: 1.0,
            aovs: vec![Aov::Depth],
            names: AovNames::default(),
            scratch: None,
            settings: settings(),
        };
        let _ = pbgi::shade_frame(&request, &Progress::silent(), &AtomicBool::new(false));
    });
}
