//! Work on receivers by all processors.

use std::num::NonZero;
use std::thread;

/// Receivers that one thread takes at once: neighbors in the picture.
const CHUNK: usize = 64;

/// What `work` makes of chunks of `items`, in their order, on all processors.
pub fn spread<T: Sync, R: Send>(items: &[T], work: impl Fn(&[T]) -> R + Sync) -> Vec<R> {
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    let chunks: Vec<&[T]> = items.chunks(CHUNK).collect();
    let (chunks, work) = (&chunks, &work);
    let mut done: Vec<(usize, R)> = thread::scope(|scope| {
        let of_thread = |first: usize| {
            move || -> Vec<(usize, R)> {
                let own = (first..chunks.len()).step_by(threads);
                own.map(|index| (index, work(chunks[index]))).collect()
            }
        };
        let workers: Vec<_> = (0..threads).map(|first| scope.spawn(of_thread(first))).collect();
        let results = workers.into_iter().map(|worker| match worker.join() {
            Ok(results) => results,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        results.flatten().collect()
    });
    done.sort_unstable_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}
