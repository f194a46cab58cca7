//! A bake that is killed, wherever it is.

use crate::support::Bench;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Kills of each kind of bake, at moments spread over its time.
const KILLS: u32 = 18;

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
        bench.write("scene.pbgi", "the old file");
        let mut killed = 0;
        for kill in 0..KILLS {
            start_and_kill(&bench, &bake(input, &[]), whole * kill / KILLS);
            // A kill may come after the new file has its name; there is nothing between the two.
            if bench.read("scene.pbgi") == b"the old file" {
                killed += 1;
            } else {
                assert!(bench.read("scene.pbgi") == finished, "kill {kill} left half a file");
                bench.write("scene.pbgi", "the old file");
            }
        }
        assert!(killed > KILLS / 3, "only {killed} kills within {whole:?} came before the end");
        bench.bake(&bake(input, &[]), "scene.pbgi");
        assert!(bench.read("scene.pbgi") == finished);
        assert_eq!(bench.files(), ["scene.pbgi"]);
    }
}

#[test]
fn a_killed_bake_is_taken_up_again() {
    let bench = Bench::new();
    let input = BAKES[0];
    let start = Instant::now();
    bench.bake(&bake(input, &[]), "scene.pbgi");
    let whole = start.elapsed();
    let finished = bench.read("scene.pbgi");
    std::fs::remove_file(bench.path("scene.pbgi")).unwrap();
    let mut taken_up = 0;
    for kill in 0..8 {
        kill_once_kept(&bench, input, whole * kill / 16);
        // A bake that ends before it is killed has nothing to keep.
        let is_kept = bench.files().iter().any(|name| name.ends_with(".state"));
        let run = bench.run(&bake(input, &["--resume"]));
        assert_eq!(run.code, 0, "{}", run.stderr);
        let is_taken_up = run.stderr.contains("taking up the surfels");
        assert_eq!(is_taken_up, is_kept, "{}", run.stderr);
        taken_up += u32::from(is_taken_up);
        assert!(bench.read("scene.pbgi") == finished);
        assert_eq!(bench.files(), ["scene.pbgi"]);
    }
    assert!(taken_up > 0, "no kill came before the end");
    // Without --resume nothing of a killed run is used, and nothing stays.
    bench.write(&kill_once_kept(&bench, input, Duration::ZERO), "damaged");
    bench.bake(&bake(input, &[]), "scene.pbgi");
    assert_eq!(bench.files(), ["scene.pbgi"]);
}

/// Kills a bake a while after it has kept what it sorted, and returns the name of that file.
fn kill_once_kept(bench: &Bench, input: &[&str], after: Duration) -> String {
    let args = bake(input, &["--resume"]);
    let mut child =
        bench.command(&args).stdin(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    loop {
        if let Some(name) = bench.files().into_iter().find(|name| name.ends_with(".state")) {
            std::thread::sleep(after);
            child.kill().unwrap();
            child.wait().unwrap();
            return name;
        }
        assert!(child.try_wait().unwrap().is_none(), "it ended without keeping anything");
        std::thread::sleep(Duration::from_millis(1));
    }
}
