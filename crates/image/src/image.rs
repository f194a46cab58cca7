//! Images in memory.

use crate::Chromaticities;
use half::f16;
use pbgi_math::Mat4;

/// One named channel of an [`Image`].
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name as in the file, with its layer: `R`, `diffuse_indirect.G`, `N.X`.
    pub name: String,
    /// Row-major samples, top row first; `width · height` of them.
    pub data: Vec<f32>,
}

/// A float image with any number of named channels of one size.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The channels; names are unique.
    pub channels: Vec<Channel>,
}

impl Image {
    /// An image without channels.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, channels: Vec::new() }
    }

    /// Samples of the channel `name`, where there is one.
    #[must_use]
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|c| c.name == name).map(|c| c.data.as_slice())
    }

    /// Appends a channel of `width · height` samples.
    ///
    /// # Panics
    ///
    /// If `data` has another length.
    pub fn push(&mut self, name: impl Into<String>, data: Vec<f32>) {
        assert_eq!(data.len(), self.width * self.height, "a channel has a sample per pixel");
        self.channels.push(Channel { name: name.into(), data });
    }

    /// Appends three channels from interleaved pixels.
    ///
    /// # Panics
    ///
    /// If `pixels` does not hold `width · height` pixels.
    pub fn push_rgb(&mut self, names: [&str; 3], pixels: &[[f32; 3]]) {
        for (k, name) in names.into_iter().enumerate() {
            self.push(name, pixels.iter().map(|p| p[k]).collect());
        }
    }

    /// Interleaved pixels of three channels, where all are present.
    #[must_use]
    pub fn rgb(&self, names: [&str; 3]) -> Option<Vec<[f32; 3]>> {
        let [r, g, b] = names.map(|name| self.channel(name));
        let (r, g, b) = (r?, g?, b?);
        Some(r.iter().zip(g).zip(b).map(|((&r, &g), &b)| [r, g, b]).collect())
    }
}

/// Samples as an EXR file stores them.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// `half`.
    Half(Vec<f16>),
    /// `float`; bits of any kind, as Cryptomatte keeps them, stay as they are.
    Float(Vec<f32>),
    /// `uint`.
    Uint(Vec<u32>),
}

impl Samples {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Half(samples) => samples.len(),
            Self::Float(samples) => samples.len(),
            Self::Uint(samples) => samples.len(),
        }
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// As floats; `uint` samples above 2²⁴ are rounded.
    #[must_use]
    pub fn into_floats(self) -> Vec<f32> {
        match self {
            Self::Half(samples) => samples.iter().map(|s| s.to_f32()).collect(),
            Self::Float(samples) => samples,
            Self::Uint(samples) => samples.iter().map(|&s| s as f32).collect(),
        }
    }
}

/// One named channel as an EXR file stores it.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredChannel {
    /// Name with its layer.
    pub name: String,
    /// Row-major samples, top row first.
    pub samples: Samples,
}

/// Channels of one size as an EXR file stores them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoredImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The channels; names are unique.
    pub channels: Vec<StoredChannel>,
}

impl From<StoredImage> for Image {
    fn from(stored: StoredImage) -> Self {
        let float = |c: StoredChannel| Channel { name: c.name, data: c.samples.into_floats() };
        let channels = stored.channels.into_iter().map(float).collect();
        Self { width: stored.width, height: stored.height, channels }
    }
}

/// Where the pixels of an image lie in the frame the camera saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageWindow {
    /// Top left pixel of the data window, whose samples the image holds.
    pub data_origin: [i32; 2],
    /// Top left pixel of the display window: the frame as the camera saw it.
    pub display_origin: [i32; 2],
    /// Columns and rows of the display window.
    pub display_size: [usize; 2],
}

impl ImageWindow {
    /// The window of an image that is the whole frame.
    #[must_use]
    pub fn whole(width: usize, height: usize) -> Self {
        Self { display_size: [width, height], ..Self::default() }
    }
}

/// A linear RGB image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RgbImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major pixels, top row first.
    pub pixels: Vec<[f32; 3]>,
}

/// Value of a header attribute of an EXR file.
#[derive(Clone, Debug, PartialEq)]
pub enum AttributeValue {
    /// `string`, UTF-8.
    Text(String),
    /// `float`.
    Float(f32),
    /// `int`.
    Int(i32),
    /// `m44f`, here in glam's convention, which multiplies column vectors: the translation is the
    /// fourth column. Files hold the transpose, because EXR multiplies row vectors.
    Matrix(Mat4),
}

/// What an EXR file says beside its samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metadata {
    /// Where the samples lie.
    pub window: ImageWindow,
    /// Attributes of the types of [`AttributeValue`], sorted by name; others are left out.
    pub attributes: Vec<(String, AttributeValue)>,
    /// What the channels of color mean, where the file says so; else they are Rec. 709.
    pub chromaticities: Option<Chromaticities>,
    /// Names of parts whose size or place differs from the first part's; they were not read into
    /// the [`Image`].
    pub parts_left_out: Vec<String>,
    /// Whether the file has several parts.
    pub is_multipart: bool,
}

impl Metadata {
    /// Value of the attribute `name`, where there is one.
    #[must_use]
    pub fn attribute(&self, name: &str) -> Option<&AttributeValue> {
        self.attributes.iter().find(|(n, _)| n == name).map(|(_, value)| value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_found_by_name() {
        let mut image = Image::new(2, 1);
        image.push_rgb(["R", "G", "B"], &[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(image.channel("G"), Some(&[2.0, 5.0][..]));
        assert_eq!(image.rgb(["B", "G", "R"]).unwrap(), [[3.0, 2.0, 1.0], [6.0, 5.0, 4.0]]);
        assert_eq!(image.rgb(["R", "G", "A"]), None);
    }
}
