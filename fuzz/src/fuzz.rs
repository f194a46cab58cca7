//! The fuzzer's program: searches for inputs of the target that `PBGI_FUZZ_TARGET` names.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| pbgi_fuzz::run_chosen(data));
