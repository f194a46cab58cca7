//! Images in memory.

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
    /// Top left pixel of the data window, whose samples the [`Image`] holds.
    pub data_origin: [i32; 2],
    /// Top left pixel of the display window: the frame as the camera saw it.
    pub display_origin: [i32; 2],
    /// Columns and rows of the display window.
    pub display_size: [usize; 2],
    /// Attributes of the types of [`AttributeValue`], sorted by name; others are left out.
    pub attributes: Vec<(String, AttributeValue)>,
    /// Names of parts whose size or place differs from the first part's; they were not read into
    /// the [`Image`].
    pub parts_left_out: Vec<String>,
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
