//! docs/format.md and the golden file: a reader made from the document alone explains every byte of it.
//!
//! `PBGI_BLESS=1` (set by `cargo xtask bless golden`) rewrites the file and its dump in the document.

use crate::support::bake;
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::Vec3;
use pbgi_store::{Octree, OpenOptions};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const BEGIN: &str = "<!-- dump: begin -->\n```text\n";
const END: &str = "```\n<!-- dump: end -->\n";

fn golden_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/v1-five-surfels.pbgi")
}

fn document_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/format.md")
}

fn is_blessing() -> bool {
    std::env::var_os("PBGI_BLESS").is_some()
}

/// Two oblong pieces of floor, a double-sided card, and a point without a normal.
fn five_surfels() -> Vec<Surfel> {
    // 0.25 × 0.125.
    let floor = |x: f32| {
        Surfel::new(Vec3::new(x, 0.0, 0.25), Vec3::Y, 0.125, 0.03125)
            .with_radiance([0.5, 0.25, 0.125])
            .with_albedo([0.75, 0.5, 0.25])
            .with_tile(Vec3::X, 2.0)
    };
    let card = |normal: Vec3, radiance: f32| {
        Surfel::new(Vec3::splat(0.5), normal, 0.25, 0.125)
            .with_radiance([radiance; 3])
            .with_flags(SurfelFlags::FRONT_ONLY)
    };
    let ember = Surfel::new(Vec3::new(1.5, 1.5, 1.5), Vec3::Z, 0.0625, 0.0078125)
        .with_radiance([64.0, 16.0, 1.0])
        .with_flags(SurfelFlags::ISOTROPIC);
    let slant = Vec3::new(0.6, 0.8, 0.0);
    vec![floor(0.0), floor(0.25), card(slant, 2.0), card(-slant, 0.0), ember]
}

fn build() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("five.pbgi");
    let options = BuildOptions { leaf_surfels_max: 2, ..BuildOptions::default() };
    bake(&five_surfels(), &options, &path);
    std::fs::read(path).unwrap()
}

/// The golden file, written anew when blessing.
fn golden() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        if is_blessing() {
            std::fs::create_dir_all(golden_path().parent().unwrap()).unwrap();
            std::fs::write(golden_path(), build()).unwrap();
        }
        std::fs::read(golden_path()).unwrap()
    })
}

#[test]
fn todays_builder_writes_the_golden_bytes() {
    assert!(build() == golden(), "the layout or the build changed: see docs/format.md, Versions");
}

#[test]
fn todays_reader_reads_the_golden_file() {
    golden();
    let octree = Octree::open(&golden_path(), &OpenOptions::default()).unwrap();
    let report = octree.verify(|_| {}).unwrap();
    assert_eq!(report.levels.iter().map(|l| l.surfels).sum::<u64>(), 5);
    let header = octree.header();
    assert_eq!((header.surfel_count, header.leaf_count, header.depth), (5, 3, 2));
    let area: f64 = five_surfels().iter().map(|s| f64::from(s.area)).sum();
    assert_eq!(header.area_total, area);
    let red: f64 = five_surfels().iter().map(|s| f64::from(s.area * s.radiance[0])).sum();
    assert_eq!(header.flux_total[0], red);
}

#[test]
fn the_document_shows_every_byte_of_the_golden_file() {
    let text = std::fs::read_to_string(document_path()).unwrap();
    let (before, rest) = text.split_once(BEGIN).expect("the document marks the dump's start");
    let (shown, after) = rest.split_once(END).expect("the document marks the dump's end");
    let dump = Dump::of_file(golden());
    if is_blessing() {
        std::fs::write(document_path(), format!("{before}{BEGIN}{dump}{END}{after}")).unwrap();
    } else {
        assert!(shown == dump, "docs/format.md is out of date: run `cargo xtask bless golden`");
    }
}

/// A reader made from the document alone: writes down what each byte is, in order.
struct Dump<'a> {
    bytes: &'a [u8],
    at: usize,
    out: String,
}

impl<'a> Dump<'a> {
    fn of_file(bytes: &'a [u8]) -> String {
        let mut dump = Self { bytes, at: 0, out: String::new() };
        let page_count = u64_at(bytes, 48);
        let table = u64_at(bytes, 56) as usize;
        dump.header();
        for page in 0..page_count as usize {
            let entry = &bytes[table + 32 * page..];
            dump.padding(u64_at(entry, 0) as usize);
            match u32_at(entry, 24) {
                1 => dump.node_page(page),
                _ => dump.surfel_page(page),
            }
        }
        dump.padding(table);
        for page in 0..page_count {
            dump.title(&format!("page table, entry {page}"));
            dump.show(8, |b| format!("offset {}", u64_at(b, 0)));
            dump.show(4, |b| format!("stored bytes {}", u32_at(b, 0)));
            dump.show(4, |b| format!("decoded bytes {}", u32_at(b, 0)));
            dump.show(8, |_| "checksum".into());
            dump.show(4, |b| format!("kind {}", u32_at(b, 0)));
            dump.show(4, |_| "reserved".into());
        }
        assert_eq!(dump.at, bytes.len(), "the dump covers the file");
        dump.out
    }

    fn title(&mut self, text: &str) {
        writeln!(self.out, "-- {text}").unwrap();
    }

    /// One line: the next `count` bytes and what they mean.
    fn show(&mut self, count: usize, explain: impl FnOnce(&[u8]) -> String) {
        let field = &self.bytes[self.at..self.at + count];
        let hex = if count > 12 && field.iter().all(|&b| b == 0) {
            format!("00 × {count}")
        } else {
            field.iter().map(|b| format!("{b:02x}")).collect::<Vec<_>>().join(" ")
        };
        writeln!(self.out, "{:5}  {hex:<36}  {}", self.at, explain(field)).unwrap();
        self.at += count;
    }

    fn padding(&mut self, end: usize) {
        if self.at < end {
            self.show(end - self.at, |_| "padding".into());
        }
    }

    fn show_u64(&mut self, name: &str) {
        self.show(8, |b| format!("{name} {}", u64_at(b, 0)));
    }

    fn show_u32(&mut self, name: &str) {
        self.show(4, |b| format!("{name} {}", u32_at(b, 0)));
    }

    fn show_vec3(&mut self, name: &str) {
        let f = |b: &[u8], i: usize| f32::from_bits(u32_at(b, 4 * i));
        self.show(12, |b| format!("{name} ({}, {}, {})", f(b, 0), f(b, 1), f(b, 2)));
    }

    fn show_f32(&mut self, name: &str) {
        self.show(4, |b| format!("{name} {}", f32::from_bits(u32_at(b, 0))));
    }

    fn show_f64(&mut self, name: &str) {
        self.show(8, |b| format!("{name} {}", f64::from_bits(u64_at(b, 0))));
    }

    fn header(&mut self) {
        self.title("header");
        self.show(8, |b| format!("magic {}", b.escape_ascii()));
        for name in ["version", "header bytes", "channels", "flags"] {
            self.show_u32(name);
        }
        for name in ["surfels", "nodes", "leaves", "pages", "page table offset"] {
            self.show_u64(name);
        }
        self.show(8, |_| "page table checksum".into());
        for name in
            ["root page", "root offset", "largest page", "leaf surfels at most", "depth in groups"]
        {
            self.show_u32(name);
        }
        self.show(4, |b| format!("radius codec: below 2^{}", u32_at(b, 0) as i32));
        self.show(4, |b| format!("area codec: below 2^{}", u32_at(b, 0) as i32));
        self.show_f32("radiance scale");
        for name in ["origin x", "origin y", "origin z"] {
            self.show_f64(name);
        }
        self.show_vec3("root cube corner");
        self.show_f32("root cube edge");
        self.show_vec3("bounds, smallest corner");
        self.show_vec3("bounds, largest corner");
        for name in ["total area", "total flux R", "total flux G", "total flux B"] {
            self.show_f64(name);
        }
        self.show_f32("spacing");
        self.show(44, |_| "reserved".into());
        self.show(8, |_| "checksum of the bytes before".into());
    }

    fn surfel_page(&mut self, page: usize) {
        self.title(&format!("page {page}: surfels"));
        self.show_u32("kind");
        let count = u32_at(&self.bytes[self.at..], 0);
        self.show_u32("surfels");
        self.show_u32("bytes per surfel");
        self.show_u32("reserved");
        let (rgb, albedo) = (self.is_rgb(), u32_at(self.bytes, 20) & 1 != 0);
        for surfel in 0..count {
            let cell = |b: &[u8], i: usize| u16_at(b, 2 * i);
            let name = format!("surfel {surfel}: center at");
            self.show(6, |b| format!("{name} ({}, {}, {})", cell(b, 0), cell(b, 1), cell(b, 2)));
            let tile = self.bytes[self.at + 3];
            let isotropic = self.bytes[self.at + 5] & 0x80 != 0;
            self.show(4, |b| match tile {
                0 => format!("  normal {}", octahedral(u32_at(b, 0))),
                tile => format!("  normal {}, tile code {tile}", octahedral(u32_at(b, 0))),
            });
            let is_tile = tile != 0 && !isotropic;
            let size = if is_tile { "  half the long edge" } else { "  radius" };
            self.mini_float(92, size, "isotropic");
            self.mini_float(96, "  area", "front only");
            if rgb {
                self.shared_exponent("  radiance", self.radiance_scale());
            }
            if albedo {
                self.shared_exponent("  albedo", 1.0);
            }
        }
    }

    fn node_page(&mut self, page: usize) {
        self.title(&format!("page {page}: nodes"));
        self.show_u32("kind");
        let groups = u32_at(&self.bytes[self.at..], 0);
        self.show_u32("groups");
        self.show_u32("surfel page, pages back");
        self.show_u32("links offset");
        let links = u32_at(&self.bytes[self.at..], 0);
        self.show_u32("links");
        self.show(12, |_| "reserved".into());
        for group in 0..groups {
            self.group(group);
        }
        for link in 0..links {
            self.show_u32(&format!("link {link}: pages back"));
            self.show_u32("  offset");
        }
    }

    fn group(&mut self, group: u32) {
        let start = self.at;
        self.title(&format!("group {group}"));
        self.show_vec3("box, smallest corner");
        self.show_vec3("box, largest corner");
        self.show_vec3("split point");
        self.show_f32("cover margin");
        let octants = self.bytes[self.at];
        self.show(1, |b| format!("octants with a child {:08b}", b[0]));
        let leaves = self.bytes[self.at];
        self.show(1, |b| format!("octants with a leaf {:08b}", b[0]));
        let lobes = self.bytes[self.at];
        self.show(1, |b| format!("lobes {}", b[0]));
        self.show(1, |_| "reserved".into());
        let children = octants.count_ones() as usize;
        for octant in (0..8).filter(|o| octants >> o & 1 != 0) {
            let is_leaf = leaves >> octant & 1 != 0;
            self.show(4, |b| format!("octant {octant}: {}", link(u32_at(b, 0), is_leaf)));
        }
        for name in ["min x", "min y", "min z", "max x", "max y", "max z"] {
            self.show(children, |_| format!("boxes of the children, {name}"));
        }
        self.show(children, |_| "ends of the children's lobes".into());
        self.padding(start + (self.at - start).next_multiple_of(4));
        for lobe in 0..lobes {
            let name = format!("lobe {lobe}: direction of the vector area");
            self.show(4, |b| {
                let direction = octahedral(u32_at(b, 0));
                format!("{name} {direction}, height {}/127", b[3] as i8)
            });
            self.mini_float(96, "  size", "blocks back");
            self.show(1, |b| format!("  width {}/255", b[0]));
            self.show(1, |b| format!("  fill {}/255", b[0]));
            if self.is_rgb() {
                self.shared_exponent("  radiance", self.radiance_scale());
            }
        }
    }

    fn is_rgb(&self) -> bool {
        u32_at(self.bytes, 16) == 3
    }

    fn radiance_scale(&self) -> f32 {
        f32::from_bits(u32_at(self.bytes, 100))
    }

    /// A MiniFloat whose codec stands at byte `codec` of the header, and what its top bit says.
    fn mini_float(&mut self, codec: usize, name: &str, flag: &str) {
        let exponent_max = u32_at(self.bytes, codec) as i32;
        self.show(2, |b| {
            let code = u16_at(b, 0);
            let (exponent, mantissa) = (i32::from(code >> 9 & 63), f64::from(code & 511));
            let value = (1.0 + mantissa / 512.0) * 2f64.powi(exponent_max - 64 + exponent);
            let value = if code & 0x7fff == 0 { 0.0 } else { value };
            let flag = if code & 0x8000 != 0 { format!(", {flag}") } else { String::new() };
            format!("{name} {value:.6}{flag}")
        });
    }

    fn shared_exponent(&mut self, name: &str, scale: f32) {
        self.show(4, |b| {
            let code = u32_at(b, 0);
            let unit = 2f64.powi((code >> 27) as i32 - 24) * f64::from(scale);
            let c = |shift: u32| f64::from(code >> shift & 511) * unit;
            format!("{name} ({:.4}, {:.4}, {:.4})", c(0), c(9), c(18))
        });
    }
}

fn link(code: u32, is_leaf: bool) -> String {
    if is_leaf {
        format!("leaf of {} surfels from {} on", code & 255, code >> 8)
    } else if code >> 31 != 0 {
        format!("external link {}", code & 0x7fff_ffff)
    } else {
        format!("group at {code} of this page")
    }
}

fn octahedral(code: u32) -> String {
    let axis = |bits: u32| (f64::from((bits << 20) as i32 >> 20) / 2047.0).max(-1.0);
    let (u, v) = (axis(code), axis(code >> 12));
    let z = 1.0 - u.abs() - v.abs();
    let fold = (-z).max(0.0);
    let (x, y) = (u - fold.copysign(u), v - fold.copysign(v));
    let length = (x * x + y * y + z * z).sqrt();
    // Plus zero, so that no −0 is shown.
    let c = |x: f64| (x / length * 1e4).round() / 1e4 + 0.0;
    format!("({:.4}, {:.4}, {:.4})", c(x), c(y), c(z))
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap())
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}
