//! Surfaces in the pixels of a G-buffer: what renderers write beside their pictures.

use crate::PbgiError;
use crate::budget::reading::read_within;
use crate::frame::camera_file::FileCamera;
use pbgi_cloud::{ReceiverColumn, ReceiverTable};
use pbgi_image::{
    Aov, AovNames, AttributeValue, ImageWindow, Metadata, StoredChannel, StoredImage,
    read_stored_exr_within,
};
use pbgi_math::{DMat4, DVec3, Vec3};
use std::path::Path;

/// The space of positions, normals and view vectors of a G-buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GBufferSpace {
    /// The world: Arnold, Blender, RenderMan's `__Pworld` and `__Nworld`.
    #[default]
    World,
    /// The camera: RenderMan's `P` and `Nn`. The file's `worldToCamera` leads back.
    Camera,
}

/// Bytes a pixel takes while its channels are floats: position, normal, alpha, view, six properties.
const PLANES_BYTES: u64 = 4 * (3 + 3 + 1 + 3 + 6);

/// Bytes of a pixel's surface: position, normal, pixel, alpha, nine columns.
const SURFACE_BYTES: u64 = 4 * (3 + 3 + 1 + 1 + 9);

/// A G-buffer, read.
pub(crate) struct GBuffer {
    pub width: usize,
    pub height: usize,
    pub window: ImageWindow,
    pub metadata: Metadata,
    /// The surfaces, in the order of their pixels. Columns: `albedo_r albedo_g albedo_b`, `roughness`, `metalness`,
    /// `specular` where the file has them, `view_x view_y view_z` (unit, toward the eye) where it or a camera tells.
    pub surfaces: ReceiverTable,
    /// The pixel of each surface.
    pub pixels: Vec<u32>,
    /// Coverage of each surface's pixel.
    pub alphas: Vec<f32>,
    /// Pixels left out because position or normal are not finite though the pixel is covered.
    pub damaged: u64,
    /// All channels as stored.
    pub channels: Vec<StoredChannel>,
}

/// Channels of a G-buffer as floats, each of the length of the image.
struct Planes {
    position: [Vec<f32>; 3],
    normal: [Vec<f32>; 3],
    alpha: Option<Vec<f32>>,
    view: Option<[Vec<f32>; 3]>,
    /// Named columns of surface properties.
    properties: Vec<(&'static str, Vec<f32>)>,
}

impl GBuffer {
    /// Reads the EXR image `path`. Its world becomes the octree's by `to_octree`, then positions become relative to `origin`. `eye` is
    /// where the camera is in its world, if that is known better than from the file.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or lacks positions or normals, or the matrix that `space` needs.
    pub fn read(
        path: &Path,
        space: GBufferSpace,
        names: &AovNames,
        to_octree: &DMat4,
        origin: DVec3,
        eye: Option<DVec3>,
        memory_limit: u64,
    ) -> Result<Self, PbgiError> {
        let input = |message: String| PbgiError::input(format!("{}: {message}", path.display()));
        let (stored, metadata) = read_within(memory_limit, |allowance| {
            read_stored_exr_within(path, allowance, PLANES_BYTES + SURFACE_BYTES)
        })?;
        let (width, height) = (stored.width, stored.height);
        if u32::try_from(width * height).is_err() {
            return Err(input(format!("{width} x {height} pixels, expected less than 2³²")));
        }
        let to_world = *to_octree * to_world(space, &metadata).map_err(input)?;
        let eye = match eye {
            Some(eye) => Some(eye),
            None => FileCamera::from_metadata(&metadata).map_err(input)?.map(|c| c.eye),
        };
        let eye = eye.map(|eye| to_octree.transform_point3(eye));
        let planes = Planes::find(&stored, names).map_err(input)?;
        let mut gbuffer = Self {
            width,
            height,
            window: metadata.window,
            metadata,
            surfaces: ReceiverTable { origin, ..ReceiverTable::default() },
            pixels: Vec::new(),
            alphas: Vec::new(),
            damaged: 0,
            channels: stored.channels,
        };
        gbuffer.collect_surfaces(&planes, &to_world);
        gbuffer.collect_columns(planes, &to_world, eye);
        Ok(gbuffer)
    }

    /// Finds the pixels that show a surface: alpha above 0 where there is alpha, and a normal.
    fn collect_surfaces(&mut self, planes: &Planes, to_world: &DMat4) {
        for pixel in 0..self.width * self.height {
            let alpha = planes.alpha.as_ref().map_or(1.0, |alpha| alpha[pixel]);
            let [position, normal] = [&planes.position, &planes.normal]
                .map(|plane| DVec3::from_array([0, 1, 2].map(|k| plane[k][pixel].into())));
            if !(alpha > 0.0) || normal == DVec3::ZERO {
                continue;
            }
            let position = to_world.transform_point3(position) - self.surfaces.origin;
            let unit = to_world.transform_vector3(normal).normalize();
            if !(position.is_finite() && unit.is_finite()) {
                self.damaged += 1;
                continue;
            }
            self.pixels.push(pixel as u32);
            self.alphas.push(alpha);
            self.surfaces.positions.push(position.as_vec3());
            self.surfaces.normals.push(unit.as_vec3());
        }
    }

    fn collect_columns(&mut self, planes: Planes, to_world: &DMat4, eye: Option<DVec3>) {
        let mut columns: Vec<(&str, Vec<f32>)> = Vec::new();
        for (name, values) in planes.properties {
            columns.push((name, self.pixels.iter().map(|p| values[*p as usize]).collect()));
        }
        let views = match (planes.view, eye) {
            (Some(planes), _) => Some(self.read_views(&planes, to_world)),
            (None, Some(eye)) => Some(self.views_from(eye)),
            (None, None) => None,
        };
        for (k, name) in ["view_x", "view_y", "view_z"].into_iter().enumerate() {
            columns.extend(views.iter().map(|v| (name, v.iter().map(|v| v[k]).collect())));
        }
        let named = |(name, values): (&str, _)| ReceiverColumn {
            name: name.to_owned(),
            values,
            ..ReceiverColumn::default()
        };
        self.surfaces.columns = columns.into_iter().map(named).collect();
    }

    fn read_views(&self, planes: &[Vec<f32>; 3], to_world: &DMat4) -> Vec<Vec3> {
        let view = |pixel: &u32| {
            let view = [0, 1, 2].map(|k| f64::from(planes[k][*pixel as usize]));
            to_world.transform_vector3(DVec3::from_array(view)).normalize_or_zero().as_vec3()
        };
        self.pixels.iter().map(view).collect()
    }

    fn views_from(&self, eye: DVec3) -> Vec<Vec3> {
        let eye = (eye - self.surfaces.origin).as_vec3();
        self.surfaces.positions.iter().map(|p| (eye - *p).normalize_or_zero()).collect()
    }

    /// Pixels without a surface.
    pub fn empty_pixels(&self) -> u64 {
        (self.width * self.height - self.pixels.len()) as u64
    }
}

/// From the space of the file's vectors to the world.
fn to_world(space: GBufferSpace, metadata: &Metadata) -> Result<DMat4, String> {
    if space == GBufferSpace::World {
        return Ok(DMat4::IDENTITY);
    }
    let inverse = match metadata.attribute("worldToCamera") {
        Some(AttributeValue::Matrix(matrix)) => matrix.as_dmat4().inverse(),
        _ => return Err("no attribute `worldToCamera`, which camera space needs".into()),
    };
    match inverse.is_finite() {
        true => Ok(inverse),
        false => Err("the attribute `worldToCamera` has no inverse".into()),
    }
}

impl Planes {
    fn find(image: &StoredImage, aovs: &AovNames) -> Result<Self, String> {
        let names: Vec<&str> = image.channels.iter().map(|c| c.name.as_str()).collect();
        let floats = |index: usize| image.channels[index].samples.clone().into_floats();
        let triple = |aov: Aov| -> Option<[Vec<f32>; 3]> {
            let indices = aovs.find_among(&names, aov)?;
            indices.into_iter().map(floats).collect::<Vec<_>>().try_into().ok()
        };
        let required = |aov: Aov, what: &str, known: &str| {
            triple(aov).ok_or_else(|| {
                let found = names.join(", ");
                format!("no channels of {what}, expected such as {known}; there are {found}")
            })
        };
        let position = required(Aov::Position, "positions", "P.X P.Y P.Z or Position.X …")?;
        let normal = required(Aov::Normal, "normals", "N.X N.Y N.Z or Normal.X …")?;
        let mut properties = Vec::new();
        let albedo = triple(Aov::Albedo).into_iter().flatten();
        properties.extend(["albedo_r", "albedo_g", "albedo_b"].into_iter().zip(albedo));
        for (name, aov) in [
            ("roughness", Aov::Roughness),
            ("metalness", Aov::Metalness),
            ("specular", Aov::Specular),
        ] {
            let found = aovs.find_among(&names, aov);
            properties.extend(found.map(|indices| (name, floats(indices[0]))));
        }
        Ok(Self {
            position,
            normal,
            alpha: AovNames::find_alpha(&names).map(floats),
            view: triple(Aov::View),
            properties,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_image::{Image, write_exr};
    use pbgi_math::Mat4;
    use pbgi_scene::{Camera, CameraView};

    const EYE: Vec3 = Vec3::new(1.0, 2.0, 8.0);
    const ORIGIN: DVec3 = DVec3::new(10.0, 0.0, 0.0);

    fn view() -> CameraView {
        CameraView { camera: Camera::look_at(EYE, Vec3::ZERO, Vec3::Y, 0.8), width: 4, height: 1 }
    }

    /// Four pixels of vectors in a space: a surface, no alpha, no normal, no finite position.
    fn write(path: &Path, to_space: Mat4, more: &[(&str, f32)], attributes: bool) {
        let mut image = Image::new(4, 1);
        let point = to_space.transform_point3(Vec3::new(3.0, 4.0, 5.0)).to_array();
        let normal = to_space.transform_vector3(Vec3::new(0.0, 2.0, 0.0)).to_array();
        for (k, name) in ["X", "Y", "Z"].into_iter().enumerate() {
            image.push(format!("P.{name}"), vec![point[k], point[k], point[k], f32::NAN]);
            image.push(format!("N.{name}"), vec![normal[k], normal[k], 0.0, normal[k]]);
        }
        image.push("A", vec![0.5, 0.0, 1.0, 1.0]);
        for (name, value) in more {
            image.push(*name, vec![*value; 4]);
        }
        let matrix = AttributeValue::Matrix(view().world_to_camera());
        let attributes = if attributes { vec![("worldToCamera".into(), matrix)] } else { vec![] };
        write_exr(path, &image, &attributes).unwrap();
    }

    fn read(path: &Path, space: GBufferSpace) -> Result<GBuffer, PbgiError> {
        let names = AovNames::default();
        GBuffer::read(path, space, &names, &DMat4::IDENTITY, ORIGIN, None, 1 << 30)
    }

    #[test]
    fn pixels_without_surface_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.exr");
        let more = [("albedo.R", 0.25), ("albedo.G", 0.5), ("albedo.B", 1.0), ("metalness", 0.75)];
        write(&path, Mat4::IDENTITY, &more, false);
        let gbuffer = read(&path, GBufferSpace::World).unwrap();
        assert_eq!((&gbuffer.pixels[..], &gbuffer.alphas[..]), (&[0u32][..], &[0.5f32][..]));
        assert_eq!((gbuffer.empty_pixels(), gbuffer.damaged), (3, 1));
        assert_eq!(gbuffer.surfaces.positions, [Vec3::new(-7.0, 4.0, 5.0)]);
        assert_eq!(gbuffer.surfaces.normals, [Vec3::Y]);
        assert_eq!(gbuffer.surfaces.column("albedo_g"), Some([0.5].as_slice()));
        assert_eq!(gbuffer.surfaces.column("metalness"), Some([0.75].as_slice()));
        assert_eq!(gbuffer.surfaces.column("roughness"), None);
        assert_eq!(gbuffer.surfaces.column("view_x"), None);
    }

    /// The known camera: vectors written in its space come back to the world, and its eye gives the view.
    #[test]
    fn camera_space_leads_back_to_the_world() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.exr");
        write(&path, view().world_to_camera(), &[], true);
        let gbuffer = read(&path, GBufferSpace::Camera).unwrap();
        let surfaces = &gbuffer.surfaces;
        assert!(surfaces.positions[0].distance(Vec3::new(-7.0, 4.0, 5.0)) < 1e-5);
        assert!(surfaces.normals[0].distance(Vec3::Y) < 1e-6);
        let toward_eye = (EYE - Vec3::new(3.0, 4.0, 5.0)).normalize();
        for (k, name) in ["view_x", "view_y", "view_z"].into_iter().enumerate() {
            assert!((surfaces.column(name).unwrap()[0] - toward_eye[k]).abs() < 1e-5, "{name}");
        }
        write(&path, Mat4::IDENTITY, &[], false);
        let message = read(&path, GBufferSpace::Camera).err().unwrap().to_string();
        assert!(message.contains("worldToCamera"), "{message}");
    }

    #[test]
    fn view_vectors_of_the_file_come_before_those_of_a_camera() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.exr");
        let view = [("V.X", 0.0), ("V.Y", 0.0), ("V.Z", -3.0)];
        write(&path, Mat4::IDENTITY, &view, true);
        let gbuffer = read(&path, GBufferSpace::World).unwrap();
        assert_eq!(gbuffer.surfaces.column("view_z"), Some([-1.0].as_slice()));
    }

    #[test]
    fn missing_channels_are_named_with_those_there_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.exr");
        let mut image = Image::new(1, 1);
        image.push("Z", vec![1.0]);
        write_exr(&path, &image, &[]).unwrap();
        let error = read(&path, GBufferSpace::World).err().unwrap();
        assert!(error.to_string().contains("P.X P.Y P.Z"), "{error}");
        assert!(error.to_string().contains("there are Z"), "{error}");
        assert_eq!(error.exit_code(), 3);
    }
}
