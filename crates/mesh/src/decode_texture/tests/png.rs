//! Files made by hand, as no encoder at hand interlaces.

use super::*;

/// Fields of the header, and chunks behind it.
pub(super) struct Fields {
    pub width: u32,
    pub height: u32,
    pub depth: u8,
    /// 0 gray, 2 colors, 3 indices, 4 gray and alpha, 6 colors and alpha.
    pub colors: u8,
    pub is_interlaced: bool,
    pub chunks: Vec<([u8; 4], Vec<u8>)>,
    /// Rows, each behind the number of its filter.
    pub rows: Vec<u8>,
}

impl Default for Fields {
    fn default() -> Self {
        let (depth, colors, is_interlaced) = (8, 2, false);
        Self { width: 1, height: 1, depth, colors, is_interlaced, chunks: vec![], rows: vec![] }
    }
}

fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32| (crc >> 1) ^ (0xedb8_8320 * (crc & 1));
    !bytes.iter().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |crc, _| step(crc)))
}

fn adler(bytes: &[u8]) -> u32 {
    let add =
        |(a, b), byte: &u8| ((a + u32::from(*byte)) % 65_521, (a + u32::from(*byte) + b) % 65_521);
    let (a, b) = bytes.iter().fold((1, 0), add);
    b << 16 | a
}

pub(super) fn file(fields: Fields) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut put = |name: [u8; 4], data: &[u8]| {
        let named = [&name, data].concat();
        bytes.extend((data.len() as u32).to_be_bytes());
        bytes.extend(&named);
        bytes.extend(crc(&named).to_be_bytes());
    };
    let size = [fields.width.to_be_bytes(), fields.height.to_be_bytes()].concat();
    put(
        *b"IHDR",
        &[&size[..], &[fields.depth, fields.colors, 0, 0, fields.is_interlaced.into()]].concat(),
    );
    fields.chunks.iter().for_each(|(name, data)| put(*name, data));
    // One block that is not compressed.
    let length = fields.rows.len() as u16;
    let mut data = vec![0x78, 1, 1];
    data.extend([length.to_le_bytes(), (!length).to_le_bytes()].concat());
    data.extend(&fields.rows);
    data.extend(adler(&fields.rows).to_be_bytes());
    put(*b"IDAT", &data);
    put(*b"IEND", &[]);
    bytes
}

/// Columns and rows of the seven pictures that an interlaced one is made of.
fn passes(width: usize, height: usize) -> [[usize; 2]; 7] {
    // First column and row, and steps of both.
    let places = [
        [0, 0, 8, 8],
        [4, 0, 8, 8],
        [0, 4, 4, 8],
        [2, 0, 4, 4],
        [0, 2, 2, 4],
        [1, 0, 2, 2],
        [0, 1, 1, 2],
    ];
    places.map(|[x, y, dx, dy]| {
        [width.saturating_sub(x).div_ceil(dx), height.saturating_sub(y).div_ceil(dy)]
    })
}

fn random_rows(fields: &Fields, random: &mut Random) -> Vec<u8> {
    let channels = [1, 0, 3, 1, 2, 0, 4][usize::from(fields.colors)];
    let (width, height) = (fields.width as usize, fields.height as usize);
    let whole = vec![[width, height]];
    let pictures = if fields.is_interlaced { passes(width, height).to_vec() } else { whole };
    let mut rows = vec![];
    for [columns, count] in pictures.into_iter().filter(|[columns, _]| *columns > 0) {
        for _ in 0..count {
            let filter = random.below(5) as u8;
            // Filters lead from index to index that there may be none of.
            rows.push(if fields.colors == 3 { 0 } else { filter });
            rows.extend(random.bytes((columns * channels * usize::from(fields.depth)).div_ceil(8)));
        }
    }
    rows
}

/// Files of all colors and depths, with and without what is transparent.
fn files(is_interlaced: bool, width: u32, height: u32) -> Vec<Vec<u8>> {
    let mut random = Random::new();
    let mut files = vec![];
    for (colors, depths) in [
        (0, &[1, 2, 4, 8, 16][..]),
        (2, &[8, 16]),
        (3, &[1, 2, 4, 8]),
        (4, &[8, 16]),
        (6, &[8, 16]),
    ] {
        for (&depth, is_transparent) in
            depths.iter().flat_map(|depth| [(depth, false), (depth, true)])
        {
            let mut chunks = vec![];
            if colors == 3 {
                chunks.push((*b"PLTE", random.bytes(3 << depth)));
            }
            match (is_transparent, colors) {
                (true, 0) => chunks
                    .push((*b"tRNS", vec![0, random.byte() & ((1_u32 << depth.min(8)) - 1) as u8])),
                (true, 2) => chunks.push((*b"tRNS", vec![0, 1, 0, 2, 0, 3])),
                // Of some indices only.
                (true, 3) => chunks.push((*b"tRNS", random.bytes((1 << depth) - 1))),
                (true, _) => continue,
                _ => {}
            }
            let mut fields =
                Fields { width, height, depth, colors, is_interlaced, chunks, rows: vec![] };
            fields.rows = random_rows(&fields, &mut random);
            files.push(file(fields));
        }
    }
    files
}

#[test]
fn all_colors_and_depths_are_as_in_the_crate_image() {
    for is_interlaced in [false, true] {
        for (width, height) in [(1, 1), (3, 2), (13, 9), (40, 30)] {
            let files = files(is_interlaced, width, height);
            assert_eq!(files.len(), 5 + 5 + 2 + 2 + 4 + 4 + 2 + 2);
            for bytes in files {
                assert!(check("", &bytes).is_some(), "{bytes:?}");
            }
        }
    }
}

#[test]
fn all_values_of_16_bits_are_rounded_as_in_the_crate_image() {
    let rows = (0..=255)
        .flat_map(|high| std::iter::once(0).chain((0..=255).flat_map(move |low| [high, low])));
    let rows: Vec<u8> = rows.collect();
    // Two files: a block holds 65535 bytes.
    for rows in rows.chunks(128 * 513) {
        for (top, rows) in rows.chunks(64 * 513).enumerate() {
            let fields = Fields {
                width: 256,
                height: 64,
                depth: 16,
                colors: 0,
                rows: rows.to_vec(),
                ..Fields::default()
            };
            assert!(check("", &file(fields)).is_some(), "{top}");
        }
    }
}

#[test]
fn files_of_the_crate_image_and_their_damage_are_read_alike() {
    for image in images(9, 7) {
        check_damaged("", &encoded(&image, ImageFormat::Png));
    }
    for bytes in files(true, 5, 5).iter().chain(&files(false, 5, 5)).step_by(5) {
        check_damaged("", bytes);
    }
}

#[test]
fn first_pictures_of_animations_are_read() {
    let mut bytes = vec![];
    let mut encoder = ::png::Encoder::new(&mut bytes, 2, 1);
    encoder.set_animated(2, 0).unwrap();
    encoder.set_color(::png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&[1, 2, 3, 4, 5, 6]).unwrap();
    writer.write_image_data(&[9; 6]).unwrap();
    writer.finish().unwrap();
    assert_eq!(check("", &bytes).unwrap().texels, [[1, 2, 3, 255], [4, 5, 6, 255]]);
}
