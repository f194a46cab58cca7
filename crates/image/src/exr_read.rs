//! Reading of EXR files.

use crate::error::decode_foreign;
use crate::{
    AttributeValue, Chromaticities, Image, ImageError, ImageWindow, Metadata, Samples,
    StoredChannel, StoredImage,
};
use exr::block::reader::Reader;
use exr::compression::Compression;
use exr::image::{AnyChannels, FlatSamples, Layer};
use exr::meta::attribute::{AttributeValue as ExrValue, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::{ReadChannels, ReadLayers};
use pbgi_file::{Allowance, open_input};
use pbgi_math::Mat4;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

/// Most bytes one byte of a chunk can inflate to: deflate codes at best 258 bytes in 2 bits.
const EXPANSION_MAX: u64 = 1032;
/// Most samples that two bytes stand for before that in DWA compression: those of a block of one value.
const DWA_EXPANSION_MAX: u64 = 64;

/// Reads the full-resolution level of a flat EXR file: scan lines or tiles; half, float or uint.
///
/// A file of several parts becomes one image: each part of the first part's size and place
/// contributes its channels, with the part's name before theirs (`beauty.R`); the rest is listed in
/// [`Metadata::parts_left_out`]. Memory: the decoded samples, once as stored and once as floats.
///
/// # Errors
///
/// [`ImageError::Malformed`] for anything truncated, damaged or larger than its file can hold;
/// [`ImageError::Unsupported`] for deep or subsampled data, with the command that converts the file.
pub fn read_exr(path: &Path) -> Result<(Image, Metadata), ImageError> {
    read_exr_within(path, &Allowance::unlimited(), 0)
}

/// As [`read_exr`], where the decoded samples, the same as floats, and so many bytes per pixel beside the floats must be allowed.
pub(crate) fn read_exr_within(
    path: &Path,
    allowance: &Allowance,
    beside_bytes: u64,
) -> Result<(Image, Metadata), ImageError> {
    let beside = |channels: u64| (4 * channels).max(beside_bytes);
    let (stored, metadata) = read_samples(path, allowance, beside)?;
    Ok((stored.into(), metadata))
}

/// As [`read_exr`], with all samples as they are stored.
///
/// # Errors
///
/// Those of [`read_exr`].
pub fn read_stored_exr(path: &Path) -> Result<(StoredImage, Metadata), ImageError> {
    read_samples(path, &Allowance::unlimited(), |_| 0)
}

/// As [`read_stored_exr`], where the decoded samples and so many bytes per pixel beside them must be allowed, with which the sizes in the
/// header are compared before a pixel is read.
///
/// # Errors
///
/// Those of [`read_exr`]; an [`Excess`](pbgi_file::Excess) as cause where the allowance does not do.
pub fn read_stored_exr_within(
    path: &Path,
    allowance: &Allowance,
    beside_bytes: u64,
) -> Result<(StoredImage, Metadata), ImageError> {
    read_samples(path, allowance, |_| beside_bytes)
}

/// Reads the attributes alone of a file, as [`read_exr`] gives them.
///
/// # Errors
///
/// Those of [`read_exr`], as far as headers tell.
pub fn read_exr_metadata(path: &Path) -> Result<Metadata, ImageError> {
    let (reader, _) = open(path)?;
    match reader.headers().first() {
        Some(first) => Ok(metadata_of(first)),
        None => Err(ImageError::malformed(path, "no part found, expected one at least")),
    }
}

/// What window and attributes of the first part say.
fn metadata_of(first: &Header) -> Metadata {
    let (own, shared) = (&first.own_attributes, &first.shared_attributes);
    let position = own.layer_position;
    let mut attributes = collect_attributes(own);
    attributes.extend(shared.other.iter().filter_map(convert));
    attributes.sort_by(|a, b| a.0.cmp(&b.0));
    Metadata {
        window: ImageWindow {
            data_origin: [position.0, position.1],
            display_origin: [shared.display_window.position.0, shared.display_window.position.1],
            display_size: [shared.display_window.size.0, shared.display_window.size.1],
        },
        attributes,
        chromaticities: shared.chromaticities.map(|c| Chromaticities {
            primaries: [c.red, c.green, c.blue].map(|v| [v.0, v.1]),
            white: [c.white.0, c.white.1],
        }),
        parts_left_out: Vec::new(),
        is_multipart: false,
    }
}

type FileReader = Reader<BufReader<File>>;

/// Reads the headers, and the length of the file.
fn open(path: &Path) -> Result<(FileReader, u64), ImageError> {
    let io = |action| move |e| ImageError::io(path, action, e);
    let file = open_input(path).map_err(io("open"))?;
    let file_bytes = file.metadata().map_err(io("read the size of"))?.len();
    decode_foreign(path, || {
        let reader = exr::block::read(BufReader::new(file), false).map_err(from_exr(path))?;
        Ok((reader, file_bytes))
    })
}

/// Reads all samples; `beside_bytes` tells of so many channels what a pixel takes beside them.
fn read_samples(
    path: &Path,
    allowance: &Allowance,
    beside_bytes: impl Fn(u64) -> u64,
) -> Result<(StoredImage, Metadata), ImageError> {
    let (reader, file_bytes) = open(path)?;
    let claimed_bytes = check_headers(path, reader.headers(), file_bytes)?;
    let beside = |header: &Header| {
        let pixels = header.layer_size.width() as u64 * header.layer_size.height() as u64;
        pixels.saturating_mul(beside_bytes(header.channels.list.len() as u64))
    };
    let needed = reader.headers().iter().map(beside).fold(claimed_bytes, u64::saturating_add);
    // Blocks on their way, and the table of their offsets.
    let needed = needed.saturating_add(needed / 16);
    allowance.check(needed).map_err(|e| ImageError::io(path, "read", e))?;
    decode_foreign(path, || decode(path, reader))
}

fn from_exr(path: &Path) -> impl Fn(exr::error::Error) -> ImageError + '_ {
    move |error| match error {
        exr::error::Error::Io(cause) => ImageError::io(path, "read", cause),
        // Deep files are refused before their headers can be looked at.
        exr::error::Error::NotSupported(what) if what.to_lowercase().contains("deep") => {
            ImageError::unsupported(path, "deep data", FLATTEN)
        }
        exr::error::Error::NotSupported(what) if what.to_lowercase().contains("subsampl") => {
            ImageError::unsupported(path, "subsampled channels (luminance and chroma)", SAMPLE)
        }
        exr::error::Error::NotSupported(what) => {
            ImageError::unsupported(path, format!("this exr file ({what})"), CONVERT)
        }
        other => ImageError::malformed(
            path,
            format!("not a readable exr file ({other}); write or copy it again"),
        ),
    }
}

const FLATTEN: &str = "flatten it with: oiiotool in.exr --flatten --compression zip -o out.exr";
const SAMPLE: &str = "write it with R, G and B where it comes from";
const CONVERT: &str = "convert it with: oiiotool in.exr --compression zip -o out.exr";

/// Bytes of all samples. Refuses what is not read here, and sizes that the file cannot hold, before they are allocated.
fn check_headers(path: &Path, headers: &[Header], file_bytes: u64) -> Result<u64, ImageError> {
    let (mut claimed_bytes, mut inflated_bytes) = (0u64, 0u64);
    let mut chunk_count = 0u64;
    for header in headers {
        let refuse = |found: String, cure: &str| Err(ImageError::unsupported(path, found, cure));
        if header.deep {
            return refuse("deep data".into(), FLATTEN);
        }
        if let Some(c) =
            header.channels.list.iter().find(|c| c.sampling.0 != 1 || c.sampling.1 != 1)
        {
            let found = format!("subsampled channel {} (luminance-chroma)", c.name);
            return refuse(found, SAMPLE);
        }
        let samples =
            (header.layer_size.width() as u64).saturating_mul(header.layer_size.height() as u64);
        let pixel_bytes = header.channels.bytes_per_pixel as u64;
        let is_dwa = matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_));
        let expansion = if is_dwa { DWA_EXPANSION_MAX } else { 1 };
        let bytes = samples.saturating_mul(pixel_bytes);
        claimed_bytes = claimed_bytes.saturating_add(bytes);
        inflated_bytes = inflated_bytes.saturating_add(bytes / expansion);
        chunk_count = chunk_count.saturating_add(header.chunk_count as u64);
    }
    // Each chunk has an offset of 8 bytes and a head of at least 8.
    let too_large = chunk_count.saturating_mul(16) > file_bytes
        || inflated_bytes > file_bytes.saturating_mul(EXPANSION_MAX);
    if too_large {
        return Err(ImageError::malformed(
            path,
            format!(
                "the header claims {claimed_bytes} bytes of pixels in {chunk_count} chunks, more \
                 than a file of {file_bytes} bytes can hold; write or copy it again"
            ),
        ));
    }
    Ok(claimed_bytes)
}

fn decode<R: Read + Seek>(
    path: &Path,
    reader: Reader<R>,
) -> Result<(StoredImage, Metadata), ImageError> {
    // On this thread only: a panic of the decoder on a pool thread would end the process.
    let metadata = reader.headers().first().map(metadata_of);
    let decoded = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_chunks(reader)
        .map_err(from_exr(path))?;
    let parts = decoded.layer_data;
    let (Some(first), Some(mut metadata)) = (parts.first(), metadata) else {
        return Err(ImageError::malformed(path, "no part found, expected one at least"));
    };
    let (size, position) = (first.size, first.attributes.layer_position);
    let (width, height) = (size.width(), size.height());
    let mut image = StoredImage { width, height, channels: Vec::new() };
    let several = parts.len() > 1;
    metadata.is_multipart = several;
    for part in parts {
        let name = part.attributes.layer_name.as_ref().map(to_string).unwrap_or_default();
        if part.size == size && part.attributes.layer_position == position {
            append_channels(&mut image, part, if several { &name } else { "" });
        } else {
            metadata.parts_left_out.push(name);
        }
    }
    Ok((image, metadata))
}

/// Appends the channels of a part under `prefix.name`; the first of two equal names wins.
fn append_channels(image: &mut StoredImage, part: Layer<AnyChannels<FlatSamples>>, prefix: &str) {
    for channel in part.channel_data.list {
        let mut name = to_string(&channel.name);
        let prefixed = name.strip_prefix(prefix).is_some_and(|rest| rest.starts_with('.'));
        if !prefix.is_empty() && !prefixed {
            name = format!("{prefix}.{name}");
        }
        if image.channels.iter().any(|c| c.name == name) {
            continue;
        }
        let samples = match channel.sample_data {
            FlatSamples::F16(samples) => Samples::Half(samples),
            FlatSamples::F32(samples) => Samples::Float(samples),
            FlatSamples::U32(samples) => Samples::Uint(samples),
        };
        image.channels.push(StoredChannel { name, samples });
    }
}

fn collect_attributes(own: &LayerAttributes) -> Vec<(String, AttributeValue)> {
    let texts = [
        ("software", &own.software_name),
        ("comments", &own.comments),
        ("owner", &own.owner),
        ("name", &own.layer_name),
    ];
    let matrices =
        [("worldToCamera", own.world_to_camera), ("worldToNDC", own.world_to_normalized_device)];
    let texts = texts.into_iter().filter_map(|(name, value)| {
        value.as_ref().map(|v| (name.to_owned(), AttributeValue::Text(to_string(v))))
    });
    let matrices = matrices.into_iter().filter_map(|(name, value)| {
        value.map(|m| (name.to_owned(), AttributeValue::Matrix(Mat4::from_cols_array(&m))))
    });
    texts.chain(matrices).chain(own.other.iter().filter_map(convert)).collect()
}

fn convert((name, value): (&Text, &ExrValue)) -> Option<(String, AttributeValue)> {
    let value = match value {
        ExrValue::Text(s) => AttributeValue::Text(to_string(s)),
        ExrValue::F32(x) => AttributeValue::Float(*x),
        ExrValue::I32(i) => AttributeValue::Int(*i),
        // The file's rows are the columns of a matrix that multiplies column vectors.
        ExrValue::Matrix4x4(m) => AttributeValue::Matrix(Mat4::from_cols_array(m)),
        _ => return None,
    };
    Some((to_string(name), value))
}

fn to_string(text: &Text) -> String {
    String::from_utf8_lossy(text.bytes()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write_exr;
    use exr::prelude as ex;
    use exr::prelude::WritableImage;
    use tempfile::tempdir;

    const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");

    #[test]
    fn tiled_mip_mapped_file_loads_at_full_resolution() {
        let path = Path::new(DATA).join("StageEnvLatLong.exr");
        if !path.exists() {
            return println!("skipped: no shared data");
        }
        let (image, _) = read_exr(&path).unwrap();
        assert_eq!((image.width, image.height), (1000, 500));
        let green = image.channel("G").unwrap();
        assert_eq!(green.len(), 500_000);
        assert!(green.iter().all(|g| g.is_finite() && *g >= 0.0));
        // The bottom right tile, too, is filled.
        assert!(green[499 * 1000 + 900..].iter().any(|g| *g > 0.0));
        let max = image.channels.iter().flat_map(|c| &c.data).fold(0f32, |a, b| a.max(*b));
        assert_eq!(max, 4096.0);
    }

    #[test]
    fn truncation_at_any_length_is_an_error() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let mut image = Image::new(64, 64);
        image.push("R", (0..4096).map(|i| (i as f32).sin()).collect());
        write_exr(&path, &image, &[]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for length in (0..bytes.len()).step_by(97).chain([1, 4, 8, 9, bytes.len() - 1]) {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let error = read_exr(&path).unwrap_err();
            assert!(matches!(error, ImageError::Malformed { .. }), "{length}: {error}");
        }
    }

    #[test]
    fn damaged_headers_never_panic() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let mut image = Image::new(9, 7);
        image.push("R", vec![0.5; 63]);
        write_exr(&path, &image, &[]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for at in 0..bytes.len().min(700) {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                std::fs::write(&path, &damaged).unwrap();
                // Some flips only rename a channel; what counts is that there is an answer.
                let _ = read_exr(&path);
            }
        }
    }

    #[test]
    fn sizes_beyond_the_file_are_refused_before_allocation() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let mut image = Image::new(9, 7);
        image.push("R", vec![0.5; 63]);
        write_exr(&path, &image, &[]).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let key = b"dataWindow\0box2i\0";
        let at = bytes.windows(key.len()).position(|w| w == key).unwrap() + key.len() + 4;
        bytes[at + 8..at + 12].copy_from_slice(&0x3fff_fff0i32.to_le_bytes());
        std::fs::write(&path, &bytes).unwrap();
        let error = read_exr(&path).unwrap_err().to_string();
        assert!(error.contains("more than a file of"), "{error}");
    }

    #[test]
    fn parts_are_merged_under_their_names() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let part = |name: &str, channel: &str, size: usize, value: f32| {
            let channels = AnyChannels::sort(
                [ex::AnyChannel::new(channel, FlatSamples::F32(vec![value; size * size]))]
                    .into_iter()
                    .collect(),
            );
            let attributes = LayerAttributes::named(name);
            Layer::new((size, size), attributes, ex::Encoding::FAST_LOSSLESS, channels)
        };
        let parts =
            [part("beauty", "R", 4, 1.0), part("AO", "AO.Y", 4, 2.0), part("small", "Y", 2, 3.0)];
        let window = ex::IntegerBounds::from_dimensions((4, 4));
        let file = exr::image::Image {
            attributes: ex::ImageAttributes::new(window),
            layer_data: exr::image::Layers::from_iter(parts),
        };
        file.write().to_file(&path).unwrap();
        let (image, metadata) = read_exr(&path).unwrap();
        assert_eq!(image.channel("beauty.R"), Some(&[1.0; 16][..]));
        assert_eq!(image.channel("AO.Y"), Some(&[2.0; 16][..]));
        assert_eq!(image.channels.len(), 2);
        assert_eq!(metadata.parts_left_out, ["small"]);
    }

    #[test]
    fn half_and_uint_become_float() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let list = [
            ex::AnyChannel::new("h", FlatSamples::F16(vec![half::f16::from_f32(0.5); 6])),
            ex::AnyChannel::new("u", FlatSamples::U32(vec![7; 6])),
        ];
        let channels = AnyChannels::sort(list.into_iter().collect());
        let file = exr::image::Image::from_channels((3, 2), channels);
        file.write().to_file(&path).unwrap();
        let (image, _) = read_exr(&path).unwrap();
        assert_eq!(image.channel("h"), Some(&[0.5; 6][..]));
        assert_eq!(image.channel("u"), Some(&[7.0; 6][..]));
    }

    #[test]
    fn dwa_compression_is_read() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let value = |i: usize| 2.0 + (i as f32 * 0.01).sin();
        for compression in [Compression::DWAA(None), Compression::DWAB(Some(45.0))] {
            let samples = |k: usize| FlatSamples::F32((0..4096).map(|i| value(i + k)).collect());
            let list = ["R", "G", "B"].iter().enumerate();
            let list = list.map(|(k, name)| ex::AnyChannel::new(*name, samples(k)));
            let channels = AnyChannels::sort(list.collect());
            let encoding = ex::Encoding { compression, ..ex::Encoding::FAST_LOSSLESS };
            let layer = Layer::new((64, 64), LayerAttributes::named("a"), encoding, channels);
            exr::image::Image::from_layer(layer).write().to_file(&path).unwrap();
            let (image, _) = read_exr(&path).unwrap();
            let red = image.channel("R").unwrap();
            // Lossy: a part in a hundred at this level.
            assert!((0..4096).all(|i| (red[i] / value(i) - 1.0).abs() < 0.01));
        }
    }

    #[test]
    fn deep_files_name_their_cure() {
        let cause = exr::error::Error::NotSupported("deep data not supported yet".into());
        let error = from_exr(Path::new("a.exr"))(cause);
        assert!(error.to_string().contains("--flatten"), "{error}");
    }
}
