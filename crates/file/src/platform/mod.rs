//! What differs between systems: everything else of the workspace is the same on all of them.
//!
//! Both halves have the same functions. Where a system cannot do something, it is left out if it saves only time or space, and none is
//! returned if it would tell something.

mod process;
#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

pub use process::{
    ProcessUse, peak_resident_bytes, process_use, processor_seconds, resident_bytes,
};
#[cfg(unix)]
pub use unix::*;
#[cfg(windows)]
pub use windows::*;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_read_and_written_where_they_belong() {
        let file = tempfile::tempfile().unwrap();
        write_all_at(&file, b"34", 2).unwrap();
        write_all_at(&file, b"12", 0).unwrap();
        let mut bytes = [0; 3];
        read_exact_at(&file, &mut bytes, 1).unwrap();
        assert_eq!(&bytes, b"234");
        let error = read_exact_at(&file, &mut bytes, 2).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::UnexpectedEof);
    }
}
