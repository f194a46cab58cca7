//! Files of the crate `image`, and files of plain blocks made by hand: that crate writes neither CMYK nor progressive files.

use super::*;

pub(super) struct Fields {
    pub width: u16,
    pub height: u16,
    pub components: u8,
    pub is_progressive: bool,
    /// What Adobe's marker says: 0 for none, 1 for YCbCr, 2 for YCCK.
    pub transform: Option<u8>,
}

impl Default for Fields {
    fn default() -> Self {
        Self { width: 8, height: 8, components: 3, is_progressive: false, transform: None }
    }
}

/// Bits, the high ones first, with a zero behind each byte of ones.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    pending: u32,
    count: u32,
}

impl Bits {
    fn put(&mut self, value: u32, count: u32) {
        for k in (0..count).rev() {
            self.pending = self.pending << 1 | (value >> k & 1);
            self.count += 1;
            if self.count == 8 {
                self.bytes.push(self.pending as u8);
                if self.pending == 0xff {
                    self.bytes.push(0);
                }
                (self.pending, self.count) = (0, 0);
            }
        }
    }
}

/// A file whose blocks of 8 x 8 have one random color each.
pub(super) fn file(fields: Fields) -> Vec<u8> {
    let mut bytes = vec![0xff, 0xd8];
    let mut put = |marker: u8, data: &[u8]| {
        bytes.extend([0xff, marker]);
        bytes.extend((data.len() as u16 + 2).to_be_bytes());
        bytes.extend(data);
    };
    if let Some(transform) = fields.transform {
        put(0xee, &[b'A', b'd', b'o', b'b', b'e', 0, 100, 0, 0, 0, 0, transform]);
    }
    // All factors are 8, so that a step of the mean is one of a texel.
    put(0xdb, &[&[0][..], &[8; 64]].concat());
    let mut frame = vec![8];
    frame.extend(fields.height.to_be_bytes());
    frame.extend(fields.width.to_be_bytes());
    frame.push(fields.components);
    (1..=fields.components).for_each(|component| frame.extend([component, 0x11, 0]));
    put(if fields.is_progressive { 0xc2 } else { 0xc0 }, &frame);
    // Means: lengths 0 to 11 in 4 bits. Else: the end of a block in one bit.
    let mut means = vec![0, 0, 0, 0, 12];
    means.extend([0; 12]);
    means.extend(0..12);
    put(0xc4, &means);
    let mut others = vec![0x10, 1];
    others.extend([0; 16]);
    put(0xc4, &others);
    let mut scan = vec![fields.components];
    (1..=fields.components).for_each(|component| scan.extend([component, 0]));
    scan.extend(if fields.is_progressive { [0, 0, 0] } else { [0, 63, 0] });
    put(0xda, &scan);
    let (mut random, mut bits) = (Random::new(), Bits::default());
    let mut last = vec![0; usize::from(fields.components)];
    let blocks = usize::from(fields.width.div_ceil(8)) * usize::from(fields.height.div_ceil(8));
    for _ in 0..blocks.min(100) {
        for last in &mut last {
            let mean = random.below(256) as i32 - 128;
            let step = mean - *last;
            *last = mean;
            let length = u32::BITS - step.unsigned_abs().leading_zeros();
            bits.put(length, 4);
            // Steps down are told less one.
            bits.put(if step < 0 { (step - 1) as u32 } else { step as u32 }, length);
            if !fields.is_progressive {
                bits.put(0, 1);
            }
        }
    }
    bits.put(0x7f, 7);
    bytes.extend(bits.bytes);
    bytes.extend([0xff, 0xd9]);
    bytes
}

#[test]
fn all_colors_are_as_in_the_crate_image() {
    for (components, transform) in
        [(1, None), (3, None), (3, Some(0)), (3, Some(1)), (4, None), (4, Some(0)), (4, Some(2))]
    {
        for is_progressive in [false, true] {
            for (width, height) in [(8, 8), (30, 17), (1, 1)] {
                let bytes = file(Fields { width, height, components, is_progressive, transform });
                let image = check("", &bytes)
                    .unwrap_or_else(|| panic!("{components} {transform:?} {is_progressive}"));
                let mut texels = image.texels;
                texels.dedup();
                assert!(texels.len() > 1 || width <= 8, "{texels:?}");
            }
        }
    }
}

#[test]
fn files_of_the_crate_image_and_their_damage_are_read_alike() {
    for image in images(37, 21).iter().step_by(2) {
        check_damaged("", &encoded(image, ImageFormat::Jpeg));
    }
    for (components, is_progressive) in [(3, true), (4, false)] {
        check_damaged(
            "",
            &file(Fields { width: 20, components, is_progressive, ..Fields::default() }),
        );
    }
}
