//! All channels of a frame at a glance.

use crate::PbgiError;
use crate::frame::Frame;
use pbgi_image::{Aov, ImageError, Tile, ToneMap, auto_exposure, write_contact_sheet};
use std::borrow::Cow;
use std::ops::Range;
use std::path::Path;

/// Largest edge of a tile in pixels.
const TILE_EDGE_MAX: usize = 480;

impl Frame {
    /// Writes a PNG with a small picture of every quantity: light with a filmic curve, the exposure chosen for each
    /// unless given in stops; visibility and albedo as they are; directions and places spread over 0..=1; depth from near
    /// (bright) to far.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_contact_sheet(&self, path: &Path, exposure: Option<f32>) -> Result<(), PbgiError> {
        let (width, height) = (self.planes.width(), self.planes.height());
        let factor = width.max(height).div_ceil(TILE_EDGE_MAX).max(1);
        let covered =
            shrink(width, height, factor, |rows| Ok(Cow::Owned(self.preview.read_covered(rows)?)))?;
        let covered: Vec<bool> = covered.into_iter().map(|share| share > 0.5).collect();
        let tile = |(aov, names): &(Aov, Vec<String>)| {
            let planes = names
                .iter()
                .filter_map(|name| self.planes.find(name))
                .map(|plane| {
                    shrink(width, height, factor, |rows| self.planes.read_rows(plane, rows))
                })
                .collect::<Result<Vec<_>, _>>()?;
            let pixels = display(*aov, &planes, &covered, exposure);
            Ok(Tile { title: title(names), pixels })
        };
        let tiles = self.layers.iter().map(tile).collect::<Result<Vec<Tile>, ImageError>>()?;
        let (width, height) = (width.div_ceil(factor), height.div_ceil(factor));
        Ok(write_contact_sheet(path, width, height, &tiles)?)
    }
}

/// The common part of channel names: their layer; `beauty` where there is none.
fn title(names: &[String]) -> String {
    match names {
        [name] => name.clone(),
        [first, ..] => first.rsplit_once('.').map_or("beauty", |(layer, _)| layer).to_owned(),
        [] => String::new(),
    }
}

/// Means of blocks of `factor × factor` pixels, smaller ones at the right and the bottom, of rows that `read` gives.
fn shrink<'a>(
    width: usize,
    height: usize,
    factor: usize,
    read: impl Fn(Range<usize>) -> Result<Cow<'a, [f32]>, ImageError>,
) -> Result<Vec<f32>, ImageError> {
    let mut means = Vec::with_capacity(width.div_ceil(factor) * height.div_ceil(factor));
    for y in (0..height).step_by(factor) {
        let rows = factor.min(height - y);
        let samples = read(y..y + rows)?;
        for x in (0..width).step_by(factor) {
            let columns = factor.min(width - x);
            let row_sum =
                |row: usize| -> f32 { samples[row * width + x..][..columns].iter().sum() };
            let sum: f32 = (0..rows).map(row_sum).sum();
            means.push(sum / (columns * rows) as f32);
        }
    }
    Ok(means)
}

/// Linear display colors of a quantity.
fn display(
    aov: Aov,
    planes: &[Vec<f32>],
    covered: &[bool],
    exposure: Option<f32>,
) -> Vec<[f32; 3]> {
    let value = |k: usize, i: usize| {
        planes.get(k.min(planes.len().saturating_sub(1))).map_or(0.0, |p| p[i])
    };
    let colors: Vec<[f32; 3]> =
        (0..covered.len()).map(|i| [0, 1, 2].map(|k| value(k, i))).collect();
    match aov {
        Aov::Beauty
        | Aov::DiffuseIndirect
        | Aov::DiffuseDirect
        | Aov::SpecularIndirect
        | Aov::Irradiance => {
            let exposure = exposure.unwrap_or_else(|| auto_exposure(&colors, Some(covered)));
            let tone = ToneMap { exposure, filmic: true };
            colors.into_iter().map(|color| tone.map(color)).collect()
        }
        Aov::Normal | Aov::BentNormal | Aov::View => spread(colors, covered, [(-1.0, 1.0); 3]),
        Aov::Position => {
            let ranges = [0, 1, 2].map(|k| range_of(&colors, covered, k));
            spread(colors, covered, ranges)
        }
        Aov::Depth => {
            let (near, far) = range_of(&colors, covered, 0);
            spread(colors, covered, [(far, near); 3])
        }
        _ => colors.into_iter().map(|color| color.map(|c| c.clamp(0.0, 1.0))).collect(),
    }
}

/// Smallest and largest value of a channel where there are surfaces.
fn range_of(colors: &[[f32; 3]], covered: &[bool], channel: usize) -> (f32, f32) {
    let values = colors.iter().zip(covered).filter(|(_, covered)| **covered);
    let values = values.map(|(color, _)| color[channel]).filter(|value| value.is_finite());
    values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// Surfaces with each channel spread from its first to its second value over 0..=1; black elsewhere.
fn spread(colors: Vec<[f32; 3]>, covered: &[bool], ranges: [(f32, f32); 3]) -> Vec<[f32; 3]> {
    let place =
        |value: f32, (from, to): (f32, f32)| match ((value - from) / (to - from)).clamp(0.0, 1.0) {
            share if share.is_nan() => 0.0,
            share => share,
        };
    let pixels = colors.into_iter().zip(covered);
    let color = |color: [f32; 3]| [0, 1, 2].map(|k| place(color[k], ranges[k]));
    pixels.map(|(c, covered)| if *covered { color(c) } else { [0.0; 3] }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_at_the_border_are_smaller() {
        let image = [0.0, 2.0, 4.0, 2.0, 4.0, 8.0];
        let read = |rows: Range<usize>| Ok(Cow::Borrowed(&image[3 * rows.start..3 * rows.end]));
        assert_eq!(shrink(3, 2, 2, read).unwrap(), [2.0, 6.0]);
        assert_eq!(shrink(3, 2, 1, read).unwrap(), image);
    }

    #[test]
    fn quantities_are_spread_as_suits_them() {
        let covered = [true, true, false];
        let depth = display(Aov::Depth, &[vec![1.0, 5.0, 1e10]], &covered, None);
        assert_eq!(depth, [[1.0; 3], [0.0; 3], [0.0; 3]]);
        let planes = [vec![1.0, 0.0, 0.0], vec![0.0, -1.0, 0.0], vec![0.0; 3]];
        let normals = display(Aov::Normal, &planes, &covered, None);
        assert_eq!(normals, [[1.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.0; 3]]);
        let open = display(Aov::Occlusion, &[vec![0.25, 1.0, 2.0]], &covered, None);
        assert_eq!(open, [[0.25; 3], [1.0; 3], [1.0; 3]]);
        // A plane has no extent in one direction.
        let places = display(
            Aov::Position,
            &[vec![3.0; 3], vec![f32::NAN; 3], vec![1.0; 3]],
            &covered,
            None,
        );
        assert!(places.iter().flatten().all(|c| *c == 0.0));
        let light = display(Aov::Irradiance, &[vec![0.01, 100.0, 0.0]], &covered, Some(0.0));
        assert!(light[0][0] == 0.01 && light[1][0] < 1.0);
    }

    #[test]
    fn titles_are_layers() {
        let of = |names: &[&str]| {
            title(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
        };
        assert_eq!(of(&["R", "G", "B", "A"]), "beauty");
        assert_eq!(of(&["irradiance.R", "irradiance.G"]), "irradiance");
        assert_eq!(of(&["AO"]), "AO");
    }
}
