//! Counters of the page cache.

/// What the cache did since the file was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// Pages asked for by readers.
    pub requests: u64,
    /// Requests answered without reading the file.
    pub hits: u64,
    /// Pages read from the file.
    pub pages_read: u64,
    /// Stored bytes of the pages read.
    pub bytes_read: u64,
    /// Different pages read at least once.
    pub distinct_pages: u64,
    /// Stored bytes of those.
    pub distinct_bytes: u64,
    /// Pages dropped to make room.
    pub evictions: u64,
    /// Pages read again after they were dropped.
    pub rereads: u64,
    /// Requests that waited for another reader to read the page.
    pub waits: u64,
    /// Nanoseconds readers spent reading, checking and decoding pages, or waiting for others to do so.
    pub wait_ns: u64,
    /// Nanoseconds of those spent reading, checking and decoding.
    pub read_ns: u64,
    /// Most bytes of decoded pages held at once.
    pub held_bytes_max: u64,
}

impl CacheStats {
    /// Share of requests that did not read the file; 1 where nothing was asked for.
    #[must_use]
    pub fn hit_rate(&self) -> f64 {
        if self.requests == 0 { 1.0 } else { self.hits as f64 / self.requests as f64 }
    }

    /// Bytes read ÷ bytes of distinct pages touched; 1 is ideal.
    #[must_use]
    pub fn read_amplification(&self) -> f64 {
        if self.distinct_bytes == 0 {
            1.0
        } else {
            self.bytes_read as f64 / self.distinct_bytes as f64
        }
    }
}

/// A reader's own counters, added to the cache's when it is dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReaderStats {
    /// Pages asked for.
    pub requests: u64,
    /// Requests answered from the reader's own pins.
    pub local_hits: u64,
    /// Pages it read from the file.
    pub pages_read: u64,
    /// Stored bytes of those.
    pub bytes_read: u64,
    /// Nanoseconds in the shared cache: for its lock, reading, or waiting for others that read.
    pub wait_ns: u64,
}
