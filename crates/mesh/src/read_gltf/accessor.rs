//! Checked reading of accessors: every range is verified before a byte is touched.

use super::container::Buffer;
use gltf::json::accessor::{Accessor, ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};

/// Most bytes of an accessor without a buffer view, which no file size bounds.
const ZEROS_BYTES_MAX: usize = 1 << 30;

/// Root and buffers of a document.
#[derive(Clone, Copy)]
pub(super) struct Accessors<'a> {
    pub root: &'a Root,
    pub buffers: &'a [Buffer<'a>],
}

/// The elements of an accessor, packed without gaps, sparse values put in their places.
struct Packed {
    bytes: Vec<u8>,
    component: ComponentType,
    width: usize,
    normalized: bool,
}

impl<'a> Accessors<'a> {
    /// Vectors of up to `N` components, as floats, normalized integers brought to −1..=1 or 0..=1.
    /// Components beyond an accessor's own are `fill`. `types` are the accessor types allowed.
    pub fn read_vectors<const N: usize>(
        &self,
        index: usize,
        types: &[Type],
        fill: f32,
    ) -> Result<Vec<[f32; N]>, String> {
        self.decode(&self.pack_typed(index, types)?, fill)
    }

    /// As [`Self::read_vectors`], where integers are normalized, whether the accessor says so or not.
    pub fn read_shares<const N: usize>(
        &self,
        index: usize,
        types: &[Type],
        fill: f32,
    ) -> Result<Vec<[f32; N]>, String> {
        let packed = Packed { normalized: true, ..self.pack_typed(index, types)? };
        self.decode(&packed, fill)
    }

    fn pack_typed(&self, index: usize, types: &[Type]) -> Result<Packed, String> {
        let accessor = self.root.accessors.get(index).ok_or("there is no such accessor")?;
        let type_ = valid(&accessor.type_)?;
        if !types.contains(&type_) {
            return Err(format!("is {type_:?}, expected {types:?}").to_lowercase());
        }
        self.pack(accessor)
    }

    fn decode<const N: usize>(&self, packed: &Packed, fill: f32) -> Result<Vec<[f32; N]>, String> {
        let component_bytes = packed.component.size();
        let decode = |element: &[u8]| {
            let mut vector = [fill; N];
            let components = element.chunks_exact(component_bytes);
            for (value, bytes) in vector.iter_mut().zip(components) {
                *value = decode_component(packed.component, packed.normalized, bytes);
            }
            vector
        };
        Ok(packed.bytes.chunks_exact(component_bytes * packed.width).map(decode).collect())
    }

    /// Vertex indices.
    pub fn read_indices(&self, index: usize) -> Result<Vec<u32>, String> {
        let accessor = self.root.accessors.get(index).ok_or("there is no such accessor")?;
        if valid(&accessor.type_)? != Type::Scalar {
            return Err("indices are not scalars".into());
        }
        let packed = self.pack(accessor)?;
        decode_indices(&packed.bytes, packed.component)
    }

    /// Bytes of buffer view `index`.
    pub fn view(&self, index: usize) -> Result<&'a [u8], String> {
        let error = || format!("buffer view {index} does not lie in its buffer");
        let view = self.root.buffer_views.get(index).ok_or("there is no such buffer view")?;
        let buffer = self.buffers.get(view.buffer.value()).ok_or_else(error)?;
        let start = view.byte_offset.map_or(0, |o| o.0);
        let end = start.checked_add(view.byte_length.0).ok_or_else(error)?;
        let (start, end) = (usize::try_from(start), usize::try_from(end));
        let (Ok(start), Ok(end)) = (start, end) else { return Err(error()) };
        buffer.get(start..end).ok_or_else(error)
    }

    fn pack(&self, accessor: &Accessor) -> Result<Packed, String> {
        let component = valid(&accessor.component_type)?.0;
        let width = valid(&accessor.type_)?.multiplicity();
        let size = component.size() * width;
        let count = usize::try_from(accessor.count.0).map_err(|_| "count is too large")?;
        let mut bytes = match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |o| o.0);
                self.pack_view(view, offset, count, size)?
            }
            None => {
                let length = count.checked_mul(size).filter(|&l| l <= ZEROS_BYTES_MAX);
                vec![0; length.ok_or("has no buffer view and too many elements")?]
            }
        };
        if let Some(sparse) = &accessor.sparse {
            let changes = usize::try_from(sparse.count.0).map_err(|_| "count is too large")?;
            let kind = valid(&sparse.indices.component_type)?.0;
            let places = self.pack_view(
                sparse.indices.buffer_view,
                sparse.indices.byte_offset.0,
                changes,
                kind.size(),
            )?;
            let places = decode_indices(&places, kind)?;
            let values = sparse.values.byte_offset.0;
            let values = self.pack_view(sparse.values.buffer_view, values, changes, size)?;
            for (place, value) in places.into_iter().zip(values.chunks_exact(size)) {
                let start =
                    (place as usize).checked_mul(size).ok_or("sparse index is too large")?;
                let target = bytes.get_mut(start..).and_then(|b| b.get_mut(..size));
                let outside = || format!("sparse index {place} is not below {count}");
                target.ok_or_else(outside)?.copy_from_slice(value);
            }
        }
        Ok(Packed { bytes, component, width, normalized: accessor.normalized })
    }

    /// `count` elements of `size` bytes of a view, the view's stride apart.
    fn pack_view(
        &self,
        view: Index<gltf::json::buffer::View>,
        offset: u64,
        count: usize,
        size: usize,
    ) -> Result<Vec<u8>, String> {
        let data = self.view(view.value())?;
        let stride = self.root.buffer_views.get(view.value()).and_then(|v| v.byte_stride);
        let stride = stride.map_or(size, |s| s.0);
        if stride < size {
            return Err(format!("stride {stride} is below the element size {size}"));
        }
        if count == 0 {
            return Ok(Vec::new());
        }
        let end = (count - 1)
            .checked_mul(stride)
            .and_then(|last| last.checked_add(size))
            .and_then(|length| usize::try_from(offset).ok()?.checked_add(length));
        let Some(end) = end.filter(|&end| end <= data.len()) else {
            return Err(format!(
                "{count} elements of {size} bytes from byte {offset} on, {stride} apart, exceed the \
                 {} bytes of buffer view {}",
                data.len(),
                view.value()
            ));
        };
        let data = &data[offset as usize..end];
        if stride == size {
            return Ok(data.to_vec());
        }
        Ok(data.chunks(stride).flat_map(|element| &element[..size]).copied().collect())
    }
}

fn valid<T: Copy>(checked: &Checked<T>) -> Result<T, String> {
    match checked {
        Checked::Valid(value) => Ok(*value),
        Checked::Invalid => Err("has an unknown type".into()),
    }
}

fn decode_indices(bytes: &[u8], component: ComponentType) -> Result<Vec<u32>, String> {
    let decode = |b: &[u8]| match *b {
        [a] => u32::from(a),
        [a, b] => u32::from(u16::from_le_bytes([a, b])),
        [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
        _ => u32::MAX,
    };
    match component {
        ComponentType::U8 | ComponentType::U16 | ComponentType::U32 => {
            Ok(bytes.chunks_exact(component.size()).map(decode).collect())
        }
        other => Err(format!("indices are {other:?}, expected u8, u16 or u32").to_lowercase()),
    }
}

fn decode_component(component: ComponentType, normalized: bool, bytes: &[u8]) -> f32 {
    let (value, scale) = match (component, bytes) {
        (ComponentType::I8, &[a]) => (f32::from(a as i8), 127.0),
        (ComponentType::U8, &[a]) => (f32::from(a), 255.0),
        (ComponentType::I16, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])), 32_767.0),
        (ComponentType::U16, &[a, b]) => (f32::from(u16::from_le_bytes([a, b])), 65_535.0),
        (ComponentType::U32, &[a, b, c, d]) => {
            (u32::from_le_bytes([a, b, c, d]) as f32, u32::MAX as f32)
        }
        (ComponentType::F32, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
        // Chunks are as long as their component: not reached.
        _ => (f32::NAN, 1.0),
    };
    if normalized { (value / scale).max(-1.0) } else { value }
}
