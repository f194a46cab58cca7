//! The containers of glTF: GLB chunks, data URIs, files beside the JSON.

use crate::SceneError;
use crate::find_file::find_file;
use crate::resources::Resources;
use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;

const CURE_GLTF_1: &str = "convert it to glTF 2.0";

/// JSON text and binary chunk of a `.gltf` or `.glb` file.
pub(super) fn split<'a>(
    path: &Path,
    file: &'a [u8],
) -> Result<(&'a [u8], Option<&'a [u8]>), SceneError> {
    let malformed = |message: String| SceneError::malformed(path, message);
    if !file.starts_with(b"glTF") {
        return Ok((file, None));
    }
    let word = |offset: usize| {
        let bytes: Option<[u8; 4]> = file.get(offset..offset + 4)?.try_into().ok();
        bytes.map(u32::from_le_bytes)
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(malformed(format!(
            "the glb header has 12 bytes, but the file only {}",
            file.len()
        )));
    };
    if version != 2 {
        return Err(SceneError::unsupported(path, format!("glb version {version}"), CURE_GLTF_1));
    }
    if length as usize > file.len() {
        return Err(malformed(format!(
            "the glb header promises {length} bytes, but the file has {}; copy it again",
            file.len()
        )));
    }
    let mut chunks = [None; 2];
    let mut offset = 12;
    while offset + 8 <= length as usize {
        let (size, kind) = (word(offset).unwrap_or(0) as usize, &file[offset + 4..offset + 8]);
        let end = offset + 8 + size;
        if end > length as usize {
            return Err(malformed(format!(
                "glb chunk at byte {offset} has {size} bytes, but only {} follow",
                length as usize - offset - 8
            )));
        }
        let data = &file[offset + 8..end];
        match kind {
            b"JSON" if offset == 12 => chunks[0] = Some(data),
            b"BIN\0" if chunks[1].is_none() => chunks[1] = Some(data),
            // The specification asks to skip unknown chunks.
            _ => {}
        }
        offset = end;
    }
    match chunks {
        [Some(json), binary] => Ok((json, binary)),
        _ => Err(malformed("the first glb chunk is not json".into())),
    }
}

/// What a URI of the file at `path` points to: a data URI or a file beside it. `place` is for
/// messages.
pub(super) fn resolve_uri(
    path: &Path,
    place: &str,
    uri: &str,
    resources: &Resources,
) -> Result<Arc<[u8]>, SceneError> {
    let malformed = |message: &str| SceneError::malformed(path, format!("{place}: {message}"));
    if let Some(data) = data_of(uri) {
        let (kind, data) =
            data.split_once(',').ok_or_else(|| malformed("data uri without a comma"))?;
        resources.take(path, data.len() as u64)?;
        let bytes = if kind.trim_end().to_ascii_lowercase().ends_with(";base64") {
            decode_base64(data).ok_or_else(|| malformed("data uri is not valid base64"))
        } else {
            decode_percent(data).ok_or_else(|| malformed("bad %-escape in a data uri"))
        };
        return Ok(bytes?.into());
    }
    if uri.contains("://") {
        let cure = "download it, put it beside the file and refer to it by name";
        return Err(SceneError::unsupported(path, format!("{place}: the address {uri}"), cure));
    }
    // Some writers do not escape, so that a name may hold what looks like an escape.
    let decoded = decode_percent(uri).and_then(|bytes| String::from_utf8(bytes).ok());
    let name = decoded.unwrap_or_else(|| uri.to_owned());
    let file = find_file(path, &name).or_else(|| find_file(path, uri)).ok_or_else(|| {
        let file = path.parent().unwrap_or(Path::new("")).join(&name);
        let source = std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such file");
        SceneError::io(&file, "read", source)
    })?;
    resources.read_referred(&file)
}

/// What is behind the scheme of a data URI, in any case; `None` for others.
pub(super) fn data_of(uri: &str) -> Option<&str> {
    let (scheme, data) = uri.split_at_checked(5)?;
    scheme.eq_ignore_ascii_case("data:").then_some(data)
}

/// The bytes of a buffer.
pub(super) enum Buffer<'a> {
    /// A chunk of the scene's own file.
    Chunk(&'a [u8]),
    /// Read from elsewhere; several buffers may have one file.
    Read(Arc<[u8]>),
}

impl Deref for Buffer<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Chunk(bytes) => bytes,
            Self::Read(bytes) => bytes,
        }
    }
}

/// Loads all buffers; each is at least as long as its `byteLength`.
pub(super) fn load_buffers<'a>(
    path: &Path,
    root: &gltf::json::Root,
    binary: Option<&'a [u8]>,
    resources: &Resources,
) -> Result<Vec<Buffer<'a>>, SceneError> {
    let load = |(i, buffer): (usize, &gltf::json::Buffer)| {
        // What nothing refers to need not be there.
        if root.buffer_views.iter().all(|view| view.buffer.value() != i) {
            return Ok(Buffer::Chunk(&[]));
        }
        let data = match (&buffer.uri, binary) {
            (Some(uri), _) => {
                Buffer::Read(resolve_uri(path, &format!("buffer {i}"), uri, resources)?)
            }
            (None, Some(binary)) if i == 0 => Buffer::Chunk(binary),
            (None, _) => {
                let message = format!("buffer {i} has neither a uri nor a glb chunk");
                return Err(SceneError::malformed(path, message));
            }
        };
        if (data.len() as u64) < buffer.byte_length.0 {
            return Err(SceneError::malformed(
                path,
                format!(
                    "buffer {i} should have {} bytes, but has {}",
                    buffer.byte_length.0,
                    data.len()
                ),
            ));
        }
        Ok(data)
    };
    root.buffers.iter().enumerate().map(load).collect()
}

/// Bytes of base64 (RFC 4648), standard or safe for names, with or without padding, in one line or several.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let digits = text.trim_ascii_end().trim_end_matches('=').as_bytes();
    let mut bytes = Vec::with_capacity(digits.len() / 4 * 3 + 3);
    let lines: Vec<u8>;
    let digits = if digits.iter().any(u8::is_ascii_whitespace) {
        lines = digits.iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect();
        &lines
    } else {
        digits
    };
    for group in digits.chunks(4) {
        let mut word = 0u32;
        for &digit in group {
            let value = match digit {
                b'A'..=b'Z' => digit - b'A',
                b'a'..=b'z' => digit - b'a' + 26,
                b'0'..=b'9' => digit - b'0' + 52,
                b'+' | b'-' => 62,
                b'/' | b'_' => 63,
                _ => return None,
            };
            word = word << 6 | u32::from(value);
        }
        let [_, a, b, c] = (word << (6 * (4 - group.len()))).to_be_bytes();
        match group.len() {
            4 => bytes.extend([a, b, c]),
            3 => bytes.extend([a, b]),
            2 => bytes.push(a),
            _ => return None,
        }
    }
    Some(bytes)
}

/// Bytes of a %-escaped text (RFC 3986).
fn decode_percent(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let [first, tail @ ..] = rest {
        rest = tail;
        if *first != b'%' {
            bytes.push(*first);
            continue;
        }
        let hex = std::str::from_utf8(tail.get(..2)?).ok()?;
        bytes.push(u8::from_str_radix(hex, 16).ok()?);
        rest = &tail[2..];
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_the_vectors_of_its_rfc() {
        for (text, bytes) in [
            ("", ""),
            ("Zg==", "f"),
            ("Zm8=", "fo"),
            ("Zm9v", "foo"),
            ("Zm9vYg==", "foob"),
            ("Zm9vYmE", "fooba"),
            ("Zm9vYmFy", "foobar"),
        ] {
            assert_eq!(decode_base64(text).unwrap(), bytes.as_bytes());
        }
        assert_eq!(decode_base64("+/+/").unwrap(), [0xfb, 0xff, 0xbf]);
        assert_eq!(decode_base64("-_+/").unwrap(), [0xfb, 0xff, 0xbf]);
        assert_eq!(decode_base64("Zm9v\r\nYm\n Fy=\n").unwrap(), b"foobar");
        assert!(decode_base64("Zm9vY").is_none());
        assert!(decode_base64("Zm*9").is_none());
    }

    #[test]
    fn percent_escapes_are_undone() {
        assert_eq!(decode_percent("a%20b%2Fc").unwrap(), b"a b/c");
        assert!(decode_percent("a%2").is_none() && decode_percent("%zz").is_none());
    }
}
