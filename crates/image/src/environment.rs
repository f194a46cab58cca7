//! Reading of environments: EXR or Radiance HDR, brought to linear Rec. 709 and checked pixel by pixel.

use crate::exr_read::read_exr_within;
use crate::{Chromaticities, Image, ImageError, ImageWindow, RgbImage, hdr};
use pbgi_file::{Allowance, open_input};
use pbgi_math::{DVec3, luminance};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// Most pixels of a picture of which only a part is stored, unless what is stored is a quarter of it.
const PADDED_PIXELS_MAX: usize = 1 << 25;
/// How far below 0 a sample may be, as a share of the picture's mean luminance, and of its largest sample: what lossy compression
/// and filters with negative lobes leave behind.
const NEGATIVE_SHARE_OF_MEAN: f32 = 0.1;
const NEGATIVE_SHARE_OF_MAX: f32 = 1e-3;
/// Most of all light that samples below 0 may take away.
const NEGATIVE_SHARE_OF_SUM: f64 = 0.01;
/// Names of the layer that is the picture itself, in lower case, the likeliest first.
const PICTURE_LAYERS: [&str; 5] = ["combined", "beauty", "rgba", "ci", "rgb"];

/// Bytes of a color.
pub(crate) const COLOR_BYTES: u64 = size_of::<[f32; 3]>() as u64;

/// An environment as it was read.
#[derive(Clone, Debug, Default)]
pub struct ReadEnvironment {
    /// Linear Rec. 709, finite, 0 or more.
    pub image: RgbImage,
    /// What was changed or left out, one sentence each.
    pub warnings: Vec<String>,
}

/// As [`read_environment_noting`], without its warnings.
///
/// # Errors
///
/// Those of [`read_environment_noting`].
pub fn read_environment(path: &Path) -> Result<RgbImage, ImageError> {
    read_environment_noting(path).map(|read| read.image)
}

/// Reads an environment, an EXR or Radiance HDR file, told apart by its first bytes.
///
/// EXR files give the channels `R`, `G`, `B`, else those of the layer that is the picture by its name (`Combined`, `beauty`, `rgba`, `Ci`),
/// else of the only layer, else luminance `Y`, with its chroma if it is there. The picture is the display window: what is not stored of it is black. Colors are
/// converted from the file's chromaticities to Rec. 709, which they are without. HDR files are divided by their exposures. An alpha
/// channel is ignored. Samples a little below 0 become 0.
///
/// # Errors
///
/// Those of the EXR reader and [`read_hdr`]; [`ImageError::Unsupported`] for other formats, for files without color, and for several
/// layers none of which is the picture by its name; [`ImageError::BadPixel`] for the first pixel that is far below 0, infinite or
/// not a number.
pub fn read_environment_noting(path: &Path) -> Result<ReadEnvironment, ImageError> {
    read_environment_noting_within(path, &Allowance::unlimited())
}

/// As [`read_environment_noting`], within an allowance of memory, with which the size in the header is compared before a pixel is read.
///
/// # Errors
///
/// Those of [`read_environment_noting`]; an [`Excess`](pbgi_file::Excess) as cause where the allowance does not do.
pub fn read_environment_noting_within(
    path: &Path,
    allowance: &Allowance,
) -> Result<ReadEnvironment, ImageError> {
    let mut warnings = Vec::new();
    let (image, chromaticities) = match read_magic(path)?.as_slice() {
        [0x76, 0x2f, 0x31, 0x01] => {
            // The picture as colors takes no more than the samples, which are gone by then.
            let (image, metadata) = read_exr_within(path, allowance, COLOR_BYTES)?;
            if !metadata.parts_left_out.is_empty() {
                let names = metadata.parts_left_out.join(", ");
                warnings.push(format!("parts of another size or place are left out: {names}"));
            }
            let image = to_rgb(path, &image, metadata.is_multipart, &mut warnings)?;
            (uncrop(path, image, &metadata.window, allowance)?, metadata.chromaticities)
        }
        [b'#', b'?', ..] => {
            let picture = hdr::read(path, allowance)?;
            warnings.extend(picture.warnings);
            (picture.image, picture.chromaticities)
        }
        [] => return Err(ImageError::malformed(path, "the file is empty")),
        magic => return Err(refuse(path, magic)),
    };
    finish(path, image, chromaticities, warnings)
}

/// Reads a Radiance HDR file (RGBE, run-length coded or flat), checked as in [`read_environment`].
///
/// # Errors
///
/// [`ImageError::Malformed`] for anything damaged; [`ImageError::BadPixel`].
pub fn read_hdr(path: &Path) -> Result<RgbImage, ImageError> {
    let picture = hdr::read(path, &Allowance::unlimited())?;
    finish(path, picture.image, picture.chromaticities, Vec::new()).map(|read| read.image)
}

fn read_magic(path: &Path) -> Result<Vec<u8>, ImageError> {
    let file = open_input(path).map_err(|e| ImageError::io(path, "open", e))?;
    let mut magic = Vec::new();
    file.take(4).read_to_end(&mut magic).map_err(|e| ImageError::io(path, "read", e))?;
    Ok(magic)
}

/// The command that makes an environment of another kind of file, if one does.
fn refuse(path: &Path, magic: &[u8]) -> ImageError {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let is_display =
        matches!(magic, [0x89, b'P', b'N', b'G'] | [0xff, 0xd8, ..] | [b'R', b'I', b'F', b'F']);
    let colors = if is_display { " --colorconvert srgb linear" } else { "" };
    let found = match magic {
        _ if is_display => "a picture of display colors, which holds no sun,",
        _ => "a file that is neither OpenEXR nor Radiance HDR",
    };
    let cure = format!(
        "take an .exr or .hdr environment, or convert it with: oiiotool {name}{colors} --compression zip -o {stem}.exr"
    );
    ImageError::unsupported(path, found, cure)
}

/// Which of red, green and blue a channel is, and the layer it belongs to.
fn color_of(channel: &str) -> Option<(&str, usize)> {
    let (layer, name) = channel.rsplit_once('.').unwrap_or(("", channel));
    let which = match name.to_ascii_lowercase().as_str() {
        "r" | "red" => 0,
        "g" | "green" => 1,
        "b" | "blue" => 2,
        _ => return None,
    };
    Some((layer, which))
}

fn to_rgb(
    path: &Path,
    image: &Image,
    is_multipart: bool,
    warnings: &mut Vec<String>,
) -> Result<RgbImage, ImageError> {
    let mut layers: BTreeMap<&str, [Option<&[f32]>; 3]> = BTreeMap::new();
    for channel in &image.channels {
        if let Some((layer, which)) = color_of(&channel.name) {
            layers.entry(layer).or_default()[which].get_or_insert(channel.data.as_slice());
        }
    }
    let whole: Vec<(&str, [&[f32]; 3])> =
        layers.into_iter().filter_map(|(layer, [r, g, b])| Some((layer, [r?, g?, b?]))).collect();
    let called = |wanted: &str| {
        whole.iter().find(|(layer, _)| {
            layer.rsplit('.').next().is_some_and(|last| last.eq_ignore_ascii_case(wanted))
        })
    };
    let picture = whole
        .iter()
        .find(|(layer, _)| layer.is_empty())
        .or_else(|| PICTURE_LAYERS.into_iter().find_map(called))
        .or(if whole.len() == 1 { whole.first() } else { None });
    let (width, height) = (image.width, image.height);
    if let Some((layer, [r, g, b])) = picture {
        let pixels = r.iter().zip(*g).zip(*b).map(|((&r, &g), &b)| [r, g, b]).collect();
        let others: Vec<&str> =
            whole.iter().map(|(other, _)| *other).filter(|other| other != layer).collect();
        if !others.is_empty() {
            let layer = if layer.is_empty() { "R, G, B" } else { layer };
            let others = others.join(", ");
            warnings.push(format!("{layer} of its layers is the light; left out are {others}"));
        }
        return Ok(RgbImage { width, height, pixels });
    }
    if !whole.is_empty() {
        let names: Vec<&str> = whole.iter().map(|(layer, _)| *layer).collect();
        let first = names[0];
        let cure = match is_multipart {
            true => format!("keep one: oiiotool in.exr --subimage {first} -o out.exr"),
            false => format!(
                "keep one: oiiotool in.exr --ch R={first}.R,G={first}.G,B={first}.B -o out.exr"
            ),
        };
        let found = format!("an environment of the layers {}", names.join(", "));
        return Err(ImageError::unsupported(path, found, cure));
    }
    let has = |name: &str| image.channels.iter().any(|channel| channel.name == name);
    // Beside X and Z it is no luminance of a gray picture.
    if !has("X")
        && !has("Z")
        && let Some(mut pixels) = image.rgb(["Y", "Y", "Y"])
    {
        if let Some(chroma) = image.rgb(["RY", "Y", "BY"]) {
            pixels = chroma.into_iter().map(color_of_chroma).collect();
        }
        return Ok(RgbImage { width, height, pixels });
    }
    let names: Vec<&str> = image.channels.iter().map(|c| c.name.as_str()).collect();
    let [a, b, c] = match names[..] {
        [a, b, c, ..] => [a, b, c],
        [a, ..] => [a; 3],
        [] => ["R", "G", "B"],
    };
    let found = format!("an environment with the channels {}", names.join(", "));
    let cure = format!(
        "it needs R, G and B, for instance: oiiotool in.exr --ch {a},{b},{c} --chnames R,G,B -o out.exr"
    );
    Err(ImageError::unsupported(path, found, cure))
}

/// The color of luminance and chroma, (R − Y)/Y and (B − Y)/Y, as OpenEXR has them, with the weights of Rec. 709.
fn color_of_chroma([ry, y, by]: [f32; 3]) -> [f32; 3] {
    let [red, blue] = [(ry + 1.0) * y, (by + 1.0) * y];
    [red, (y - 0.2126 * red - 0.0722 * blue) / 0.7152, blue]
}

/// The picture: the display window, black where nothing is stored.
fn uncrop(
    path: &Path,
    image: RgbImage,
    window: &ImageWindow,
    allowance: &Allowance,
) -> Result<RgbImage, ImageError> {
    let [width, height] = window.display_size;
    // Where the stored pixels begin in the picture.
    let [x, y] =
        [0, 1].map(|k| i64::from(window.data_origin[k]) - i64::from(window.display_origin[k]));
    if [x, y] == [0, 0] && [width, height] == [image.width, image.height] {
        return Ok(image);
    }
    let pixel_count = width.saturating_mul(height);
    if pixel_count > PADDED_PIXELS_MAX.max(image.pixels.len().saturating_mul(4)) {
        let found = format!(
            "a picture of {width} x {height} pixels of which {} x {} are stored",
            image.width, image.height
        );
        let cure = "write all of it: oiiotool in.exr --croptofull -o out.exr";
        return Err(ImageError::unsupported(path, found, cure));
    }
    let overlap = |start: i64, stored: usize, whole: usize| {
        let end = start.saturating_add(stored as i64).min(whole as i64);
        let start_in = start.max(0);
        (start_in < end).then(|| (start_in as usize, (end - start_in) as usize))
    };
    let (columns, rows) = (overlap(x, image.width, width), overlap(y, image.height, height));
    let (Some((left, columns)), Some((top, rows))) = (columns, rows) else {
        let message = "its stored pixels (data window) lie outside of the picture (display window); it shows nothing";
        return Err(ImageError::malformed(path, message));
    };
    let needed = COLOR_BYTES.saturating_mul((pixel_count + image.pixels.len()) as u64);
    allowance.check(needed).map_err(|e| ImageError::io(path, "read", e))?;
    let mut pixels = vec![[0.0; 3]; pixel_count];
    for row in top..top + rows {
        let from = (row as i64 - y) as usize * image.width + (left as i64 - x) as usize;
        let to = row * width + left;
        pixels[to..to + columns].copy_from_slice(&image.pixels[from..from + columns]);
    }
    Ok(RgbImage { width, height, pixels })
}

/// Brings finite pixels to Rec. 709, and to 0 what is a little below.
fn finish(
    path: &Path,
    mut image: RgbImage,
    chromaticities: Option<Chromaticities>,
    mut warnings: Vec<String>,
) -> Result<ReadEnvironment, ImageError> {
    check_pixels(path, &image)?;
    clamp(&mut image, &mut warnings, "are below 0, by compression or filters");
    // Some programs write zeros where they know none.
    let is_known = |c: &Chromaticities| c.primaries.as_flattened().iter().any(|v| *v != 0.0);
    let other = chromaticities.filter(|c| is_known(c) && !c.is_near(&Chromaticities::REC_709));
    match other.map(|c| c.to_rec_709()) {
        Some(Some(matrix)) => {
            for pixel in &mut image.pixels {
                let color = matrix * DVec3::from_array(pixel.map(f64::from));
                *pixel = color.to_array().map(|c| c as f32);
            }
            check_finite(path, &image, "repair it with: oiiotool in.exr --mulc 0.001 -o out.exr")?;
            clamp(&mut image, &mut warnings, "have colors that Rec. 709 does not hold");
        }
        Some(None) => {
            warnings.push(
                "its chromaticities are those of no color space; they are taken as Rec. 709".into(),
            );
        }
        None => {}
    }
    Ok(ReadEnvironment { image, warnings })
}

/// Makes 0 of what is below.
fn clamp(image: &mut RgbImage, warnings: &mut Vec<String>, what: &str) {
    let is_below = |p: &&mut [f32; 3]| p.iter().any(|c| *c < 0.0);
    let mut count = 0u64;
    for pixel in image.pixels.iter_mut().filter(is_below) {
        // Rounding alone is no news.
        let largest = pixel.iter().fold(0f32, |max, c| max.max(c.abs()));
        count += u64::from(pixel.iter().any(|c| *c < -1e-5 * largest));
        *pixel = pixel.map(|c| c.max(0.0));
    }
    let of = image.pixels.len();
    if count > 0 {
        warnings.push(format!("{count} of {of} pixels {what}; what is below 0 is taken as 0"));
    }
}

/// Passes an image all of whose pixels are finite and none far below 0.
fn check_pixels(path: &Path, image: &RgbImage) -> Result<(), ImageError> {
    let finite = |p: &[f32; 3]| p.iter().all(|c| c.is_finite());
    let samples = || image.pixels.iter().flatten().copied();
    let largest = samples().fold(0f32, f32::max);
    let sum: f64 = image.pixels.iter().map(|p| f64::from(luminance(p.map(|c| c.max(0.0))))).sum();
    let mean = (sum / image.pixels.len().max(1) as f64) as f32;
    let (above, below) = samples().fold((0f64, 0f64), |(above, below), c| {
        (above + f64::from(c.max(0.0)), below - f64::from(c.min(0.0)))
    });
    let limit = match below <= NEGATIVE_SHARE_OF_SUM * above {
        true => NEGATIVE_SHARE_OF_MEAN * mean + NEGATIVE_SHARE_OF_MAX * largest,
        false => 0.0,
    };
    let is_bad = |p: &[f32; 3]| !finite(p) || p.iter().any(|c| *c < -limit);
    let Some(index) = image.pixels.iter().position(is_bad) else { return Ok(()) };
    let cure = match finite(&image.pixels[index]) {
        true => "repair it with: oiiotool in.exr --clamp:min=0 -o out.exr",
        false => "repair it with: oiiotool in.exr --fixnan box3 --clamp:min=0 -o out.exr",
    };
    Err(bad_pixel(path, image, index, cure))
}

/// Passes an image all of whose pixels are finite.
fn check_finite(path: &Path, image: &RgbImage, cure: &str) -> Result<(), ImageError> {
    let bad = image.pixels.iter().position(|p| p.iter().any(|c| !c.is_finite()));
    bad.map_or(Ok(()), |index| Err(bad_pixel(path, image, index, cure)))
}

fn bad_pixel(path: &Path, image: &RgbImage, index: usize, cure: &str) -> ImageError {
    ImageError::BadPixel {
        path: path.to_owned(),
        column: index % image.width,
        row: index / image.width,
        value: image.pixels[index],
        cure: cure.to_owned(),
    }
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
            let luminances = image.pixels.iter().map(|p| luminance(*p));
            let channels = image.pixels.iter().flatten().copied();
            let found = [luminances.fold(0f32, f32::max), channels.fold(0f32, f32::max)];
            assert!(found.iter().any(|f| (f / max - 1.0).abs() < 0.01), "{name}: {found:?}");
        }
    }

    /// The page of formats names every layer that is taken for the picture.
    #[test]
    fn layers_are_documented() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/formats.md");
        let page = std::fs::read_to_string(page).unwrap().to_lowercase();
        for layer in PICTURE_LAYERS {
            assert!(page.contains(&format!("`{layer}`")), "{layer}");
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
    fn what_is_a_little_below_0_becomes_0_with_a_warning() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let mut image = RgbImage { width: 20, height: 10, pixels: vec![[1.0; 3]; 200] };
        image.pixels[7] = [-0.05, 0.0, 5.0];
        write_environment_exr(&path, &image, &[]).unwrap();
        let read = read_environment_noting(&path).unwrap();
        assert_eq!(read.image.pixels[7], [0.0, 0.0, 5.0]);
        assert!(read.warnings[0].starts_with("1 of 200 pixels are below 0"), "{:?}", read.warnings);
        // Many a little make a lot.
        image.pixels.iter_mut().step_by(2).for_each(|p| *p = [-0.05; 3]);
        write_environment_exr(&path, &image, &[]).unwrap();
        assert!(matches!(read_environment(&path), Err(ImageError::BadPixel { .. })));
    }

    /// Writes channels of one value each, stored at a place of a picture of 8 × 4.
    fn write_layers(path: &Path, channels: &[(&str, f32)], size: [usize; 2], origin: [i32; 2]) {
        let mut image = Image::new(size[0], size[1]);
        for (name, value) in channels {
            image.push(*name, vec![*value; size[0] * size[1]]);
        }
        let window =
            ImageWindow { data_origin: origin, display_origin: [1, 1], display_size: [8, 4] };
        crate::write_windowed_exr(path, &image, &[], &window, &[]).unwrap();
    }

    const WHITE: [(&str, f32); 3] = [("R", 1.0), ("G", 1.0), ("B", 1.0)];

    #[test]
    fn what_is_not_stored_of_a_picture_is_black() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        for (size, origin, lit) in [
            ([8, 4], [1, 1], 32),
            ([4, 2], [1, 1], 8),
            ([4, 2], [5, 3], 8),
            ([4, 2], [-1, 0], 2),
            ([20, 20], [-5, -5], 32),
            ([4, 2], [7, 4], 2),
        ] {
            write_layers(&path, &WHITE, size, origin);
            let image = read_environment(&path).unwrap();
            assert_eq!((image.width, image.height), (8, 4));
            let found = image.pixels.iter().filter(|p| **p == [1.0; 3]).count();
            assert_eq!(found, lit, "{size:?} {origin:?}");
        }
        write_layers(&path, &WHITE, [4, 2], [9, 1]);
        assert!(read_environment(&path).unwrap_err().to_string().contains("shows nothing"));
        write_layers(&path, &WHITE, [4, 2], [5, 1]);
        assert_eq!(read_environment(&path).unwrap().pixels[3..5], [[0.0; 3], [1.0; 3]]);
    }

    #[test]
    fn pictures_far_larger_than_what_is_stored_are_refused() {
        let window = ImageWindow { display_size: [1 << 30, 1 << 29], ..ImageWindow::default() };
        let image = RgbImage { width: 2, height: 1, pixels: vec![[1.0; 3]; 2] };
        let message = uncrop(Path::new("a.exr"), image, &window, &Allowance::unlimited())
            .unwrap_err()
            .to_string();
        assert!(message.contains("--croptofull"), "{message}");
    }

    #[test]
    fn luminance_has_its_chroma_and_is_no_part_of_another_space() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        write_layers(&path, &[("Y", 0.5)], [8, 4], [1, 1]);
        assert_eq!(read_environment(&path).unwrap().pixels[0], [0.5; 3]);
        let [r, g, b] = [1.0f32, 0.5, 0.25];
        let y = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        let chroma = [("BY", (b - y) / y), ("RY", (r - y) / y), ("Y", y)];
        write_layers(&path, &chroma, [8, 4], [1, 1]);
        let found = read_environment(&path).unwrap().pixels[0];
        assert!(found.iter().zip([r, g, b]).all(|(f, e)| (f - e).abs() < 1e-6), "{found:?}");
        write_layers(&path, &[("X", 0.5), ("Y", 0.5), ("Z", 0.5)], [8, 4], [1, 1]);
        let message = read_environment(&path).unwrap_err().to_string();
        assert!(
            message.contains("channels X, Y, Z") && message.contains("--ch X,Y,Z"),
            "{message}"
        );
        write_layers(&path, &[("Z", 0.5)], [8, 4], [1, 1]);
        assert!(read_environment(&path).unwrap_err().to_string().contains("--ch Z,Z,Z"));
    }

    #[test]
    fn the_layer_that_is_the_picture_is_found() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let layers = |names: &[(&str, f32)]| {
            let channels: Vec<(String, f32)> = names
                .iter()
                .flat_map(|(layer, value)| ["R", "G", "B"].map(|c| (format!("{layer}{c}"), *value)))
                .collect();
            let channels: Vec<(&str, f32)> =
                channels.iter().map(|(name, value)| (name.as_str(), *value)).collect();
            write_layers(&path, &channels, [8, 4], [1, 1]);
            read_environment_noting(&path)
        };
        for (names, value, warnings) in [
            (&[("AO.", 0.0), ("Combined.", 2.0)][..], 2.0, 1),
            (&[("View.AO.", 0.0), ("View.Combined.", 2.0)], 2.0, 1),
            (&[("AO.", 0.0), ("", 3.0), ("Combined.", 2.0)], 3.0, 1),
            (&[("diffuse.", 4.0)], 4.0, 0),
        ] {
            let read = layers(names).unwrap();
            assert_eq!(
                (read.image.pixels[0][1], read.warnings.len()),
                (value, warnings),
                "{names:?}"
            );
        }
        let message = layers(&[("AO.", 0.0), ("key.", 1.0)]).unwrap_err().to_string();
        assert!(message.contains("AO, key") && message.contains("--ch R=AO.R"), "{message}");
        write_layers(&path, &[("red", 1.0), ("green", 2.0), ("blue", 3.0)], [8, 4], [1, 1]);
        assert_eq!(read_environment(&path).unwrap().pixels[0], [1.0, 2.0, 3.0]);
    }

    #[test]
    fn colors_of_other_primaries_are_converted() {
        let image = RgbImage { width: 2, height: 1, pixels: vec![[0.950_456, 1.0, 1.089_058]; 2] };
        let read = |chromaticities| finish(Path::new("a"), image.clone(), chromaticities, vec![]);
        let white = read(Some(Chromaticities::XYZ)).unwrap().image.pixels[0];
        assert!(white.iter().all(|c| (c - 1.0).abs() < 1e-4), "{white:?}");
        let same = read(Some(Chromaticities::REC_709)).unwrap();
        assert_eq!(same.image, image);
        let line = Chromaticities { primaries: [[0.3, 0.3]; 3], white: [0.3, 0.3] };
        let unknown = read(Some(line)).unwrap();
        assert_eq!(unknown.image, image);
        assert!(unknown.warnings[0].contains("no color space"));
        let zeros = Chromaticities { primaries: [[0.0; 2]; 3], white: [0.0; 2] };
        assert!(read(Some(zeros)).unwrap().warnings.is_empty());
        let green = RgbImage { width: 1, height: 1, pixels: vec![[0.0, 1.0, 0.0]] };
        let read = finish(Path::new("a"), green, Some(Chromaticities::XYZ), vec![]).unwrap();
        assert!(read.image.pixels[0][1] > 0.0 && read.image.pixels[0][0] == 0.0);
        assert!(read.warnings[0].contains("Rec. 709 does not hold"));
    }

    #[test]
    fn chromaticities_are_read_from_exr_files() {
        use exr::prelude::WritableImage;
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let list = [("R", 0.950_456f32), ("G", 1.0), ("B", 1.089_058)];
        let list = list.map(|(name, value)| {
            let samples = exr::image::FlatSamples::F32(vec![value; 2]);
            exr::prelude::AnyChannel::new(name, samples)
        });
        let channels = exr::image::AnyChannels::sort(list.into_iter().collect());
        let mut file = exr::image::Image::from_channels((2, 1), channels);
        let at = |[x, y]: [f32; 2]| exr::math::Vec2(x, y);
        let [red, green, blue] = Chromaticities::XYZ.primaries.map(at);
        let white = at(Chromaticities::XYZ.white);
        file.attributes.chromaticities =
            Some(exr::meta::attribute::Chromaticities { red, green, blue, white });
        file.write().to_file(&path).unwrap();
        let pixel = read_environment(&path).unwrap().pixels[0];
        assert!(pixel.iter().all(|c| (c - 1.0).abs() < 1e-4), "{pixel:?}");
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

    /// Found by fuzzing: pixels near the largest number became infinite light.
    #[test]
    fn what_is_no_number_in_rec_709_is_refused() {
        let mut image = RgbImage { width: 2, height: 1, pixels: vec![[1.0; 3], [2e38, 0.0, 0.0]] };
        let wide = Chromaticities {
            primaries: [[0.713, 0.293], [0.165, 0.83], [0.128, 0.044]],
            white: [0.321_68, 0.337_67],
        };
        let read = |image| finish(Path::new("wide.hdr"), image, Some(wide), Vec::new());
        let message = read(image.clone()).unwrap_err().to_string();
        assert!(message.contains("wide.hdr") && message.contains("--mulc"), "{message}");
        image.pixels[1][0] = 1e38;
        assert!(read(image).unwrap().image.pixels[1][0] > 1.5e38);
    }

    #[test]
    fn other_formats_and_missing_files_say_what_to_do() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.png");
        std::fs::write(&path, b"\x89PNG....").unwrap();
        let message = read_environment(&path).unwrap_err().to_string();
        assert!(
            message.contains("no sun")
                && message.contains("oiiotool a.png --colorconvert srgb linear"),
            "{message}"
        );
        std::fs::write(&path, b"GIF89a").unwrap();
        let message = read_environment(&path).unwrap_err().to_string();
        assert!(message.contains("oiiotool a.png --compression"), "{message}");
        let missing = read_environment(&directory.path().join("none.exr")).unwrap_err();
        assert!(missing.to_string().contains("open failed"), "{missing}");
    }
}
