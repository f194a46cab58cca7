//! Inputs as users name them: mesh files, point clouds, standard input, procedural scenes.

use crate::PbgiError;
use crate::bake::octree_source::{OCTREE_CACHE_BYTES, OctreeSource};
use crate::budget::reading::read_within;
use crate::foreign::{refuse_foreign, refuse_misnamed};
use pbgi_cloud::{
    CloudError, CloudOptions, ConcatSource, LAS_MAGIC, LazyCloud, PlyHeader, SliceSource, Surfel,
    SurfelSource, open_cloud, raw::RAW_MAGIC,
};
use pbgi_file::open_input;
use pbgi_mesh::read_scene_within;
use pbgi_procedural::{ProceduralSpec, procedural_scene};
use pbgi_scene::{DiceError, DiceOptions, DicedScene, Scene, Spacing, TwoSided};
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Surfels meshes are diced into where nothing else is asked for.
pub const DEFAULT_SURFELS: u64 = 1_000_000;

/// How fine meshes are diced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sampling {
    /// Longest micropolygon edge in scene units.
    Spacing(f32),
    /// Surfels of all mesh inputs together, shared out by area.
    Surfels(u64),
}

impl Default for Sampling {
    fn default() -> Self {
        Self::Surfels(DEFAULT_SURFELS)
    }
}

/// What a name stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// A file with triangles: `.glb`, `.gltf`, `.obj`, or `.ply` with faces or strips of triangles.
    Mesh,
    /// A point cloud that may lack normals, or have some of 0: `.ply` without faces and without normals or sizes.
    BareCloud,
    /// A point cloud as it is: `.ply` without faces, `.ptc`, a raw surfel stream, `-` for such a stream on
    /// standard input.
    Cloud,
    /// LiDAR points, `.las` or `.laz`: without normals, +Z up.
    Lidar,
    /// An octree file, whose surfels are read back.
    Octree,
    /// A scene made from its name, `demo:NAME?key=value`.
    Procedural,
}

impl InputKind {
    /// Finds out what `name` stands for: by its extension for meshes, else by the first bytes of
    /// the file.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or is of no known kind.
    pub fn detect(name: &str) -> Result<Self, PbgiError> {
        if name == "-" {
            return Ok(Self::Cloud);
        }
        if ProceduralSpec::matches(name) {
            return Ok(Self::Procedural);
        }
        refuse_foreign(name)?;
        let path = Path::new(name);
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        if ["glb", "gltf", "obj"].iter().any(|e| extension.eq_ignore_ascii_case(e)) {
            return Ok(Self::Mesh);
        }
        let file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
        let mut start = Vec::new();
        file.take(RAW_MAGIC.len() as u64)
            .read_to_end(&mut start)
            .map_err(|e| CloudError::io(path, "read", e))?;
        match start.as_slice() {
            [] => Err(PbgiError::input(format!("{name}: the file is empty"))),
            magic if *magic == RAW_MAGIC => Ok(Self::Cloud),
            magic if *magic == pbgi_format::MAGIC => Ok(Self::Octree),
            start if start.starts_with(&LAS_MAGIC) => Ok(Self::Lidar),
            [b'p', b'p', b't', b'c', ..] => Ok(Self::Cloud),
            [b'p', b'l', b'y', ..] => Self::of_ply(path),
            _ => Err(PbgiError::input(format!(
                "{name}: not a file this program reads; expected a mesh (.glb, .gltf, .obj, .ply), \
                 a point cloud (.ply, .las, .laz, .ptc, raw surfels), an octree (.pbgi), or demo:NAME for a procedural scene"
            ))),
        }
    }

    /// Whether `name` means a procedural scene rather than a file.
    #[must_use]
    pub fn is_procedural_name(name: &str) -> bool {
        ProceduralSpec::matches(name)
    }

    fn of_ply(path: &Path) -> Result<Self, PbgiError> {
        let file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
        let header = PlyHeader::read(&mut BufReader::new(file), path)?;
        let has_rows = |name| header.element(name).is_some_and(|faces| faces.count > 0);
        if has_rows("face") || has_rows("tristrips") {
            return Ok(Self::Mesh);
        }
        // A normal of 0 means that it is not known, but where surfels have a size: those were written on purpose.
        let has = |names: [&str; 2]| {
            let vertex = header.element("vertex");
            vertex.is_some_and(|v| names.iter().any(|name| v.property(name).is_some()))
        };
        let is_whole = has(["nx", "normal_x"]) && has(["radius", "area"]);
        Ok(if is_whole { Self::Cloud } else { Self::BareCloud })
    }

    /// Whether +Z is up unless said otherwise.
    #[must_use]
    pub fn is_z_up(self) -> bool {
        self == Self::Lidar
    }

    /// Whether normals may be missing and are to be estimated.
    #[must_use]
    pub fn lacks_normals(self) -> bool {
        matches!(self, Self::Lidar | Self::BareCloud)
    }

    /// Whether the input has triangles.
    #[must_use]
    pub fn is_mesh(self) -> bool {
        matches!(self, Self::Mesh | Self::Procedural)
    }
}

/// Reads the scene that `name` stands for: a mesh file or a procedural scene.
///
/// # Errors
///
/// If it cannot be read, or has no triangles.
pub fn load_scene(name: &str) -> Result<Scene, PbgiError> {
    load_scene_within(name, u64::MAX)
}

/// As [`load_scene`], where the process may hold so many bytes: what files state that they hold is counted before it is read.
///
/// # Errors
///
/// As [`load_scene`]; [`PbgiError::Budget`] with the limit that would do.
pub fn load_scene_within(name: &str, memory_limit: u64) -> Result<Scene, PbgiError> {
    if ProceduralSpec::matches(name) {
        return Ok(procedural_scene(name)?.scene);
    }
    let path = Path::new(name);
    refuse_foreign(name)?;
    if is_octree(path) {
        return Err(PbgiError::input(format!(
            "{name} is an octree, expected the mesh it was baked from; name that one, or none to see the surfels themselves"
        )));
    }
    refuse_misnamed(path)?;
    read_within(memory_limit, |allowance| read_scene_within(path, allowance))
}

/// Whether a file starts as octree files do; not if it cannot be read.
pub fn is_octree(path: &Path) -> bool {
    starts_as_octree(path).unwrap_or(false)
}

/// Whether a file starts as octree files do.
///
/// # Errors
///
/// If it cannot be read.
pub fn starts_as_octree(path: &Path) -> std::io::Result<bool> {
    let mut start = Vec::new();
    let length = pbgi_format::MAGIC.len() as u64;
    open_input(path)?.take(length).read_to_end(&mut start)?;
    Ok(*start == pbgi_format::MAGIC)
}

/// What becomes of the light that octree files store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OctreeUse {
    /// It is kept as it is.
    Keep,
    /// Their surfels are lit; files that store light are refused.
    Light,
    /// Their surfels are lit; what files store is what surfels emit.
    LightUnlit,
}

/// One input, opened.
enum Content {
    Scene {
        scene: Box<Scene>,
        /// Surfels the name itself asks for.
        surfels: Option<u64>,
        /// Its lights, once it is read.
        lights: Vec<Surfel>,
    },
    /// Taken when it is read.
    Cloud(Option<Box<dyn SurfelSource>>),
}

/// Inputs that were opened, to be read as one cloud.
pub struct Inputs {
    names: Vec<String>,
    contents: Vec<Content>,
    /// What users should know about the inputs, one sentence each.
    pub warnings: Vec<String>,
    /// Whether any input has +Z up.
    pub any_z_up: bool,
    /// Whether any input may lack normals.
    pub any_lacks_normals: bool,
    /// Bytes that page caches of octree files may hold.
    pub cache_bytes: u64,
    /// Lights that became surfels, once inputs are read.
    pub light_count: usize,
    /// Of scenes that give no surfel because all their surfaces are holes, that they are, and by which materials.
    pub all_holes: Vec<String>,
}

/// How scenes become surfels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneSampling {
    /// How fine.
    pub sampling: Sampling,
    /// Which surfaces get a surfel for each side.
    pub two_sided: TwoSided,
    /// Factor on the intensity of lights; 0 leaves them out.
    pub light_scale: f32,
}

impl Inputs {
    /// Opens all inputs: scenes completely; cloud files are closed again until their turn comes.
    ///
    /// # Errors
    ///
    /// Names the first input that cannot be read.
    pub fn open(
        names: &[String],
        options: &CloudOptions,
        octrees: OctreeUse,
        memory_limit: u64,
    ) -> Result<Self, PbgiError> {
        if names.is_empty() {
            return Err(PbgiError::usage("no input; name meshes, point clouds or demo:street"));
        }
        if names.iter().filter(|name| *name == "-").count() > 1 {
            return Err(PbgiError::usage("standard input (-) can be read only once"));
        }
        let kinds: Vec<InputKind> =
            names.iter().map(|name| InputKind::detect(name)).collect::<Result<_, _>>()?;
        let mut inputs = Self {
            names: names.to_vec(),
            contents: Vec::new(),
            warnings: Vec::new(),
            any_z_up: kinds.iter().any(|kind| kind.is_z_up()),
            any_lacks_normals: kinds.iter().any(|kind| kind.lacks_normals()),
            cache_bytes: 0,
            light_count: 0,
            all_holes: Vec::new(),
        };
        for (name, kind) in names.iter().zip(kinds) {
            let content = if kind == InputKind::Octree {
                let octree = OctreeSource::open(Path::new(name))?;
                if octrees != OctreeUse::Keep {
                    octree.check_relightable(octrees == OctreeUse::LightUnlit)?;
                }
                inputs.any_z_up |= octree.header().flags.z_up;
                inputs.cache_bytes += OCTREE_CACHE_BYTES;
                Content::Cloud(Some(Box::new(octree)))
            } else if kind.is_mesh() {
                let spec = ProceduralSpec::parse(name).ok();
                let scene = Box::new(load_scene_within(name, memory_limit)?);
                inputs.warnings.extend(scene.warnings.iter().map(|w| format!("{name}: {w}")));
                let surfels = spec.and_then(|spec| spec.surfels);
                Content::Scene { scene, surfels, lights: Vec::new() }
            } else {
                Content::Cloud(Some(open_cloud_of(name, options)?))
            };
            inputs.contents.push(content);
        }
        Ok(inputs)
    }

    /// Files that inputs refer to.
    pub fn files(&self) -> Vec<PathBuf> {
        let of = |content: &Content| match content {
            Content::Scene { scene, .. } => scene.files.clone(),
            Content::Cloud(_) => Vec::new(),
        };
        self.contents.iter().flat_map(of).collect()
    }

    /// Whether any input is a point cloud.
    #[must_use]
    pub fn any_cloud(&self) -> bool {
        self.contents.iter().any(|c| matches!(c, Content::Cloud(_)))
    }

    /// All inputs as one stream, in their order, each scene's lights behind its micropolygons, and the coarsest spacing
    /// meshes are diced with. Clouds can be read once only. Dicing ends soon after `cancel` is set.
    ///
    /// # Errors
    ///
    /// If a scene cannot be diced; on cancellation.
    pub fn read_as_one<'s>(
        &'s mut self,
        how: SceneSampling,
        cancel: &'s AtomicBool,
    ) -> Result<(ConcatSource<'s>, Option<f64>), PbgiError> {
        let two_sided = how.two_sided;
        let spacings = self.choose_spacings(how.sampling, two_sided, cancel)?;
        let Self { names, contents, warnings, light_count, all_holes, .. } = self;
        let mut sources: Vec<Box<dyn SurfelSource + 's>> = Vec::new();
        let mut coarsest: Option<f64> = None;
        for ((name, content), spacing) in names.iter().zip(contents).zip(spacings) {
            match content {
                Content::Cloud(source) => {
                    sources.push(source.take().ok_or_else(|| {
                        PbgiError::failed(format!("{name}: a cloud can be read once only"))
                    })?);
                }
                Content::Scene { scene, lights, .. } => {
                    *lights = scene.light_surfels(how.light_scale);
                    *light_count += if lights.is_empty() { 0 } else { scene.lights.len() };
                    let diced = dice(name, scene, DiceOptions { spacing, two_sided }, cancel)?;
                    warnings.extend(dicing_warnings(name, spacing, &diced));
                    if let Sampling::Spacing(length) = how.sampling {
                        warnings.extend(doubtful_spacing(name, scene, length));
                    }
                    if let Some(why) = all_holes_of(&diced) {
                        warnings.push(format!("{name}: {why}"));
                        all_holes.push(why);
                    }
                    if diced.spacing().is_finite() {
                        coarsest = Some(coarsest.unwrap_or(0.0).max(diced.spacing()));
                    }
                    sources.push(Box::new(diced));
                    sources.push(Box::new(SliceSource::new(lights)));
                }
            }
        }
        Ok((ConcatSource::new(sources), coarsest))
    }

    /// The spacing of each input; that of clouds means nothing.
    fn choose_spacings(
        &self,
        sampling: Sampling,
        two_sided: TwoSided,
        cancel: &AtomicBool,
    ) -> Result<Vec<Spacing>, PbgiError> {
        let count = match sampling {
            Sampling::Spacing(length) => {
                return Ok(vec![Spacing::Length(length); self.names.len()]);
            }
            Sampling::Surfels(count) => count,
        };
        let sharing = |content: &&Content| matches!(content, Content::Scene { surfels: None, .. });
        let is_shared = self.contents.iter().filter(sharing).count() > 1;
        let mut areas = Vec::new();
        for (name, content) in self.names.iter().zip(&self.contents) {
            areas.push(match content {
                Content::Scene { scene, surfels: None, .. } if is_shared => {
                    let spacing = Spacing::Length(f32::INFINITY);
                    dice(name, scene, DiceOptions { spacing, two_sided }, cancel)?.visible_area()
                }
                Content::Scene { surfels: None, .. } => 1.0,
                _ => 0.0,
            });
        }
        let total = areas.iter().sum::<f64>();
        let share = |area: f64| if total > 0.0 { area / total } else { 1.0 };
        Ok(self
            .contents
            .iter()
            .zip(areas)
            .map(|(content, area)| match content {
                Content::Scene { surfels: Some(own), .. } => Spacing::Count(*own),
                _ => Spacing::Count(((count as f64 * share(area)).round() as u64).max(1)),
            })
            .collect())
    }
}

/// A cloud to be read when its turn comes; standard input stays open.
fn open_cloud_of(name: &str, options: &CloudOptions) -> Result<Box<dyn SurfelSource>, CloudError> {
    match name {
        "-" => open_cloud(Path::new(name), options),
        _ => Ok(Box::new(LazyCloud::open(Path::new(name), options)?)),
    }
}

fn dice<'a>(
    name: &str,
    scene: &'a Scene,
    options: DiceOptions,
    cancel: &'a AtomicBool,
) -> Result<DicedScene<'a>, PbgiError> {
    DicedScene::new_until(scene, options, cancel).map_err(|source| match source {
        DiceError::Stopped => PbgiError::Interrupted,
        source => PbgiError::Dice { input: name.to_owned(), source },
    })
}

/// Spacings along the diagonal of a scene, below and above which the spacing is doubted.
const SPACINGS_DOUBTED: (f32, f32) = (4.0, 50_000.0);

/// A warning where a spacing looks as if it were of other units than the scene.
fn doubtful_spacing(name: &str, scene: &Scene, spacing: f32) -> Option<String> {
    let size = scene.bounds().extent().length();
    let (least, most) = SPACINGS_DOUBTED;
    let how = match size / spacing {
        ratio if ratio < least => "coarse",
        ratio if ratio > most => "fine",
        _ => return None,
    };
    Some(format!(
        "{name}: a spacing of {spacing} is {how} for a scene of {size:.3} units, as centimeters against meters; \
         --surfels 1M chooses one that suits"
    ))
}

/// Materials that are named in one sentence, at most.
const MATERIALS_NAMED: usize = 8;

/// That all surfaces are holes, and by which materials, if they are.
fn all_holes_of(diced: &DicedScene<'_>) -> Option<String> {
    let materials = diced.hole_materials();
    if materials.is_empty() || diced.count() != Some(0) {
        return None;
    }
    let mut names = materials[..materials.len().min(MATERIALS_NAMED)].join(", ");
    if materials.len() > MATERIALS_NAMED {
        names.push_str(&format!(" and {} more", materials.len() - MATERIALS_NAMED));
    }
    Some(format!("all surfaces are holes, by the alpha of their materials: {names}"))
}

/// Surfels over those asked for from which on there is a warning.
const MORE_THAN_ASKED: f64 = 1.1;

fn dicing_warnings(name: &str, spacing: Spacing, diced: &DicedScene<'_>) -> Vec<String> {
    let mut warnings = Vec::new();
    let count = diced.count().unwrap_or(0);
    if let Spacing::Count(asked) = spacing
        && count as f64 > MORE_THAN_ASKED * asked as f64
    {
        warnings.push(format!(
            "{name}: {count} surfels, more than the {asked} asked for: every triangle is at least one, and the largest are cut"
        ));
    }
    if diced.degenerate_count() > 0 {
        let skipped = diced.degenerate_count();
        warnings.push(format!("{name}: {skipped} triangles have no area and were left out"));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(folder: &Path, name: &str, text: &str) -> String {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    }

    const POINT: &str = "property float x\nproperty float y\nproperty float z\n";

    #[test]
    fn kinds_are_told_by_extension_or_content() {
        let folder = tempfile::tempdir().unwrap();
        let ply = |name: &str, rest: &str| {
            let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{POINT}{rest}");
            InputKind::detect(&write(folder.path(), name, &text)).unwrap()
        };
        assert_eq!(ply("a.ply", "end_header\n0 0 0\n"), InputKind::BareCloud);
        let normals = "property float nx\nproperty float ny\nproperty float nz\nend_header\n";
        assert_eq!(ply("b.PLY", normals), InputKind::BareCloud);
        assert_eq!(ply("b.ply", &format!("property float area\n{normals}")), InputKind::Cloud);
        let strips = "element tristrips 1\nproperty list int int vertex_indices\nend_header\n";
        assert_eq!(ply("s.ply", strips), InputKind::Mesh);
        let faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
        assert_eq!(ply("c", faces), InputKind::Mesh);
        assert_eq!(ply("d.ply", &faces.replace("face 1", "face 0")), InputKind::BareCloud);
        let detect = |name: &str| InputKind::detect(name);
        assert_eq!(detect("none.OBJ").unwrap(), InputKind::Mesh);
        assert_eq!(detect("-").unwrap(), InputKind::Cloud);
        assert_eq!(detect("demo:street").unwrap(), InputKind::Procedural);
        let las = write(folder.path(), "x.bin", "LASF.....");
        assert!(detect(&las).unwrap().is_z_up());
    }

    #[test]
    fn unreadable_inputs_are_named() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [("empty.ply", ""), ("x.fbx", "Kaydara FBX")] {
            let path = write(folder.path(), name, text);
            let error = InputKind::detect(&path).unwrap_err();
            assert_eq!(error.exit_code(), 3);
            assert!(error.to_string().contains(name), "{error}");
        }
        let error = InputKind::detect("none.ply").unwrap_err();
        assert_eq!(error.exit_code(), 3);
    }

    #[test]
    fn surfels_are_shared_out_by_area() {
        let folder = tempfile::tempdir().unwrap();
        let square = |name: &str, edge: f32| {
            let text = format!(
                "v 0 0 0\nv {edge} 0 0\nv {edge} {edge} 0\nv 0 {edge} 0\nf 1 2 3\nf 1 3 4\n"
            );
            write(folder.path(), name, &text)
        };
        let names = [square("a.obj", 1.0), square("b.obj", 3.0), "demo:room?surfels=5k".to_owned()];
        let mut inputs =
            Inputs::open(&names, &CloudOptions::default(), OctreeUse::Keep, 1 << 30).unwrap();
        let spacings = inputs
            .choose_spacings(Sampling::Surfels(10_000), TwoSided::None, &AtomicBool::new(false))
            .unwrap();
        assert_eq!(spacings, [1000, 9000, 5000].map(Spacing::Count));
        let sampling = Sampling::Surfels(10_000);
        let never = AtomicBool::new(false);
        let how = SceneSampling { sampling, two_sided: TwoSided::None, light_scale: 1.0 };
        let (mut source, spacing) = inputs.read_as_one(how, &never).unwrap();
        assert!(spacing.is_some_and(|s| s > 0.0));
        let (mut surfels, announced) = (Vec::new(), source.count().unwrap());
        while source.read_chunk(&mut surfels).unwrap() {}
        assert_eq!(surfels.len() as u64, announced);
        assert!((announced as f64 / 15_000.0 - 1.0).abs() < 0.05, "{announced}");
    }
}
