//! Files of all headers, bits and masks, made by hand.

use super::*;

#[derive(Clone, Copy)]
pub(super) struct Fields {
    /// Bytes of the header of the picture.
    pub own_bytes: u32,
    pub width: i32,
    pub height: i32,
    pub bits: u16,
    pub compression: u32,
    pub color_count: u32,
    /// What lies behind the fields that all headers have.
    pub masks: [u32; 4],
    /// Colors that there are.
    pub palette: usize,
}

impl Default for Fields {
    fn default() -> Self {
        let (bits, compression, color_count) = (24, 0, 0);
        Self {
            own_bytes: 40,
            width: 1,
            height: 1,
            bits,
            compression,
            color_count,
            masks: [0; 4],
            palette: 0,
        }
    }
}

pub(super) fn file(fields: Fields, pixels: &[u8]) -> Vec<u8> {
    let mut own = fields.own_bytes.to_le_bytes().to_vec();
    if fields.own_bytes == 12 {
        own.extend(
            [fields.width as u16, fields.height as u16, 1, fields.bits]
                .map(u16::to_le_bytes)
                .concat(),
        );
    } else {
        own.extend([fields.width, fields.height].map(i32::to_le_bytes).concat());
        own.extend([1, fields.bits].map(u16::to_le_bytes).concat());
        let rest = [fields.compression, 0, 0, 0, fields.color_count, 0];
        own.extend(rest.map(u32::to_le_bytes).concat());
        if fields.compression == 3 {
            own.extend(fields.masks.map(u32::to_le_bytes).concat());
        }
        own.resize(own.len().max(fields.own_bytes as usize), 0);
    }
    let color_bytes = if fields.own_bytes == 12 { 3 } else { 4 };
    own.extend(Random::new().bytes(color_bytes * fields.palette));
    let offset = 14 + own.len() as u32;
    let size = offset + pixels.len() as u32;
    [&b"BM"[..], &size.to_le_bytes(), &[0; 4], &offset.to_le_bytes(), &own, pixels].concat()
}

/// Random pixels as many as there are to be.
fn with_pixels(fields: Fields) -> Vec<u8> {
    let row_bytes = (fields.width as usize * usize::from(fields.bits)).div_ceil(32) * 4;
    file(fields, &Random::new().bytes(row_bytes * fields.height.unsigned_abs() as usize))
}

const HEADERS: [u32; 6] = [12, 40, 52, 56, 108, 124];

#[test]
fn palettes_and_plain_colors_are_as_in_the_crate_image() {
    let mut count = 0;
    for (own_bytes, bits) in
        HEADERS.into_iter().flat_map(|own| [1, 2, 4, 8, 16, 24, 32].map(|bits| (own, bits)))
    {
        for (width, height) in [(1, 1_i32), (2, 3), (5, -4), (17, 2), (34, 1)] {
            for color_count in [0, 2] {
                let height = if own_bytes == 12 { height.abs() } else { height };
                let palette = if bits > 8 { 0 } else { 1 << bits };
                let fields = Fields {
                    own_bytes,
                    width,
                    height,
                    bits,
                    color_count,
                    palette,
                    ..Fields::default()
                };
                count += usize::from(check("", &with_pixels(fields)).is_some());
            }
        }
    }
    // The oldest header has no pixels of 2, 16 and 32 bits.
    assert_eq!(count, (6 * 7 - 3) * 5 * 2);
}

#[test]
fn masks_are_as_in_the_crate_image() {
    let masks = [
        (16, [0xf800, 0x7e0, 0x1f, 0]),
        (16, [0x7c00, 0x3e0, 0x1f, 0x8000]),
        (16, [0xf00, 0xf0, 0xf, 0xf000]),
        (16, [0x7, 0x18, 0xe0, 0x7f00]),
        (16, [0xff80, 0x40, 0x3f, 0]),
        (32, [0xff_0000, 0xff00, 0xff, 0xff00_0000]),
        (32, [0xff_0000, 0xff00, 0xff, 0]),
        (32, [0xff00_0000, 0xff_0000, 0xff00, 0]),
        (32, [0x3ff0_0000, 0xf_fc00, 0x3ff, 0xc000_0000]),
        (32, [0xff, 0xff00, 0xff_0000, 0xff00_0000]),
        (32, [0xfe, 0x1_ff00, 0x3_0000, 0x8000_0000]),
    ];
    for own_bytes in &HEADERS[1..] {
        for (bits, masks) in masks {
            for height in [6, -6] {
                let fields = Fields {
                    own_bytes: *own_bytes,
                    width: 23,
                    height,
                    bits,
                    compression: 3,
                    masks,
                    ..Fields::default()
                };
                assert!(check("", &with_pixels(fields)).is_some(), "{own_bytes} {masks:x?}");
            }
        }
    }
    // Gaps, none, and more bits than a pixel has.
    for masks in [[0xf0f, 0xf0, 0xf000, 0], [0, 0xff, 0xff00, 0], [0xf_0000, 0xff, 0xff00, 0]] {
        let bytes = with_pixels(Fields { bits: 16, compression: 3, masks, ..Fields::default() });
        assert!(expected("", &bytes).is_none() && decode_image("", &bytes).is_err());
    }
}

#[test]
fn every_value_of_a_mask_is_scaled_as_in_the_crate_image() {
    let values: Vec<u8> = (0..=u16::MAX).step_by(1).flat_map(u16::to_le_bytes).collect();
    // Lengths of 1 to 8 bits, and of 9.
    for length in 1..=9_u32 {
        let red = (1 << length) - 1;
        let masks = [red, 1 << length, 1 << (length + 1), 0];
        let fields = Fields {
            width: 1 << 10,
            height: 1 << 6,
            bits: 16,
            compression: 3,
            masks,
            ..Fields::default()
        };
        assert!(check("", &file(fields, &values)).is_some());
    }
}

/// Runs, mostly such as fit into rows of `width`.
fn random_runs(random: &mut Random, bits: usize, width: usize, height: usize) -> Vec<u8> {
    let mut bytes = vec![];
    for _ in 0..height {
        let mut x = 0;
        while x < width && random.below(8) > 0 {
            let count = 1 + random.below(width - x);
            match random.below(9) {
                0 => bytes.extend([0, 2, count as u8, 0]),
                1 if random.below(3) == 0 => bytes.extend([0, 2, 0, 1]),
                2..5 if count >= 3 => {
                    bytes.extend([0, count as u8]);
                    bytes.extend(random.bytes((count * bits).div_ceil(16) * 2));
                }
                _ => bytes.extend([count as u8, random.byte()]),
            }
            x += count;
        }
        bytes.extend(if random.below(30) == 0 { [0, 1] } else { [0, 0] });
    }
    bytes
}

#[test]
fn runs_are_as_in_the_crate_image() {
    let mut random = Random::new();
    let mut count = 0;
    for k in 0..2000 {
        let (bits, compression) = if k % 2 == 0 { (8, 1) } else { (4, 2) };
        let (width, height) = (1 + random.below(20), 1 + random.below(6));
        let runs = random_runs(&mut random, bits, width, height);
        let (width, height) = (width as i32, height as i32);
        let fields = Fields {
            width,
            height,
            bits: bits as u16,
            compression,
            palette: 1 << bits,
            ..Fields::default()
        };
        count += usize::from(check("", &file(fields, &runs)).is_some());
    }
    assert!(count > 1000, "{count}");
    // A last run that is too long is cut.
    let fields = Fields { width: 3, bits: 8, compression: 1, palette: 256, ..Fields::default() };
    assert!(check("", &file(fields, &[9, 7, 0, 0])).is_some());
    assert!(decode_image("", &file(fields, &[0, 4, 1, 2, 3, 4, 0, 0])).is_err());
    assert!(decode_image("", &file(fields, &[0, 2, 0, 1, 0, 1])).is_err());
    // Runs start at the bottom.
    let fields = Fields { height: -1, ..fields };
    assert!(decode_image("", &file(fields, &[3, 7, 0, 0])).is_err());
}

#[test]
fn files_of_the_crate_image_and_their_damage_are_read_alike() {
    for image in images(9, 7) {
        check_damaged("", &encoded(&image, ImageFormat::Bmp));
    }
    let fields = Fields { width: 11, height: 5, ..Fields::default() };
    check_damaged(
        "",
        &with_pixels(Fields {
            bits: 16,
            compression: 3,
            masks: [0xf800, 0x7e0, 0x1f, 0],
            ..fields
        }),
    );
    check_damaged("", &with_pixels(Fields { own_bytes: 12, bits: 1, palette: 2, ..fields }));
    let runs = random_runs(&mut Random::new(), 8, 11, 5);
    check_damaged("", &file(Fields { bits: 8, compression: 1, palette: 256, ..fields }, &runs));
    let runs = random_runs(&mut Random::new(), 4, 11, 5);
    check_damaged("", &file(Fields { bits: 4, compression: 2, palette: 16, ..fields }, &runs));
}
