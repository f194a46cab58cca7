//! The layout of the octree file and its document change together or not at all.
//!
//! A hash of the sources that define the layout, without comments, tests and white space, stands in
//! the front matter of the document. Code that changes without changing the layout needs a
//! `cargo xtask bless layout`, and a look at the document.

use crate::workspace::Workspace;

/// The normative text.
pub const DOCUMENT: &str = "docs/format.md";

const KEY: &str = "layout-lock: ";

/// Sources that say which byte means what.
const SOURCES: [&str; 12] = [
    "crates/format/src/header.rs",
    "crates/format/src/page_table.rs",
    "crates/format/src/page.rs",
    "crates/format/src/group.rs",
    "crates/format/src/lobe.rs",
    "crates/format/src/surfel.rs",
    "crates/format/src/leaf.rs",
    "crates/format/src/leaf_writer.rs",
    "crates/format/src/bits.rs",
    "crates/format/src/mini_float.rs",
    "crates/math/src/octahedral.rs",
    "crates/math/src/rgbe.rs",
];

/// What is wrong with the lock.
pub fn check(workspace: &Workspace) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    let document = workspace.read(DOCUMENT)?;
    let (found, expected) = (front_matter(&document, KEY), lock(workspace)?);
    if found != Some(&*expected) {
        faults.push(format!(
            "{DOCUMENT}: the layout's sources changed ({expected}, the document was written for \
             {}); bring the document, the golden file and the changelog up to date, then run \
             `cargo xtask bless layout`",
            found.unwrap_or("none")
        ));
    }
    let header = workspace.read(SOURCES[0])?;
    let version = header
        .split_once("FORMAT_VERSION: u32 = ")
        .and_then(|(_, rest)| rest.split_once(';'))
        .map(|(version, _)| version);
    if version.is_none() || front_matter(&document, "format-version: ") != version {
        faults.push(format!("{DOCUMENT}: its format-version is not that of {}", SOURCES[0]));
    }
    Ok(faults)
}

/// Records the lock of today's sources in the document.
pub fn record(workspace: &Workspace) -> Result<(), String> {
    let document = workspace.read(DOCUMENT)?;
    let found = front_matter(&document, KEY)
        .ok_or_else(|| format!("{DOCUMENT}: its front matter holds no `{KEY}`"))?;
    let blessed =
        document.replacen(&format!("{KEY}{found}"), &format!("{KEY}{}", lock(workspace)?), 1);
    workspace.write(DOCUMENT, &blessed)
}

fn lock(workspace: &Workspace) -> Result<String, String> {
    let mut hash = Fnv::new();
    for path in SOURCES {
        hash.add(path.as_bytes());
        hash.add(essence(&workspace.read(path)?).as_bytes());
    }
    Ok(format!("{:016x}", hash.0))
}

/// Value of a key between the two `---` at the start of a document.
fn front_matter<'a>(document: &'a str, key: &str) -> Option<&'a str> {
    let matter = document.strip_prefix("---\n")?.split("\n---\n").next()?;
    matter.lines().find_map(|line| line.strip_prefix(key))
}

/// Code without its tests, comments and white space.
fn essence(source: &str) -> String {
    let code = source.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    code.lines()
        .map(|line| line.split("//").next().unwrap_or_default())
        .flat_map(str::chars)
        .filter(|c| !c.is_whitespace())
        .collect()
}

/// The 64-bit hash FNV-1a.
struct Fnv(u64);

impl Fnv {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_tests_and_white_space_do_not_count() {
        let source =
            "/// Bytes.\npub const N: usize = 4; // four\n\n#[cfg(test)]\nmod tests {\n}\n";
        assert_eq!(essence(source), "pubconstN:usize=4;");
        assert_ne!(essence(source), essence(&source.replace('4', "8")));
    }

    #[test]
    fn front_matter_ends_where_it_ends() {
        let document = "---\nformat-version: 1\nlayout-lock: 12ab\n---\nother: 3\n";
        assert_eq!(front_matter(document, KEY), Some("12ab"));
        assert_eq!(front_matter(document, "other: "), None);
        assert_eq!(front_matter("layout-lock: 12ab\n", KEY), None);
    }

    #[test]
    fn the_hash_is_fnv_1a() {
        let mut hash = Fnv::new();
        hash.add(b"a");
        assert_eq!(hash.0, 0xaf63_dc4c_8601_ec8c);
    }
}
