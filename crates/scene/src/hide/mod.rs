//! Hiding: the micropolygons a camera sees.
//!
//! All triangles are drawn into a depth buffer with several samples per pixel. Each covered sample
//! then falls into a cell of a lattice on its triangle whose cells have about the size of the
//! shading rate on the screen; each cell seen is one micropolygon, shaded once however many samples
//! show it (decoupled sampling, Ragan-Kelley et al. 2011). Tiles of the image are independent: a
//! cell that two tiles see is a micropolygon in each, which costs a few percent and makes every
//! window of the image equal, bit for bit, to that part of the whole.

mod coverage;
mod disks;
mod lattice;
mod pattern;
mod project;
mod surface;
mod tiles;
mod triangles;

pub use coverage::{Coverage, Fragment};
pub use disks::{Disk, VisibleSurfels, hide_disks};
pub use triangles::{Micropolygon, VisibleSet, hide};

use crate::CameraView;
use pattern::SamplePattern;
use tiles::{PixelRect, TileGrid};

/// A rectangle of the image to work on, in pixels from the top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelWindow {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// How finely to hide.
#[derive(Clone, Copy, Debug)]
pub struct HideOptions {
    /// Samples per pixel: 1, 4, 8 or 16.
    pub samples: u32,
    /// Wanted area of a micropolygon in pixels, above 0.
    pub shading_rate: f32,
    /// Part of the image to work on; all of it if `None`.
    pub window: Option<PixelWindow>,
}

impl HideOptions {
    /// Refuses a shading rate that is not a positive number.
    ///
    /// # Errors
    ///
    /// [`HideError::ShadingRate`].
    pub fn check_shading_rate(&self) -> Result<(), HideError> {
        let rate = self.shading_rate;
        let is_good = rate > 0.0 && rate.is_finite();
        if is_good { Ok(()) } else { Err(HideError::ShadingRate { rate }) }
    }
}

impl Default for HideOptions {
    fn default() -> Self {
        Self { samples: 8, shading_rate: 1.0, window: None }
    }
}

/// Why nothing could be hidden.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum HideError {
    /// A number of samples without a pattern.
    #[error("{samples} samples per pixel are not supported; use 1, 4, 8 or 16")]
    Samples {
        /// What was asked for.
        samples: u32,
    },
    /// A shading rate that is not a positive number.
    #[error("shading rate {rate} is out of range; use a number of pixels above 0, such as 1")]
    ShadingRate {
        /// What was asked for.
        rate: f32,
    },
    /// An image without pixels, or too large.
    #[error(
        "an image of {width} x {height} pixels is out of range; use 1 to 65536 along each edge"
    )]
    Image {
        /// Pixels along a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A window that is empty or reaches outside the image.
    #[error(
        "window {} x {} at column {}, row {} does not lie in an image of {width} x {height} pixels",
        window.width, window.height, window.x, window.y
    )]
    Window {
        /// What was asked for.
        window: PixelWindow,
        /// Pixels along a row of the image.
        width: u32,
        /// Rows of the image.
        height: u32,
    },
    /// A camera whose matrix or field of view makes no image.
    #[error(
        "camera \"{name}\" makes no image (vertical field of view {yfov} radians); it needs a finite rigid transform and an angle between 0 and {YFOV_MAX}"
    )]
    Camera {
        /// The camera's name.
        name: String,
        /// Its vertical field of view.
        yfov: f32,
    },
    /// More triangles than can be numbered.
    #[error("{count} triangles are too many to hide at once; at most {} fit", u32::MAX)]
    Triangles {
        /// Triangles of all instances.
        count: u64,
    },
}

/// Widest field of view in radians, just below a half-space.
const YFOV_MAX: f32 = 3.13;

/// Longest edge of an image in pixels.
const IMAGE_EDGE_MAX: u32 = 65536;

/// Checked options: the sample pattern and the tiles to work on.
fn prepare(
    view: &CameraView,
    options: &HideOptions,
) -> Result<(SamplePattern, TileGrid), HideError> {
    let pattern = SamplePattern::new(options.samples)
        .ok_or(HideError::Samples { samples: options.samples })?;
    options.check_shading_rate()?;
    let (width, height) = (view.width, view.height);
    if !(1..=IMAGE_EDGE_MAX).contains(&width) || !(1..=IMAGE_EDGE_MAX).contains(&height) {
        return Err(HideError::Image { width, height });
    }
    let camera = &view.camera;
    let angle_is_usable = camera.yfov > 1e-6 && camera.yfov < YFOV_MAX;
    if !angle_is_usable || !camera.transform.is_finite() {
        return Err(HideError::Camera { name: camera.name.clone(), yfov: camera.yfov });
    }
    let image = PixelRect { x0: 0, y0: 0, x1: width, y1: height };
    let Some(window) = options.window else { return Ok((pattern, TileGrid::new(image, image))) };
    let fits = |start: u32, length: u32, end: u32| {
        length > 0 && start.checked_add(length).is_some_and(|stop| stop <= end)
    };
    if !fits(window.x, window.width, width) || !fits(window.y, window.height, height) {
        return Err(HideError::Window { window, width, height });
    }
    let window = PixelRect {
        x0: window.x,
        y0: window.y,
        x1: window.x + window.width,
        y1: window.y + window.height,
    };
    Ok((pattern, TileGrid::new(image, window)))
}

#[cfg(test)]
mod tests;
