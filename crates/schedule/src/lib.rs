//! Receivers to coherent batches to workers to results.
//!
//! Starts the threads that gather. It must never know where receivers come from, what becomes of the results, or how light is gathered.
#![forbid(unsafe_code)]

mod queue;
mod records;
mod shade;
mod spread;

pub use records::{KeptRecords, RECORD_BYTES};
pub use shade::{
    CHUNKS_IN_FLIGHT, Feed, RECEIVER_BYTES_IN_FLIGHT, ReceiverOrder, ScheduleError, ShadeOptions,
    ShadeReport, Shaded, shade_receivers, shade_stream,
};
pub use spread::Spread;
