//! The cache against a plain model, and under many schedules of its threads.

use super::*;
#[cfg(not(miri))]
use shuttle::thread;
use std::sync::atomic::{AtomicU64, Ordering};
#[cfg(miri)]
use std::thread;

/// Bytes of a page: whole blocks.
const BYTES: usize = 4096;

/// Runs `test` once, with threads that take turns.
fn alone(test: impl Fn() + Send + Sync + 'static) {
    #[cfg(not(miri))]
    shuttle::check_random(test, 1);
    #[cfg(miri)]
    test();
}

/// A cache of `pages` pages of [`BYTES`] bytes with room for so many.
fn cache(pages: usize, room: u64) -> Cache {
    Cache::new(&vec![BYTES as u32; pages], room * BYTES as u64).unwrap()
}

fn loaded(id: u32, mut buffer: Buffer) -> LoadedPage {
    buffer.bytes_mut().fill(id as u8);
    LoadedPage { stored_bytes: buffer.bytes().len() as u32, buffer, read_ns: 0 }
}

fn load(cache: &Cache, id: u32, bytes: usize) -> PageRef {
    match cache.get(PageId(id), bytes as u32) {
        Lookup::Found(page) => page,
        Lookup::Load(buffer) => cache.insert(PageId(id), loaded(id, buffer)),
        Lookup::LeftOut => panic!("page {id} was left out"),
    }
}

#[test]
fn pages_in_use_stay_and_the_budget_holds() {
    alone(|| {
        let cache = cache(10, 3);
        // Kept by the policy, but for the third, which passes.
        (0..2).for_each(|id| drop(load(&cache, id, BYTES)));
        let pinned = load(&cache, 2, BYTES);
        for id in 3..10 {
            drop(load(&cache, id, BYTES));
            cache.validate();
        }
        let stats = cache.stats();
        assert_eq!((stats.evictions, stats.hits, stats.pages_read), (7, 0, 10));
        assert_eq!(pinned.bytes(), &[2; BYTES]);
        drop(load(&cache, 2, BYTES));
        assert_eq!(cache.stats().hits, 1, "page 2 was pinned");
        assert_eq!(cache.stats().held_bytes_max, 3 * BYTES as u64);
    });
}

#[test]
fn abandoned_loads_can_be_tried_again_and_damaged_pages_stay_out() {
    alone(|| {
        let cache = cache(2, 2);
        assert!(matches!(cache.get(PageId(0), 50), Lookup::Load(_)));
        cache.abandon(PageId(0));
        cache.validate();
        assert!(matches!(cache.get(PageId(0), 50), Lookup::Load(_)));
        cache.leave_out(PageId(0));
        cache.validate();
        assert!(matches!(cache.get(PageId(0), 50), Lookup::LeftOut));
        assert_eq!(cache.region.held_bytes(), 0, "what was not loaded gave its room back");
        assert_eq!(cache.left_out(), [PageId(0)]);
    });
}

/// What one run of [`race`] does.
#[derive(Clone, Copy)]
struct Race {
    threads: usize,
    rounds: usize,
    pages: u32,
    /// Pages the cache holds; each thread pins up to two.
    room: u64,
}

/// Threads ask for pages in orders of their own, pin two at a time, and give up every fifth load. At any moment one thread at most
/// loads a page, what is pinned stays what it was, and no more is held than the budget.
fn race(race: Race) {
    let cache = Arc::new(cache(race.pages as usize, race.room));
    let loading: Arc<Vec<AtomicU64>> =
        Arc::new((0..race.pages).map(|_| AtomicU64::new(0)).collect());
    let threads: Vec<_> = (0..race.threads)
        .map(|thread| {
            let (cache, loading) = (Arc::clone(&cache), Arc::clone(&loading));
            thread::spawn(move || {
                let mut pinned: Option<PageRef> = None;
                for round in 0..race.rounds {
                    let id = ((round * (thread + 1) + thread) % race.pages as usize) as u32;
                    let page = match cache.get(PageId(id), BYTES as u32) {
                        Lookup::Found(page) => page,
                        Lookup::LeftOut => panic!("page {id} was left out"),
                        Lookup::Load(buffer) => {
                            let others = loading[id as usize].fetch_add(1, Ordering::SeqCst);
                            assert_eq!(others, 0, "one thread loads page {id}");
                            thread::yield_now();
                            loading[id as usize].fetch_sub(1, Ordering::SeqCst);
                            if (round + thread) % 5 == 4 {
                                drop(buffer);
                                cache.abandon(PageId(id));
                                continue;
                            }
                            cache.insert(PageId(id), loaded(id, buffer))
                        }
                    };
                    assert_eq!(page.bytes(), [id as u8; BYTES]);
                    cache.validate();
                    if let Some(before) = pinned.replace(page) {
                        thread::yield_now();
                        drop(before);
                    }
                }
            })
        })
        .collect();
    threads.into_iter().for_each(|thread| thread.join().unwrap());
    cache.validate();
    let stats = cache.stats();
    assert!(stats.held_bytes_max <= race.room * BYTES as u64, "{}", stats.held_bytes_max);
    let present = cache.lock().policy.len() as u64;
    assert_eq!(cache.region.held_bytes(), present * BYTES as u64, "all else was dropped");
}

/// All schedules of two threads that want the same page.
#[test]
#[cfg(not(miri))]
fn every_schedule_of_two_threads_loads_a_page_once() {
    shuttle::check_dfs(|| race(Race { threads: 2, rounds: 1, pages: 1, room: 2 }), None);
}

#[test]
fn random_schedules_keep_the_books() {
    let tight = Race { threads: 3, rounds: 8, pages: 7, room: 6 };
    #[cfg(not(miri))]
    {
        shuttle::check_random(move || race(tight), 300);
        shuttle::check_pct(move || race(Race { threads: 2, rounds: 10, ..tight }), 300, 3);
    }
    #[cfg(miri)]
    race(tight);
}

/// Pages of very different sizes come and go; what is held never exceeds the budget, gaps or not.
#[test]
fn gaps_between_pages_of_many_sizes_do_not_break_the_budget() {
    alone(|| {
        let sizes: Vec<u32> = (0..200u32).map(|i| 60 + (i * 7919 % 65_000)).collect();
        let budget = 20 * 65_536;
        let cache = Cache::new(&sizes, budget).unwrap();
        let mut pinned = std::collections::VecDeque::new();
        for round in 0..if cfg!(miri) { 24 } else { 3000u32 } {
            let id = (round * round % 211 + round * 31) % 200;
            let page = load(&cache, id, sizes[id as usize] as usize);
            assert!(page.bytes().iter().all(|byte| *byte == id as u8));
            pinned.push_back(page);
            if pinned.len() > 4 {
                pinned.pop_front();
            }
            assert!(cache.region.held_bytes() <= budget);
        }
        cache.validate();
        let stats = cache.stats();
        assert!(cfg!(miri) || (stats.evictions > 1000 && stats.hits > 100), "{stats:?}");
    });
}

/// Where pins leave no gap, a page is admitted all the same, and what it took is freed again.
#[test]
fn more_pins_than_the_budget_holds_are_admitted() {
    alone(|| {
        let cache = cache(5, 2);
        let pinned: Vec<PageRef> = (0..5).map(|id| load(&cache, id, BYTES)).collect();
        assert_eq!(cache.region.held_bytes(), 5 * BYTES as u64);
        for (id, page) in (0..).zip(&pinned) {
            assert_eq!(page.bytes(), [id; BYTES]);
        }
        drop(pinned);
        cache.validate();
    });
}
