//! Nothing of the user's is destroyed, and nothing is waited for.

use crate::support::{fail, octree, run, shade, text};
use std::io::Write;
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const POINT: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
    property float nx\nproperty float ny\nproperty float nz\nend_header\n0 2 0 0 1 0\n";

const LIGHT: [&str; 5] = ["--env-color", "1,1,1", "--resolution", "8x6", "-q"];

/// What makes a gather cheap.
const COARSE: [&str; 4] = ["--solid-angle", "3", "--raster", "2"];

/// A folder with an octree, a scene, its texture, points and an environment.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::copy(octree(), path("scene.pbgi")).unwrap();
    let octree = path("scene.pbgi");
    std::fs::write(path("points.ply"), POINT).unwrap();
    let obj = "mtllib s.mtl\nusemtl a\nv -9 0 -9\nv 9 0 -9\nv 0 0 9\nvt 0 0\nf 1/1 2/1 3/1\n";
    std::fs::write(path("scene.obj"), obj).unwrap();
    std::fs::write(path("s.mtl"), "newmtl a\nmap_Kd wood.png\n").unwrap();
    let picture = ["--aovs", "beauty", "--preview", text(&path("wood.png")).to_owned().leak()];
    shade(&[&[text(&octree), "-o", text(&path("sky.exr"))], &LIGHT[..], &picture].concat());
    folder
}

/// Runs the tool, which must refuse what would destroy `file`, and leave it as it is.
fn refuse(file: &Path, arguments: &[&str]) {
    let before = std::fs::read(file).unwrap();
    let error = fail(2, arguments);
    assert!(std::fs::read(file).unwrap() == before, "{arguments:?} changes {}", file.display());
    assert!(error.contains("choose another output"), "{arguments:?}: {error}");
}

#[test]
fn no_output_is_an_input() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    symlink("scene.pbgi", path("link.png")).unwrap();
    std::fs::hard_link(path("scene.pbgi"), path("hard.png")).unwrap();
    let [octree, points, sky, obj, wood, new] =
        ["scene.pbgi", "points.ply", "sky.exr", "scene.obj", "wood.png", "new.exr"]
            .map(|name| text(&path(name)).to_owned());
    let [link, hard] = ["link.png", "hard.png"].map(|name| text(&path(name)).to_owned());
    let spelled = format!("{}/./scene.pbgi", folder.path().display());
    for option in ["--preview", "--contact-sheet", "--stats-json", "--trace-pages"] {
        for output in [&octree, &link, &hard, &spelled] {
            let outputs = [octree.as_str(), "-o", &new, option, output];
            refuse(&path("scene.pbgi"), &[&outputs, &LIGHT[..]].concat());
        }
    }
    refuse(&path("scene.pbgi"), &[&[octree.as_str(), "-o", &octree], &LIGHT[..]].concat());
    let of_points = ["--env-color", "1,1,1", "-q", "--force"];
    let surfels = [octree.as_str(), "--surfels", "-o", &octree];
    refuse(&path("scene.pbgi"), &[&surfels[..], &of_points].concat());
    let receivers = [octree.as_str(), "--receivers", &points, "-o", &points];
    refuse(&path("points.ply"), &[&receivers[..], &of_points].concat());
    refuse(&path("sky.exr"), &[&octree, "--env", &sky, "--resolution", "8x6", "-q", "-o", &sky]);
    let scene = [octree.as_str(), "--scene", &obj];
    refuse(&path("scene.obj"), &[&scene[..], &["-o", &obj], &LIGHT].concat());
    // What a scene refers to is an input, too.
    refuse(&path("wood.png"), &[&scene[..], &["-o", &new, "--preview", &wood], &LIGHT].concat());
    assert!(!path("new.exr").exists());
}

#[test]
fn no_two_outputs_are_one_and_no_other_kind_of_file_is_replaced() {
    let folder = folder();
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    std::fs::write(path("diary.txt"), "dear diary").unwrap();
    let with = |more: &[&str]| -> Vec<String> {
        let octree = path("scene.pbgi");
        let all = [&[octree.as_str()], &LIGHT[..], more].concat();
        all.into_iter().map(str::to_owned).collect()
    };
    let refused = |more: &[&str]| {
        let arguments = with(more);
        fail(2, &arguments.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let twice = refused(&["-o", &path("new.exr"), "--preview", &path("new.exr")]);
    assert!(twice.contains("written twice"), "{twice}");
    for option in ["-o", "--preview", "--stats-json", "--trace-pages"] {
        let other = [option, &path("diary.txt")];
        let rest = ["-o", &path("new.exr")];
        let error = match option {
            "-o" => refused(&other),
            _ => refused(&[other, rest].concat()),
        };
        assert!(error.contains("exists and is not"), "{error}");
    }
    assert_eq!(std::fs::read_to_string(path("diary.txt")).unwrap(), "dear diary");
    // A later frame's input.
    std::fs::copy(path("sky.exr"), path("a12.exr")).unwrap();
    std::fs::copy(path("sky.exr"), path("a2.exr")).unwrap();
    let frames = ["--frames", "2-12x10", "-o", &path("a1#.exr"), "--env", &path("a#.exr")];
    let octree = path("scene.pbgi");
    let all = [&[octree.as_str(), "--resolution", "8x6", "-q"], &frames[..]].concat();
    assert!(fail(2, &all).contains("is the input"));
}

#[test]
fn links_stay_and_devices_are_written_in_place() {
    let folder = folder();
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    std::fs::create_dir(path("deep")).unwrap();
    std::fs::copy(path("sky.exr"), path("deep/picture.exr")).unwrap();
    symlink("deep/picture.exr", path("link.exr")).unwrap();
    let octree = path("scene.pbgi");
    shade(&[&[octree.as_str(), "-o", &path("link.exr")], &LIGHT[..]].concat());
    assert!(Path::new(&path("link.exr")).is_symlink());
    assert_ne!(
        std::fs::read(path("deep/picture.exr")).unwrap(),
        std::fs::read(path("sky.exr")).unwrap()
    );
    let surfels = [octree.as_str(), "--surfels", "--env-color", "1,1,1", "-q", "--force"];
    let surfels = [&surfels[..], &COARSE, &["-o"]].concat();
    shade(&[&surfels[..], &["/dev/null"]].concat());
    assert!(std::fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    let made = Command::new("mkfifo").arg(path("pipe")).status().unwrap();
    assert!(made.success());
    let start = Instant::now();
    assert!(fail(2, &[&surfels[..], &[&path("pipe")]].concat()).contains("is a pipe"));
    assert!(
        fail(2, &[&[octree.as_str(), "-o", &path("pipe")], &LIGHT[..]].concat())
            .contains("is a pipe")
    );
    // Neither is waited for.
    let camera = ["--camera-file", &path("pipe"), "-o", &path("x.exr")];
    fail(3, &[&[octree.as_str()], &camera[..], &LIGHT].concat());
    let camera = ["--camera-file", "/dev/zero", "-o", &path("x.exr")];
    fail(3, &[&[octree.as_str()], &camera[..], &LIGHT].concat());
    fail(3, &[&[path("pipe").as_str(), "-o", &path("x.exr")], &LIGHT[..]].concat());
    assert!(start.elapsed() < Duration::from_secs(20));
    assert!(std::fs::metadata(path("pipe")).unwrap().file_type().is_fifo());
}

#[test]
fn what_a_killed_run_leaves_the_next_one_removes() {
    let folder = folder();
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    let names = || std::fs::read_dir(folder.path()).unwrap().count();
    let surfels =
        [&path("scene.pbgi"), "--surfels", "--env-color", "1,1,1", "-q", "-o", &path("all.csv")];
    let surfels = [&surfels[..], &COARSE].concat();
    let before = names();
    let mut left = 0;
    for milliseconds in (0..400).step_by(20) {
        let mut child = Command::new(env!("CARGO_BIN_EXE_pbgi-shade"))
            .args(&surfels)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(milliseconds));
        child.kill().unwrap();
        child.wait().unwrap();
        left = left.max(names() - before);
        let _ = std::fs::remove_file(path("all.csv"));
    }
    assert!(left > 0, "no kill came while the file was written");
    shade(&surfels);
    assert_eq!(names(), before + 1);
}

#[test]
fn a_standard_error_that_nobody_reads_changes_nothing() {
    let folder = folder();
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    let closed = |arguments: &[&str]| {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_pbgi-shade"));
        command.args(arguments).stdout(Stdio::null()).stderr(writer);
        command.status().unwrap().code()
    };
    assert_eq!(closed(&["none.pbgi", "-o", &path("x.exr")]), Some(3));
    let frames = ["--frames", "1-3", "--env-color", "1,1,1", "--resolution", "8x6"];
    let output = [&path("scene.pbgi"), "-o", &path("f.#.exr")];
    assert_eq!(closed(&[&output[..], &frames].concat()), Some(0));
    (1..4).for_each(|frame| assert!(Path::new(&path(&format!("f.{frame}.exr"))).exists()));
}

/// A Radiance file of one color, run-length coded.
fn write_sky(path: &Path, width: u16, height: u16) {
    let mut row = vec![2, 2, (width >> 8) as u8, width as u8];
    for value in [128, 128, 128, 129] {
        let mut left = usize::from(width);
        while left > 0 {
            let run = left.min(127);
            row.extend([128 + run as u8, value]);
            left -= run;
        }
    }
    let header = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n");
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    file.write_all(header.as_bytes()).unwrap();
    (0..height).for_each(|_| file.write_all(&row).unwrap());
}

#[test]
fn large_environments_are_refused_before_they_are_read() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write_sky(&path("sky.hdr"), 8192, 4096);
    // Decoded it takes 800 MB, which the system does not grant here.
    let tool = env!("CARGO_BIN_EXE_pbgi-shade");
    let (octree, sky, output) = (path("scene.pbgi"), path("sky.hdr"), path("x.exr"));
    let command = format!(
        "ulimit -v 700000; exec {tool} {} --env {} --resolution 8x6 -q -o {} -t 1 --memory-limit 256MiB",
        octree.display(),
        sky.display(),
        output.display()
    );
    let run = Command::new("sh").args(["-c", &command]).output().unwrap();
    let error = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(4), "{error}");
    assert!(error.contains("sky.hdr") && error.contains("--memory-limit "), "{error}");
    write_sky(&path("small.hdr"), 64, 32);
    let small = text(&path("small.hdr")).to_owned();
    let good = [text(&octree), "--env", &small, "--resolution", "8x6", "-q", "-o", text(&output)];
    assert!(run_ok(&good));
}

fn run_ok(arguments: &[&str]) -> bool {
    run(arguments).status.success()
}

/// What killed runs have left beside each output, the next run to the same outputs removes; what a run that lives writes, and files of
/// others, it leaves alone.
#[test]
fn what_killed_runs_have_left_is_removed() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let outputs = ["a.exr", "a.png", "sheet.png", "a.json", "a.trace", "a.ply"];
    let left = outputs.map(|name| path(&format!(".{name}.k1l2m3n4o5p6.pbgi-tmp")));
    let others = [".b.exr.k1l2m3n4o5p6.pbgi-tmp", ".a.exr.notes"].map(path);
    left.iter().chain(&others).for_each(|path| std::fs::write(path, "half").unwrap());
    let alive = path(".a.exr.livelivelive.pbgi-tmp");
    let living = std::fs::File::create(&alive).unwrap();
    living.lock().unwrap();
    let names = outputs.map(|name| text(&path(name)).to_owned());
    let [picture, preview, sheet, json, trace, points] = names.each_ref().map(String::as_str);
    let more = ["--preview", preview, "--contact-sheet", sheet, "--stats-json", json];
    let octree = text(&path("scene.pbgi")).to_owned();
    let of_picture = [&[octree.as_str(), "-o", picture, "--trace-pages", trace], &LIGHT[..], &more];
    shade(&of_picture.concat());
    let receivers = text(&path("points.ply")).to_owned();
    shade(&[octree.as_str(), "--receivers", &receivers, "-o", points, "-q"]);
    for path in &left {
        assert!(!path.exists(), "{} is still there", path.display());
    }
    assert!(others.iter().chain([&alive]).all(|path| path.exists()));
    assert!(names.iter().all(|name| Path::new(name).exists()));
}
