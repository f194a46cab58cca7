//! What a picture looks like at a glance.

use crate::PbgiError;
use pbgi_image::{Image, ImageError, Planes, ToneMap, auto_exposure_of, write_png_rows};
use std::ops::Range;
use std::path::Path;

/// The beauty, or ambient occlusion where there is no light, and where there are surfaces.
#[derive(Debug)]
pub(crate) struct Preview {
    /// As [`preview_names`] lists them.
    planes: Planes,
    is_lit: bool,
}

/// Planes of a preview: its colors, or one gray, then 1 where surfaces are and else 0.
pub(crate) fn preview_names(is_lit: bool) -> Vec<String> {
    let colors: &[&str] = if is_lit { &["R", "G", "B"] } else { &["AO"] };
    colors.iter().chain(&["covered"]).map(|name| (*name).to_owned()).collect()
}

impl Preview {
    /// A preview of planes that [`preview_names`] lists.
    pub fn new(planes: Planes, is_lit: bool) -> Self {
        Self { planes, is_lit }
    }

    /// A preview of pixels in memory.
    pub fn of_pixels(
        size: [usize; 2],
        is_lit: bool,
        beauty: &[[f32; 3]],
        occlusion: Vec<f32>,
        covered: &[bool],
    ) -> Self {
        let mut image = Image::new(size[0], size[1]);
        match is_lit {
            true => image.push_rgb(["R", "G", "B"], beauty),
            false => image.push("AO", occlusion),
        }
        image.push("covered", covered.iter().map(|covered| f32::from(*covered)).collect());
        Self::new(image.into(), is_lit)
    }

    /// 1 where surfaces are in these rows, else 0.
    pub fn read_covered(&self, rows: Range<usize>) -> Result<Vec<f32>, ImageError> {
        let plane = self.planes.names().len() - 1;
        Ok(self.planes.read_rows(plane, rows)?.into_owned())
    }

    /// Appends the colors of a row.
    fn read_row(&self, y: usize, row: &mut Vec<[f32; 3]>) -> Result<(), ImageError> {
        let read = |plane: usize| self.planes.read_rows(plane, y..y + 1);
        match self.is_lit {
            true => {
                let (r, g, b) = (read(0)?, read(1)?, read(2)?);
                row.extend(r.iter().zip(&*g).zip(&*b).map(|((r, g), b)| [*r, *g, *b]));
            }
            false => row.extend(read(0)?.iter().map(|gray| [*gray; 3])),
        }
        Ok(())
    }

    /// The exposure that suits the surfaces.
    fn exposure(&self) -> Result<f32, ImageError> {
        if !self.is_lit {
            return Ok(0.0);
        }
        let mut row = Vec::new();
        auto_exposure_of(|take| {
            for y in 0..self.planes.height() {
                row.clear();
                self.read_row(y, &mut row)?;
                let pixels = row.iter().zip(self.read_covered(y..y + 1)?);
                pixels.filter(|(_, covered)| *covered > 0.5).for_each(|(color, _)| take(*color));
            }
            Ok(())
        })
    }

    /// Writes it as a PNG; `exposure` is in stops.
    pub fn write(&self, path: &Path, exposure: Option<f32>) -> Result<(), PbgiError> {
        let exposure = exposure.map_or_else(|| self.exposure(), Ok)?;
        let tone = ToneMap { exposure, filmic: self.is_lit };
        let (width, height) = (self.planes.width(), self.planes.height());
        Ok(write_png_rows(path, width, height, tone, |y, row| self.read_row(y, row))?)
    }
}
