//! Decoders of other crates, on bytes nobody vouches for.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// Whether a panic of this thread becomes an error.
    static IS_CAUGHT: Cell<bool> = const { Cell::new(false) };
}

/// Runs a decoder; `None` if it panics.
///
/// Decoders of other crates are careful, but not proved: a damaged file must end in an error whatever they do. `decode` must run on this thread only,
/// and nothing it touched may be used after a panic.
pub fn catch_decoder_panic<T>(decode: impl FnOnce() -> T) -> Option<T> {
    let was_caught = IS_CAUGHT.replace(true);
    let decoded = catch_unwind(AssertUnwindSafe(decode));
    IS_CAUGHT.set(was_caught);
    decoded.ok()
}

/// Has panics that [`catch_decoder_panic`] makes errors of not printed. The hook is the whole process's: for programs, not for libraries.
pub fn hush_decoder_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let tell = take_hook();
        set_hook(Box::new(move |info| {
            if !IS_CAUGHT.get() {
                tell(info);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// The only test here that sets hooks, which all of them share.
    #[test]
    fn caught_panics_are_no_panics_and_are_not_told() {
        static TOLD: AtomicUsize = AtomicUsize::new(0);
        set_hook(Box::new(|_| {
            TOLD.fetch_add(1, Ordering::Relaxed);
        }));
        hush_decoder_panics();
        hush_decoder_panics();
        assert_eq!(catch_decoder_panic(|| 7), Some(7));
        let nested = catch_decoder_panic(|| {
            let inner: Option<u8> = catch_decoder_panic(|| panic!("odd file"));
            assert_eq!(inner, None);
            panic!("odder file")
        });
        assert_eq!(nested, None::<u8>);
        assert_eq!(TOLD.load(Ordering::Relaxed), 0);
        // All others are told.
        assert!(catch_unwind(|| panic!("at fault")).is_err());
        assert_eq!(TOLD.load(Ordering::Relaxed), 1);
        let _ = take_hook();
    }
}
