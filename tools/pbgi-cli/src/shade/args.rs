//! Arguments of `pbgi shade`.

use crate::cli::{CommonArgs, EXIT_CODES_HELP, IoMode, parse_resolution, parse_triple};
use crate::environment::EnvironmentArgs;
use crate::shade::frames::Frames;
use clap::{Args, Parser, ValueEnum};
use pbgi::{Aov, AovNames, AovPreset};
use pbgi::{
    CameraChoice, GlossSettings, ImportanceTerms, PbgiError, ShadeSettings, StoreSettings, UpAxis,
};
use std::path::PathBuf;

/// Gather light from an octree file, for a picture or for points
///
/// A picture shows the scene given by --scene (the mesh the octree was baked from), or, without one,
/// the surfels of the octree themselves; with --gbuffer, what another renderer saw is shaded. Results for points go to
/// a table, or back into the scan they came from.
///
/// Examples:
///   pbgi shade street.pbgi --scene demo:street --env sky.exr -o street.exr --preview street.png
///   pbgi shade street.pbgi --gbuffer beauty.exr --pass-through --env sky.exr -o lit.exr
///   pbgi shade room.pbgi --receivers points.ply -o shaded.ply --check 200
///   pbgi shade town.pbgi --receivers town.laz --env-color 1,1,1 -o town_lit.laz
#[derive(Clone, Debug, Parser)]
#[command(name = "pbgi-shade", version, after_long_help = EXIT_CODES_HELP, verbatim_doc_comment, max_term_width = 100)]
pub struct ShadeArgs {
    /// Octree file, made by pbgi bake
    pub octree: PathBuf,
    /// Result: an EXR picture (overwritten); for points .ply .npy .csv, or .las .laz for a scan
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Replace a file of points that exists
    #[arg(long)]
    pub force: bool,
    /// What is seen or shaded
    #[command(flatten)]
    pub view: ViewArgs,
    /// A G-buffer
    #[command(flatten)]
    pub gbuffer: GBufferArgs,
    /// Points
    #[command(flatten)]
    pub points: PointArgs,
    /// Frames
    #[command(flatten)]
    pub animation: AnimationArgs,
    /// Distant light
    #[command(flatten)]
    pub light: EnvironmentArgs,
    /// What is reflected
    #[command(flatten)]
    pub gloss: GlossArgs,
    /// How good
    #[command(flatten)]
    pub quality: QualityArgs,
    /// What is written
    #[command(flatten)]
    pub output_options: OutputArgs,
    /// How the octree file is read
    #[command(flatten)]
    pub store: StoreArgs,
    /// Options of every tool
    #[command(flatten)]
    pub common: CommonArgs,
}

/// How the octree file is read.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Octree file")]
pub struct StoreArgs {
    /// How the octree file is read
    #[arg(long, value_enum, value_name = "HOW", default_value = "read", hide_short_help = true)]
    pub io: IoMode,
    /// Shade on without pages that are damaged
    ///
    /// What lies in them counts as nothing. How many were left out is told in a warning, the statistics and the picture's attributes.
    #[arg(long, hide_short_help = true)]
    pub skip_damaged: bool,
    /// Record which pages of the octree file are asked for, in order
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    pub trace_pages: Option<PathBuf>,
}

impl StoreArgs {
    /// What was asked for.
    pub fn settings(&self) -> StoreSettings {
        StoreSettings {
            backend: self.io.into(),
            skip_damaged: self.skip_damaged,
            trace: self.trace_pages.clone(),
        }
    }
}

/// What a picture shows.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Picture")]
pub struct ViewArgs {
    /// Scene whose surfaces are shaded: .glb .gltf .obj .ply or demo:NAME
    #[arg(long, value_name = "FILE")]
    pub scene: Option<String>,
    /// Camera of the scene, by name or number
    #[arg(long, value_name = "NAME|INDEX", conflicts_with_all = ["camera_position", "camera_file"])]
    pub camera: Option<String>,
    /// Camera of a JSON file, or of an EXR picture's attributes
    ///
    /// JSON has either position, target and, if wanted, up, or the rows of camera_to_world, which acts on columns; and fov,
    /// the vertical field of view in degrees. An EXR picture has worldToNDC, or worldToCamera with --fov.
    #[arg(long, value_name = "JSON|EXR", conflicts_with = "camera_position")]
    pub camera_file: Option<PathBuf>,
    /// Place of the eye
    #[arg(long, value_name = "X,Y,Z", requires = "camera_target", value_parser = parse_place,
          allow_hyphen_values = true)]
    pub camera_position: Option<[f64; 3]>,
    /// What the camera looks at
    #[arg(long, value_name = "X,Y,Z", requires = "camera_position", value_parser = parse_place,
          allow_hyphen_values = true)]
    pub camera_target: Option<[f64; 3]>,
    /// Vertical field of view in degrees [default: 45]
    #[arg(long, value_name = "DEGREES", conflicts_with = "camera")]
    pub fov: Option<f32>,
    /// What is up in the picture [default: the file's up axis]
    #[arg(long = "camera-up", alias = "up", value_name = "X,Y,Z", requires = "camera_position", value_parser = parse_triple,
          allow_hyphen_values = true, hide_short_help = true)]
    pub up: Option<[f32; 3]>,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "960x540", value_parser = parse_resolution)]
    pub resolution: [u32; 2],
    /// Samples per pixel for edges: 1, 4, 8 or 16
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub samples: u32,
    /// Area of a micropolygon in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 1.0, hide_short_help = true)]
    pub shading_rate: f32,
}

impl ViewArgs {
    /// The camera asked for, one at a place turned by as many degrees.
    pub fn camera(&self, turned_degrees: f64) -> CameraChoice {
        if let (Some(position), Some(target)) = (self.camera_position, self.camera_target) {
            return CameraChoice::LookAt {
                position: position.into(),
                target: target.into(),
                up: self.up.map(Into::into),
                fov_degrees: self.fov,
                turned_degrees,
            };
        }
        if let Some(path) = self.camera_file.clone() {
            return CameraChoice::File { path, fov_degrees: self.fov };
        }
        self.camera.clone().map_or(CameraChoice::Default, CameraChoice::Named)
    }
}

/// Surfaces that another renderer saw, instead of a picture of our own.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Instead of a picture")]
pub struct GBufferArgs {
    /// EXR of another renderer with positions and normals
    ///
    /// Channels are found by the names of Arnold (P, N, albedo), Blender (Position, Normal, Diffuse Color) and RenderMan
    /// (__Pworld, __Nworld, albedo). Pixels whose alpha or normal is 0 show no surface and stay black.
    #[arg(long, value_name = "EXR", conflicts_with_all = ["scene", "camera"])]
    pub gbuffer: Option<PathBuf>,
    /// Space of its vectors
    #[arg(
        long,
        value_enum,
        value_name = "SPACE",
        default_value = "world",
        requires = "gbuffer",
        hide_short_help = true
    )]
    pub gbuffer_space: SpaceArg,
    /// Axis that is up in it, y or z [default: that of the octree]
    #[arg(long, value_enum, value_name = "AXIS", requires = "gbuffer", hide_short_help = true)]
    pub gbuffer_up: Option<UpArg>,
    /// Factor from its units to those of the octree: 0.01 for centimeters over meters
    #[arg(
        long,
        value_name = "FACTOR",
        default_value_t = 1.0,
        requires = "gbuffer",
        allow_hyphen_values = true,
        hide_short_help = true
    )]
    pub gbuffer_scale: f64,
    /// Take its other channels and attributes along, bit for bit
    #[arg(long, requires = "gbuffer")]
    pub pass_through: bool,
}

/// An axis that is up.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum UpArg {
    /// +Y
    Y,
    /// +Z
    Z,
}

impl From<UpArg> for UpAxis {
    fn from(up: UpArg) -> Self {
        match up {
            UpArg::Y => Self::Y,
            UpArg::Z => Self::Z,
        }
    }
}

/// The space of a G-buffer's vectors.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum SpaceArg {
    /// The world
    #[default]
    World,
    /// The camera, as RenderMan's P and Nn; the attribute worldToCamera leads back
    Camera,
}

/// What points have nothing to do with.
const PICTURE_FLAGS: [&str; 5] = ["scene", "gbuffer", "camera", "camera_position", "camera_file"];

/// Which points are shaded instead of a picture.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Instead of a picture")]
pub struct PointArgs {
    /// Points with normals (.ply), or a scan (.las .laz)
    ///
    /// Other columns of a PLY file pass through. Normals of scans are estimated, and all their points are shaded.
    #[arg(long, value_name = "FILE", conflicts_with_all = PICTURE_FLAGS)]
    pub receivers: Option<PathBuf>,
    /// Place of the eye that points reflect toward
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_place, allow_hyphen_values = true,
          hide_short_help = true, conflicts_with_all = PICTURE_FLAGS)]
    pub eye: Option<[f64; 3]>,
    /// Every surfel of the octree
    #[arg(long, conflicts_with = "receivers", conflicts_with_all = PICTURE_FLAGS)]
    pub surfels: bool,
}

/// Frames of an animation.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Animation")]
pub struct AnimationArgs {
    /// Frames, such as 1-20; their numbers replace #### in file names
    ///
    /// 0-100x10 is every tenth. All files may have a run of # in their names: octree, scene, camera, environment,
    /// G-buffer, points, and those that are written.
    #[arg(long, value_name = "RANGE", value_parser = Frames::parse)]
    pub frames: Option<Frames>,
    /// Turn of the environment per frame number: none at frame 0
    #[arg(
        long,
        value_name = "DEGREES",
        requires = "frames",
        allow_hyphen_values = true,
        hide_short_help = true
    )]
    pub env_turn: Option<f32>,
    /// Turn of --camera-position about the upward line through its target, per frame number
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, requires_all = ["frames", "camera_position"],
          allow_hyphen_values = true, hide_short_help = true)]
    pub camera_turn: f64,
    /// Turn of the camera at this frame.
    #[arg(skip)]
    pub camera_turned: f64,
}

/// What surfaces reflect glossily.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Light")]
pub struct GlossArgs {
    /// Reflect glossily, by materials
    ///
    /// Of the scene, of the G-buffer, or in the columns roughness, metalness and specular of points.
    #[arg(long)]
    pub gloss: bool,
    /// Roughness of everything, 0 to 1; implies --gloss
    #[arg(long, value_name = "R", allow_hyphen_values = true)]
    pub roughness: Option<f32>,
    /// Metalness of everything, 0 to 1; implies --gloss
    #[arg(long, value_name = "M", allow_hyphen_values = true, hide_short_help = true)]
    pub metalness: Option<f32>,
    /// Strength of the gloss of everything but metals, 0 to 1; implies --gloss
    #[arg(long, value_name = "S", allow_hyphen_values = true, hide_short_help = true)]
    pub specular: Option<f32>,
}

impl GlossArgs {
    /// The gloss asked for.
    pub fn settings(&self) -> Option<GlossSettings> {
        let Self { gloss, roughness, metalness, specular } = *self;
        let settings = GlossSettings { roughness, metalness, specular };
        (gloss || settings != GlossSettings::default()).then_some(settings)
    }
}

/// How good the result is.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Quality")]
pub struct QualityArgs {
    /// Cut error by name: draft is 10%, medium 4%, final 1%
    ///
    /// draft, medium or final: the same as --target-error with that value.
    #[arg(long, value_enum, hide_possible_values = true, value_name = "PRESET", conflicts_with_all = ["solid_angle", "target_error"])]
    pub quality: Option<QualityPreset>,
    /// Cut error to choose the solid angle for, such as 2%
    ///
    /// A sample of receivers is measured first, and what was chosen is reported.
    #[arg(long, value_name = "SHARE", value_parser = parse_share, conflicts_with = "solid_angle")]
    pub target_error: Option<f64>,
    /// Largest solid angle of a node taken as one, sr
    ///
    /// 0 takes every surfel.
    #[arg(long, visible_alias = "maxsolidangle", value_name = "SR",
          default_value_t = ShadeSettings::default().solid_angle_sr)]
    pub solid_angle: f32,
    /// Error that interpolation may add; 0 gathers for each
    ///
    /// Receivers whose neighbors' light tells theirs are interpolated, by irradiance gradients; sharp shadows of suns and gloss never are. The mean of
    /// what it adds is about a tenth of this; --check tells. 10% if not given, with --target-error or --quality four times that, at most 20%.
    #[arg(long, value_name = "SHARE", value_parser = parse_share_or_none)]
    pub interpolation: Option<f32>,
    /// What makes nodes smaller in some directions than in others
    ///
    /// Some of env,lobe,cosine,radiance,quality, or all or off: bright parts of the environment, what a glossy surface reflects
    /// most of, the cosine of diffuse surfaces, bright nodes, nodes that are pieces of planes.
    #[arg(long, value_name = "TERMS", default_value = "all", hide_short_help = true)]
    pub importance: ImportanceTerms,
    /// Texels along a face of the cube raster
    #[arg(long, value_name = "N", default_value_t = ShadeSettings::default().raster_edge,
          hide_short_help = true)]
    pub raster: usize,
    /// Directions of a reflection: 16, 64, 256, 1024, 4096 or 16384
    ///
    /// More of them see smaller things, and what hides what among them: a fire of 30 k sparks in glossy ground errs by 4.7, 2.8 and 1.8 % with
    /// 1024, 4096 and 16384.
    #[arg(long, value_name = "N", default_value_t = ShadeSettings::default().directions,
          hide_short_help = true)]
    pub directions: usize,
    /// Surfels that rise less than this share of their radius above a receiver are its own surface
    #[arg(long, value_name = "SHARE", default_value_t = ShadeSettings::default().bias,
          hide_short_help = true)]
    pub bias: f32,
    /// Gather N receivers by every surfel, print the error
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub check: usize,
}

impl QualityArgs {
    /// What interpolation may be wrong by.
    pub fn interpolation(&self) -> f32 {
        let usual = || ShadeSettings::usual_interpolation(self.target_error());
        self.interpolation.unwrap_or_else(usual)
    }

    /// The cut error asked for, by number or by name.
    pub fn target_error(&self) -> Option<f64> {
        self.target_error.or(self.quality.map(QualityPreset::target_error))
    }
}

/// A cut error by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum QualityPreset {
    /// 10%: where light comes from, in little time
    Draft,
    /// 4%: about that of the default solid angle
    Medium,
    /// 1%: below what is seen
    Final,
}

impl QualityPreset {
    /// The relative root mean square error against taking every surfel.
    pub fn target_error(self) -> f64 {
        match self {
            Self::Draft => 0.1,
            Self::Medium => 0.04,
            Self::Final => 0.01,
        }
    }
}

/// Whose channel names are written.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum NamePreset {
    /// Arnold's
    #[default]
    Arnold,
    /// Blender's
    Blender,
    /// RenderMan's
    Renderman,
}

/// What is written.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Output")]
pub struct OutputArgs {
    /// Channels, by Arnold's names and `beauty`, or `all`
    #[arg(long, value_name = "LIST", default_value = "all")]
    pub aovs: String,
    /// Names of the channels: arnold, blender or renderman
    #[arg(
        long,
        value_enum,
        value_name = "PRESET",
        default_value = "arnold",
        hide_possible_values = true
    )]
    pub aov_names: NamePreset,
    /// Picture for the eye, with a filmic curve
    #[arg(long, value_name = "PNG")]
    pub preview: Option<PathBuf>,
    /// Picture of all channels side by side
    #[arg(long, value_name = "PNG")]
    pub contact_sheet: Option<PathBuf>,
    /// Exposure of preview and contact sheet in stops, or auto
    #[arg(long, value_name = "EV", default_value = "auto", value_parser = parse_exposure,
          allow_hyphen_values = true, hide_short_help = true)]
    pub exposure: Exposure,
    /// Statistics as JSON, to a file or - for standard output
    #[arg(long, value_name = "FILE")]
    pub stats_json: Option<PathBuf>,
    /// Show statistics of cuts, levels of the tree and page cache, too
    #[arg(long, hide_short_help = true)]
    pub stats: bool,
}

impl OutputArgs {
    /// The channels asked for, among those `known`; those of gloss only where something is glossy, and direct light only where there is
    /// an environment.
    pub fn parse_aovs(
        &self,
        known: &[Aov],
        settings: &ShadeSettings,
    ) -> Result<Vec<Aov>, PbgiError> {
        let has_gloss = settings.gloss.is_some();
        let has_environment = settings.environment.is_some();
        if self.aovs == "all" {
            let is_made = |aov: &&Aov| match aov {
                Aov::SpecularIndirect => has_gloss,
                Aov::DiffuseDirect => has_environment,
                _ => true,
            };
            return Ok(known.iter().filter(is_made).copied().collect());
        }
        let names = AovNames::default();
        let name_of = |aov: Aov| match aov {
            Aov::Beauty => "beauty",
            aov => names.layer(aov),
        };
        let mut aovs = Vec::new();
        for name in self.aovs.split(',').map(str::trim).filter(|name| !name.is_empty()) {
            let found = known.iter().find(|a| name_of(**a).eq_ignore_ascii_case(name));
            let Some(aov) = found else {
                let known: Vec<&str> = known.iter().map(|a| name_of(*a)).collect();
                return Err(PbgiError::usage(format!(
                    "--aovs: there is no `{name}`; there are {}",
                    known.join(", ")
                )));
            };
            if !aovs.contains(aov) {
                aovs.push(*aov);
            }
        }
        if !has_gloss && aovs.contains(&Aov::SpecularIndirect) {
            return Err(PbgiError::usage(
                "--aovs: `specular_indirect` needs glossy surfaces; add --gloss or --roughness R",
            ));
        }
        if !has_environment && aovs.contains(&Aov::DiffuseDirect) {
            return Err(PbgiError::usage(
                "--aovs: `diffuse_direct` is the light of an environment; add --env or --env-color",
            ));
        }
        if aovs.is_empty() {
            return Err(PbgiError::usage("--aovs names no channel; `all` means all"));
        }
        Ok(aovs)
    }

    /// The names asked for.
    pub fn names(&self) -> AovNames {
        AovNames::preset(match self.aov_names {
            NamePreset::Arnold => AovPreset::Arnold,
            NamePreset::Blender => AovPreset::Blender,
            NamePreset::Renderman => AovPreset::Renderman,
        })
    }
}

/// Exposure of a preview.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// One that suits the picture.
    Auto,
    /// In stops.
    Stops(f32),
}

impl Exposure {
    /// Stops, unless they are to be found.
    pub fn stops(self) -> Option<f32> {
        match self {
            Self::Auto => None,
            Self::Stops(stops) => Some(stops),
        }
    }
}

fn parse_exposure(text: &str) -> Result<Exposure, String> {
    if text == "auto" {
        return Ok(Exposure::Auto);
    }
    let stops = text.parse().ok().filter(|x: &f32| x.abs() <= 100.0);
    let expected = || format!("`{text}` is no exposure; expected `auto` or stops such as 1.5");
    stops.map(Exposure::Stops).ok_or_else(expected)
}

/// A share: 2% or 0.02.
fn parse_share(text: &str) -> Result<f64, String> {
    let (number, scale) = text.strip_suffix('%').map_or((text, 1.0), |number| (number, 0.01));
    let share = number.trim().parse().ok().map(|x: f64| x * scale);
    share.filter(|x| (1e-4..=1.0).contains(x)).ok_or_else(|| {
        format!("`{text}` is no error; expected such as 2% or 0.02, from 0.01% to 100%")
    })
}

/// The same, or 0.
fn parse_share_or_none(text: &str) -> Result<f32, String> {
    if text.trim() == "0" { Ok(0.0) } else { parse_share(text).map(|share| share as f32) }
}

/// Three coordinates in double precision: survey coordinates have millions of meters.
fn parse_place(text: &str) -> Result<[f64; 3], String> {
    let parts: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|x: &f64| x.is_finite()))
        .collect();
    parts
        .and_then(|parts| parts.try_into().ok())
        .ok_or_else(|| format!("`{text}` are not three numbers; expected such as 0,1.5,-2"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use pbgi::FRAME_AOVS;

    fn parse(arguments: &[&str]) -> Result<ShadeArgs, clap::Error> {
        let all = ["pbgi-shade", "a.pbgi", "-o", "a.exr"].iter().chain(arguments);
        ShadeArgs::try_parse_from(all)
    }

    #[test]
    fn options_are_consistent() {
        ShadeArgs::command().debug_assert();
    }

    #[test]
    fn short_help_fits_a_screen() {
        let help = ShadeArgs::command().render_help().to_string();
        assert!(help.lines().count() <= 60, "{} lines: {help}", help.lines().count());
    }

    #[test]
    fn numbers_are_read() {
        let args = parse(&["--resolution", "64x36", "--exposure", "-1.5"]).unwrap();
        assert_eq!(args.view.resolution, [64, 36]);
        assert_eq!(args.output_options.exposure, Exposure::Stops(-1.5));
        let camera = ["--camera-position", "-1,2,3e6", "--camera-target", "0,0,0"];
        let CameraChoice::LookAt { position, .. } = parse(&camera).unwrap().view.camera(0.0) else {
            panic!("no look-at camera")
        };
        assert_eq!(position.to_array(), [-1.0, 2.0, 3e6]);
        for bad in [["--resolution", "64"], ["--resolution", "0x3"], ["--exposure", "bright"]] {
            assert!(parse(&bad).is_err(), "{bad:?}");
        }
        assert!(parse(&["--importance", "env,glow"]).is_err());
        let interpolation = |words: &[&str]| parse(words).map(|a| a.quality.interpolation());
        assert_eq!(interpolation(&[]).unwrap(), 0.1);
        assert_eq!(interpolation(&["--target-error", "5%"]).unwrap(), 0.2);
        assert_eq!(interpolation(&["--quality", "medium"]).unwrap(), 0.16);
        assert_eq!(interpolation(&["--quality", "draft"]).unwrap(), 0.2);
        assert_eq!(interpolation(&["--quality", "draft", "--interpolation", "5%"]).unwrap(), 0.05);
        assert_eq!(interpolation(&["--interpolation", "0"]).unwrap(), 0.0);
        assert_eq!(interpolation(&["--interpolation", "5%"]).unwrap(), 0.05);
        assert!(interpolation(&["--interpolation", "-1"]).is_err());
        let target = |text| parse(&["--target-error", text]).map(|a| a.quality.target_error);
        assert_eq!((target("2%").unwrap(), target("0.5").unwrap()), (Some(0.02), Some(0.5)));
        assert!(target("0").is_err() && target("2 percent").is_err());
        assert_eq!(parse(&[]).unwrap().gloss.settings(), None);
        let rough = parse(&["--roughness", "0.3"]).unwrap().gloss.settings().unwrap();
        assert_eq!((rough.roughness, rough.metalness), (Some(0.3), None));
        assert!(parse(&["--camera-position", "1,2,3"]).is_err());
        assert!(parse(&["--receivers", "r.ply", "--scene", "s.glb"]).is_err());
    }

    #[test]
    fn qualities_are_errors_and_stand_alone() {
        let target = |words: &[&str]| parse(words).map(|args| args.quality.target_error());
        let of = |name| target(&["--quality", name]).unwrap().unwrap();
        assert_eq!(target(&[]).unwrap(), None);
        assert!(of("draft") > of("medium") && of("medium") > of("final"));
        for other in ["--solid-angle=0.1", "--target-error=2%"] {
            assert!(target(&["--quality", "draft", other]).is_err(), "{other}");
        }
        assert!(target(&["--target-error=2%", "--solid-angle=0.1"]).is_err());
    }

    #[test]
    fn environments_are_placed_as_named() {
        use pbgi::EnvironmentPlacement;
        let rotation = |options: &[&str]| {
            let args = parse(&[&["--env", "sky.exr"][..], options].concat()).unwrap();
            args.light.spec().unwrap().unwrap().rotate_degrees
        };
        assert_eq!(rotation(&[]), 0.0);
        for (name, degrees) in
            [("openexr", 0.0), ("mitsuba", 0.0), ("blender", 90.0), ("three", 90.0)]
        {
            assert_eq!(EnvironmentPlacement::from_name(name).unwrap().rotate_degrees(), degrees);
            assert_eq!(rotation(&["--env-placement", name]), degrees);
            let turned = rotation(&["--env-placement", name, "--env-rotate", "-30"]);
            assert_eq!(turned, degrees - 30.0);
        }
        assert!(parse(&["--env-placement", "blender"]).is_err(), "without an environment");
    }

    #[test]
    fn channels_are_found_by_name() {
        let in_light = |list: &str, has_gloss: bool, has_sky: bool| {
            let environment =
                has_sky.then(|| parse(&["--env-color", "1,1,1"]).unwrap().light.spec().unwrap());
            let settings = ShadeSettings {
                gloss: has_gloss.then(GlossSettings::default),
                environment: environment.flatten(),
                ..ShadeSettings::default()
            };
            parse(&["--aovs", list]).unwrap().output_options.parse_aovs(&FRAME_AOVS, &settings)
        };
        let of = |list: &str, has_gloss| in_light(list, has_gloss, true);
        let aovs = |list: &str| of(list, false);
        assert_eq!(aovs("all").unwrap().len(), FRAME_AOVS.len() - 1);
        assert_eq!(of("all", true).unwrap().len(), FRAME_AOVS.len());
        assert_eq!(of("specular_indirect", true).unwrap(), [Aov::SpecularIndirect]);
        assert!(aovs("specular_indirect").unwrap_err().to_string().contains("--gloss"));
        assert_eq!(in_light("all", true, false).unwrap().len(), FRAME_AOVS.len() - 1);
        let error = in_light("diffuse_direct", false, false).unwrap_err();
        assert!(error.to_string().contains("--env"), "{error}");
        assert_eq!(aovs("beauty, ao,P,ao").unwrap(), [Aov::Beauty, Aov::Occlusion, Aov::Position]);
        assert!(
            aovs("gloss")
                .unwrap_err()
                .to_string()
                .contains("beauty, diffuse_direct, diffuse_indirect")
        );
        assert!(aovs(",").is_err());
    }
}
