//! What goes wrong ends with the right exit code, a message that names place and cure, and no litter.

use crate::support::{Bench, Ply, ply, ply_sphere};

/// Runs the tool on what must fail with `code`; the message must hold all `parts`.
fn refuse(bench: &Bench, args: &[&str], code: i32, parts: &[&str]) {
    let before = bench.files();
    let run = bench.run(args);
    assert_eq!(run.code, code, "{args:?}: {}", run.stderr);
    for part in parts {
        assert!(run.stderr.contains(part), "{args:?}: `{part}` is not in: {}", run.stderr);
    }
    assert!(run.stdout.is_empty(), "{args:?}: {}", run.stdout);
    assert_eq!(bench.files(), before, "{args:?} leaves files behind");
}

#[test]
fn unreadable_inputs_end_with_code_3() {
    let bench = Bench::new();
    let good = ply_sphere(1000, Ply::Little);
    bench.write("empty.ply", "");
    bench.write("cut.ply", &good[..good.len() - 10]);
    bench.write("none.ply", ply(&["x", "y", "z"], vec![], Ply::Little));
    bench.write("x.fbx", "Kaydara FBX Binary");
    bench.write("cut.las", "LASF\0\0\0");
    bench.write("bad.glb", "glTF....");
    let mut values = vec![0.5; 3000];
    values[301] = f32::NAN;
    bench.write("nan.ply", ply(&["x", "y", "z"], values, Ply::Little));
    refuse(&bench, &["missing.ply"], 3, &["missing.ply", "open"]);
    refuse(&bench, &["missing.glb"], 3, &["missing.glb", "No such file"]);
    refuse(&bench, &["empty.ply"], 3, &["empty.ply", "empty"]);
    refuse(&bench, &["cut.ply"], 3, &["cut.ply"]);
    refuse(&bench, &["none.ply"], 3, &["none.ply", "no surfels"]);
    refuse(&bench, &["x.fbx"], 3, &["x.fbx", ".glb"]);
    refuse(&bench, &["cut.las"], 3, &["cut.las"]);
    refuse(&bench, &["bad.glb"], 3, &["bad.glb"]);
    refuse(&bench, &["nan.ply"], 3, &["nan.ply", "row 100", "--skip-invalid"]);
    let run = bench.run(&["nan.ply", "--skip-invalid", "-o", "skipped.pbgi"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(bench.check("skipped.pbgi").surfels, 999);
}

#[test]
fn raw_streams_that_break_off_end_with_code_3() {
    let bench = Bench::new();
    for input in [&b""[..], b"PBGISURF", b"something else entirely"] {
        let run = bench.run_with_input(&["-", "-o", "x.pbgi"], input);
        assert_eq!(run.code, 3, "{}", run.stderr);
    }
    assert!(bench.files().is_empty());
}

#[test]
fn unreadable_environments_end_with_code_3() {
    let bench = Bench::new();
    bench.write("sky.exr", "no image");
    for sky in ["sky.exr", "missing.exr"] {
        refuse(&bench, &["demo:cornell?surfels=1k", "--env", sky], 3, &[sky]);
    }
}

#[test]
fn misuse_ends_with_code_2() {
    let bench = Bench::new();
    bench.write("s.ply", ply_sphere(1000, Ply::Little));
    bench.write("old.pbgi", "PBGITREE, an old file");
    for (args, part) in [
        (&[][..], "INPUT"),
        (&["s.ply", "-o", "old.pbgi"], "--force"),
        (&["s.ply", "-o", "s.ply", "--force"], "s.ply"),
        (&["s.ply", "-o", ".", "--force"], "-o"),
        (&["s.ply", "--memory-limit", "1MiB"], "64MiB"),
        (&["s.ply", "--memory-limit", "much"], "512MiB"),
        (&["s.ply", "--page-bytes", "16"], "4KiB"),
        (&["s.ply", "--leaf-surfels", "0"], "1 to 255"),
        (&["s.ply", "--temp-dir", "none"], "--temp-dir"),
        (&["s.ply", "--bounces", "1", "--occlusion-only"], "--occlusion-only"),
        (&["demo:moon"], "street"),
        (&["demo:room", "--spacing", "-1"], "--spacing"),
        (&["-"], "-o"),
        (&["-", "-", "-o", "x.pbgi"], "once"),
    ] {
        refuse(&bench, args, 2, &[part]);
    }
    assert_eq!(bench.read("old.pbgi"), b"PBGITREE, an old file");
    bench.bake(&["s.ply", "-o", "old.pbgi", "--force"], "old.pbgi");
}

#[test]
fn outputs_that_cannot_be_written_end_before_the_work() {
    let bench = Bench::new();
    bench.write("s.ply", ply_sphere(1000, Ply::Little));
    bench.write("file", "");
    refuse(&bench, &["s.ply", "-o", "none/s.pbgi"], 1, &["none/s.pbgi"]);
    refuse(&bench, &["s.ply", "-o", "file/s.pbgi"], 1, &["file/s.pbgi"]);
}

#[test]
fn scenes_beyond_the_limit_end_with_code_4() {
    let bench = Bench::new();
    let args = ["demo:street?surfels=100k&size=64", "--memory-limit", "64MiB"];
    refuse(&bench, &args, 4, &["--memory-limit"]);
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_with_code_130_and_leaves_nothing() {
    let bench = Bench::new();
    let args = ["demo:room?surfels=400k", "--bounces", "3", "--progress", "json"];
    let mut command = bench.command(&args);
    command.stderr(std::process::Stdio::piped()).stdout(std::process::Stdio::null());
    let mut child = command.spawn().unwrap();
    let mut stderr = std::io::BufReader::new(child.stderr.take().unwrap());
    // Light is being gathered by the time the second phase has ended.
    let mut line = String::new();
    while !line.contains("\"name\":\"build\"") {
        line.clear();
        assert!(std::io::BufRead::read_line(&mut stderr, &mut line).unwrap() > 0, "ended early");
    }
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    std::io::copy(&mut stderr, &mut std::io::sink()).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(bench.files().is_empty(), "{:?}", bench.files());
}

#[test]
fn scenes_that_are_all_holes_end_at_once_and_name_their_materials() {
    let bench = Bench::new();
    let square = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\n";
    bench.write("m.mtl", "newmtl pane\nd 0\nnewmtl wall\nKd 1 1 1\n");
    bench.write("g.obj", format!("mtllib m.mtl\n{square}usemtl pane\nf 1 2 3 4\n"));
    for how in [["--surfels", "2000"], ["--spacing", "0.1"]] {
        let args = ["g.obj", how[0], how[1]];
        refuse(&bench, &args, 3, &["no surfels", "all surfaces are holes", "pane"]);
    }
    // Among others it is a warning, and takes no surfels from them.
    bench.write("w.obj", format!("mtllib m.mtl\n{square}usemtl wall\nf 1 2 3 4\n"));
    let run = bench.run(&["g.obj", "w.obj", "--surfels", "2000", "-o", "x.pbgi", "--strict"]);
    assert!(run.code == 3 && run.stderr.contains("--strict"), "{}", run.stderr);
    assert!(run.stderr.contains("g.obj: all surfaces are holes"), "{}", run.stderr);
    let surfels = bench.check("x.pbgi").surfels;
    assert!((1900..2100).contains(&surfels), "{surfels}");
}
