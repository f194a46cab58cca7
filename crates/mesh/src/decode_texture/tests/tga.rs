//! Files of all kinds, bits and corners, made by hand.

use super::*;

#[derive(Clone, Copy, Debug)]
pub(super) struct Fields {
    pub palette_kind: u8,
    pub kind: u8,
    pub palette_start: u16,
    pub palette_count: u16,
    pub palette_bits: u8,
    pub width: u16,
    pub height: u16,
    pub bits: u8,
    pub descriptor: u8,
}

impl Default for Fields {
    fn default() -> Self {
        Self {
            palette_kind: 0,
            kind: 2,
            palette_start: 0,
            palette_count: 0,
            palette_bits: 0,
            width: 1,
            height: 1,
            bits: 24,
            descriptor: 0,
        }
    }
}

/// A file with a text and a random palette; `texels` follow.
pub(super) fn file(fields: Fields, texels: &[u8]) -> Vec<u8> {
    let text = b"some text";
    let mut bytes = vec![text.len() as u8, fields.palette_kind, fields.kind];
    bytes.extend([fields.palette_start, fields.palette_count].map(u16::to_le_bytes).concat());
    bytes.push(fields.palette_bits);
    bytes.extend([3, 4, fields.width, fields.height].map(u16::to_le_bytes).concat());
    bytes.extend([fields.bits, fields.descriptor]);
    bytes.extend(text);
    let color_bytes = usize::from(fields.palette_bits.div_ceil(8));
    bytes.extend(Random::new().bytes(color_bytes * usize::from(fields.palette_count)));
    bytes.extend(texels);
    bytes
}

/// Texels, or runs of them, that are enough for any kind.
fn random_texels(fields: Fields) -> Vec<u8> {
    let mut random = Random::new();
    let count = usize::from(fields.width) * usize::from(fields.height);
    let index = |k: usize| fields.palette_start as usize + k % fields.palette_count.max(1) as usize;
    let texel = |random: &mut Random| match (fields.kind & 3, fields.bits) {
        (1, 8) => vec![index(random.below(1000)) as u8],
        (1, _) => (index(random.below(1000)) as u16).to_le_bytes().to_vec(),
        (_, bits) => random.bytes(usize::from(bits.div_ceil(8))),
    };
    if fields.kind < 8 {
        return (0..count).flat_map(|_| texel(&mut random)).collect();
    }
    let mut bytes = vec![];
    // The last runs are too long, or for nothing.
    for _ in 0..count {
        let length = random.below(9) as u8;
        let is_repeated = random.below(2) == 0;
        bytes.push(if is_repeated { 128 + length } else { length });
        (0..if is_repeated { 1 } else { length + 1 })
            .for_each(|_| bytes.extend(texel(&mut random)));
    }
    bytes
}

/// All corners, and all counts of alpha's bits.
fn descriptors() -> impl Iterator<Item = u8> {
    (0..4).flat_map(|corner| [0, 1, 4, 8].map(|alpha| corner << 4 | alpha))
}

#[test]
fn colors_and_grays_are_as_in_the_crate_image() {
    let mut count = 0;
    for (kind, descriptor) in
        [2, 3, 10, 11].into_iter().flat_map(|kind| descriptors().map(move |d| (kind, d)))
    {
        for bits in [8, 15, 16, 24, 32] {
            for (width, height) in [(1, 1), (3, 2), (5, 7)] {
                let fields = Fields { kind, width, height, bits, descriptor, ..Fields::default() };
                count +=
                    usize::from(check("a.tga", &file(fields, &random_texels(fields))).is_some());
            }
        }
    }
    // Colors: 15 bits, 16 with 0 or 1 and 32 with 0 or 8 bits of alpha, 24. Grays: 8 with 0 or 8, 16 with 8.
    assert_eq!(count, (6 + 3) * 2 * 4 * 3);
}

#[test]
fn palettes_are_as_in_the_crate_image() {
    let mut count = 0;
    for (kind, descriptor) in
        [1, 9].into_iter().flat_map(|kind| descriptors().map(move |d| (kind, d)))
    {
        for (bits, palette_bits) in
            [8, 16].into_iter().flat_map(|bits| [15, 16, 24, 32].map(|p| (bits, p)))
        {
            for (palette_start, palette_count) in [(0, 200), (7, 30)] {
                let fields = Fields {
                    palette_kind: 1,
                    kind,
                    palette_start,
                    palette_count,
                    palette_bits,
                    width: 5,
                    height: 3,
                    bits,
                    descriptor,
                };
                let bytes = file(fields, &random_texels(fields));
                count += usize::from(check("a.tga", &bytes).is_some());
                let wrong = Fields { palette_count: 2, palette_start: 300, ..fields };
                let bytes = file(wrong, &random_texels(fields));
                assert!(decode_image("a.tga", &bytes).is_err(), "{wrong:?}");
            }
        }
    }
    // 15, 16 with 0 or 1, 24, 32 with 0 or 8; that crate does not read indices of 16 bits of colors of 15.
    assert_eq!(count, (6 + 5) * 2 * 4 * 2);
}

#[test]
fn palettes_that_are_not_used_are_skipped() {
    let fields = Fields {
        palette_kind: 1,
        palette_bits: 24,
        palette_count: 9,
        width: 2,
        ..Fields::default()
    };
    let image = check("a.tga", &file(fields, &[1, 2, 3, 4, 5, 6])).unwrap();
    assert_eq!(image.texels, [[3, 2, 1, 255], [6, 5, 4, 255]]);
}

#[test]
fn files_of_the_crate_image_and_their_damage_are_read_alike() {
    for image in images(9, 7) {
        check_damaged("a.tga", &encoded(&image, ImageFormat::Tga));
    }
    for (kind, bits) in [(1, 8), (9, 16), (10, 16), (11, 8)] {
        let palette_kind = u8::from(kind & 3 == 1);
        let (palette_bits, palette_count) = (24 * palette_kind, 256 * u16::from(palette_kind));
        let fields = Fields {
            palette_kind,
            kind,
            bits,
            width: 6,
            height: 5,
            palette_bits,
            palette_count,
            ..Fields::default()
        };
        check_damaged("a.tga", &file(fields, &random_texels(fields)));
    }
}
