//! Cameras in files: JSON, and the matrices of EXR images.

use crate::PbgiError;
use pbgi_file::read_input;
use pbgi_image::{AttributeValue, Metadata, read_exr_metadata};
use pbgi_math::{Affine3A, DMat3, DMat4, DVec3, DVec4, Mat4};
use pbgi_scene::Camera;
use serde::Deserialize;
use std::path::Path;

/// Longest JSON file of a camera in bytes.
const JSON_BYTES_MAX: u64 = 1 << 20;

/// A camera in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FileCamera {
    pub eye: DVec3,
    /// Axes of the camera in the world: right, up, backward; orthonormal.
    pub axes: DMat3,
    /// Full vertical field of view in degrees, where the file says.
    pub fov_degrees: Option<f32>,
}

impl FileCamera {
    /// Reads a JSON file, or the attributes of an EXR image, told apart by their extension.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or tells of no camera.
    pub fn read(path: &Path) -> Result<Self, PbgiError> {
        let input = |message: String| PbgiError::input(format!("{}: {message}", path.display()));
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr")) {
            let metadata = read_exr_metadata(path)?;
            let camera = Self::from_metadata(&metadata).map_err(input)?;
            return camera.ok_or_else(|| {
                input("no camera: expected an attribute `worldToNDC` or `worldToCamera`".into())
            });
        }
        let text = read_input(path, JSON_BYTES_MAX)
            .map_err(|e| PbgiError::input(format!("{}: read failed: {e}", path.display())))?;
        let json: JsonCamera =
            serde_json::from_slice(&text).map_err(|e| input(format!("not a camera: {e}")))?;
        json.camera().map_err(input)
    }

    /// The camera of an EXR image, if its attributes tell of one.
    ///
    /// # Errors
    ///
    /// If a matrix is no perspective one.
    pub fn from_metadata(metadata: &Metadata) -> Result<Option<Self>, String> {
        let matrix = |name: &str| match metadata.attribute(name) {
            Some(AttributeValue::Matrix(matrix)) => Some(matrix.as_dmat4()),
            _ => None,
        };
        match (matrix("worldToNDC"), matrix("worldToCamera")) {
            (Some(ndc), _) => Self::from_ndc(ndc).map(Some),
            (None, Some(camera)) => Self::from_world(camera.inverse()).map(Some),
            (None, None) => Ok(None),
        }
    }

    /// The camera of a projection to normalized device coordinates: after division by w, 0..=1 from left to right and
    /// from top to bottom, or −1..=1 from left to right and from bottom to top. No convention of camera space is assumed.
    fn from_ndc(world_to_ndc: DMat4) -> Result<Self, String> {
        let bad = |what: &str| Err(format!("`worldToNDC` {what}"));
        let [x, y, w] = [0, 1, 3].map(|row| world_to_ndc.row(row));
        let rows = DMat3::from_cols(x.truncate(), y.truncate(), w.truncate()).transpose();
        // At the eye x, y and w vanish together.
        let eye = rows.inverse() * -DVec3::new(x.w, y.w, w.w);
        let forward = w.truncate().normalize();
        if !(rows.determinant() != 0.0 && eye.is_finite() && forward.is_finite()) {
            return bad("is no perspective projection");
        }
        let on_axis = |row: DVec4| row.truncate().dot(forward) / w.truncate().dot(forward);
        let (u, v) = (on_axis(x), on_axis(y));
        let is_near = |value: f64, expected: f64| (value - expected).abs() < 1e-3;
        let (left, right, top, bottom) = match (u, v) {
            (u, v) if is_near(u, 0.5) && is_near(v, 0.5) => (0.0, 1.0, 0.0, 1.0),
            (u, v) if is_near(u, 0.0) && is_near(v, 0.0) => (-1.0, 1.0, 1.0, -1.0),
            _ => return bad("has its axis off the center of the image, which no camera here has"),
        };
        // Direction to (u, v), one unit along the axis.
        let toward = |u: f64, v: f64| {
            let normal = |row: DVec4, at: f64| row.truncate() - at * w.truncate();
            let direction = normal(x, u).cross(normal(y, v));
            direction / direction.dot(forward)
        };
        let up = toward(u, top) - toward(u, bottom);
        let side = toward(right, v) - toward(left, v);
        if !(up.is_finite() && side.is_finite()) || side.cross(up).dot(forward) >= 0.0 {
            return bad("mirrors the image, which no camera here does");
        }
        let axes = DMat3::from_cols(up.cross(-forward).normalize(), up.normalize(), -forward);
        let fov_degrees = (2.0 * (0.5 * up.length()).atan()).to_degrees() as f32;
        Ok(Self { eye, axes, fov_degrees: Some(fov_degrees) })
    }

    /// The camera of a matrix from camera space, which looks down −Z with +Y up, to the world.
    fn from_world(camera_to_world: DMat4) -> Result<Self, String> {
        let row = camera_to_world.row(3);
        if row.distance(DVec4::W) > 1e-6 {
            return Err(format!(
                "the last row of the camera's matrix is {row}, expected 0 0 0 1; matrices here act on columns: \
                 transpose it"
            ));
        }
        let axes = DMat3::from_mat4(camera_to_world);
        let up = axes.y_axis.normalize();
        let back = axes.z_axis.normalize();
        let side = up.cross(back).normalize();
        let eye = camera_to_world.w_axis.truncate();
        if !(eye.is_finite() && side.is_finite()) || side.dot(axes.x_axis) <= 0.0 {
            return Err("the camera's matrix is singular, or mirrors the image".into());
        }
        let axes = DMat3::from_cols(side, back.cross(side), back);
        Ok(Self { eye, axes, fov_degrees: None })
    }

    /// The camera relative to `origin`; `fov_degrees` is used where the file has none.
    pub fn camera(&self, origin: DVec3, fov_degrees: f32) -> Camera {
        let to_world = DMat4::from_mat3_translation(self.axes, self.eye - origin);
        Camera {
            name: String::new(),
            transform: Affine3A::from_mat4(Mat4::from_cols_array(
                &to_world.to_cols_array().map(|x| x as f32),
            )),
            yfov: self.fov_degrees.unwrap_or(fov_degrees).to_radians(),
        }
    }
}

/// What is wrong with a field of view in degrees; none where nothing is.
pub(crate) fn bad_fov(fov_degrees: f32) -> Option<String> {
    let is_good = fov_degrees > 0.0 && fov_degrees < 179.0;
    (!is_good).then(|| format!("{fov_degrees} degrees, expected more than 0 and less than 179"))
}

/// A camera as JSON: a place with a target, or a matrix.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JsonCamera {
    position: Option<[f64; 3]>,
    target: Option<[f64; 3]>,
    up: Option<[f64; 3]>,
    /// Rows of a matrix that acts on columns.
    camera_to_world: Option<[[f64; 4]; 4]>,
    fov: Option<f32>,
}

impl JsonCamera {
    fn camera(&self) -> Result<FileCamera, String> {
        if let Some(problem) = self.fov.and_then(bad_fov) {
            return Err(format!("fov is {problem}"));
        }
        let camera = match (self.camera_to_world, self.position, self.target) {
            (Some(rows), None, None) if self.up.is_none() => {
                FileCamera::from_world(DMat4::from_cols_array_2d(&rows).transpose())?
            }
            (None, Some(position), Some(target)) => {
                let (position, target) = (DVec3::from_array(position), DVec3::from_array(target));
                let back = (position - target).normalize();
                let up = DVec3::from_array(self.up.unwrap_or([0.0, 1.0, 0.0]));
                let side = up.cross(back).normalize();
                if !(back.is_finite() && side.is_finite()) {
                    return Err("position, target and up make no view; they must differ".into());
                }
                let axes = DMat3::from_cols(side, back.cross(side), back);
                FileCamera { eye: position, axes, fov_degrees: None }
            }
            _ => {
                return Err("expected either `position` and `target` (with `up` or without), or \
                     `camera_to_world`"
                    .into());
            }
        };
        Ok(FileCamera { fov_degrees: self.fov, ..camera })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::Vec3;
    use pbgi_scene::CameraView;

    const EYE: DVec3 = DVec3::new(3.0, 2.0, 5.0);

    fn view() -> CameraView {
        let target = Vec3::new(-1.0, 0.5, 0.0);
        let camera = Camera::look_at(EYE.as_vec3(), target, Vec3::Y, 0.8);
        CameraView { camera, width: 640, height: 360 }
    }

    fn assert_is_view(camera: &FileCamera) {
        let (found, expected) = (camera.camera(DVec3::ZERO, 45.83662), view().camera);
        let [found_matrix, matrix] = [&found, &expected].map(|c| Mat4::from(c.transform));
        assert!(found_matrix.abs_diff_eq(matrix, 1e-4), "{found_matrix} {matrix}");
        assert!((found.yfov - expected.yfov).abs() < 1e-4, "{}", found.yfov);
    }

    fn metadata(attributes: &[(&str, Mat4)]) -> Metadata {
        let attribute =
            |(name, matrix): &(&str, Mat4)| ((*name).to_owned(), AttributeValue::Matrix(*matrix));
        Metadata { attributes: attributes.iter().map(attribute).collect(), ..Metadata::default() }
    }

    #[test]
    fn matrices_of_images_give_their_camera_back() {
        let (ndc, camera) = (view().world_to_ndc(), view().world_to_camera());
        let read = |attributes: &[(&str, Mat4)]| FileCamera::from_metadata(&metadata(attributes));
        assert_is_view(&read(&[("worldToNDC", ndc)]).unwrap().unwrap());
        assert_is_view(&read(&[("worldToCamera", camera)]).unwrap().unwrap());
        assert_eq!(read(&[]), Ok(None));
        // −1 to 1, y upward.
        let signed = Mat4::from_cols_array_2d(&[
            [2.0, 0.0, 0.0, 0.0],
            [0.0, -2.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [-1.0, 1.0, 0.0, 1.0],
        ]);
        assert_is_view(&read(&[("worldToNDC", signed * ndc)]).unwrap().unwrap());
        // The convention of camera space does not matter where there is a projection.
        let flipped = Mat4::from_scale(Vec3::new(1.0, 1.0, -1.0)) * camera;
        let both = read(&[("worldToNDC", ndc), ("worldToCamera", flipped)]);
        assert_is_view(&both.unwrap().unwrap());
        for (matrix, expected) in [
            (ndc.transpose(), "worldToNDC"),
            (Mat4::IDENTITY, "no perspective"),
            (Mat4::from_translation(Vec3::new(0.0, 0.0, f32::NAN)), "no perspective"),
            (ndc * Mat4::from_scale(Vec3::new(-1.0, 1.0, 1.0)), "mirrors"),
        ] {
            let message = read(&[("worldToNDC", matrix)]).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
    }

    fn from_json(text: &str) -> Result<FileCamera, PbgiError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.json");
        std::fs::write(&path, text).unwrap();
        FileCamera::read(&path)
    }

    #[test]
    fn json_cameras_are_read() {
        let fov = "\"fov\": 45.83662";
        let text = format!(r#"{{"position": [3, 2, 5], "target": [-1, 0.5, 0], {fov}}}"#);
        assert_is_view(&from_json(&text).unwrap());
        let rows = Mat4::from(view().camera.transform).transpose().to_cols_array_2d();
        let text = format!(r#"{{"camera_to_world": {rows:?}, {fov}}}"#);
        assert_is_view(&from_json(&text).unwrap());
        let transposed = Mat4::from(view().camera.transform).to_cols_array_2d();
        for (text, expected) in [
            (format!(r#"{{"camera_to_world": {transposed:?}}}"#), "transpose it"),
            (r#"{"position": [1, 2, 3]}"#.into(), "expected either"),
            (r#"{"position": [1, 2, 3], "target": [1, 2, 3]}"#.into(), "must differ"),
            (r#"{"position": [0, 0, 0], "target": [0, 1, 0]}"#.into(), "must differ"),
            (r#"{"position": [0, 0, 0], "target": [1, 0, 0], "fov": 180}"#.into(), "fov is 180"),
            (r#"{"eye": [0, 0, 0]}"#.into(), "unknown field `eye`"),
            ("[".into(), "not a camera"),
        ] {
            let error = from_json(&text).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
            assert_eq!(error.exit_code(), 3);
        }
    }
}
