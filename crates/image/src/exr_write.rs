//! Writing of EXR files.

use crate::{
    AttributeValue, Image, ImageError, ImageWindow, Planes, RgbImage, Samples, StoredChannel,
    write_atomically,
};
use exr::block::UncompressedBlock;
use exr::block::writer::{ChunksWriter, ParallelBlocksCompressor};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::attribute::{
    AttributeValue as ExrValue, ChannelDescription, IntegerBounds, LineOrder, SampleType, Text,
};
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use half::f16;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Cursor, Seek, Write};
use std::ops::Range;
use std::path::Path;

/// Header attributes that describe the layout of the file and so cannot be set by a caller.
pub const LAYOUT_ATTRIBUTES: [&str; 14] = [
    "channels",
    "chunkCount",
    "compression",
    "dataWindow",
    "displayWindow",
    "lineOrder",
    "maxSamplesPerPixel",
    "name",
    "pixelAspectRatio",
    "screenWindowCenter",
    "screenWindowWidth",
    "tiles",
    "type",
    "version",
];

/// Writes `image` as one part of ZIP-compressed scan lines, each channel as 32-bit floats; it is the whole frame.
///
/// Channels go into a single part with names such as `diffuse_indirect.R`, which every reader
/// understands as layers. Attributes take their standard field where the name has one
/// (`worldToCamera`, `worldToNDC`, `software`, `comments`, `owner`); matrices are transposed on
/// the way, see [`AttributeValue::Matrix`]. The bytes are the same for any number of threads.
/// The file appears whole or not at all ([`write_atomically`]). Beside `image` only a few blocks of
/// 16 rows are in memory at a time ([`exr_write_bytes`]).
///
/// # Errors
///
/// [`ImageError::Unwritable`] for an empty image, a channel of the wrong length, names that are
/// empty, doubled or reserved; [`ImageError::Io`] if writing fails.
pub fn write_exr(
    path: &Path,
    image: &Image,
    attributes: &[(String, AttributeValue)],
) -> Result<(), ImageError> {
    let window = ImageWindow::whole(image.width, image.height);
    write_windowed_exr(path, image, &[], &window, attributes)
}

/// As [`write_exr`], with the pixels at their place in a frame of any size, and with the `stored` channels of another
/// file, of the same number of pixels, bit for bit.
///
/// # Errors
///
/// Those of [`write_exr`].
pub fn write_windowed_exr(
    path: &Path,
    image: &Image,
    stored: &[StoredChannel],
    window: &ImageWindow,
    attributes: &[(String, AttributeValue)],
) -> Result<(), ImageError> {
    let own = image
        .channels
        .iter()
        .map(|c| Written { name: &c.name, samples: WrittenSamples::Float(&c.data) });
    write_channels(path, [image.width, image.height], own, stored, window, attributes)
}

/// As [`write_windowed_exr`], of planes, which need not be in memory.
///
/// # Errors
///
/// Those of [`write_exr`] and of [`Planes::read`].
pub fn write_planes_exr(
    path: &Path,
    planes: &Planes,
    stored: &[StoredChannel],
    window: &ImageWindow,
    attributes: &[(String, AttributeValue)],
) -> Result<(), ImageError> {
    let own = planes
        .names()
        .iter()
        .enumerate()
        .map(|(plane, name)| Written { name, samples: WrittenSamples::Plane(planes, plane) });
    write_channels(path, [planes.width(), planes.height()], own, stored, window, attributes)
}

/// Most bytes of memory that writing takes beside the image, if a single block does not take more.
const WRITE_BYTES_MAX: usize = 64 << 20;

/// Rows of a block.
const BLOCK_ROWS: usize = 16;

/// Times a block is held while it is compressed: as it comes, with its bytes in another order, and compressed.
const BLOCK_COPIES: usize = 3;

/// Bytes of memory that writing `height` rows of `width` pixels with so many channels takes beside the image, at most.
#[must_use]
pub fn exr_write_bytes(width: usize, height: usize, channel_count: usize) -> usize {
    let at_once = match compressor_threads(width, channel_count) {
        0 => 1,
        threads => threads + 2,
    };
    at_once.min(height.div_ceil(BLOCK_ROWS)) * block_bytes(width, channel_count) * BLOCK_COPIES
}

fn block_bytes(width: usize, channel_count: usize) -> usize {
    BLOCK_ROWS * width * channel_count * size_of::<f32>()
}

/// Threads that compress blocks: one more block than that is being made, and one is waiting; none where there is no room for that.
fn compressor_threads(width: usize, channel_count: usize) -> usize {
    let blocks = WRITE_BYTES_MAX / (block_bytes(width, channel_count) * BLOCK_COPIES).max(1);
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    blocks.saturating_sub(2).min(processors)
}

fn write_channels<'a>(
    path: &Path,
    size: [usize; 2],
    own: impl Iterator<Item = Written<'a>>,
    stored: &'a [StoredChannel],
    window: &ImageWindow,
    attributes: &[(String, AttributeValue)],
) -> Result<(), ImageError> {
    let stored = stored
        .iter()
        .map(|c| Written { name: &c.name, samples: WrittenSamples::Stored(&c.samples) });
    let channels = check_channels(path, size, own.chain(stored).collect())?;
    let mut header = describe(path, size, &channels, attributes)?;
    set_window(&mut header, window);
    let sorted =
        serialize_sorted(&header).map_err(|message| ImageError::unwritable(path, message))?;
    write_atomically(path, |file| {
        exr::block::write(&mut *file, [header].into_iter().collect(), true, |meta, writer| {
            write_blocks(&meta, writer, &channels, size[0])
        })
        .map_err(|error| match error {
            exr::error::Error::Io(cause) => cause,
            other => io::Error::other(other.to_string()),
        })?;
        file.seek(io::SeekFrom::Start(0))?;
        file.write_all(&sorted)
    })
    .map_err(ImageError::or_cause)
}

/// Compresses all blocks in their order, on several threads where there is room for their blocks.
fn write_blocks(
    meta: &MetaData,
    writer: &mut impl ChunksWriter,
    channels: &[Written<'_>],
    width: usize,
) -> exr::error::UnitResult {
    let blocks = meta.enumerate_ordered_header_block_indices().map(|(number, index)| {
        let (y, rows) = (index.pixel_position.y(), index.pixel_size.y());
        let data = gather_rows(channels, width, y..y + rows).map_err(io::Error::other)?;
        Ok((number, UncompressedBlock { index, data }))
    });
    let mut blocks = blocks.map(|block| block.map_err(exr::error::Error::Io));
    let threads = compressor_threads(width, channels.len());
    let pool = || rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let parallel = (threads > 0)
        .then(|| ParallelBlocksCompressor::new_with_thread_pool(meta, writer, pool))
        .flatten();
    if let Some(mut compressor) = parallel {
        return blocks.try_for_each(|block| {
            let (number, block) = block?;
            compressor.add_block_to_compression_queue(number, block)
        });
    }
    let mut compressor = writer.sequential_blocks_compressor(meta);
    blocks.try_for_each(|block| {
        let (number, block) = block?;
        compressor.compress_block(number, block)
    })
}

/// Writes an environment as an EXR file with the channels `R`, `G` and `B`.
///
/// # Errors
///
/// Those of [`write_exr`].
pub fn write_environment_exr(
    path: &Path,
    environment: &RgbImage,
    attributes: &[(String, AttributeValue)],
) -> Result<(), ImageError> {
    let (width, height) = (environment.width, environment.height);
    let found = environment.pixels.len();
    if found != width * height {
        let message = format!("{found} pixels, expected {width} x {height}");
        return Err(ImageError::unwritable(path, message));
    }
    let mut image = Image::new(width, height);
    image.push_rgb(["R", "G", "B"], &environment.pixels);
    write_exr(path, &image, attributes)
}

/// A channel to be written.
struct Written<'a> {
    name: &'a str,
    samples: WrittenSamples<'a>,
}

enum WrittenSamples<'a> {
    Float(&'a [f32]),
    Stored(&'a Samples),
    /// A plane by its index.
    Plane(&'a Planes, usize),
}

impl WrittenSamples<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Float(samples) => samples.len(),
            Self::Stored(samples) => samples.len(),
            Self::Plane(planes, plane) => planes.len(*plane),
        }
    }

    fn kind(&self) -> SampleType {
        match self {
            Self::Float(_) | Self::Plane(..) | Self::Stored(Samples::Float(_)) => SampleType::F32,
            Self::Stored(Samples::Half(_)) => SampleType::F16,
            Self::Stored(Samples::Uint(_)) => SampleType::U32,
        }
    }

    /// Rows of samples.
    fn read(&self, range: Range<usize>) -> Result<RowSamples<'_>, ImageError> {
        Ok(match self {
            Self::Float(s) => RowSamples::Float(Cow::Borrowed(&s[range])),
            Self::Stored(Samples::Float(s)) => RowSamples::Float(Cow::Borrowed(&s[range])),
            Self::Stored(Samples::Half(s)) => RowSamples::Half(&s[range]),
            Self::Stored(Samples::Uint(s)) => RowSamples::Uint(&s[range]),
            Self::Plane(planes, plane) => RowSamples::Float(planes.read(*plane, range)?),
        })
    }
}

/// Samples of the rows of a block.
enum RowSamples<'a> {
    Half(&'a [f16]),
    Float(Cow<'a, [f32]>),
    Uint(&'a [u32]),
}

impl RowSamples<'_> {
    /// Appends samples in the byte order of this machine.
    fn push_bytes(&self, range: Range<usize>, bytes: &mut Vec<u8>) {
        fn push<T, const N: usize>(samples: &[T], bytes: &mut Vec<u8>, to: fn(&T) -> [u8; N]) {
            bytes.extend(samples.iter().flat_map(to));
        }
        match self {
            Self::Half(s) => push(&s[range], bytes, |s| s.to_ne_bytes()),
            Self::Float(s) => push(&s[range], bytes, |s| s.to_ne_bytes()),
            Self::Uint(s) => push(&s[range], bytes, |s| s.to_ne_bytes()),
        }
    }
}

/// The channels in the order of the file, which is that of their names.
fn check_channels<'a>(
    path: &Path,
    [width, height]: [usize; 2],
    mut channels: Vec<Written<'a>>,
) -> Result<Vec<Written<'a>>, ImageError> {
    if width == 0 || height == 0 || channels.is_empty() {
        let count = channels.len();
        let message = format!("it is empty: {width} x {height} pixels, {count} channels");
        return Err(ImageError::unwritable(path, message));
    }
    channels.sort_by(|a, b| a.name.as_bytes().cmp(b.name.as_bytes()));
    for channel in &channels {
        check_name(path, "channel", channel.name)?;
        let (found, expected) = (channel.samples.len(), width * height);
        if found != expected {
            let name = channel.name;
            let message = format!("channel {name} has {found} samples, expected {expected}");
            return Err(ImageError::unwritable(path, message));
        }
    }
    match channels.windows(2).find(|pair| pair[0].name == pair[1].name) {
        Some(pair) => {
            let message = format!("two channels are called {}; rename one", pair[0].name);
            Err(ImageError::unwritable(path, message))
        }
        None => Ok(channels),
    }
}

/// Places the pixels in their frame.
fn set_window(header: &mut Header, window: &ImageWindow) {
    let [x, y] = window.data_origin;
    header.own_attributes.layer_position = Vec2(x, y);
    let [x, y] = window.display_origin;
    let [columns, rows] = window.display_size;
    header.shared_attributes.display_window = IntegerBounds::new((x, y), (columns, rows));
}

/// Names are at most 255 bytes in the format.
fn check_name(path: &Path, what: &str, name: &str) -> Result<(), ImageError> {
    if name.is_empty() || name.len() > 255 || name.contains('\0') {
        let message = format!("{what} name \"{name}\" is not of 1 to 255 bytes without zeros");
        return Err(ImageError::unwritable(path, message));
    }
    Ok(())
}

fn text(value: &str) -> Text {
    Text::from_slice_unchecked(value.as_bytes())
}

fn describe(
    path: &Path,
    size: [usize; 2],
    channels: &[Written<'_>],
    attributes: &[(String, AttributeValue)],
) -> Result<Header, ImageError> {
    let list = channels
        .iter()
        .map(|c| ChannelDescription::new(text(c.name), c.samples.kind(), false))
        .collect();
    let mut header = Header::new(text(""), (size[0], size[1]), list).with_encoding(
        Compression::ZIP16,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    header.own_attributes.layer_name = None;
    for (name, value) in attributes {
        check_name(path, "attribute", name)?;
        if LAYOUT_ATTRIBUTES.contains(&name.as_str()) {
            let message = format!("attribute {name} describes the file's layout; rename it");
            return Err(ImageError::unwritable(path, message));
        }
        set_attribute(&mut header, name, value);
    }
    Ok(header)
}

fn set_attribute(header: &mut Header, name: &str, value: &AttributeValue) {
    let own = &mut header.own_attributes;
    match (name, value) {
        ("worldToCamera", AttributeValue::Matrix(m)) => {
            own.world_to_camera = Some(m.to_cols_array());
        }
        ("worldToNDC", AttributeValue::Matrix(m)) => {
            own.world_to_normalized_device = Some(m.to_cols_array());
        }
        ("software", AttributeValue::Text(s)) => own.software_name = Some(text(s)),
        ("comments", AttributeValue::Text(s)) => own.comments = Some(text(s)),
        ("owner", AttributeValue::Text(s)) => own.owner = Some(text(s)),
        _ => {
            let value = match value {
                AttributeValue::Text(s) => ExrValue::Text(text(s)),
                AttributeValue::Float(x) => ExrValue::F32(*x),
                AttributeValue::Int(i) => ExrValue::I32(*i),
                // The rows of the transpose are the columns of the matrix.
                AttributeValue::Matrix(m) => ExrValue::Matrix4x4(m.to_cols_array()),
            };
            own.other.insert(text(name), value);
        }
    }
}

/// The first bytes of a file with this header, up to the last attribute, attributes sorted by name.
///
/// The exr crate keeps attributes in a hash map with random seeds, so the order it writes them in,
/// and with it the file, differs from run to run. Sorting changes neither length nor meaning.
fn serialize_sorted(header: &Header) -> Result<Vec<u8>, String> {
    let mut file = Cursor::new(Vec::new());
    // It ends in an error, because no chunk is written, but not before the header is.
    let ended =
        exr::block::write(&mut file, [header.clone()].into_iter().collect(), true, |_, _| {
            Err(exr::error::Error::Aborted)
        });
    match ended {
        Err(exr::error::Error::Aborted) => {}
        Err(error) => return Err(error.to_string()),
        Ok(()) => return Err("the exr writer accepts a file without chunks".into()),
    }
    let bytes = file.into_inner();
    let attributes = split_attributes(&bytes).ok_or("the exr writer left a broken header")?;
    let mut sorted = bytes[..ATTRIBUTES_OFFSET].to_vec();
    sorted.extend(attributes.into_values().flatten());
    Ok(sorted)
}

/// Attributes begin after the magic number and the version.
const ATTRIBUTES_OFFSET: usize = 8;

/// The attributes of a header by name: each is name, zero, type, zero, size, value; an empty name
/// ends them. `None` if the bytes end before.
fn split_attributes(bytes: &[u8]) -> Option<BTreeMap<&[u8], &[u8]>> {
    let mut attributes = BTreeMap::new();
    let mut rest = bytes.get(ATTRIBUTES_OFFSET..)?;
    while *rest.first()? != 0 {
        let name_bytes = rest.iter().position(|b| *b == 0)?;
        let type_bytes = rest[name_bytes + 1..].iter().position(|b| *b == 0)?;
        let value_offset = name_bytes + type_bytes + 6;
        let size = rest.get(value_offset - 4..value_offset)?.try_into().ok()?;
        let end = value_offset.checked_add(u32::from_le_bytes(size) as usize)?;
        attributes.insert(&rest[..name_bytes], rest.get(..end)?);
        rest = &rest[end..];
    }
    Some(attributes)
}

/// Samples of some rows in the order of a block: by row, then channel, then column.
fn gather_rows(
    channels: &[Written<'_>],
    width: usize,
    rows: Range<usize>,
) -> Result<Vec<u8>, ImageError> {
    let range = rows.start * width..rows.end * width;
    let samples: Vec<RowSamples<'_>> =
        channels.iter().map(|c| c.samples.read(range.clone())).collect::<Result<_, _>>()?;
    let mut bytes = Vec::with_capacity(rows.len() * width * channels.len() * size_of::<f32>());
    for row in 0..rows.len() {
        for channel in &samples {
            channel.push_bytes(row * width..(row + 1) * width, &mut bytes);
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read_exr;
    use pbgi_math::{Mat4, Vec3};
    use tempfile::tempdir;

    fn gradient(width: usize, height: usize, names: &[&str]) -> Image {
        let mut image = Image::new(width, height);
        for (k, name) in names.iter().enumerate() {
            image.push(*name, (0..width * height).map(|i| (i * (k + 1)) as f32 * 0.37).collect());
        }
        image
    }

    #[test]
    fn channels_and_attributes_come_back() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let names = ["R", "G", "B", "A", "irradiance.R", "N.X", "AO", "pbgi.cut_size"];
        let image = gradient(67, 41, &names);
        let camera = Mat4::from_rotation_y(0.3) * Mat4::from_translation(Vec3::new(1.0, 2.0, 3.0));
        let attributes = [
            ("worldToCamera".to_owned(), AttributeValue::Matrix(camera)),
            ("pbgi/other".to_owned(), AttributeValue::Matrix(camera)),
            ("software".to_owned(), AttributeValue::Text("pbgi é".into())),
            ("pbgi/solid_angle".to_owned(), AttributeValue::Float(0.03)),
            ("pbgi/threads".to_owned(), AttributeValue::Int(-7)),
        ];
        write_exr(&path, &image, &attributes).unwrap();
        let (read, metadata) = read_exr(&path).unwrap();
        assert_eq!((read.width, read.height, read.channels.len()), (67, 41, names.len()));
        for name in names {
            assert_eq!(read.channel(name), image.channel(name), "{name}");
        }
        for (name, value) in &attributes {
            assert_eq!(metadata.attribute(name), Some(value), "{name}");
        }
        assert_eq!(metadata.window, ImageWindow::whole(67, 41));
    }

    /// A camera at (0, 0, 5) that looks along −Z only translates: EXR keeps the translation in the
    /// last four floats of `worldToCamera`.
    #[test]
    fn matrices_are_transposed_in_the_file() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let camera = Mat4::from_translation(Vec3::new(0.0, 0.0, -5.0));
        let attribute = ("worldToCamera".to_owned(), AttributeValue::Matrix(camera));
        write_exr(&path, &gradient(1, 1, &["Y"]), &[attribute]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let key = b"worldToCamera\0m44f\0";
        let at = bytes.windows(key.len()).position(|w| w == key).unwrap() + key.len() + 4;
        let floats: Vec<f32> = bytes[at..at + 64]
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
            .collect();
        assert_eq!(floats[12..], [0.0, 0.0, -5.0, 1.0]);
        assert_eq!([floats[3], floats[7], floats[11]], [0.0; 3]);
    }

    /// Windows and samples of every type survive, odd bits of floats included.
    #[test]
    fn stored_channels_pass_through_bit_for_bit() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let ids: Vec<f32> =
            (0..12u32).map(|i| f32::from_bits(0x7f80_0001 ^ (i * 0x1357))).collect();
        let stored = [
            ("crypto00.r", Samples::Float(ids.clone())),
            ("id", Samples::Uint((0..12).map(|i| u32::MAX - i).collect())),
            ("Z", Samples::Half((0..12).map(|i| f16::from_f32(i as f32 * 0.3)).collect())),
        ]
        .map(|(name, samples)| StoredChannel { name: name.to_owned(), samples });
        let window =
            ImageWindow { data_origin: [-3, 7], display_origin: [1, -2], display_size: [640, 360] };
        write_windowed_exr(&path, &gradient(4, 3, &["AO"]), &stored, &window, &[]).unwrap();
        let (read, metadata) = crate::read_stored_exr(&path).unwrap();
        assert_eq!(metadata.window, window);
        assert_eq!((read.width, read.height, read.channels.len()), (4, 3, 4));
        for channel in &stored[1..] {
            assert!(read.channels.contains(channel), "{}", channel.name);
        }
        let found = read.channels.into_iter().find(|c| c.name == "crypto00.r").unwrap();
        let bits = |floats: Vec<f32>| -> Vec<u32> { floats.iter().map(|f| f.to_bits()).collect() };
        assert_eq!(bits(found.samples.into_floats()), bits(ids));
    }

    #[test]
    fn bytes_repeat() {
        let directory = tempdir().unwrap();
        let image = gradient(300, 200, &["R", "G", "B"]);
        let files: Vec<Vec<u8>> = (0..4)
            .map(|i| {
                let path = directory.path().join(format!("{i}.exr"));
                let attributes: Vec<_> =
                    (0..9).map(|k| (format!("pbgi/{k}"), AttributeValue::Int(k))).collect();
                write_exr(&path, &image, &attributes).unwrap();
                std::fs::read(&path).unwrap()
            })
            .collect();
        assert!(files.iter().all(|f| *f == files[0]));
    }

    /// Planes on disk give the file of an image in memory, compressed by one thread or many.
    #[test]
    fn planes_give_the_bytes_of_an_image() {
        let directory = tempdir().unwrap();
        let names = ["R", "G", "B", "A", "N.X", "AO"];
        for (width, height) in [(300, 83), (60_001, 17)] {
            let image = gradient(width, height, &names);
            let owned = names.map(str::to_owned).to_vec();
            let mut planes = Planes::in_scratch(directory.path(), width, height, owned).unwrap();
            for rows in 0..height {
                for (plane, channel) in image.channels.iter().enumerate() {
                    let row = rows * width..(rows + 1) * width;
                    planes.append(plane, &channel.data[row]).unwrap();
                }
            }
            let stored = [StoredChannel {
                name: "id".to_owned(),
                samples: Samples::Uint((0..(width * height) as u32).collect()),
            }];
            let window = ImageWindow::whole(width, height);
            let [a, b] = ["a.exr", "b.exr"].map(|name| directory.path().join(name));
            write_windowed_exr(&a, &image, &stored, &window, &[]).unwrap();
            write_planes_exr(&b, &planes, &stored, &window, &[]).unwrap();
            assert!(std::fs::read(&a).unwrap() == std::fs::read(&b).unwrap(), "{width}");
            std::fs::remove_file(&a).unwrap();
            std::fs::remove_file(&b).unwrap();
        }
        assert!(compressor_threads(300, 7) > 0 && compressor_threads(60_001, 7) == 0);
        let lacking = Planes::in_memory(2, 2, vec!["R".to_owned()]);
        let path = directory.path().join("c.exr");
        let window = ImageWindow::whole(2, 2);
        let error = write_planes_exr(&path, &lacking, &[], &window, &[]).unwrap_err().to_string();
        assert!(error.contains("channel R has 0 samples, expected 4"), "{error}");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
    }

    #[test]
    fn bad_images_are_refused_and_leave_no_file() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let good = gradient(2, 2, &["R"]);
        let mut short = good.clone();
        short.channels[0].data.pop();
        let cases = [
            (Image::new(2, 2), "empty"),
            (gradient(0, 2, &["R"]), "empty"),
            (gradient(2, 2, &["R", "R"]), "two channels are called R"),
            (gradient(2, 2, &[""]), "channel name"),
            (short, "channel R has 3 samples, expected 4"),
        ];
        for (image, message) in cases {
            let error = write_exr(&path, &image, &[]).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        let reserved = ("channels".to_owned(), AttributeValue::Int(1));
        assert!(write_exr(&path, &good, &[reserved]).is_err());
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
    }
}
