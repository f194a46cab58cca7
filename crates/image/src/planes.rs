//! Channels that grow row by row, in memory or on disk.

use crate::{Channel, Image, ImageError};
use pbgi_file::platform::{free_bytes_beside, read_exact_at, reserve, write_all_at};
use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Bytes of a sample.
const SAMPLE_BYTES: usize = size_of::<f32>();

/// Named float channels of one size, each a plane that grows from the top row down.
///
/// They are in memory, or where it is short in a scratch file, which has no name: nothing of it stays however the process ends. Both
/// give the same samples, bit for bit.
#[derive(Debug)]
pub struct Planes {
    width: usize,
    height: usize,
    names: Vec<String>,
    store: Store,
}

#[derive(Debug)]
enum Store {
    Memory(Vec<Vec<f32>>),
    /// One plane after the other, each with room for all its samples.
    Scratch {
        file: File,
        folder: PathBuf,
        /// Samples that each plane has so far.
        counts: Vec<usize>,
    },
}

impl Planes {
    /// Empty planes in memory.
    #[must_use]
    pub fn in_memory(width: usize, height: usize, names: Vec<String>) -> Self {
        let planes = names.iter().map(|_| Vec::with_capacity(width * height)).collect();
        Self { width, height, names, store: Store::Memory(planes) }
    }

    /// Empty planes in a scratch file in `folder`, whose room on disk is reserved where the file system can.
    ///
    /// # Errors
    ///
    /// [`ImageError::Io`] with the folder if no file can be made there, or the disk has no room for it.
    pub fn in_scratch(
        folder: &Path,
        width: usize,
        height: usize,
        names: Vec<String>,
    ) -> Result<Self, ImageError> {
        let file = tempfile::tempfile_in(folder)
            .map_err(|e| ImageError::io(folder, "create a temporary file", e))?;
        let bytes = (names.len() * width * height * SAMPLE_BYTES) as u64;
        reserve_room(&file, bytes)
            .map_err(|e| ImageError::io(folder, "reserve room for a temporary file", e))?;
        let (folder, counts) = (folder.to_owned(), vec![0; names.len()]);
        Ok(Self { width, height, names, store: Store::Scratch { file, folder, counts } })
    }

    /// Pixels along a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Names of the planes.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Index of the plane `name`, where there is one.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|own| own == name)
    }

    /// Samples that a plane has so far.
    #[must_use]
    pub fn len(&self, plane: usize) -> usize {
        match &self.store {
            Store::Memory(planes) => planes[plane].len(),
            Store::Scratch { counts, .. } => counts[plane],
        }
    }

    /// Whether there are no planes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Appends samples to a plane.
    ///
    /// # Errors
    ///
    /// [`ImageError::Io`] with the folder if the scratch file cannot be written.
    ///
    /// # Panics
    ///
    /// If that is more than its pixels.
    pub fn append(&mut self, plane: usize, samples: &[f32]) -> Result<(), ImageError> {
        let (pixels, before) = (self.width * self.height, self.len(plane));
        assert!(before + samples.len() <= pixels, "a plane has a sample per pixel");
        match &mut self.store {
            Store::Memory(planes) => planes[plane].extend_from_slice(samples),
            Store::Scratch { file, folder, counts } => {
                let mut bytes = Vec::with_capacity(samples.len() * SAMPLE_BYTES);
                bytes.extend(samples.iter().flat_map(|sample| sample.to_le_bytes()));
                write_all_at(file, &bytes, offset_of(plane * pixels + before))
                    .map_err(|e| ImageError::io(folder, "write to a temporary file", e))?;
                counts[plane] += samples.len();
            }
        }
        Ok(())
    }

    /// Samples of a plane.
    ///
    /// # Errors
    ///
    /// [`ImageError::Io`] with the folder if the scratch file cannot be read.
    ///
    /// # Panics
    ///
    /// If the plane has fewer.
    pub fn read(&self, plane: usize, range: Range<usize>) -> Result<Cow<'_, [f32]>, ImageError> {
        match &self.store {
            Store::Memory(planes) => Ok(Cow::Borrowed(&planes[plane][range])),
            Store::Scratch { file, folder, counts } => {
                assert!(range.start <= range.end && range.end <= counts[plane], "{range:?}");
                let mut bytes = vec![0; range.len() * SAMPLE_BYTES];
                let first = plane * self.width * self.height + range.start;
                read_exact_at(file, &mut bytes, offset_of(first))
                    .map_err(|e| ImageError::io(folder, "load from a temporary file", e))?;
                let samples = bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b));
                Ok(Cow::Owned(samples.collect()))
            }
        }
    }

    /// Samples of some rows of a plane.
    ///
    /// # Errors
    ///
    /// As [`Planes::read`].
    ///
    /// # Panics
    ///
    /// If the plane has fewer.
    pub fn read_rows(
        &self,
        plane: usize,
        rows: Range<usize>,
    ) -> Result<Cow<'_, [f32]>, ImageError> {
        self.read(plane, rows.start * self.width..rows.end * self.width)
    }

    /// All planes as an image in memory.
    ///
    /// # Errors
    ///
    /// As [`Planes::read`].
    ///
    /// # Panics
    ///
    /// If a plane lacks samples.
    pub fn to_image(&self) -> Result<Image, ImageError> {
        let mut image = Image::new(self.width, self.height);
        for (plane, name) in self.names.iter().enumerate() {
            image.push(name, self.read(plane, 0..self.len(plane))?.into_owned());
        }
        Ok(image)
    }
}

impl From<Image> for Planes {
    fn from(image: Image) -> Self {
        let Image { width, height, channels } = image;
        let (names, planes) =
            channels.into_iter().map(|Channel { name, data }| (name, data)).unzip();
        Self { width, height, names, store: Store::Memory(planes) }
    }
}

/// Room left on the disk for others.
const FREE_BYTES_MIN: u64 = 16 << 20;

/// Reserves disk space for a file, none of it where there is not enough: some file systems reserve what they have before they refuse.
fn reserve_room(file: &File, bytes: u64) -> io::Result<()> {
    let needed = bytes.saturating_add(FREE_BYTES_MIN);
    if let Some(free) = free_bytes_beside(file).filter(|free| *free < needed) {
        let text = format!("{needed} bytes are needed, {free} are free");
        return Err(io::Error::new(io::ErrorKind::StorageFull, text));
    }
    if bytes > 0 { reserve(file, 0, bytes) } else { Ok(()) }
}

fn offset_of(sample: usize) -> u64 {
    (sample * SAMPLE_BYTES) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::tempdir;

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|k| format!("layer.{k}")).collect()
    }

    /// Planes of 7 × 5 pixels that grow by rows, and odd bits of floats.
    fn fill(mut planes: Planes) -> Planes {
        for row in 0..5u32 {
            for plane in 0..3 {
                let bits = |x: u32| 0x7f80_0001 ^ ((row * 7 + x) * 0x1357 + plane * 0x10_0000);
                let samples: Vec<f32> = (0..7).map(|x| f32::from_bits(bits(x))).collect();
                planes.append(plane as usize, &samples).unwrap();
            }
        }
        planes
    }

    #[test]
    fn scratch_gives_what_memory_gives_and_has_no_name() {
        let folder = tempdir().unwrap();
        let memory = fill(Planes::in_memory(7, 5, names(3)));
        let scratch = fill(Planes::in_scratch(folder.path(), 7, 5, names(3)).unwrap());
        let bits = |samples: Cow<'_, [f32]>| -> Vec<u32> {
            samples.iter().map(|sample| sample.to_bits()).collect()
        };
        for plane in 0..3 {
            for range in [0..35, 0..0, 3..4, 6..29, 34..35] {
                let found = bits(scratch.read(plane, range.clone()).unwrap());
                assert_eq!(found, bits(memory.read(plane, range.clone()).unwrap()));
                assert_eq!(found.len(), range.len());
            }
            let rows = bits(scratch.read_rows(plane, 1..3).unwrap());
            assert_eq!(rows, bits(memory.read(plane, 7..21).unwrap()));
        }
        assert_ne!(bits(memory.read(0, 0..35).unwrap()), bits(memory.read(1, 0..35).unwrap()));
        assert_eq!((scratch.find("layer.2"), scratch.find("none")), (Some(2), None));
        #[cfg(unix)]
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn images_and_planes_are_the_same_samples() {
        let folder = tempdir().unwrap();
        let mut image = Image::new(3, 2);
        image.push("a", (0..6).map(|i| i as f32).collect());
        image.push("b", (0..6).map(|i| i as f32 * 0.3).collect());
        let planes = Planes::from(image.clone());
        assert_eq!(planes.to_image().unwrap(), image);
        let names = vec!["a".to_owned(), "b".to_owned()];
        let mut scratch = Planes::in_scratch(folder.path(), 3, 2, names).unwrap();
        for plane in 0..2 {
            scratch.append(plane, &image.channels[plane].data).unwrap();
        }
        assert_eq!(scratch.to_image().unwrap(), image);
    }

    #[test]
    fn folders_that_take_no_file_are_named() {
        let missing = Path::new("no-such-folder");
        let error = Planes::in_scratch(missing, 1, 1, names(1)).unwrap_err().to_string();
        assert!(error.starts_with("no-such-folder: create a temporary file failed"), "{error}");
    }

    /// Where the system tells how much room there is, none of it is taken.
    #[test]
    #[cfg(unix)]
    fn full_disks_are_named_at_once() {
        let folder = tempdir().unwrap();
        let error = Planes::in_scratch(folder.path(), 1 << 24, 1 << 24, names(1)).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(folder.path().to_str().unwrap()), "{text}");
        assert!(
            text.contains("temporary file failed: 1125899923619840 bytes are needed"),
            "{text}"
        );
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
