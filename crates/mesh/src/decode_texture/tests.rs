//! Every kind of file against the crate `image`, which shares the decoders of PNG, JPEG and WebP, but not what is made of their texels.

mod bmp;
mod jpeg;
mod png;
mod tga;
mod webp;

use super::*;
use image::{ImageDecoder, ImageFormat, ImageReader};
use std::io::Cursor;

/// Larger images are not decoded: damage may claim any size.
const TESTED_BYTES_MAX: u64 = 1 << 20;

/// Numbers that look random, from a fixed seed.
struct Random(u64);

impl Random {
    fn new() -> Self {
        Self(0x9e37_79b9_7f4a_7c15)
    }

    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 33) as usize % end
    }

    fn byte(&mut self) -> u8 {
        self.below(256) as u8
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.byte()).collect()
    }
}

/// What the crate `image` takes for a file of this name.
fn format_of(name: &str, bytes: &[u8]) -> Option<ImageFormat> {
    let read = [
        ImageFormat::Png,
        ImageFormat::Jpeg,
        ImageFormat::WebP,
        ImageFormat::Bmp,
        ImageFormat::Tga,
    ];
    let by_name = name.ends_with(".tga").then_some(ImageFormat::Tga);
    image::guess_format(bytes).ok().or(by_name).filter(|format| read.contains(format))
}

/// What the crate `image` makes of a file, and the bytes it says that decoding takes. It may panic where files are damaged.
fn expected(name: &str, bytes: &[u8]) -> Option<(DecodedImage, u64)> {
    let format = format_of(name, bytes)?;
    let reader = || ImageReader::with_format(Cursor::new(bytes), format);
    let decode = || {
        let decoded_bytes = reader().into_decoder().ok()?.total_bytes();
        let image = reader().decode().ok()?.into_rgba8();
        let texels = image.pixels().map(|pixel| pixel.0).collect();
        let image = DecodedImage { width: image.width(), height: image.height(), texels };
        Some((image, decoded_bytes))
    };
    std::panic::catch_unwind(decode).ok().flatten()
}

/// Reads a file, and holds size and texels to those of the crate `image`, if that reads it. Files that only one of both reads are none here.
fn check(name: &str, bytes: &[u8]) -> Option<DecodedImage> {
    let size = TextureSize::of(name, bytes);
    if size.as_ref().is_ok_and(|size| size.bytes > TESTED_BYTES_MAX) {
        return None;
    }
    let found = decode_image(name, bytes);
    // Nobody guards our own decoders.
    let is_own = matches!(FileKind::of(name, bytes), Some(FileKind::Bmp | FileKind::Tga));
    if let (true, Err(why)) = (is_own, &found) {
        assert!(!why.contains("the decoder failed"), "{why}");
    }
    // That crate takes all kinds of tga that it does not know for gray.
    if found.as_ref().is_err_and(|why| why.contains("a palette of kind")) {
        return None;
    }
    let (image, decoded_bytes) = expected(name, bytes)?;
    let found = found.unwrap_or_else(|why| panic!("{why}: {bytes:?}"));
    assert!(found == image, "other texels: {bytes:?}");
    let size = size.unwrap();
    assert_eq!(size.texels, found.texels.len() as u64);
    assert_eq!(size.texels, u64::from(found.width) * u64::from(found.height));
    assert_eq!(size.bytes, decoded_bytes);
    Some(found)
}

/// Cuts and changes a file that is read, and checks what is left of it.
fn check_damaged(name: &str, bytes: &[u8]) {
    assert!(check(name, bytes).is_some(), "{bytes:?}");
    for end in (0..bytes.len()).step_by(1 + bytes.len() / 60) {
        check(name, &bytes[..end]);
    }
    let mut random = Random::new();
    for _ in 0..400 {
        let mut damaged = bytes.to_vec();
        for _ in 0..=random.below(3) {
            // Headers matter most.
            let end = if random.below(2) == 0 { bytes.len().min(64) } else { bytes.len() };
            damaged[random.below(end)] = random.byte();
        }
        check(name, &damaged);
    }
}

/// A file that the crate `image` writes.
fn encoded(image: &image::DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(vec![]);
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Images of all channels of 8 bits.
fn images(width: u32, height: u32) -> [image::DynamicImage; 4] {
    let mut random = Random::new();
    // Some neighbors are equal, as runs are made of.
    let mut byte = || random.below(4) as u8 * 80;
    let rgba = image::RgbaImage::from_fn(width, height, |_, _| image::Rgba([0; 4].map(|_| byte())));
    let rgba = image::DynamicImage::from(rgba);
    [rgba.to_luma8().into(), rgba.to_luma_alpha8().into(), rgba.to_rgb8().into(), rgba]
}

#[test]
fn kinds_are_told_as_by_the_crate_image() {
    let marks: [&[u8]; 10] = [
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff",
        b"RIFF1234WEBP",
        b"RIFF1234WAVE",
        b"RIFF1234WEBX",
        b"BM",
        b"GIF89a",
        b"MM\0*",
        b"#?RADIANCE",
        b"qoif",
    ];
    for mark in marks {
        for end in 0..=mark.len() {
            let format = FileKind::of("", &mark[..end]).map(|kind| match kind {
                FileKind::Png => ImageFormat::Png,
                FileKind::Jpeg => ImageFormat::Jpeg,
                FileKind::WebP => ImageFormat::WebP,
                FileKind::Bmp => ImageFormat::Bmp,
                FileKind::Tga => ImageFormat::Tga,
            });
            assert_eq!(format, format_of("", &mark[..end]), "{:?}", &mark[..end]);
        }
    }
    assert_eq!(FileKind::of("a.tga", b"BM"), Some(FileKind::Bmp));
    assert_eq!(FileKind::of("folder/a.TGA", &[0, 0, 2]), Some(FileKind::Tga));
    assert_eq!(FileKind::of("tga", &[0, 0, 2]), None);
}

#[test]
fn errors_say_what_is_wrong() {
    let why = decode_image("a.gif", b"GIF89a").unwrap_err();
    assert_eq!(why, "it is neither png, jpeg, webp, bmp or tga; convert it to png");
    for (name, bytes) in [
        ("", &b"\x89PNG\r\n\x1a\n"[..]),
        ("", b"\xff\xd8\xff"),
        ("", b"RIFF1234WEBP"),
        ("", b"BM"),
        ("a.tga", b""),
    ] {
        let why = decode_image(name, bytes).unwrap_err();
        assert!(why.starts_with("it cannot be decoded ("), "{why}");
        assert_eq!(TextureSize::of(name, bytes).unwrap_err(), why);
    }
    let empty = tga::file(tga::Fields { width: 0, ..tga::Fields::default() }, &[]);
    assert_eq!(decode_image("a.tga", &empty).unwrap_err(), "it has no pixels");
    let empty = bmp::file(bmp::Fields { height: 0, ..bmp::Fields::default() }, &[]);
    assert_eq!(decode_image("", &empty).unwrap_err(), "it has no pixels");
}

#[test]
fn headers_do_not_make_us_allocate() {
    let files = [
        ("", png::file(png::Fields { width: 40_000, height: 40_000, ..png::Fields::default() })),
        ("", jpeg::file(jpeg::Fields { width: 40_000, height: 40_000, ..jpeg::Fields::default() })),
        ("", webp::file(&[webp::lossy(16_383, 16_383)])),
        (
            "",
            bmp::file(bmp::Fields { width: 40_000, height: 40_000, ..bmp::Fields::default() }, &[]),
        ),
        (
            "a.tga",
            tga::file(tga::Fields { width: 40_000, height: 40_000, ..tga::Fields::default() }, &[]),
        ),
    ];
    for (name, bytes) in files {
        let size = TextureSize::of(name, &bytes).unwrap();
        assert!(size.bytes > DECODED_BYTES_MAX, "{size:?}");
        let why = decode_image(name, &bytes).unwrap_err();
        assert!(why.contains("take more than 512 MiB"), "{why}");
    }
}

#[test]
fn panics_of_decoders_become_errors() {
    let why = run_decoder(|| -> Result<(), String> { panic!("odd file") }).unwrap_err();
    assert_eq!(why, "it cannot be decoded (the decoder failed on damaged data)");
}
