//! Opening a cloud by its name.

use crate::forward_file::ForwardFile;
use crate::las::LAS_MAGIC;
use crate::ptc::PTC_MAGIC;
use crate::raw::RAW_MAGIC;
use crate::{CloudError, CloudOptions, LasPoints, PlyPoints, PtcPoints, RawSource, SurfelSource};
use pbgi_file::open_input;
use std::io::Read;
use std::path::Path;

/// Opens a PLY, LAS, LAZ, PTC or raw surfel file, told apart by their first bytes; `-` is a raw surfel
/// stream on standard input.
///
/// # Errors
///
/// If the file cannot be read, or is of no known kind.
pub fn open_cloud(
    path: &Path,
    options: &CloudOptions,
) -> Result<Box<dyn SurfelSource>, CloudError> {
    if path.as_os_str() == "-" {
        return Ok(Box::new(RawSource::new(std::io::stdin(), path, options)?));
    }
    let file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
    let mut start = Vec::new();
    file.take(RAW_MAGIC.len() as u64)
        .read_to_end(&mut start)
        .map_err(|e| CloudError::io(path, "read", e))?;
    if start == RAW_MAGIC {
        // It reads large blocks by itself.
        Ok(Box::new(RawSource::new(ForwardFile::open(path)?, path, options)?))
    } else if start.starts_with(&LAS_MAGIC) {
        Ok(Box::new(LasPoints::open(path, options)?))
    } else if start.starts_with(b"ply") {
        Ok(Box::new(PlyPoints::open(path, options)?))
    } else if start.starts_with(&PTC_MAGIC) {
        Ok(Box::new(PtcPoints::open(path, options)?))
    } else {
        Err(CloudError::malformed(
            path,
            "not a point cloud this engine reads: expected PLY, LAS, LAZ, PTC, or a raw surfel stream",
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RawKind, SliceSource, write_raw_file};

    #[test]
    fn kinds_are_told_by_their_first_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud");
        let options = CloudOptions::default();
        write_raw_file(&path, RawKind::Full, &mut SliceSource::new(&[])).unwrap();
        assert_eq!(open_cloud(&path, &options).unwrap().count(), Some(0));
        let ply = "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n\
            property float z\nend_header\n";
        std::fs::write(&path, ply).unwrap();
        assert_eq!(open_cloud(&path, &options).unwrap().count(), Some(0));
        for (bytes, expected) in
            [("LASF", "not a LAS file"), ("pptc", "ends in its header"), ("", "not a point cloud")]
        {
            std::fs::write(&path, bytes).unwrap();
            let Err(error) = open_cloud(&path, &options) else { panic!("{bytes} was opened") };
            assert!(error.to_string().contains(expected), "{error}");
        }
        assert!(open_cloud(Path::new("no/such/file"), &options).is_err());
    }
}
