//! Which camera a frame is seen through.

use crate::PbgiError;
use crate::frame::camera_file::{FileCamera, bad_fov};
use pbgi_math::{Aabb, DVec3, Vec3};
use pbgi_scene::{Camera, Scene};
use std::path::PathBuf;

/// Vertical field of view where none is given, in degrees.
const FOV_DEGREES: f32 = 45.0;

/// Which camera to use.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum CameraChoice {
    /// The scene's first camera; without one, a three-quarter view of everything.
    #[default]
    Default,
    /// A camera of the scene by its name, or else by its number from 0.
    Named(String),
    /// The camera of a JSON file, or of the attributes of an EXR image.
    File {
        /// The file.
        path: PathBuf,
        /// Full vertical field of view in degrees where the file has none; 45 if not given.
        fov_degrees: Option<f32>,
    },
    /// A camera given by numbers.
    LookAt {
        /// Place of the eye in the world.
        position: DVec3,
        /// What it looks at.
        target: DVec3,
        /// What is up in the image; the file's up axis if not given.
        up: Option<Vec3>,
        /// Full vertical field of view in degrees; 45 if not given.
        fov_degrees: Option<f32>,
        /// Turn of the position about the line through the target along the up direction, in degrees, counterclockwise
        /// seen from above.
        turned_degrees: f64,
    },
}

/// Where a camera is to be found, and what it has to show.
pub(crate) struct CameraContext<'a> {
    pub scene: Option<&'a Scene>,
    /// Box of what there is to see, relative to `origin`.
    pub bounds: Aabb,
    pub up: Vec3,
    /// Width over height of the image.
    pub aspect: f32,
    /// World position of the origin of camera coordinates.
    pub origin: DVec3,
}

impl CameraContext<'_> {
    /// The camera that `choice` means, relative to the context's origin.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`] if there is no such camera or its numbers make none.
    pub fn find(&self, choice: &CameraChoice) -> Result<Camera, PbgiError> {
        let cameras = self.scene.map_or(&[][..], |scene| scene.cameras.as_slice());
        match choice {
            CameraChoice::Default => Ok(match cameras.first() {
                Some(camera) => camera.clone(),
                None => {
                    let fov = FOV_DEGREES.to_radians();
                    Camera::framing(&self.bounds, self.up, self.aspect, fov)
                }
            }),
            CameraChoice::Named(name) => {
                let by_name = cameras.iter().find(|camera| camera.name == *name);
                let by_number = || cameras.get(name.parse::<usize>().ok()?);
                let found = by_name.or_else(by_number).cloned();
                found.ok_or_else(|| no_such_camera(name, cameras))
            }
            CameraChoice::File { path, fov_degrees } => {
                let fov = check_fov(*fov_degrees)?;
                Ok(FileCamera::read(path)?.camera(self.origin, fov))
            }
            CameraChoice::LookAt { position, target, up, fov_degrees, turned_degrees } => {
                let fov = check_fov(*fov_degrees)?;
                let up = up.unwrap_or(self.up);
                if !(position.is_finite() && target.is_finite()) || position == target {
                    return Err(PbgiError::usage(format!(
                        "the camera's position {position} and target {target} must be different \
                         finite places"
                    )));
                }
                if !up.is_finite() || up == Vec3::ZERO {
                    return Err(PbgiError::usage(format!(
                        "the camera's up direction {up} must be a finite vector other than 0"
                    )));
                }
                let local = |p: DVec3| (p - self.origin).as_vec3();
                let up = up.normalize();
                let position = turn_about(*position, *target, up, *turned_degrees);
                Ok(Camera::look_at(local(position), local(*target), up, fov.to_radians()))
            }
        }
    }
}

/// `position` turned about the line through `target` along the unit vector `up`: Rodrigues' formula.
fn turn_about(position: DVec3, target: DVec3, up: Vec3, degrees: f64) -> DVec3 {
    if degrees == 0.0 {
        return position;
    }
    let (arm, up) = (position - target, up.as_dvec3());
    let (sin, cos) = degrees.to_radians().sin_cos();
    target + arm * cos + up.cross(arm) * sin + up * (up.dot(arm) * (1.0 - cos))
}

/// A field of view in degrees, that of no choice in place of none.
fn check_fov(fov_degrees: Option<f32>) -> Result<f32, PbgiError> {
    let fov = fov_degrees.unwrap_or(FOV_DEGREES);
    match bad_fov(fov) {
        None => Ok(fov),
        Some(problem) => Err(PbgiError::usage(format!("the field of view is {problem}"))),
    }
}

fn no_such_camera(name: &str, cameras: &[Camera]) -> PbgiError {
    let list: Vec<String> =
        cameras.iter().enumerate().map(|(i, c)| format!("{i} \"{}\"", c.name)).collect();
    let there = match list.is_empty() {
        true => {
            "there are none; use --camera-file, or --camera-position and --camera-target".to_owned()
        }
        false => format!("there are {}", list.join(", ")),
    };
    PbgiError::usage(format!("there is no camera \"{name}\"; {there}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn context(scene: Option<&Scene>) -> CameraContext<'_> {
        CameraContext {
            scene,
            bounds: Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE },
            up: Vec3::Z,
            aspect: 1.5,
            origin: DVec3::new(5e6, 0.0, 0.0),
        }
    }

    fn named(name: &str) -> Camera {
        Camera { name: name.to_owned(), ..Camera::look_at(Vec3::X, Vec3::ZERO, Vec3::Y, 1.0) }
    }

    #[test]
    fn cameras_are_found_by_name_then_by_number() {
        let scene = Scene { cameras: vec![named("wide"), named("0")], ..Scene::default() };
        let find = |text: &str| context(Some(&scene)).find(&CameraChoice::Named(text.to_owned()));
        assert_eq!(find("0").unwrap().name, "0");
        assert_eq!(find("1").unwrap().name, "0");
        assert_eq!(find("wide").unwrap().name, "wide");
        let message = find("tele").unwrap_err().to_string();
        assert!(message.contains("0 \"wide\"") && message.contains("tele"), "{message}");
        assert_eq!(context(Some(&scene)).find(&CameraChoice::Default).unwrap().name, "wide");
    }

    #[test]
    fn look_at_is_relative_to_the_origin() {
        let choice = CameraChoice::LookAt {
            position: DVec3::new(5e6 + 3.0, 0.0, 1.0),
            target: DVec3::new(5e6, 0.0, 1.0),
            up: None,
            fov_degrees: None,
            turned_degrees: 0.0,
        };
        let camera = context(None).find(&choice).unwrap();
        assert_eq!(Vec3::from(camera.transform.translation), Vec3::new(3.0, 0.0, 1.0));
        let above: Vec3 = camera.transform.matrix3.y_axis.into();
        assert!((above - Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn cameras_turn_about_their_target() {
        let (eye, target) = (DVec3::new(3.0, 4.0, 7.0), DVec3::new(1.0, 4.0, 5.0));
        let turned = |degrees| turn_about(eye, target, Vec3::Z, degrees);
        assert!(turned(90.0).distance(DVec3::new(1.0, 6.0, 7.0)) < 1e-12);
        assert!(turned(-180.0).distance(DVec3::new(-1.0, 4.0, 7.0)) < 1e-12);
        assert!(turned(360.0).distance(eye) < 1e-12);
        assert_eq!(turned(0.0), eye);
    }

    #[test]
    fn cameras_without_a_view_are_misuse() {
        let place = DVec3::ONE;
        for (target, up, fov_degrees) in [
            (place, None, None),
            (DVec3::NAN, None, None),
            (DVec3::ZERO, Some(Vec3::ZERO), None),
            (DVec3::ZERO, None, Some(180.0)),
            (DVec3::ZERO, None, Some(f32::NAN)),
        ] {
            let choice = CameraChoice::LookAt {
                position: place,
                target,
                up,
                fov_degrees,
                turned_degrees: 0.0,
            };
            assert_eq!(context(None).find(&choice).unwrap_err().exit_code(), 2);
        }
    }
}
