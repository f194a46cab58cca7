//! Scan lines of Radiance HDR files.
//!
//! A pixel is red, green, blue, and an exponent *e*, a byte each; a channel *c* stands for *c* · 2^(*e* − 136), and *e* = 0 for black. A scan line is
//! stored in one of two ways, which its first pixel tells:
//!
//! * It is 2, 2, and a third byte below 128: the channels follow one behind the other, in packets. A first byte of at most 128 says how many values
//!   follow; a larger one, less 128, how often the value behind it is repeated.
//! * Else it is the first of pixels of 4 bytes each. Red, green and blue of 1 are none: their exponent says how often the pixel before is repeated;
//!   of several such in a row, each counts 256 times as much as the one before.

use std::io::{BufRead, Error, ErrorKind};

/// A pixel as stored.
type Rgbe = [u8; 4];

/// Why scan lines cannot be read.
enum Failure {
    /// The file cannot be read.
    Io(Error),
    /// What is wrong with its pixels.
    Damaged(String),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error.kind() {
            ErrorKind::UnexpectedEof => Self::Damaged("it ends before its last pixel".into()),
            _ => Self::Io(error),
        }
    }
}

/// Reads scan lines of `length` pixels, which is above 0, one after the other. The inner error says what is wrong with them.
///
/// Takes memory for the pixels, and for one scan line. The caller has made sure that there is as much.
pub(super) fn read_scan_lines(
    reader: &mut impl BufRead,
    lines: usize,
    length: usize,
) -> std::io::Result<Result<Vec<[f32; 3]>, String>> {
    let mut pixels = Vec::with_capacity(lines * length);
    let mut line = vec![[0; 4]; length];
    for number in 1..=lines {
        match read_scan_line(reader, &mut line) {
            Ok(()) => pixels.extend(line.iter().map(|pixel| color_of(*pixel))),
            Err(Failure::Io(error)) => return Err(error),
            Err(Failure::Damaged(why)) => return Ok(Err(format!("scan line {number}: {why}"))),
        }
    }
    Ok(Ok(pixels))
}

/// Red, green and blue that a pixel stands for. All of them can be told in `f32`.
fn color_of([red, green, blue, exponent]: Rgbe) -> [f32; 3] {
    if exponent == 0 {
        return [0.0; 3];
    }
    // 2^(exponent − 136), of which f64 has 1023 more in its bits.
    let scale = f64::from_bits((u64::from(exponent) + (1023 - 136)) << 52) as f32;
    [red, green, blue].map(|channel| f32::from(channel) * scale)
}

/// Overwrites all pixels of `line`, which has some.
fn read_scan_line(reader: &mut impl BufRead, line: &mut [Rgbe]) -> Result<(), Failure> {
    let first = read_bytes(reader)?;
    match first {
        [2, 2, ..128, _] => (0..4).try_for_each(|channel| read_channel(reader, line, channel)),
        _ => read_pixels(reader, first, line),
    }
}

/// Reads the packets of one channel.
fn read_channel(
    reader: &mut impl BufRead,
    line: &mut [Rgbe],
    channel: usize,
) -> Result<(), Failure> {
    let mut rest = line;
    while !rest.is_empty() {
        let [head] = read_bytes(reader)?;
        let count = usize::from(if head > 128 { head - 128 } else { head });
        let (packet, behind) = rest.split_at_mut_checked(count).ok_or_else(too_long)?;
        let mut values = [0; 128];
        if head > 128 {
            values = read_bytes::<1>(reader).map(|[value]| [value; 128])?;
        } else {
            reader.read_exact(&mut values[..count])?;
        }
        packet.iter_mut().zip(values).for_each(|(pixel, value)| pixel[channel] = value);
        rest = behind;
    }
    Ok(())
}

/// Reads pixels and their repetitions behind the first.
fn read_pixels(reader: &mut impl BufRead, first: Rgbe, line: &mut [Rgbe]) -> Result<(), Failure> {
    if let [1, 1, 1, _] = first {
        return Err(Failure::Damaged("its first pixel repeats the one before".into()));
    }
    let (mut last, mut unit) = (first, 1_usize);
    line[0] = first;
    let mut rest = &mut line[1..];
    while !rest.is_empty() {
        let pixel = read_bytes(reader)?;
        let count = match pixel {
            [1, 1, 1, count] => {
                let count = usize::from(count).saturating_mul(unit);
                unit = unit.saturating_mul(256);
                count
            }
            _ => {
                (last, unit) = (pixel, 1);
                1
            }
        };
        let (run, behind) = rest.split_at_mut_checked(count).ok_or_else(too_long)?;
        run.fill(last);
        rest = behind;
    }
    Ok(())
}

fn too_long() -> Failure {
    Failure::Damaged("it has more pixels than the header says".into())
}

fn read_bytes<const N: usize>(reader: &mut impl BufRead) -> std::io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::image::{DynamicImage, codecs::hdr::HdrDecoder};

    /// What the crate `image` makes of scan lines.
    fn expected(bytes: &[u8], lines: usize, length: usize) -> Option<Vec<[f32; 3]>> {
        let header = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {lines} +X {length}\n");
        let file = [header.as_bytes(), bytes].concat();
        // It counts repetitions of repetitions with overflow, which may panic.
        let decode = || {
            let decoder = HdrDecoder::new(std::io::Cursor::new(file)).ok()?;
            DynamicImage::from_decoder(decoder).ok()
        };
        let picture = std::panic::catch_unwind(decode).ok().flatten()?;
        Some(picture.into_rgb32f().as_raw().as_chunks().0.to_vec())
    }

    /// Reads scan lines and compares them, bit for bit, with those of the crate `image`.
    fn check(bytes: &[u8], lines: usize, length: usize) -> Option<Vec<[f32; 3]>> {
        let bits = |pixels: Option<Vec<[f32; 3]>>| {
            pixels.map(|pixels| pixels.concat().into_iter().map(f32::to_bits).collect::<Vec<_>>())
        };
        let found = read_scan_lines(&mut &*bytes, lines, length).unwrap().ok();
        assert_eq!(bits(found.clone()), bits(expected(bytes, lines, length)), "{bytes:?}");
        found
    }

    /// Bytes that look random, from a fixed seed.
    fn random_bytes() -> impl FnMut() -> u8 {
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 56) as u8
        }
    }

    #[test]
    fn all_mantissas_and_exponents_are_as_in_the_crate_image() {
        let pixels = (0..=255).flat_map(|e| (0..=255).map(move |c| [c, 255 - c, 7, e]));
        let bytes: Vec<u8> = pixels.flatten().collect();
        // Pixels as wide as one: no first pixel of a line is a repetition or a head.
        let found = check(&bytes, 256 * 256, 1).unwrap();
        assert_eq!(found[256 * 136 + 9], [9.0, 246.0, 7.0]);
        assert_eq!(found[256 * 2 + 255][0], 255.0 * 2_f32.powi(-134));
    }

    /// Channels in packets, of one pixel and of a hundred and more, of values and of repetitions.
    fn packets(length: usize, mut random: impl FnMut() -> u8) -> Vec<u8> {
        let mut bytes = vec![2, 2, (length >> 8) as u8, length as u8];
        for _ in 0..4 {
            let mut rest = length;
            while rest > 0 {
                let is_repeated = random() & 1 == 0;
                // 128 is a length of values, not of repetitions.
                let count =
                    rest.min(1 + usize::from(random() % if is_repeated { 127 } else { 128 }));
                rest -= count;
                bytes.push(if is_repeated { 128 + count as u8 } else { count as u8 });
                bytes.extend((0..if is_repeated { 1 } else { count }).map(|_| random()));
            }
        }
        bytes
    }

    #[test]
    fn packets_are_as_in_the_crate_image() {
        let mut random = random_bytes();
        for length in [2, 8, 100, 129, 7000] {
            let bytes: Vec<u8> = (0..5).flat_map(|_| packets(length, &mut random)).collect();
            assert!(check(&bytes, 5, length).is_some());
            assert!(check(&bytes, 5, length + 1).is_none());
            assert!(check(&bytes, 5, length - 1).is_none());
        }
    }

    #[test]
    fn repeated_pixels_are_as_in_the_crate_image() {
        let a = [200, 100, 50, 130];
        let b = [20, 150, 70, 120];
        let lines: [(&[Rgbe], usize); 5] = [
            (&[a, [1, 1, 1, 3], b], 5),
            (&[a, [1, 1, 1, 4], [1, 1, 1, 2], b, [1, 1, 1, 1]], 1 + 4 + 512 + 2),
            (&[a, [1, 1, 1, 0], [1, 1, 1, 1], b], 258),
            (&[a, b, a, b], 4),
            (&[a, b, [1, 1, 1, 255]], 257),
        ];
        for (stored, length) in lines {
            let bytes = [stored.as_flattened(), stored.as_flattened()].concat();
            assert!(check(&bytes, 2, length).is_some());
            check(&bytes, 2, length - 1);
            assert!(check(&bytes[..bytes.len() - 1], 2, length).is_none());
        }
        assert!(check([[1, 1, 1, 2], a].as_flattened(), 1, 3).is_none());
        assert!(check([a, [1, 1, 1, 255], [1, 1, 1, 255], a].as_flattened(), 1, 300).is_none());
    }

    #[test]
    fn repetitions_without_end_are_no_panic() {
        let mut bytes = vec![9, 9, 9, 130];
        bytes.extend([1, 1, 1, 0].repeat(50));
        bytes.extend([1, 1, 1, 1]);
        assert!(read_scan_lines(&mut &*bytes, 1, 5).unwrap().is_err());
    }

    #[test]
    fn damaged_scan_lines_are_as_in_the_crate_image() {
        let mut random = random_bytes();
        for length in [3, 40, 300] {
            let whole: Vec<u8> = (0..3).flat_map(|_| packets(length, &mut random)).collect();
            let flat: Vec<u8> = (0..3 * 4 * length).map(|_| random()).collect();
            for bytes in [whole, flat] {
                for end in (0..bytes.len()).step_by(1 + bytes.len() / 50) {
                    check(&bytes[..end], 3, length);
                }
                for _ in 0..300 {
                    let mut damaged = bytes.clone();
                    let place = usize::from(random()) << 8 | usize::from(random());
                    damaged[place % bytes.len()] = random();
                    check(&damaged, 3, length);
                }
            }
        }
    }

    /// A reader that fails before its end.
    struct Failing;

    impl std::io::Read for Failing {
        fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
            Err(Error::other("no disk"))
        }
    }

    #[test]
    fn failures_of_the_disk_are_told_from_damage() {
        let error = read_scan_lines(&mut std::io::BufReader::new(Failing), 1, 1).unwrap_err();
        assert_eq!(error.to_string(), "no disk");
        let why = read_scan_lines(&mut &[9, 9][..], 1, 1).unwrap().unwrap_err();
        assert_eq!(why, "scan line 1: it ends before its last pixel");
    }
}
