//! Nothing of the user's is destroyed, nothing is waited for, and no input takes more memory than is granted.

use crate::support::Bench;
use std::os::unix::fs::symlink;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

/// Runs the tool, which must end with `code`.
fn end(bench: &Bench, args: &[&str], code: i32) -> String {
    let run = bench.run(args);
    assert_eq!(run.code, code, "{args:?}: {}", run.stderr);
    run.stderr
}

#[test]
fn no_output_is_an_input_and_no_other_kind_of_file_is_replaced() {
    let bench = Bench::new();
    bench.write("s.obj", TRIANGLE);
    bench.write("diary.txt", "dear diary");
    let small = ["s.obj", "--surfels", "50", "-q", "--force"];
    symlink("s.obj", bench.path("link.json")).unwrap();
    for output in ["s.obj", "link.json", "diary.txt"] {
        let error =
            end(&bench, &[&small[..], &["-o", "x.pbgi", "--stats-json", output]].concat(), 2);
        assert!(error.contains(output), "{error}");
    }
    end(&bench, &[&small[..], &["-o", "diary.txt"]].concat(), 2);
    end(&bench, &[&small[..], &["-o", "x.pbgi", "--stats-json", "x.pbgi"]].concat(), 2);
    assert_eq!(bench.read("s.obj"), TRIANGLE.as_bytes());
    assert_eq!(bench.read("diary.txt"), b"dear diary");
    assert_eq!(bench.files(), ["diary.txt", "link.json", "s.obj"]);
    // Statistics of the same kind are replaced.
    for _ in 0..2 {
        end(&bench, &[&small[..], &["-o", "x.pbgi", "--stats-json", "x.json"]].concat(), 0);
    }
}

#[test]
fn nothing_is_written_through_links() {
    let bench = Bench::new();
    bench.write("victim", "precious");
    for name in [".out.pbgi.tmp", ".out.pbgi.pbgi-tmp", ".out-0000000000000000.runs"] {
        symlink("victim", bench.path(name)).unwrap();
    }
    end(&bench, &["demo:room?surfels=1k", "-o", "out.pbgi", "--resume", "-q"], 0);
    assert_eq!(bench.read("victim"), b"precious");
    assert!(!bench.path("out.pbgi").is_symlink());
    assert_eq!(bench.files().len(), 5);
}

#[test]
fn a_second_bake_of_one_output_ends_at_once_and_the_first_is_not_disturbed() {
    for more in [&[][..], &["--resume"]] {
        let bench = Bench::new();
        let slow = ["demo:room?surfels=8k", "--bounces", "2", "-o", "out.pbgi", "-q"];
        let mut first = bench.command(&[&slow[..], more].concat());
        let mut first = first.stdout(Stdio::null()).spawn().unwrap();
        while bench.files().is_empty() && first.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(5));
        }
        let start = Instant::now();
        let error =
            end(&bench, &[&["demo:street?surfels=1M", "-o", "./out.pbgi"], more].concat(), 1);
        assert!(error.contains("another bake"), "{error}");
        assert!(first.try_wait().unwrap().is_none(), "the first was too quick");
        assert!(start.elapsed() < Duration::from_secs(5));
        assert!(first.wait().unwrap().success());
        assert_eq!(bench.files(), ["out.pbgi"]);
    }
}

#[test]
fn limits_above_the_memory_of_the_machine_and_many_threads_are_no_defect() {
    let bench = Bench::new();
    for limit in [["--memory-limit", "1T"], ["--threads", "4096"]] {
        let args = ["demo:room?surfels=2k", "-o", "a.pbgi", "--force", "-q"];
        end(&bench, &[&args[..], &limit].concat(), 0);
    }
}

/// A glTF file of one triangle in the buffer `uri`, with so many equal nodes, and primitives in their mesh.
fn gltf(uri: &str, nodes: usize, primitives: usize) -> String {
    let list = |item: &str, count: usize| vec![item; count].join(",");
    let scene_nodes: Vec<String> = (0..nodes).map(|i| i.to_string()).collect();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[{}]}}],"nodes":[{}],
        "meshes":[{{"primitives":[{}]}}],"buffers":[{{"byteLength":36,"uri":"{uri}"}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}]}}"#,
        scene_nodes.join(","),
        list(r#"{"mesh":0}"#, nodes),
        list(r#"{"attributes":{"POSITION":0}}"#, primitives),
    )
}

#[test]
fn references_to_devices_and_pipes_are_refused_at_once() {
    let bench = Bench::new();
    assert!(Command::new("mkfifo").arg(bench.path("pipe")).status().unwrap().success());
    let start = Instant::now();
    let refused = "expected a regular file";
    for (uri, said) in [("/dev/zero", refused), ("pipe", refused), (".", "no such file")] {
        bench.write("a.gltf", gltf(uri, 1, 1));
        let error = end(&bench, &["a.gltf", "-o", "o.pbgi", "-q", "--memory-limit", "64MiB"], 3);
        assert!(error.contains(said), "{error}");
    }
    for input in ["pipe", "/dev/zero"] {
        end(&bench, &[input, "-o", "o.pbgi", "-q"], 3);
    }
    bench.write("a.obj", format!("mtllib m.mtl\nusemtl a\n{TRIANGLE}"));
    for texture in ["/dev/zero", "pipe"] {
        bench.write("m.mtl", format!("newmtl a\nmap_Kd {texture}\n"));
        let error = end(&bench, &["a.obj", "-o", "o.pbgi", "--force", "--surfels", "9"], 0);
        assert!(error.contains("is ignored"), "{error}");
    }
    assert!(start.elapsed() < Duration::from_secs(60));
}

/// Runs the tool at the smallest limit where the system grants little more than it needs.
fn run_confined(bench: &Bench, input: &str) -> (Option<i32>, String) {
    let tool = env!("CARGO_BIN_EXE_pbgi-bake");
    let command = format!(
        "ulimit -v 1000000; exec {tool} {input} -o o.pbgi --force -q -t 1 --memory-limit 64MiB"
    );
    let mut shell = Command::new("sh");
    shell.args(["-c", &command]).current_dir(bench.path("."));
    let run = shell.output().unwrap();
    (run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned())
}

#[test]
fn instances_are_counted_before_they_are_made() {
    let bench = Bench::new();
    bench.write("t.bin", [0.0f32, 0., 0., 1., 0., 0., 0., 1., 0.].map(f32::to_le_bytes).concat());
    bench.write("a.gltf", gltf("t.bin", 3000, 3000));
    let (code, error) = run_confined(&bench, "a.gltf");
    assert_eq!(code, Some(4), "{error}");
    assert!(error.contains("a.gltf") && error.contains("--memory-limit "), "{error}");
    bench.write("b.gltf", gltf("t.bin", 30, 30));
    end(&bench, &["b.gltf", "-o", "b.pbgi", "-q"], 0);
}

#[test]
fn libraries_and_buffers_are_read_once_however_often_they_are_named() {
    let bench = Bench::new();
    let materials: String = (0..5000).map(|i| format!("newmtl m{i}\nKd 1 0 0\n")).collect();
    bench.write("m.mtl", materials);
    bench.write("a.obj", format!("{}usemtl m7\n{TRIANGLE}", "mtllib m.mtl\n".repeat(2000)));
    let (code, error) = run_confined(&bench, "a.obj");
    assert_eq!(code, Some(0), "{error}");
    let buffer = r#"{"byteLength":36,"uri":"t.bin"},"#.repeat(1000);
    let json = gltf("t.bin", 1, 1).replace(r#""buffers":["#, &format!(r#""buffers":[{buffer}"#));
    bench.write("t.bin", vec![0; 1 << 20]);
    bench.write("a.gltf", json);
    let (code, error) = run_confined(&bench, "a.gltf");
    // A triangle without area gives no surfels.
    assert_eq!(code, Some(3), "{error}");
}

#[test]
fn a_resumed_bake_notices_what_its_scene_refers_to() {
    let bench = Bench::new();
    let edge = 250;
    let mut obj = "mtllib m.mtl\nusemtl a\n".to_owned();
    for i in 0..=edge {
        (0..=edge).for_each(|j| obj += &format!("v {} 0 {}\n", i as f32 * 0.1, j as f32 * 0.1));
    }
    for i in 0..edge {
        for j in 0..edge {
            let a = i * (edge + 1) + j + 1;
            obj += &format!("f {a} {} {} {}\n", a + 1, a + edge + 2, a + edge + 1);
        }
    }
    bench.write("s.obj", obj);
    let args = ["s.obj", "--surfels", "500k", "-q", "-o"];
    bench.write("m.mtl", "newmtl a\nKd 0 1 0\n");
    end(&bench, &[&args[..], &["fresh.pbgi"]].concat(), 0);
    let is_kept = || bench.files().iter().any(|name| name.ends_with(".state"));
    let was_killed = (0..8).any(|_| {
        bench.write("m.mtl", "newmtl a\nKd 1 0 0\n");
        let mut command = bench.command(&[&args[..], &["o.pbgi", "--resume"]].concat());
        let mut child = command.stdout(Stdio::null()).spawn().unwrap();
        while !is_kept() && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let is_killed = is_kept();
        if !is_killed {
            std::fs::remove_file(bench.path("o.pbgi")).unwrap();
        }
        is_killed
    });
    assert!(was_killed, "no kill came before the end");
    bench.write("m.mtl", "newmtl a\nKd 0 1 0\n");
    end(&bench, &[&args[..], &["o.pbgi", "--resume"]].concat(), 0);
    assert!(bench.read("o.pbgi") == bench.read("fresh.pbgi"));
    assert_eq!(bench.files(), ["fresh.pbgi", "m.mtl", "o.pbgi", "s.obj"]);
}

#[test]
fn scales_without_right_results_are_refused() {
    let bench = Bench::new();
    let cloud = |scale: f32| {
        let rows: String = (0..20)
            .map(|i| format!("{} {} 0 0 0 1 {}\n", i as f32 * scale, (i % 4) as f32 * scale, scale))
            .collect();
        let columns = ["x", "y", "z", "nx", "ny", "nz", "radius"];
        let columns: String = columns.iter().map(|c| format!("property float {c}\n")).collect();
        format!("ply\nformat ascii 1.0\nelement vertex 20\n{columns}end_header\n{rows}")
    };
    for (scale, code) in [(1e3, 0), (1e7, 0), (1e-5, 0), (1e10, 3), (1e15, 3), (1e-10, 3)] {
        bench.write("a.ply", cloud(scale));
        let error = end(&bench, &["a.ply", "-o", "a.pbgi", "--force", "-q"], code);
        assert!(code == 0 || error.contains("scale the scene"), "{scale}: {error}");
    }
}

#[test]
fn light_that_the_file_cannot_hold_is_reported() {
    let bench = Bench::new();
    let cloud = |bright: f32| {
        let row = |i: usize, light: f32| format!("{i} 0 0 0 1 0 0.4 {light} {light} {light}\n");
        let rows: String = (0..100).map(|i| row(i, if i == 7 { bright } else { 1.0 })).collect();
        let columns = ["x", "y", "z", "nx", "ny", "nz", "radius"].into_iter();
        let columns = columns.chain(["radiance_r", "radiance_g", "radiance_b"]);
        let columns: String = columns.map(|c| format!("property float {c}\n")).collect();
        format!("ply\nformat ascii 1.0\nelement vertex 100\n{columns}end_header\n{rows}")
    };
    for (bright, is_said) in [(1.0, false), (1e9, false), (1e12, true), (1e20, true)] {
        bench.write("a.ply", cloud(bright));
        let said = end(&bench, &["a.ply", "-o", "a.pbgi", "--force"], 0);
        assert_eq!(said.contains("99 of 100 surfels shine"), is_said, "{bright}: {said}");
    }
    // A few dark corners are no defect.
    bench.write("a.ply", cloud(1e-12));
    let said = end(&bench, &["a.ply", "-o", "a.pbgi", "--force"], 0);
    assert!(!said.contains("surfels shine"), "{said}");
}
