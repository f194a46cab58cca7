//! RenderMan's point clouds, `.ptc`: writing, a bounded number of points at a time.

use crate::CloudError;
use crate::output::{commit_output, create_output};
use crate::ptc::{PTC_MAGIC, encode_normal};
use pbgi_file::AtomicFile;
use pbgi_math::{Aabb, Vec3};
use std::f32::consts::PI;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

/// What every point of a [`PtcWriter`] has.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PtcPoint {
    /// Place in the world.
    pub position: Vec3,
    /// Unit normal, or 0 for none.
    pub normal: Vec3,
    /// Radius of the disk.
    pub radius: f32,
    /// Area of the surface it stands for.
    pub area: f32,
    /// Radiance leaving it, W·m⁻²·sr⁻¹; written as radiosity, π times as much.
    pub radiance: [f32; 3],
    /// Albedo, 0..=1.
    pub albedo: [f32; 3],
}

/// Writes a `.ptc` file of version 0 with the channels `_area`, `_radiosity` and `_albedo`; the last two only where
/// asked for. The file appears when it is complete.
pub struct PtcWriter {
    file: AtomicFile,
    radiosity: bool,
    albedo: bool,
    count: u64,
    bounds: Aabb,
    bytes: Vec<u8>,
}

impl PtcWriter {
    /// Starts the file `path`.
    ///
    /// # Errors
    ///
    /// If the folder cannot be written.
    pub fn create(path: &Path, radiosity: bool, albedo: bool) -> Result<Self, CloudError> {
        let file = create_output(path)?;
        let bounds = Aabb::EMPTY;
        let mut writer = Self { file, radiosity, albedo, count: 0, bounds, bytes: Vec::new() };
        writer.write_header()?;
        Ok(writer)
    }

    /// Appends points.
    ///
    /// # Errors
    ///
    /// If writing fails.
    pub fn write(&mut self, points: &[PtcPoint]) -> Result<(), CloudError> {
        for point in points {
            self.bytes.clear();
            self.push_floats(&point.position.to_array());
            self.bytes.extend(encode_normal(point.normal));
            self.push_floats(&[point.radius, point.area]);
            if self.radiosity {
                self.push_floats(&point.radiance.map(|l| l * PI));
            }
            if self.albedo {
                self.push_floats(&point.albedo);
            }
            self.bounds = self.bounds.with_point(point.position);
            self.flush()?;
        }
        self.count += points.len() as u64;
        Ok(())
    }

    /// Completes the file; it appears under its name. Returns the number of points.
    ///
    /// # Errors
    ///
    /// If writing fails; the file's name is then as it was.
    pub fn finish(mut self) -> Result<u64, CloudError> {
        self.file
            .seek(SeekFrom::Start(0))
            .map_err(|e| CloudError::io(self.file.path(), "write", e))?;
        self.write_header()?;
        commit_output(self.file)?;
        Ok(self.count)
    }

    /// The header has the same length whatever the points.
    fn write_header(&mut self) -> Result<(), CloudError> {
        const IDENTITY: [f32; 16] =
            [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];
        let bounds = match self.count {
            0 => Aabb { min: Vec3::ZERO, max: Vec3::ZERO },
            _ => self.bounds,
        };
        self.bytes.clear();
        self.bytes.extend(PTC_MAGIC);
        self.bytes.extend(0u32.to_le_bytes());
        self.bytes.extend((self.count as f64).to_le_bytes());
        self.push_floats(&bounds.min.to_array());
        self.push_floats(&bounds.max.to_array());
        // No camera made these points, nor an image.
        self.push_floats(&IDENTITY);
        self.push_floats(&IDENTITY);
        self.push_floats(&[1.0; 3]);
        let colors = u32::from(self.radiosity) + u32::from(self.albedo);
        self.bytes.extend((1 + colors).to_le_bytes());
        self.bytes.extend((1 + 3 * colors).to_le_bytes());
        self.bytes.extend(b"float _area\n");
        if self.radiosity {
            self.bytes.extend(b"color _radiosity\n");
        }
        if self.albedo {
            self.bytes.extend(b"color _albedo\n");
        }
        self.flush()
    }

    fn push_floats(&mut self, values: &[f32]) {
        self.bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }

    fn flush(&mut self) -> Result<(), CloudError> {
        self.file.write_all(&self.bytes).map_err(|e| CloudError::io(self.file.path(), "write", e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CloudOptions, PtcPoints, SurfelSource};

    fn point(i: usize) -> PtcPoint {
        let x = i as f32;
        PtcPoint {
            position: Vec3::new(x, -0.5 * x, 3.0),
            normal: if i.is_multiple_of(7) {
                Vec3::ZERO
            } else {
                Vec3::new(x.sin(), x.cos(), 0.3).normalize()
            },
            radius: 0.25 + x,
            area: 0.125,
            radiance: [x, 0.5, 0.0],
            albedo: [0.25, 0.5, 1.0],
        }
    }

    #[test]
    fn written_points_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ptc");
        for (radiosity, albedo) in [(false, false), (true, false), (false, true), (true, true)] {
            let points: Vec<PtcPoint> = (0..5000).map(point).collect();
            let mut writer = PtcWriter::create(&path, radiosity, albedo).unwrap();
            points.chunks(999).for_each(|points| writer.write(points).unwrap());
            assert_eq!(writer.finish().unwrap(), 5000);
            let mut source = PtcPoints::open(&path, &CloudOptions::default()).unwrap();
            assert_eq!(source.count(), Some(5000));
            let mut surfels = Vec::new();
            while source.read_chunk(&mut surfels).unwrap() {}
            assert_eq!(surfels.len(), 5000);
            for (surfel, point) in surfels.iter().zip(&points) {
                assert_eq!(surfel.position, point.position.to_array());
                assert_eq!((surfel.radius, surfel.area), (point.radius, point.area));
                assert_eq!(surfel.is_isotropic(), point.normal == Vec3::ZERO);
                let turned = (surfel.normal() - point.normal).length();
                assert!(surfel.is_isotropic() || turned < 2e-3, "{turned}");
                let radiance = if radiosity { point.radiance } else { [0.0; 3] };
                for (found, expected) in surfel.radiance.iter().zip(radiance) {
                    assert!((found - expected).abs() <= 1e-6 * expected, "{found} {expected}");
                }
                let albedo = if albedo { point.albedo } else { [0.5; 3] };
                assert_eq!(surfel.albedo_rgb(), albedo);
            }
        }
    }

    /// What a reader of the format relies on, byte for byte.
    #[test]
    fn headers_are_those_of_the_format() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ptc");
        let mut writer = PtcWriter::create(&path, true, false).unwrap();
        writer.write(&[point(1), point(2)]).unwrap();
        writer.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(&bytes[..16], b"pptc\0\0\0\0\0\0\0\0\0\0\0\x40");
        let bounds: Vec<f32> =
            bytes[16..40].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        assert_eq!(bounds, [1.0, -1.0, 3.0, 2.0, -0.5, 3.0]);
        let channels = b"\x02\0\0\0\x04\0\0\0float _area\ncolor _radiosity\n";
        assert_eq!(&bytes[180..180 + channels.len()], channels);
        assert_eq!(bytes.len(), 180 + channels.len() + 2 * (20 + 16));
    }
}
