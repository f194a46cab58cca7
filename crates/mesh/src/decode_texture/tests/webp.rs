//! Files of the crate `image`, which are lossless, and a lossy picture of one color in all kinds of envelopes.

use super::*;

pub(super) fn chunk(name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut bytes = [&name[..], &(data.len() as u32).to_le_bytes(), data].concat();
    bytes.resize(bytes.len().next_multiple_of(2), 0);
    bytes
}

pub(super) fn file(chunks: &[Vec<u8>]) -> Vec<u8> {
    let data = [&b"WEBP"[..], &chunks.concat()].concat();
    [&b"RIFF"[..], &(data.len() as u32).to_le_bytes(), &data].concat()
}

/// A lossy picture of one block, which is 16 x 16.
pub(super) fn lossy(width: u16, height: u16) -> Vec<u8> {
    let mut data = vec![0x30, 0x01, 0x00, 0x9d, 0x01, 0x2a];
    data.extend([width.to_le_bytes(), height.to_le_bytes()].concat());
    data.extend([0x0e, 0xc0, 0xfe, 0x25, 0xa4, 0x00, 0x03, 0x70, 0x00, 0x00, 0x00, 0x00]);
    chunk(b"VP8 ", &data)
}

/// Low 3 bytes.
fn u24(value: u32) -> [u8; 3] {
    let [a, b, c, _] = value.to_le_bytes();
    [a, b, c]
}

/// The header of files with alpha (16) or pictures that move (2).
fn extended(flags: u8, width: u32, height: u32) -> Vec<u8> {
    chunk(b"VP8X", &[&[flags, 0, 0, 0][..], &u24(width - 1), &u24(height - 1)].concat())
}

fn alpha(width: usize, height: usize) -> Vec<u8> {
    chunk(b"ALPH", &[&[0][..], &Random::new().bytes(width * height)].concat())
}

/// One picture of 8 x 6 that moves, at (4, 2).
fn frame(parts: &[Vec<u8>]) -> Vec<u8> {
    let head = [&u24(2)[..], &u24(1), &u24(7), &u24(5), &u24(100), &[0]].concat();
    chunk(b"ANMF", &[head, parts.concat()].concat())
}

fn lossless(width: u32, height: u32) -> Vec<u8> {
    encoded(&images(width, height)[3], ImageFormat::WebP)[12..].to_vec()
}

fn files() -> Vec<Vec<u8>> {
    let background = chunk(b"ANIM", &[10, 20, 30, 40, 0, 0]);
    vec![
        file(&[lossy(13, 7)]),
        file(&[extended(16, 13, 7), alpha(13, 7), lossy(13, 7)]),
        file(&[extended(16, 13, 7), lossless(13, 7)]),
        file(&[
            extended(2, 20, 10),
            background.clone(),
            frame(&[lossy(8, 6)]),
            frame(&[lossy(8, 6)]),
        ]),
        file(&[extended(18, 20, 10), background.clone(), frame(&[alpha(8, 6), lossy(8, 6)])]),
        file(&[extended(18, 20, 10), background, frame(&[lossless(8, 6)]), frame(&[lossy(8, 6)])]),
    ]
}

#[test]
fn all_envelopes_are_as_in_the_crate_image() {
    for (k, bytes) in files().iter().enumerate() {
        assert!(check("", bytes).is_some(), "{k}");
    }
    for image in images(9, 7).iter().chain(&images(1, 1)) {
        assert!(check("", &encoded(image, ImageFormat::WebP)).is_some());
    }
}

#[test]
fn damaged_files_are_read_alike() {
    for bytes in files() {
        check_damaged("", &bytes);
    }
    check_damaged("", &encoded(&images(9, 7)[2], ImageFormat::WebP));
}
