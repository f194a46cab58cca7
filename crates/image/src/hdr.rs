//! Reading of Radiance HDR files: their header here, their pixels by [`scan_lines`].

mod scan_lines;

use self::scan_lines::read_scan_lines;
use crate::environment::COLOR_BYTES;
use crate::{Chromaticities, ImageError, RgbImage};
use pbgi_file::{Allowance, open_input};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Most pixels one byte of an HDR file can stand for. Run lengths code 127 samples in 2 bytes, so
/// 4 channels make 16 pixels a byte; the older scheme reaches 64 (255 pixels in 4 bytes).
const PIXELS_PER_BYTE_MAX: u64 = 64;
/// Longest header line, and most of them.
const LINE_BYTES_MAX: u64 = 1 << 16;
const HEADER_LINES_MAX: usize = 10_000;

/// A picture as it is meant: upright, divided by the exposures and color corrections that its header names.
pub(crate) struct HdrPicture {
    pub image: RgbImage,
    /// What its channels are, where that is not Rec. 709.
    pub chromaticities: Option<Chromaticities>,
    /// What is read differently than the file says.
    pub warnings: Vec<String>,
}

/// What the lines before the pixels say.
#[derive(Debug, PartialEq)]
struct Header {
    /// Products of all EXPOSURE and COLORCORR lines.
    exposure: f64,
    correction: [f64; 3],
    chromaticities: Option<Chromaticities>,
    /// Whether pixels are XYZ.
    is_xyz: bool,
    pixel_aspect: f64,
    scan: Scan,
}

/// The order of pixels: the axis that changes last, its direction and length, then the other.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Scan {
    /// Scan lines are columns.
    is_upright: bool,
    /// Whether columns, and rows, run against those of an image from the top left.
    flips: [bool; 2],
    width: usize,
    height: usize,
}

pub(crate) fn read(path: &Path, allowance: &Allowance) -> Result<HdrPicture, ImageError> {
    let file = open_input(path).map_err(|e| ImageError::io(path, "open", e))?;
    let file_bytes =
        file.metadata().map_err(|e| ImageError::io(path, "read the size of", e))?.len();
    let mut reader = BufReader::new(file);
    let header = Header::read(&mut reader).map_err(|e| ImageError::io(path, "read", e))?.map_err(
        |message| ImageError::malformed(path, format!("{message}; write or copy it again")),
    )?;
    let Scan { is_upright, width, height, .. } = header.scan;
    let pixel_count = (width as u64).saturating_mul(height as u64);
    if pixel_count == 0 || pixel_count > file_bytes.saturating_mul(PIXELS_PER_BYTE_MAX) {
        let message = format!(
            "the header claims {width} x {height} pixels, which a file of {file_bytes} bytes cannot hold; write or \
             copy it again"
        );
        return Err(ImageError::malformed(path, message));
    }
    let needed = pixel_count.saturating_mul(2 * COLOR_BYTES);
    allowance.check(needed).map_err(|e| ImageError::io(path, "read", e))?;
    let (lines, length) = if is_upright { (width, height) } else { (height, width) };
    let stored = read_scan_lines(&mut reader, lines, length)
        .map_err(|e| ImageError::io(path, "read", e))?
        .map_err(|message| {
            let message = format!("not a readable hdr file ({message}); write or copy it again");
            ImageError::malformed(path, message)
        })?;
    let pixels = header.scan.upright(stored);
    let factors = header.correction.map(|c| (1.0 / (header.exposure * c)) as f32);
    let pixels = match factors == [1.0; 3] {
        true => pixels,
        false => pixels.into_iter().map(|p| [0, 1, 2].map(|c| p[c] * factors[c])).collect(),
    };
    let mut warnings = Vec::new();
    if (header.pixel_aspect - 1.0).abs() > 1e-3 {
        let aspect = header.pixel_aspect;
        warnings
            .push(format!("PIXASPECT {aspect} is not read; the picture covers the whole sphere"));
    }
    let chromaticities = match header.is_xyz {
        true => Some(Chromaticities::XYZ),
        false => header.chromaticities,
    };
    Ok(HdrPicture { image: RgbImage { width, height, pixels }, chromaticities, warnings })
}

impl Header {
    /// Reads up to the first pixel. The inner error says what is wrong.
    fn read(reader: &mut impl BufRead) -> std::io::Result<Result<Self, String>> {
        let mut header = Self {
            exposure: 1.0,
            correction: [1.0; 3],
            chromaticities: None,
            is_xyz: false,
            pixel_aspect: 1.0,
            scan: Scan { is_upright: false, flips: [false; 2], width: 0, height: 0 },
        };
        let mut line = Vec::new();
        for number in 1..HEADER_LINES_MAX {
            line.clear();
            let read = reader.by_ref().take(LINE_BYTES_MAX).read_until(b'\n', &mut line)?;
            let text = String::from_utf8_lossy(&line);
            let text = text.trim();
            if read == 0 || read as u64 == LINE_BYTES_MAX {
                return Ok(Err(format!(
                    "not a readable hdr file (no end of its header in line {number})"
                )));
            }
            if number > 1 && text.is_empty() {
                line.clear();
                reader.by_ref().take(LINE_BYTES_MAX).read_until(b'\n', &mut line)?;
                let scan = Scan::parse(&String::from_utf8_lossy(&line));
                return Ok(scan.map(|scan| Self { scan, ..header }));
            }
            if number > 1
                && let Err(message) = header.read_line(text)
            {
                return Ok(Err(format!("header line {number}: {message}")));
            }
        }
        Ok(Err(format!("no end of its header in {HEADER_LINES_MAX} lines")))
    }

    fn read_line(&mut self, line: &str) -> Result<(), String> {
        let Some((key, value)) = line.split_once('=').filter(|_| !line.starts_with('#')) else {
            return Ok(());
        };
        let value = value.trim();
        let positive = |text: &str| {
            let number: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
            let is_positive = number > 0.0 && number.is_finite();
            is_positive
                .then_some(number)
                .ok_or_else(|| format!("`{line}`, expected a number above 0"))
        };
        let numbers =
            || value.split_ascii_whitespace().map(positive).collect::<Result<Vec<_>, _>>();
        match key.trim().to_ascii_uppercase().as_str() {
            "EXPOSURE" => self.exposure *= positive(value)?,
            "PIXASPECT" => self.pixel_aspect *= positive(value)?,
            "COLORCORR" => match numbers()?.as_slice() {
                [r, g, b] => {
                    let own = self.correction;
                    self.correction = [own[0] * r, own[1] * g, own[2] * b];
                }
                _ => return Err(format!("`{line}`, expected three numbers")),
            },
            "PRIMARIES" => {
                let parsed: Result<Vec<f32>, _> =
                    value.split_ascii_whitespace().map(str::parse).collect();
                let Ok([rx, ry, gx, gy, bx, by, wx, wy]) = parsed.as_deref() else {
                    return Err(format!("`{line}`, expected eight numbers"));
                };
                let primaries = [[*rx, *ry], [*gx, *gy], [*bx, *by]];
                self.chromaticities = Some(Chromaticities { primaries, white: [*wx, *wy] });
            }
            "FORMAT" => match value {
                "32-bit_rle_rgbe" => self.is_xyz = false,
                "32-bit_rle_xyze" => self.is_xyz = true,
                _ => return Err(format!("`{line}`, expected 32-bit_rle_rgbe or 32-bit_rle_xyze")),
            },
            _ => {}
        }
        Ok(())
    }
}

impl Scan {
    /// Parses the line of the size, such as `-Y 512 +X 1024`.
    fn parse(line: &str) -> Result<Self, String> {
        let error = || format!("the size is `{}`, expected such as `-Y 512 +X 1024`", line.trim());
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let [first, lines, second, length] = words[..] else { return Err(error()) };
        let number = |text: &str| text.parse::<u32>().map(|n| n as usize).map_err(|_| error());
        let (lines, length) = (number(lines)?, number(length)?);
        let is_upright = first.ends_with(['X', 'x']);
        let (x, y) = if is_upright { (first, second) } else { (second, first) };
        let (width, height) = if is_upright { (lines, length) } else { (length, lines) };
        let flip_x = match x {
            "+X" | "+x" => false,
            "-X" | "-x" => true,
            _ => return Err(error()),
        };
        // Y runs up: from the top it falls.
        let flip_y = match y {
            "-Y" | "-y" => false,
            "+Y" | "+y" => true,
            _ => return Err(error()),
        };
        Ok(Self { is_upright, flips: [flip_x, flip_y], width, height })
    }

    /// Stored pixels in rows from the top left.
    fn upright(&self, stored: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
        if !self.is_upright && self.flips == [false; 2] {
            return stored;
        }
        let Self { width, height, .. } = *self;
        let mut pixels = Vec::with_capacity(stored.len());
        for row in 0..height {
            for column in 0..width {
                let x = if self.flips[0] { width - 1 - column } else { column };
                let y = if self.flips[1] { height - 1 - row } else { row };
                pixels.push(stored[if self.is_upright { x * height + y } else { y * width + x }]);
            }
        }
        pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat file of pixels whose red counts from 1, each of exponent 136: of the value of its byte.
    fn file(header: &str, size: &str, count: u8) -> Vec<u8> {
        let mut bytes = format!("{header}\n{size}\n").into_bytes();
        bytes.extend((1..=count).flat_map(|red| [red, 100, 0, 136]));
        bytes
    }

    fn read_bytes(bytes: &[u8]) -> Result<HdrPicture, ImageError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdr");
        std::fs::write(&path, bytes).unwrap();
        read(&path, &Allowance::unlimited())
    }

    fn reds(bytes: &[u8]) -> Vec<f32> {
        read_bytes(bytes).unwrap().image.pixels.iter().map(|p| p[0]).collect()
    }

    const RGBE: &str = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n";

    #[test]
    fn signatures_of_all_programs_are_read() {
        for signature in ["#?RADIANCE", "#?RGBE", "#?", "#?AUTOPANO"] {
            let header =
                format!("{signature}\n# made by hand\nFORMAT=32-bit_rle_rgbe\nVIEW= -vtv\n");
            assert_eq!(reds(&file(&header, "-Y 1 +X 3", 3)), [1.0, 2.0, 3.0]);
        }
    }

    #[test]
    fn all_orders_of_pixels_give_the_same_picture() {
        // As rows from the top: 1 2 3 / 4 5 6.
        let expected = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        for (size, order) in [
            ("-Y 2 +X 3", [1, 2, 3, 4, 5, 6]),
            ("+Y 2 +X 3", [4, 5, 6, 1, 2, 3]),
            ("-Y 2 -X 3", [3, 2, 1, 6, 5, 4]),
            ("+Y 2 -X 3", [6, 5, 4, 3, 2, 1]),
            ("+X 3 -Y 2", [1, 4, 2, 5, 3, 6]),
            ("+X 3 +Y 2", [4, 1, 5, 2, 6, 3]),
            ("-X 3 -Y 2", [3, 6, 2, 5, 1, 4]),
        ] {
            let mut bytes = format!("{RGBE}\n{size}\n").into_bytes();
            bytes.extend(order.iter().flat_map(|red| [*red, 0, 0, 136u8]));
            let picture = read_bytes(&bytes).unwrap();
            assert_eq!((picture.image.width, picture.image.height), (3, 2), "{size}");
            assert_eq!(reds(&bytes), expected, "{size}");
        }
    }

    #[test]
    fn exposures_and_corrections_are_taken_back() {
        let header = format!("{RGBE}EXPOSURE=2\nexposure = 4\nCOLORCORR= 0.5 1 1\n");
        let picture = read_bytes(&file(&header, "-Y 1 +X 2", 2)).unwrap();
        assert_eq!(picture.image.pixels, [[0.25, 12.5, 0.0], [0.5, 12.5, 0.0]]);
        assert!(picture.warnings.is_empty());
        let wide = format!("{RGBE}PIXASPECT=2\n");
        assert_eq!(read_bytes(&file(&wide, "-Y 1 +X 2", 2)).unwrap().warnings.len(), 1);
    }

    #[test]
    fn primaries_and_xyz_are_told() {
        let header = format!("{RGBE}PRIMARIES= 0.7 0.3 0.2 0.7 0.1 0.05 0.3 0.3\n");
        let found = read_bytes(&file(&header, "-Y 1 +X 2", 2)).unwrap().chromaticities.unwrap();
        assert_eq!((found.primaries[1], found.white), ([0.2, 0.7], [0.3, 0.3]));
        let xyz = "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n";
        let found = read_bytes(&file(xyz, "-Y 1 +X 2", 2)).unwrap().chromaticities;
        assert_eq!(found, Some(Chromaticities::XYZ));
    }

    #[test]
    fn bad_headers_are_named() {
        for (header, size, expected) in [
            (RGBE, "-Y 2 +Z 2", "expected such as"),
            (RGBE, "-Y 2", "expected such as"),
            (RGBE, "-Y -2 +X 2", "expected such as"),
            (RGBE, "-Y 100000 +X 100000", "cannot hold"),
            ("#?RADIANCE\nEXPOSURE=0\n", "-Y 1 +X 2", "line 2: `EXPOSURE=0`"),
            ("#?RADIANCE\nEXPOSURE=nan\n", "-Y 1 +X 2", "above 0"),
            ("#?RADIANCE\nCOLORCORR=1 2\n", "-Y 1 +X 2", "three numbers"),
            ("#?RADIANCE\nPRIMARIES=1 2\n", "-Y 1 +X 2", "eight numbers"),
            ("#?RADIANCE\nFORMAT=16-bit\n", "-Y 1 +X 2", "rle_xyze"),
        ] {
            let Err(error) = read_bytes(&file(header, size, 2)) else { panic!("{header} {size}") };
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}
