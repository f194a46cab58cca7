//! docs/format.md and the golden file: a reader made from the document alone explains every byte of it.
//!
//! `PBGI_BLESS=1` (set by `cargo xtask bless golden`) rewrites the file and its dump in the document.

use crate::support::bake;
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::Vec3;
use pbgi_store::{Octree, OpenOptions};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const BEGIN: &str = "<!-- dump: begin -->\n```text\n";
const END: &str = "```\n<!-- dump: end -->\n";

fn golden_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/v7-five-surfels.pbgi")
}

fn document_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/format.md")
}

fn is_blessing() -> bool {
    std::env::var_os("PBGI_BLESS").is_some()
}

/// An oblong and a triangular piece of floor, a double-sided card, and a point without a normal.
fn five_surfels() -> Vec<Surfel> {
    let floor = |x: f32, area: f32| {
        Surfel::new(Vec3::new(x, 0.0, 0.25), Vec3::Y, 0.125, area)
            .with_radiance([0.5, 0.25, 0.125])
            .with_albedo([0.75, 0.5, 0.25])
    };
    // 0.25 × 0.125, and its half.
    let oblong = floor(0.0, 0.03125).with_tile(Vec3::X, 2.0);
    let corner = floor(0.25, 0.015625).with_triangle(Vec3::new(0.25, 0.0, -0.125), 0.8);
    let card = |normal: Vec3, radiance: f32| {
        Surfel::new(Vec3::splat(0.5), normal, 0.25, 0.125)
            .with_radiance([radiance; 3])
            .with_flags(SurfelFlags::FRONT_ONLY)
    };
    let ember = Surfel::new(Vec3::new(1.5, 1.5, 1.5), Vec3::Z, 0.0625, 0.0078125)
        .with_radiance([64.0, 16.0, 1.0])
        .with_flags(SurfelFlags::ISOTROPIC);
    let slant = Vec3::new(0.6, 0.8, 0.0);
    vec![oblong, corner, card(slant, 2.0), card(-slant, 0.0), ember]
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
    let report = octree.verify(2, |_| {}).unwrap();
    assert_eq!(report.levels.iter().map(|l| l.surfels).sum::<u64>(), 5);
    let header = octree.header();
    assert_eq!((header.surfel_count, header.leaf_count, header.depth), (5, 3, 2));
    let area: f64 = five_surfels().iter().map(|s| f64::from(s.area)).sum();
    assert_eq!(header.area_total, area);
    let red: f64 = five_surfels().iter().map(|s| f64::from(s.area * s.radiance[0])).sum();
    assert_eq!(header.flux_total[0], red);
}

#[test]
fn files_of_older_versions_are_refused() {
    for version in 1..=6 {
        let name = format!("golden/v{version}-five-surfels.pbgi");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
        let error = Octree::open(&path, &OpenOptions::default()).err().unwrap().to_string();
        let expected = format!(
            "header: version: found {version}, expected 7 (the file is of an older program: bake it again)"
        );
        assert!(error.contains(&expected), "{error}");
    }
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
    /// By surfel page: first bytes and sizes of the leaves.
    leaves: BTreeMap<usize, BTreeMap<usize, usize>>,
    out: String,
}

impl<'a> Dump<'a> {
    fn of_file(bytes: &'a [u8]) -> String {
        let mut dump = Self { bytes, at: 0, leaves: BTreeMap::new(), out: String::new() };
        let page_count = u64_at(bytes, 48);
        let table = u64_at(bytes, 56) as usize;
        for page in 0..page_count as usize {
            let entry = &bytes[table + 32 * page..];
            if u32_at(entry, 24) == 1 {
                dump.collect_leaves(page, &bytes[u64_at(entry, 0) as usize..]);
            }
        }
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
        let start = self.at;
        self.title(&format!("page {page}: surfels"));
        self.show_u32("kind");
        self.show_u32("surfels");
        self.show(8, |_| "reserved".into());
        for (offset, count) in self.leaves[&page].clone() {
            assert_eq!(self.at - start, offset, "leaves lie one after the other");
            self.leaf(offset, count);
        }
        self.show(8, |_| "after the last leaf".into());
    }

    fn show_u8(&mut self, name: &str) -> usize {
        let byte = self.bytes[self.at];
        self.show(1, |b| format!("{name} {}", b[0]));
        byte.into()
    }

    /// A list of values of `bytes` bytes each: its length.
    fn list(&mut self, name: &str, bytes: usize, explain: impl Fn(&[u8]) -> String) -> usize {
        let count = self.show_u8(&format!("{name}s listed"));
        for index in 0..count {
            self.show(bytes, |b| format!("  {name} {index}: {}", explain(b)));
        }
        count
    }

    fn leaf(&mut self, offset: usize, count: usize) {
        self.title(&format!("leaf at {offset}, {count} surfels"));
        let control = u16_at(self.bytes, self.at);
        let width = [control & 15, control >> 4 & 15, control >> 8 & 15].map(u32::from);
        let (orientation, size) = (control >> 12 & 3, control >> 14);
        self.show(2, |_| {
            format!(
                "bits of a position {width:?}, orientation mode {orientation}, size mode {size}"
            )
        });
        let mut fields: Vec<(String, u32)> = Vec::new();
        for (axis, bits) in width.into_iter().enumerate() {
            fields.push((format!("position {axis}"), bits));
        }
        let orientation_bits = match orientation {
            1 => 20,
            2 => 32,
            _ => index_bits(self.list("orientation", 4, |b| match b[3] {
                0 => format!("normal {}", octahedral(u32_at(b, 0))),
                tile => format!("normal {}, tile code {tile}", octahedral(u32_at(b, 0))),
            })),
        };
        fields.push(("orientation".into(), orientation_bits));
        if orientation != 1 {
            let foot_bits = match self.bytes[self.at] {
                0 | 255 => match self.show_u8("feet: 0 none, 255 of each surfel:") {
                    0 => 0,
                    _ => 7,
                },
                _ => {
                    index_bits(self.list("feet", 1, |b| format!("{} of 126", i32::from(b[0]) - 1)))
                }
            };
            fields.push(("foot".into(), foot_bits));
        }
        for (axis, bits) in width.into_iter().enumerate() {
            let is_height = orientation == 3 && axis == 2;
            if bits == 0 || is_height {
                self.show(2, |b| format!("position {axis} from {} on", u16_at(b, 0)));
            }
            if bits > 0 && is_height {
                self.show_u8("  in steps of 2 to the power of");
            }
        }
        self.leaf_sizes(size, &mut fields);
        self.leaf_colors(&mut fields);
        let stride: u32 = fields.iter().map(|f| f.1).sum();
        let records = &self.bytes[self.at..];
        let bytes = (stride as usize * count).div_ceil(8);
        self.show(bytes, |_| format!("surfels of {stride} bits"));
        for surfel in 0..count {
            let mut at = surfel * stride as usize;
            let mut text = format!("surfel {surfel}:");
            for (name, bits) in fields.iter().filter(|f| f.1 > 0) {
                let bit = |i: usize| u64::from(records[(at + i) / 8] >> ((at + i) % 8) & 1) << i;
                let number: u64 = (0..*bits as usize).map(bit).sum();
                write!(text, " {name} {number}").unwrap();
                at += *bits as usize;
            }
            self.note(&text);
        }
    }

    /// Radii and areas of a leaf.
    fn leaf_sizes(&mut self, mode: u16, fields: &mut Vec<(String, u32)>) {
        let [radius, area] = [92, 96].map(|at| u32_at(self.bytes, at) as i32);
        let mut below = |dump: &mut Self, name: &str| {
            let control = u32::from(dump.bytes[dump.at]);
            dump.show(1, |_| format!("  {} bits, in steps of 2^{}", control & 15, control >> 4));
            fields.push((name.into(), control & 15));
        };
        match mode {
            0 => {
                let count = self.list("size", 4, |b| {
                    let flag =
                        |bit: u32, name| if u32_at(b, 0) >> bit & 1 != 0 { name } else { "" };
                    let size = mini_float(u16_at(b, 0).into(), radius);
                    let area = mini_float(u16_at(b, 2).into(), area);
                    let (isotropic, front) = (flag(15, ", isotropic"), flag(31, ", front only"));
                    format!("{size:.6}, area {area:.6}{isotropic}{front}")
                });
                fields.push(("size".into(), index_bits(count)));
            }
            1 => {
                self.show(2, |b| format!("size²/area {}", mini_float(u16_at(b, 0).into(), 32)));
                self.mini_float(96, "largest area", "front only");
                below(self, "area");
            }
            2 => {
                self.mini_float(92, "largest size", "isotropic");
                self.mini_float(96, "largest area", "front only");
                below(self, "size");
                below(self, "area");
            }
            _ => fields.push(("size".into(), 32)),
        }
    }

    /// Light and albedo of a leaf.
    fn leaf_colors(&mut self, fields: &mut Vec<(String, u32)>) {
        let widths = |control: u16| [control & 15, control >> 4 & 15, control >> 8 & 15];
        let explain = |control: u16| {
            let zero = if control >> 15 != 0 { ", 0 is none" } else { "" };
            format!("{:?} bits, in steps of 2^{}{zero}", widths(control), control >> 12 & 7)
        };
        let mut push = |name: &str, control: u16| {
            for (channel, bits) in ["R", "G", "B"].into_iter().zip(widths(control)) {
                fields.push((format!("{name} {channel}"), bits.into()));
            }
        };
        if self.is_rgb() {
            let control = u16_at(self.bytes, self.at);
            self.show(2, |_| format!("radiance: {}", explain(control)));
            if control & 0x8fff != 0x8000 {
                let scale = f64::from(self.radiance_scale());
                self.show(6, |b| {
                    let c = |i: usize| mini_float(u16_at(b, 2 * i).into(), 16) * scale;
                    format!("  at least ({:.4}, {:.4}, {:.4})", c(0), c(1), c(2))
                });
            }
            push("radiance", control);
        }
        if u32_at(self.bytes, 20) & 1 != 0 {
            let root = |b: &[u8], i: usize| (f64::from(b[i]) / 255.0).powi(2);
            let color =
                |b: &[u8]| format!("({:.4}, {:.4}, {:.4})", root(b, 0), root(b, 1), root(b, 2));
            let count = self.list("albedo", 3, color);
            if count > 0 {
                fields.push(("albedo".into(), index_bits(count)));
            } else {
                let control = u16_at(self.bytes, self.at);
                self.show(2, |_| format!("albedo: {}", explain(control)));
                self.show(3, |b| format!("  at least {}", color(b)));
                push("albedo", control);
            }
        }
    }

    /// Where the leaves of a node page lie.
    fn collect_leaves(&mut self, number: usize, page: &[u8]) {
        let lobe_bytes = if self.is_rgb() { 12 } else { 8 };
        let mut at = 32;
        while at < u32_at(page, 12) as usize {
            let (octants, leaves, lobes) = (page[at + 38], page[at + 39], page[at + 40]);
            let children = octants.count_ones() as usize;
            for (child, octant) in (0..8).filter(|o| octants >> o & 1 != 0).enumerate() {
                let link = u32_at(page, at + 41 + 4 * child);
                if leaves >> octant & 1 != 0 {
                    let of_page = self.leaves.entry(number - u32_at(page, 8) as usize).or_default();
                    of_page.insert((link >> 8) as usize, (link & 255) as usize);
                }
            }
            at += (41 + 11 * children).next_multiple_of(4) + usize::from(lobes) * lobe_bytes;
            let [wide, narrow] = [0, 4].map(|i| u32_at(page, at + i).count_ones() as usize);
            at += (8 + 8 * wide + 2 * narrow).next_multiple_of(4);
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
        self.show(2, |b| format!("cover margin {}", f32::from_bits(u32::from(u16_at(b, 0)) << 16)));
        let octants = self.bytes[self.at];
        self.show(1, |b| format!("octants with a child {:08b}", b[0]));
        let leaves = self.bytes[self.at];
        self.show(1, |b| format!("octants with a leaf {:08b}", b[0]));
        let lobes = self.bytes[self.at];
        self.show(1, |b| format!("lobes {}", b[0]));
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
            self.show(1, |b| {
                let kind = if b[0] & 0x80 == 0 { "a surface" } else { "loose" };
                format!("  fill {}/127, {kind}", b[0] & 0x7f)
            });
            if self.is_rgb() {
                self.shared_exponent("  radiance", self.radiance_scale());
            }
        }
        let stencils = self.at;
        let sets = [0, 4].map(|i| u32_at(&self.bytes[self.at..], i));
        self.show(4, |b| format!("lobes with a wide stencil {:b}", u32_at(b, 0)));
        self.show(4, |b| format!("lobes with a narrow stencil {:b}", u32_at(b, 0)));
        for (set, bytes) in sets.into_iter().zip([8, 2]) {
            for lobe in (0..32).filter(|lobe| set >> lobe & 1 != 0) {
                self.show(bytes, |b| {
                    let rows: String = b.iter().rev().map(|row| format!("{row:08b}")).collect();
                    format!("stencil of lobe {lobe}: {rows}")
                });
            }
        }
        self.padding(stencils + (self.at - stencils).next_multiple_of(4));
    }

    fn is_rgb(&self) -> bool {
        u32_at(self.bytes, 16) == 3
    }

    fn radiance_scale(&self) -> f32 {
        f32::from_bits(u32_at(self.bytes, 100))
    }

    /// A line about bytes already shown.
    fn note(&mut self, text: &str) {
        writeln!(self.out, "{:45}{text}", "").unwrap();
    }

    /// A MiniFloat whose codec stands at byte `codec` of the header, and what its top bit says.
    fn mini_float(&mut self, codec: usize, name: &str, flag: &str) {
        let exponent_max = u32_at(self.bytes, codec) as i32;
        self.show(2, |b| {
            let code = u16_at(b, 0);
            let value = mini_float(code.into(), exponent_max);
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

/// Bits that tell so many things apart.
fn index_bits(count: usize) -> u32 {
    (0..).find(|bits| 1 << bits >= count).unwrap()
}

/// Bit 15 means something else.
fn mini_float(code: u32, exponent_max: i32) -> f64 {
    let (exponent, mantissa) = ((code >> 9 & 63) as i32, f64::from(code & 511));
    let value = (1.0 + mantissa / 512.0) * 2f64.powi(exponent_max - 64 + exponent);
    if code & 0x7fff == 0 { 0.0 } else { value }
}

fn link(code: u32, is_leaf: bool) -> String {
    if is_leaf {
        format!("leaf of {} surfels at {}", code & 255, code >> 8)
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
