//! Every target over its seeds and past findings, whole, cut short and with bytes changed.

use pbgi_fuzz::{TARGETS, Target, peak_bytes};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Bytes a target may take: twice what readers are granted by it, and buffers.
const PEAK_BYTES_MAX: usize = 192 << 20;

/// Far more than any input takes.
const TIME_MAX: Duration = Duration::from_secs(20);

/// Changed copies tried of each file.
const CHANGES: u64 = 24;

fn folder_of(target: &Target) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds").join(target.name)
}

/// Runs a target and measures it.
fn run(target: &Target, what: &str, data: &[u8]) {
    let start = Instant::now();
    let ((), peak) = peak_bytes(|| (target.run)(data));
    let name = target.name;
    assert!(peak <= PEAK_BYTES_MAX, "{name}: {what} takes {peak} bytes");
    assert!(start.elapsed() <= TIME_MAX, "{name}: {what} takes {:?}", start.elapsed());
}

/// Numbers that look random: splitmix64.
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mixed = (*state ^ *state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ mixed >> 31
}

/// Sets up to four bytes to values that break most.
fn change(data: &mut [u8], state: &mut u64) {
    for _ in 0..=next(state) % 4 {
        let at = next(state) as usize % data.len();
        data[at] = match next(state) % 4 {
            0 => 0,
            1 => 0xff,
            2 => data[at] ^ 1 << (next(state) % 8),
            _ => next(state) as u8,
        };
    }
}

/// One test, so that the memory of one input is not counted with that of another.
#[test]
fn no_seed_whole_cut_or_changed_makes_a_reader_panic_hang_or_exceed_its_memory() {
    for target in &TARGETS {
        let start = Instant::now();
        let mut files: Vec<PathBuf> = std::fs::read_dir(folder_of(target))
            .unwrap_or_else(|e| panic!("seeds/{}: {e}", target.name))
            .map(|entry| entry.unwrap().path())
            .collect();
        files.sort();
        assert!(!files.is_empty(), "{} has no seeds", target.name);
        run(target, "nothing", &[]);
        for file in &files {
            let (data, name) = (std::fs::read(file).unwrap(), file.display().to_string());
            assert!(data.len() <= target.bytes_max, "{name} is longer than its target's inputs");
            run(target, &name, &data);
            let mut state = data.len() as u64;
            for _ in 0..CHANGES.min(data.len() as u64) {
                let seed = state;
                let mut changed = data.clone();
                match next(&mut state) % 4 {
                    0 => changed.truncate(next(&mut state) as usize % data.len()),
                    _ => change(&mut changed, &mut state),
                }
                println!("{}: {name} changed by {seed:#x}", target.name);
                run(target, &format!("{name} changed by {seed:#x}"), &changed);
            }
        }
        println!("{}: {} files in {:.1?}", target.name, files.len(), start.elapsed());
    }
}
