//! Reading of little-endian fields.

/// Bytes from a place on.
#[derive(Clone, Copy)]
pub(super) struct ByteReader<'b>(&'b [u8]);

impl<'b> ByteReader<'b> {
    /// Starts at an offset from the first byte.
    pub fn at(bytes: &'b [u8], offset: usize) -> Result<Self, String> {
        bytes.get(offset..).map(Self).ok_or_else(ends_too_early)
    }

    /// The next `count` bytes.
    pub fn take(&mut self, count: usize) -> Result<&'b [u8], String> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or_else(ends_too_early)?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self.0.split_first_chunk().ok_or_else(ends_too_early)?;
        self.0 = rest;
        Ok(*taken)
    }

    pub fn u8(&mut self) -> Result<u8, String> {
        self.array().map(|[byte]| byte)
    }

    pub fn u16(&mut self) -> Result<u16, String> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }
}

fn ends_too_early() -> String {
    "the file ends too early".into()
}
