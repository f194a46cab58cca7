//! A bake that is killed, wherever it is.

use crate::support::Bench;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Kills of each kind of bake, at moments spread over its time.
const KILLS: u32 = 18;

/// An old octree, as far as its first bytes tell.
const OLD: &str = "PBGITREE, an old file";

/// Bakes that go through all phases: to disk and back, and with light.
const BAKES: [&[&str]; 2] = [
    &["demo:street?surfels=500k", "--memory-limit", "64MiB"],
    &["demo:room?surfels=4k", "--memory-limit", "64MiB", "--bounces", "2"],
];

fn bake<'a>(input: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    [input, &["-o", "scene.pbgi", "--force", "--threads", "2"], more].concat()
}

/// Starts a bake and kills it after a while.
fn start_and_kill(bench: &Bench, args: &[&str], after: Duration) {
    let mut command = bench.command(args);
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    std::thread::sleep(after);
    // SIGKILL: the process gets no chance to clean up.
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_killed_bake_leaves_the_old_file_and_the_next_one_leaves_nothing_else() {
    for input in BAKES {
        let bench = Bench::new();
        let start = Instant::now();
        bench.bake(&bake(input, &[]), "scene.pbgi");
        let whole = start.elapsed();
        let finished = bench.read("scene.pbgi");
        bench.write("scene.pbgi", OLD);
        let mut killed = 0;
        for kill in 0..KILLS {
            start_and_kill(&bench, &bake(input, &[]), whole * kill / KILLS);
            // A kill may come after the new file has its name; there is nothing between the two.
            if bench.read("scene.pbgi") == OLD.as_bytes() {
                killed += 1;
            } else {
                assert!(bench.read("scene.pbgi") == finished, "kill {kill} left half a file");
                bench.write("scene.pbgi", OLD);
            }
        }
        assert!(killed > KILLS / 3, "only {killed} kills within {whole:?} came before the end");
        bench.bake(&bake(input, &[]), "scene.pbgi");
        assert!(bench.read("scene.pbgi") == finished);
        assert_eq!(bench.files(), ["scene.pbgi"]);
    }
}

/// What a bake keeps once a phase is finished: by the name of its file, and by what the next run says of it.
struct Kept {
    ends_with: &'static str,
    notice: &'static str,
}

/// What bakes keep after the sort, and after passes of light.
const KEPT: [Kept; 2] = [
    Kept { ends_with: ".state", notice: "taking up the surfels" },
    Kept { ends_with: ".passes", notice: "going on after pass" },
];

impl Kept {
    fn find(&self, bench: &Bench) -> Option<String> {
        bench.files().into_iter().find(|name| name.ends_with(self.ends_with))
    }
}

#[test]
fn a_killed_bake_is_taken_up_again() {
    for (input, kept) in BAKES.into_iter().zip(&KEPT) {
        let bench = Bench::new();
        let start = Instant::now();
        bench.bake(&bake(input, &[]), "scene.pbgi");
        let whole = start.elapsed();
        let finished = bench.read("scene.pbgi");
        std::fs::remove_file(bench.path("scene.pbgi")).unwrap();
        let mut taken_up = 0;
        for kill in 0..8 {
            kill_once_kept(&bench, input, kept, whole * kill / 16);
            // A bake that ends before it is killed has nothing to keep.
            let is_kept = kept.find(&bench).is_some();
            let run = bench.run(&bake(input, &["--resume"]));
            assert_eq!(run.code, 0, "{}", run.stderr);
            assert_eq!(run.stderr.contains(kept.notice), is_kept, "{}", run.stderr);
            taken_up += u32::from(is_kept);
            assert!(bench.read("scene.pbgi") == finished);
            assert_eq!(bench.files(), ["scene.pbgi"]);
        }
        assert!(taken_up > 0, "no kill came before the end");
    }
}

#[test]
fn what_a_killed_bake_has_kept_is_not_used_unasked_or_damaged() {
    for (input, kept) in BAKES.into_iter().zip(&KEPT) {
        let bench = Bench::new();
        bench.bake(&bake(input, &[]), "scene.pbgi");
        let finished = bench.read("scene.pbgi");
        for more in [&[][..], &["--resume"]] {
            // Some bakes may end before they are killed.
            let name = (0..8).find_map(|_| {
                kill_once_kept(&bench, input, kept, Duration::ZERO);
                kept.find(&bench)
            });
            bench.write(&name.expect("a kill comes before the end"), "damaged");
            let run = bench.run(&bake(input, more));
            assert_eq!(run.code, 0, "{}", run.stderr);
            assert!(!run.stderr.contains(kept.notice), "{}", run.stderr);
            assert!(bench.read("scene.pbgi") == finished);
            assert_eq!(bench.files(), ["scene.pbgi"]);
        }
    }
}

/// Starts a bake and kills it a while after it has kept something, if it does not end before that.
fn kill_once_kept(bench: &Bench, input: &[&str], kept: &Kept, after: Duration) {
    let args = bake(input, &["--resume"]);
    let mut command = bench.command(&args);
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while kept.find(bench).is_none() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(after);
    child.kill().unwrap();
    child.wait().unwrap();
}
