//! Locks of the cache: those of the standard library. In unit tests they are shuttle's, which tries many schedules of the threads;
//! all tests of this crate that touch a cache therefore run inside it. Not under Miri, which knows no assembly and has schedules of its own.

#[cfg(all(test, not(miri)))]
pub(crate) use shuttle::sync::{Arc, Condvar, Mutex, MutexGuard};
#[cfg(any(not(test), miri))]
pub(crate) use std::sync::{Arc, Condvar, Mutex, MutexGuard};
