//! The cache against a plain model, and under many schedules of its threads.

use super::*;
use shuttle::thread;

/// Runs `test` once, with threads that take turns.
fn alone(test: impl Fn() + Send + Sync + 'static) {
    shuttle::check_random(test, 1);
}

fn loaded(id: u32, bytes: usize) -> LoadedPage {
    LoadedPage { bytes: vec![id as u8; bytes].into(), stored_bytes: bytes as u32, read_ns: 0 }
}

fn load(cache: &Cache, id: u32, bytes: usize) -> PageRef {
    match cache.get(PageId(id), bytes as u32) {
        Lookup::Found(page) => page,
        Lookup::Load => cache.insert(PageId(id), loaded(id, bytes)),
        Lookup::LeftOut => panic!("page {id} was left out"),
    }
}

#[test]
fn pages_in_use_stay_and_the_budget_holds() {
    alone(|| {
        let cache = Cache::new(10, 300);
        // Kept by the policy, but for the third, which passes.
        (0..2).for_each(|id| drop(load(&cache, id, 100)));
        let pinned = load(&cache, 2, 100);
        for id in 3..10 {
            drop(load(&cache, id, 100));
            cache.validate();
        }
        let stats = cache.stats();
        assert_eq!((stats.evictions, stats.hits, stats.pages_read), (7, 0, 10));
        assert_eq!(pinned.bytes(), &[2; 100]);
        drop(load(&cache, 2, 100));
        assert_eq!(cache.stats().hits, 1, "page 2 was pinned");
        assert_eq!(cache.stats().held_bytes_max, 300);
    });
}

#[test]
fn abandoned_loads_can_be_tried_again_and_damaged_pages_stay_out() {
    alone(|| {
        let cache = Cache::new(2, 100);
        assert!(matches!(cache.get(PageId(0), 50), Lookup::Load));
        cache.abandon(PageId(0), 50);
        cache.validate();
        assert!(matches!(cache.get(PageId(0), 50), Lookup::Load));
        cache.leave_out(PageId(0), 50);
        cache.validate();
        assert!(matches!(cache.get(PageId(0), 50), Lookup::LeftOut));
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

const BYTES: usize = 10;

/// Threads ask for pages in orders of their own, pin two at a time, and give up every fifth load. At any moment one thread at most
/// loads a page, what is pinned stays what it was, and no more is held than the budget.
fn race(race: Race) {
    let cache = Arc::new(Cache::new(race.pages as usize, race.room * BYTES as u64));
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
                        Lookup::Load => {
                            let others = loading[id as usize].fetch_add(1, Ordering::SeqCst);
                            assert_eq!(others, 0, "one thread loads page {id}");
                            thread::yield_now();
                            loading[id as usize].fetch_sub(1, Ordering::SeqCst);
                            if (round + thread) % 5 == 4 {
                                cache.abandon(PageId(id), BYTES as u32);
                                continue;
                            }
                            cache.insert(PageId(id), loaded(id, BYTES))
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
    assert_eq!(cache.held.load(Ordering::Relaxed), cache.lock().bytes, "all else was dropped");
}

/// All schedules of two threads that want the same page.
#[test]
fn every_schedule_of_two_threads_loads_a_page_once() {
    shuttle::check_dfs(|| race(Race { threads: 2, rounds: 1, pages: 1, room: 2 }), None);
}

#[test]
fn random_schedules_keep_the_books() {
    let tight = Race { threads: 3, rounds: 8, pages: 7, room: 6 };
    shuttle::check_random(move || race(tight), 300);
    shuttle::check_pct(move || race(Race { threads: 2, rounds: 10, ..tight }), 300, 3);
}
