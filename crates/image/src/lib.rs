//! Images in and out: multichannel EXR, HDR environments, PNG previews, AOV names, error metrics.
//!
//! Pixels are 32-bit floats in memory, linear, rows from the top. This crate must never know what a
//! surfel, a receiver or an environment's geometry is: it moves named channels between files and memory.
#![forbid(unsafe_code)]

mod aov;
mod atomic;
mod chromaticities;
mod contact_sheet;
mod environment;
mod error;
mod exr_read;
mod exr_write;
mod hdr;
mod image;
mod metrics;
mod planes;
mod png;
mod tone;

pub use self::image::{
    AttributeValue, Channel, Image, ImageWindow, Metadata, RgbImage, Samples, StoredChannel,
    StoredImage,
};
pub use aov::{Aov, AovNames, AovPreset};
pub use atomic::write_atomically;
pub use chromaticities::Chromaticities;
pub use contact_sheet::{Tile, write_contact_sheet};
pub use environment::{
    ReadEnvironment, read_environment, read_environment_noting, read_environment_noting_within,
    read_hdr,
};
pub use error::ImageError;
pub use exr_read::{read_exr, read_exr_metadata, read_stored_exr, read_stored_exr_within};
pub use exr_write::{
    LAYOUT_ATTRIBUTES, exr_write_bytes, write_environment_exr, write_exr, write_planes_exr,
    write_windowed_exr,
};
pub use metrics::{ErrorMetrics, MetricsError, compare, squared_errors};
pub use planes::Planes;
pub use png::{write_png, write_png_rows};
pub use tone::{ToneMap, auto_exposure, auto_exposure_of};
