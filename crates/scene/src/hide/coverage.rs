//! Which micropolygons each pixel shows, and images made of their values.

use super::tiles::PixelRect;
use crate::CameraView;
use pbgi_math::Vec3;
use rayon::prelude::*;

/// A part of a pixel: samples that show the same micropolygon or surfel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fragment {
    /// Index into the list of micropolygons or surfels.
    pub index: u32,
    /// Samples of the pixel that show it.
    pub samples: u32,
}

/// Fragments of every pixel of a window of the image, in rows from the top.
#[derive(Clone, Debug)]
pub struct Coverage {
    view: CameraView,
    window: PixelRect,
    samples: u32,
    /// First fragment of each pixel, and the total.
    starts: Vec<u32>,
    fragments: Vec<Fragment>,
}

/// Fragments of the pixels of one rectangle, in rows.
pub(super) struct RectFragments {
    pub rect: PixelRect,
    pub counts: Vec<u32>,
    pub fragments: Vec<Fragment>,
}

impl Coverage {
    /// Joins rectangles that tile the window.
    pub(super) fn join(
        view: &CameraView,
        window: PixelRect,
        samples: u32,
        parts: &[RectFragments],
    ) -> Self {
        let width = (window.x1 - window.x0) as usize;
        let pixel_count = width * (window.y1 - window.y0) as usize;
        let place = |part: &RectFragments, row: u32| {
            (part.rect.y0 + row - window.y0) as usize * width + (part.rect.x0 - window.x0) as usize
        };
        let mut starts = vec![0u32; pixel_count + 1];
        for part in parts.iter().filter(|part| !part.rect.is_empty()) {
            let row_length = (part.rect.x1 - part.rect.x0) as usize;
            for (row, counts) in part.counts.chunks_exact(row_length).enumerate() {
                let first = place(part, row as u32) + 1;
                starts[first..first + row_length].copy_from_slice(counts);
            }
        }
        for pixel in 0..pixel_count {
            starts[pixel + 1] += starts[pixel];
        }
        let empty = Fragment { index: 0, samples: 0 };
        let mut fragments = vec![empty; starts[pixel_count] as usize];
        for part in parts.iter().filter(|part| !part.rect.is_empty()) {
            let row_length = (part.rect.x1 - part.rect.x0) as usize;
            let mut rest = part.fragments.as_slice();
            for (row, counts) in part.counts.chunks_exact(row_length).enumerate() {
                let (these, others) = rest.split_at(counts.iter().sum::<u32>() as usize);
                let first = starts[place(part, row as u32)] as usize;
                fragments[first..first + these.len()].copy_from_slice(these);
                rest = others;
            }
        }
        Self { view: view.clone(), window, samples, starts, fragments }
    }

    /// Pixels along a row of the window.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.window.x1 - self.window.x0
    }

    /// Rows of the window.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.window.y1 - self.window.y0
    }

    /// Column and row in the image of the window's top left pixel.
    #[must_use]
    pub fn origin(&self) -> [u32; 2] {
        [self.window.x0, self.window.y0]
    }

    /// Samples per pixel.
    #[must_use]
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// What a pixel shows, largest part first (of equal parts the nearer). `pixel` counts along the
    /// rows of the window. Samples that no fragment claims show the background.
    #[must_use]
    pub fn fragments(&self, pixel: usize) -> &[Fragment] {
        &self.fragments[self.starts[pixel] as usize..self.starts[pixel + 1] as usize]
    }

    /// Number of pixels in the window.
    #[must_use]
    pub fn pixel_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Covered part of each pixel, 0..=1.
    #[must_use]
    pub fn alpha(&self) -> Vec<f32> {
        let of = |pixel| self.covered_samples(pixel) as f32 / self.samples as f32;
        (0..self.pixel_count()).into_par_iter().map(of).collect()
    }

    /// Unit world direction through the middle of a pixel.
    #[must_use]
    pub fn pixel_direction(&self, pixel: usize) -> Vec3 {
        let column = self.window.x0 + pixel as u32 % self.width();
        let row = self.window.y0 + pixel as u32 / self.width();
        self.view.ray(column as f32 + 0.5, row as f32 + 0.5).1
    }

    /// Antialiased image: the mean over the samples of each pixel (box filter) of `value` of what
    /// they show, or of `background` for the pixel's direction where they show nothing.
    #[must_use]
    pub fn resolve<const K: usize>(
        &self,
        value: impl Fn(usize) -> [f32; K] + Sync,
        background: impl Fn(Vec3) -> [f32; K] + Sync,
    ) -> Vec<[f32; K]> {
        let per_sample = 1.0 / self.samples as f32;
        let pixel_value = |pixel: usize| {
            let mut sum = [0f32; K];
            let mut add = |values: [f32; K], samples: u32| {
                for k in 0..K {
                    sum[k] += values[k] * samples as f32;
                }
            };
            for fragment in self.fragments(pixel) {
                add(value(fragment.index as usize), fragment.samples);
            }
            let open = self.samples - self.covered_samples(pixel);
            if open > 0 {
                add(background(self.pixel_direction(pixel)), open);
            }
            sum.iter_mut().for_each(|total| *total *= per_sample);
            sum
        };
        (0..self.pixel_count()).into_par_iter().map(pixel_value).collect()
    }

    /// Image of data that must not be mixed, such as positions: the value of each pixel's largest
    /// fragment, or `empty` where there is none.
    #[must_use]
    pub fn resolve_nearest<const K: usize>(
        &self,
        value: impl Fn(usize) -> [f32; K] + Sync,
        empty: [f32; K],
    ) -> Vec<[f32; K]> {
        let of = |pixel| {
            self.fragments(pixel).first().map_or(empty, |fragment| value(fragment.index as usize))
        };
        (0..self.pixel_count()).into_par_iter().map(of).collect()
    }

    fn covered_samples(&self, pixel: usize) -> u32 {
        self.fragments(pixel).iter().map(|fragment| fragment.samples).sum()
    }
}
