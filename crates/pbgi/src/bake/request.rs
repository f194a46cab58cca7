//! What to bake, and how.

use crate::bake::input::Sampling;
use crate::bake::relight::LightRequest;
use crate::outputs::{Output, OutputKind, RunFiles, check_writable};
use crate::shade::LightSource;
use crate::{PbgiError, check_memory_limit};
use pbgi_build::{BuildOptions, PAGE_BYTES_RANGE};
use pbgi_cloud::CloudOptions;
use pbgi_file::{FileState, folder_of};
use pbgi_light::UpAxis;
use pbgi_scene::TwoSided;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

/// What to do where a cloud has no normals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NormalsChoice {
    /// Estimate them from neighbors.
    #[default]
    Estimate,
    /// Leave surfels isotropic: particles, smoke.
    Isotropic,
}

/// What to bake, and how.
#[derive(Clone, Debug)]
pub struct BakeRequest {
    /// Files, `-`, or procedural scenes, as [`crate::InputKind::detect`] tells them apart.
    pub inputs: Vec<String>,
    /// The octree file to write.
    pub output: PathBuf,
    /// Replace the output if it exists.
    pub force: bool,
    /// How fine meshes are diced.
    pub sampling: Sampling,
    /// Which surfaces get a surfel for each side.
    pub two_sided: TwoSided,
    /// Factor on the intensity of point and spot lights, 0 or more; 0 leaves them out.
    pub light_scale: f32,
    /// How records of clouds become surfels.
    pub cloud: CloudOptions,
    /// The upward axis; +Z with LiDAR input and +Y otherwise, where not given.
    pub up: Option<UpAxis>,
    /// What to do without normals.
    pub normals: NormalsChoice,
    /// Light to store.
    pub light: LightRequest,
    /// What octree files among the inputs store as radiance is what their surfels emit: they were baked without environment and bounces.
    pub unlit: bool,
    /// Keep the sorted surfels and the octree of the last pass of light until the bake is complete, and go on with what an earlier run has
    /// kept. Estimated sizes and normals are estimated again.
    pub resume: bool,
    /// Folder for temporary files; that of the output where not given.
    pub temp_dir: Option<PathBuf>,
    /// Bytes the process may hold.
    pub memory_limit: u64,
    /// Threads, at least 1.
    pub threads: usize,
    /// Bytes a page aims at, within [`PAGE_BYTES_RANGE`].
    pub page_bytes: usize,
    /// Most surfels of a leaf, 1 to 255.
    pub leaf_surfels_max: usize,
    /// Compress pages with LZ4.
    pub compress: bool,
    /// Store neither radiance nor albedo.
    pub occlusion_only: bool,
}

impl Default for BakeRequest {
    fn default() -> Self {
        let build = BuildOptions::default();
        Self {
            inputs: Vec::new(),
            output: PathBuf::new(),
            force: false,
            sampling: Sampling::default(),
            two_sided: TwoSided::default(),
            light_scale: 1.0,
            cloud: CloudOptions::default(),
            up: None,
            normals: NormalsChoice::default(),
            light: LightRequest::default(),
            unlit: false,
            resume: false,
            temp_dir: None,
            memory_limit: 1 << 30,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            page_bytes: build.page_bytes,
            leaf_surfels_max: build.leaf_surfels_max,
            compress: build.compress,
            occlusion_only: false,
        }
    }
}

impl BakeRequest {
    /// Refuses values out of range and outputs that cannot be.
    ///
    /// # Errors
    ///
    /// Names the option and what is expected.
    pub fn check(&self) -> Result<(), PbgiError> {
        check_memory_limit(self.memory_limit)?;
        self.light.check()?;
        if !PAGE_BYTES_RANGE.contains(&self.page_bytes) {
            return Err(PbgiError::usage(format!(
                "--page-bytes {} is out of range; expected 4KiB to 1MiB",
                self.page_bytes
            )));
        }
        if !(1..=255).contains(&self.leaf_surfels_max) {
            return Err(PbgiError::usage(format!(
                "--leaf-surfels {} is out of range; expected 1 to 255",
                self.leaf_surfels_max
            )));
        }
        match self.sampling {
            Sampling::Spacing(s) if !(s > 0.0 && s.is_finite()) => {
                return Err(PbgiError::usage(format!("--spacing {s} is no length above 0")));
            }
            Sampling::Surfels(0) => {
                return Err(PbgiError::usage("--surfels 0 gives no cloud; expected at least 1"));
            }
            _ => {}
        }
        if !(0.0..=f32::MAX).contains(&self.light_scale) {
            return Err(PbgiError::usage(format!(
                "--light-scale {} is out of range; expected a factor of 0 or more",
                self.light_scale
            )));
        }
        if self.occlusion_only && self.light.is_any() {
            return Err(PbgiError::usage(
                "--occlusion-only stores no light; leave out --env and --bounces",
            ));
        }
        if let Some(folder) = self.temp_dir.as_ref().filter(|folder| !folder.is_dir()) {
            let folder = folder.display();
            return Err(PbgiError::usage(format!("--temp-dir {folder} is no folder")));
        }
        if self.resume && self.inputs.iter().any(|input| input == "-") {
            return Err(PbgiError::usage(
                "--resume cannot tell whether standard input is the same again; bake a file",
            ));
        }
        self.files()?;
        check_writable(&self.output)
    }

    /// The files that the request names.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`] if the output is an input, or is not to be replaced.
    pub fn files(&self) -> Result<RunFiles, PbgiError> {
        let mut files = RunFiles::default();
        files.add_named_inputs(&self.inputs)?;
        if let Some(sky) = self.sky() {
            files.add_input(sky)?;
        }
        let (path, kind, replace) = (&self.output, OutputKind::Octree, self.force);
        files.add_output(&Output { option: "-o", path, kind, replace })?;
        Ok(files)
    }

    /// The image of the environment, if it is one.
    fn sky(&self) -> Option<&Path> {
        self.light.environment.as_ref().and_then(|spec| match &spec.source {
            LightSource::File(path) => Some(path.as_path()),
            LightSource::Uniform(_) => None,
        })
    }

    /// Tells requests apart whose phases give different results: by inputs, the environment and the files that inputs have `referred` to, with
    /// their states, and by all that shapes the surfels and their light.
    pub(crate) fn fingerprint(&self, referred: &[PathBuf]) -> u64 {
        let mut hasher = DefaultHasher::new();
        env!("CARGO_PKG_VERSION").hash(&mut hasher);
        let named = self.inputs.iter().map(Path::new).chain(self.sky());
        for path in named.chain(referred.iter().map(PathBuf::as_path)) {
            (std::fs::canonicalize(path).ok(), path, FileState::of(path)).hash(&mut hasher);
        }
        let Self { sampling, two_sided, light_scale, cloud, up, normals, light, unlit, .. } = self;
        format!("{sampling:?} {two_sided:?} {light_scale} {cloud:?} {up:?} {normals:?} {light:?} {unlit}")
            .hash(&mut hasher);
        // The memory limit decides how large pieces are.
        (self.memory_limit, self.occlusion_only).hash(&mut hasher);
        hasher.finish()
    }

    /// Folder for temporary files.
    pub(crate) fn temp_dir(&self) -> PathBuf {
        self.temp_dir.clone().unwrap_or_else(|| folder_of(&self.output).to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_misuse() {
        let good = || BakeRequest { output: "x.pbgi".into(), ..BakeRequest::default() };
        good().check().unwrap();
        let light = LightRequest { bounces: 1, ..LightRequest::default() };
        for bad in [
            BakeRequest { page_bytes: 100, ..good() },
            BakeRequest { leaf_surfels_max: 256, ..good() },
            BakeRequest { memory_limit: 1 << 20, ..good() },
            BakeRequest { sampling: Sampling::Spacing(f32::NAN), ..good() },
            BakeRequest { sampling: Sampling::Surfels(0), ..good() },
            BakeRequest { light_scale: -1.0, ..good() },
            BakeRequest { light_scale: f32::NAN, ..good() },
            BakeRequest { occlusion_only: true, light, ..good() },
            BakeRequest { temp_dir: Some("none/such".into()), ..good() },
            BakeRequest { resume: true, inputs: vec!["-".into()], ..good() },
            BakeRequest::default(),
        ] {
            assert_eq!(bad.check().unwrap_err().exit_code(), crate::EXIT_MISUSED, "{bad:?}");
        }
    }
}
