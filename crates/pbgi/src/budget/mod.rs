//! What memory and disk a run may take, and how it is divided.

pub(crate) mod bake;
pub(crate) mod disk_space;
pub(crate) mod limit;
pub(crate) mod reading;
pub(crate) mod split;
