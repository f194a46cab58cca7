//! Octree files as inputs, lit anew.

use crate::invariance::write_gray_environment;
use crate::support::Bench;

/// Surfels of a leaf are rounded, without a shift of the mean (format document, leaves), and lit where they are then: light agrees with that of the
/// scene's own surfels to the share that one more rounding may change it by.
const ROUNDING: f64 = 2e-3;

fn assert_same(bench: &Bench, relit: &str, direct: &str) {
    let [relit, direct] = [relit, direct].map(|name| bench.check(name));
    assert_eq!(relit.surfels, direct.surfels);
    assert!((relit.area_total / direct.area_total - 1.0).abs() < 1e-3);
    for (found, expected) in relit.flux_total.iter().zip(direct.flux_total) {
        assert!((found / expected - 1.0).abs() < ROUNDING, "{found} {expected}");
    }
}

#[test]
fn a_relit_octree_has_the_light_of_its_scene() {
    let bench = Bench::new();
    write_gray_environment(&bench);
    // An open box without light of its own.
    bench.write(
        "box.obj",
        "v 0 0 0\nv 3 0 0\nv 3 2 0\nv 0 2 0\nv 0 0 2.5\nv 3 0 2.5\nv 3 2 2.5\nv 0 2 2.5\n\
         f 1 2 3 4\nf 5 8 7 6\nf 1 4 8 5\nf 2 6 7 3\nf 1 5 6 2\n",
    );
    // Cuts so fine that what rounding changes of nodes does not count.
    let light = ["--env", "sky.hdr", "--bounces", "2", "--bounce-solid-angle", "0.05", "--force"];
    bench.bake(&["box.obj", "--surfels", "6k", "-o", "plain.pbgi"], "plain.pbgi");
    let direct = ["box.obj", "--surfels", "6k", "-o", "direct.pbgi"];
    bench.bake(&[&direct[..], &light].concat(), "direct.pbgi");
    let mut files = Vec::new();
    for threads in ["1", "2"] {
        let relight = ["--relight", "plain.pbgi", "-o", "relit.pbgi", "--threads", threads];
        bench.bake(&[&relight[..], &light].concat(), "relit.pbgi");
        assert_same(&bench, "relit.pbgi", "direct.pbgi");
        files.push(bench.read("relit.pbgi"));
    }
    assert!(files[0] == files[1]);
    // The same again under the same light: what was lit is refused, and the way out named.
    let run = bench.run(&["--relight", "relit.pbgi", "--env", "sky.hdr", "-o", "twice.pbgi"]);
    assert_eq!(run.code, 3, "{}", run.stderr);
    for word in ["relit.pbgi", "--unlit", "bake its scene again"] {
        assert!(run.stderr.contains(word), "{}", run.stderr);
    }
}

#[test]
fn lamps_of_an_octree_shine_again() {
    let bench = Bench::new();
    bench.bake(&["demo:room?surfels=6k", "-o", "plain.pbgi"], "plain.pbgi");
    bench.bake(&["demo:room?surfels=6k", "--bounces", "2", "-o", "direct.pbgi"], "direct.pbgi");
    let args = ["--relight", "plain.pbgi", "--unlit", "--bounces", "2", "-o", "relit.pbgi"];
    bench.bake(&args, "relit.pbgi");
    assert_same(&bench, "relit.pbgi", "direct.pbgi");
}

#[test]
fn octrees_that_cannot_be_lit_are_refused() {
    let bench = Bench::new();
    bench.bake(&["demo:room?surfels=2k", "--occlusion-only", "-o", "dark.pbgi"], "dark.pbgi");
    bench.bake(&["demo:room?surfels=2k", "-o", "room.pbgi"], "room.pbgi");
    let bounce = ["--bounces", "1", "--force"];
    for (args, code, word) in [
        (&["--relight", "dark.pbgi", "-o", "x.pbgi"][..], 3, "--occlusion-only"),
        (&["--relight", "room.pbgi", "-o", "x.pbgi"], 3, "--unlit"),
        (&["--relight", "room.pbgi", "--unlit"], 2, "another output"),
        (&["--relight", "none.pbgi", "-o", "x.pbgi"], 3, "none.pbgi"),
        (&["--relight", "room.pbgi", "demo:room"], 2, "cannot be used with"),
    ] {
        let run = bench.run(&[args, &bounce].concat());
        assert_eq!(run.code, code, "{args:?}: {}", run.stderr);
        assert!(run.stderr.contains(word), "{args:?}: {}", run.stderr);
    }
    let run = bench.run(&["--relight", "room.pbgi", "-o", "x.pbgi"]);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(run.stderr.contains("--env"), "{}", run.stderr);
    assert_eq!(bench.files(), ["dark.pbgi", "room.pbgi"]);
}

#[test]
fn a_damaged_octree_is_named() {
    let bench = Bench::new();
    bench.bake(&["demo:cornell?surfels=4k", "-o", "old.pbgi"], "old.pbgi");
    let mut bytes = bench.read("old.pbgi");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    bench.write("old.pbgi", bytes);
    let args = ["--relight", "old.pbgi", "--unlit", "--bounces", "1", "-o", "new.pbgi"];
    let run = bench.run(&args);
    assert_eq!(run.code, 3, "{}", run.stderr);
    assert!(run.stderr.contains("old.pbgi") && run.stderr.contains("damaged"), "{}", run.stderr);
    assert_eq!(bench.files(), ["old.pbgi"]);
}
