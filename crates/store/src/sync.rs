//! Locks of the cache: those of the standard library. In unit tests they are shuttle's, which tries many schedules of the threads;
//! all tests of this crate that touch a cache therefore run inside it.

#[cfg(test)]
pub(crate) use shuttle::sync::{Arc, Condvar, Mutex, MutexGuard};
#[cfg(not(test))]
pub(crate) use std::sync::{Arc, Condvar, Mutex, MutexGuard};
