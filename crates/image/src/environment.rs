//! Reading of environments: EXR or Radiance HDR, checked pixel by pixel.

use crate::error::catch_decoder_panic;
use crate::exr_read::read_exr_within;
use crate::{Image, ImageError, RgbImage};
use ::image::{DynamicImage, ImageDecoder, codecs::hdr::HdrDecoder};
use pbgi_file::{Allowance, open_input};
use std::io::{BufReader, Read};
use std::path::Path;

/// Most pixels one byte of an HDR file can stand for. Run lengths code 127 samples in 2 bytes, so
/// 4 channels make 16 pixels a byte; the older scheme reaches 64 (255 pixels in 4 bytes).
const HDR_PIXELS_PER_BYTE_MAX: u64 = 64;

/// Bytes of a color.
const COLOR_BYTES: u64 = size_of::<[f32; 3]>() as u64;

/// Reads an environment, an EXR or Radiance HDR file, told apart by its first bytes.
///
/// EXR files give the channels `R`, `G`, `B`, else the first layer that has all three, else
/// luminance `Y`. Values are linear; an alpha channel is ignored.
///
/// # Errors
///
/// Those of [`read_exr`] and [`read_hdr`]; [`ImageError::Unsupported`] for other formats and for
/// files without color; [`ImageError::BadPixel`] for the first pixel that is negative, infinite or
/// not a number.
pub fn read_environment(path: &Path) -> Result<RgbImage, ImageError> {
    read_environment_within(path, &Allowance::unlimited())
}

/// As [`read_environment`], within an allowance of memory, with which the size in the header is compared before a pixel is read.
///
/// # Errors
///
/// Those of [`read_environment`]; an [`Excess`](pbgi_file::Excess) as cause where the allowance does not do.
pub fn read_environment_within(path: &Path, allowance: &Allowance) -> Result<RgbImage, ImageError> {
    let image = match read_magic(path)?.as_slice() {
        [0x76, 0x2f, 0x31, 0x01] => {
            // The picture as colors takes no more than the samples, which are gone by then.
            to_rgb(path, &read_exr_within(path, allowance, COLOR_BYTES)?.0)?
        }
        [b'#', b'?', ..] => decode_hdr(path, allowance)?,
        [] => return Err(ImageError::malformed(path, "the file is empty")),
        _ => {
            return Err(ImageError::unsupported(
                path,
                "a file that is neither OpenEXR nor Radiance HDR",
                "convert it with: oiiotool in.png --compression zip -o out.exr",
            ));
        }
    };
    check_pixels(path, image)
}

/// Reads a Radiance HDR file (RGBE, run-length coded or flat), checked as in [`read_environment`].
///
/// # Errors
///
/// [`ImageError::Malformed`] for anything damaged; [`ImageError::BadPixel`].
pub fn read_hdr(path: &Path) -> Result<RgbImage, ImageError> {
    check_pixels(path, decode_hdr(path, &Allowance::unlimited())?)
}

fn read_magic(path: &Path) -> Result<Vec<u8>, ImageError> {
    let file = open_input(path).map_err(|e| ImageError::io(path, "open", e))?;
    let mut magic = Vec::new();
    file.take(4).read_to_end(&mut magic).map_err(|e| ImageError::io(path, "read", e))?;
    Ok(magic)
}

fn decode_hdr(path: &Path, allowance: &Allowance) -> Result<RgbImage, ImageError> {
    let file = open_input(path).map_err(|e| ImageError::io(path, "open", e))?;
    let file_bytes =
        file.metadata().map_err(|e| ImageError::io(path, "read the size of", e))?.len();
    let damaged = |e: ::image::ImageError| {
        let message = format!("not a readable hdr file ({e}); write or copy it again");
        ImageError::malformed(path, message)
    };
    catch_decoder_panic(path, || {
        let decoder = HdrDecoder::new(BufReader::new(file)).map_err(damaged)?;
        let (width, height) = decoder.dimensions();
        let pixel_count = u64::from(width) * u64::from(height);
        if pixel_count == 0 || pixel_count > file_bytes.saturating_mul(HDR_PIXELS_PER_BYTE_MAX) {
            let message = format!(
                "the header claims {width} x {height} pixels, which a file of {file_bytes} bytes \
                 cannot hold; write or copy it again"
            );
            return Err(ImageError::malformed(path, message));
        }
        let needed = pixel_count.saturating_mul(2 * COLOR_BYTES);
        allowance.check(needed).map_err(|e| ImageError::io(path, "read", e))?;
        let samples =
            DynamicImage::from_decoder(decoder).map_err(damaged)?.into_rgb32f().into_raw();
        let pixels = samples.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        Ok(RgbImage { width: width as usize, height: height as usize, pixels })
    })
}

fn to_rgb(path: &Path, image: &Image) -> Result<RgbImage, ImageError> {
    let layers = image.channels.iter().filter_map(|c| c.name.strip_suffix(".R"));
    let pixels = image
        .rgb(["R", "G", "B"])
        .or_else(|| {
            layers
                .filter_map(|layer| {
                    let [r, g, b] = ["R", "G", "B"].map(|c| format!("{layer}.{c}"));
                    image.rgb([&r, &g, &b])
                })
                .next()
        })
        .or_else(|| image.rgb(["Y", "Y", "Y"]));
    match pixels {
        Some(pixels) => Ok(RgbImage { width: image.width, height: image.height, pixels }),
        None => {
            let names: Vec<&str> = image.channels.iter().map(|c| c.name.as_str()).collect();
            Err(ImageError::unsupported(
                path,
                format!("an environment with the channels {}", names.join(", ")),
                "it needs R, G and B: oiiotool in.exr --chnames R,G,B -o out.exr",
            ))
        }
    }
}

/// Passes on an image all of whose pixels are finite and not negative.
fn check_pixels(path: &Path, image: RgbImage) -> Result<RgbImage, ImageError> {
    let bad = image.pixels.iter().position(|p| !p.iter().all(|c| c.is_finite() && *c >= 0.0));
    let Some(index) = bad else { return Ok(image) };
    let value = image.pixels[index];
    let cure = if value.iter().any(|c| c.is_nan() || c.is_infinite()) {
        "repair it with: oiiotool in.exr --fixnan box3 --clamp:min=0 -o out.exr"
    } else {
        "repair it with: oiiotool in.exr --clamp:min=0 -o out.exr"
    };
    Err(ImageError::BadPixel {
        path: path.to_owned(),
        column: index % image.width,
        row: index / image.width,
        value,
        cure: cure.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write_environment_exr;
    use tempfile::tempdir;

    const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");

    #[test]
    fn real_environments_have_their_listed_maxima() {
        let cases = [
            ("kloppenheim_05_1k.hdr", 1024, 78944.0),
            ("potsdamer_platz_1k.hdr", 1024, 10.94),
            ("st_peters_square_night_1k.hdr", 1024, 9134.0),
            ("StageEnvLatLong.exr", 1000, 4096.0),
        ];
        for (name, width, max) in cases {
            let path = Path::new(DATA).join(name);
            if !path.exists() {
                println!("skipped: no {name}");
                continue;
            }
            let image = read_environment(&path).unwrap();
            assert_eq!((image.width, image.height), (width, width / 2));
            let luminances = image.pixels.iter().map(|p| pbgi_math::luminance(*p));
            let channels = image.pixels.iter().flatten().copied();
            let found = [luminances.fold(0f32, f32::max), channels.fold(0f32, f32::max)];
            assert!(found.iter().any(|f| (f / max - 1.0).abs() < 0.01), "{name}: {found:?}");
        }
    }

    #[test]
    fn bad_pixels_are_named() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        for (bad, shown) in [(-1.0, "-1"), (f32::NAN, "NaN"), (f32::INFINITY, "inf")] {
            let mut image = RgbImage { width: 5, height: 4, pixels: vec![[1.0; 3]; 20] };
            image.pixels[13][1] = bad;
            image.pixels[17][0] = bad;
            write_environment_exr(&path, &image, &[]).unwrap();
            let error = read_environment(&path).unwrap_err().to_string();
            let expected = format!("pixel (column 3, row 2) is (1, {shown}, 1)");
            assert!(error.contains(&expected) && error.contains("oiiotool"), "{error}");
        }
    }

    #[test]
    fn damaged_hdr_files_are_errors() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.hdr");
        let cases: [&[u8]; 6] = [
            b"",
            b"#?",
            b"#?RADIANCE\n",
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 4\n",
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999999 +X 99999999\n\x02\x02",
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 0 +X 0\n",
        ];
        for bytes in cases {
            std::fs::write(&path, bytes).unwrap();
            let error = read_environment(&path).unwrap_err();
            assert!(matches!(error, ImageError::Malformed { .. }), "{error}");
        }
        let whole = Path::new(DATA).join("kloppenheim_05_1k.hdr");
        let Ok(whole) = std::fs::read(whole) else {
            return println!("skipped: no shared data");
        };
        for length in [11, 60, 100, 1000, 100_000, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = read_hdr(&path).unwrap_err();
            assert!(matches!(error, ImageError::Malformed { .. }), "{length}: {error}");
        }
    }

    #[test]
    fn other_formats_and_missing_files_say_what_to_do() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.png");
        std::fs::write(&path, b"\x89PNG....").unwrap();
        assert!(read_environment(&path).unwrap_err().to_string().contains("oiiotool"));
        let missing = read_environment(&directory.path().join("none.exr")).unwrap_err();
        assert!(missing.to_string().contains("open failed"), "{missing}");
    }
}
