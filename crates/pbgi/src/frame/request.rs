//! What picture to make.

use crate::frame::camera_choice::CameraChoice;
use crate::shade::ShadeSettings;
use pbgi_image::{Aov, AovNames};
use pbgi_scene::{HideOptions, PixelWindow, Scene};
use std::path::Path;

/// What picture to make.
#[derive(Clone, Debug)]
pub struct FrameRequest<'a> {
    /// The octree file that lights and blocks.
    pub octree: &'a Path,
    /// The scene whose visible surfaces are shaded, in the world coordinates the octree was baked in.
    /// Without one, the surfels of the octree themselves are drawn and shaded.
    pub scene: Option<&'a Scene>,
    /// The camera.
    pub camera: CameraChoice,
    /// Pixels along a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Samples per pixel for coverage: 1, 4, 8 or 16.
    pub samples: u32,
    /// Wanted area of a micropolygon in pixels.
    pub shading_rate: f32,
    /// Channels to make.
    pub aovs: Vec<Aov>,
    /// Names of the channels.
    pub names: AovNames,
    /// A folder where rows that are done wait for the others where the memory limit does not hold them: in a file without a name.
    /// Without one they are in memory.
    pub scratch: Option<&'a Path>,
    /// Quality, light and resources.
    pub settings: ShadeSettings,
}

impl FrameRequest<'_> {
    /// How finely a part of the picture, or all of it, is hidden.
    pub(crate) fn hide_options(&self, window: Option<PixelWindow>) -> HideOptions {
        HideOptions { samples: self.samples, shading_rate: self.shading_rate, window }
    }
}

/// The quantities a frame can have. [`Aov::SpecularIndirect`] is 0 without [`ShadeSettings::gloss`].
pub const FRAME_AOVS: [Aov; 12] = [
    Aov::Beauty,
    Aov::DiffuseDirect,
    Aov::DiffuseIndirect,
    Aov::SpecularIndirect,
    Aov::Irradiance,
    Aov::Occlusion,
    Aov::SkyVisibility,
    Aov::BentNormal,
    Aov::Position,
    Aov::Normal,
    Aov::Depth,
    Aov::Albedo,
];
