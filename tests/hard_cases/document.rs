//! `docs/hard-cases.md`: what is promised, and what is measured.

use crate::verdict::{Measured, Verdict, show};
use std::fmt::Write;
use std::path::PathBuf;

const INTRODUCTION: &str = "\
# Hard cases

Hard cases are scenes that break what is not careful: surfaces that all but touch, sizes, brightnesses and places far apart, things that are
neither open nor closed. Each has an independent expected value (a closed form in double precision, another scene that must give the same, or
a refusal), a bound on the error with its derivation, and a measurement. This page is written by `cargo xtask bless hard-cases`;
`cargo xtask hard-cases` measures again and fails where a promise is broken or a known limit got worse. The scenes are in
`crates/testkit/src/hard`. Settings are the defaults, where a case does not say otherwise.

Errors are absolute for shares of the hemisphere and for what has the right value 1, else relative; the largest of all receivers counts.
Margin is what is left of the promise. A promise of 0 is one of equal bits, or of a refusal.
";

const LIMITS: &str = "
## Known limits

Not kept today. A measurement above the figure called *at most* fails.

| case | promised | measured | at most | because |
|---|---|---|---|---|
";

fn path() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/hard-cases.md"))
}

/// The page.
fn render(rows: &[Measured]) -> String {
    let mut page = INTRODUCTION.to_owned();
    page += "\n## Promises\n\n| case | scene, and what is compared | promised | measured | margin |\n|---|---|---|---|---|\n";
    for row in rows.iter().filter(|row| row.case.limit.is_none()) {
        let (name, about, promise) = (row.case.name, row.case.about, show(row.case.promise));
        let (error, margin) = (row.shown_error(), row.shown_margin());
        let _ = writeln!(page, "| `{name}` | {about} | {promise} | {error} | {margin} |");
    }
    page += LIMITS;
    for row in rows {
        let Some(limit) = &row.case.limit else { continue };
        let (name, promise) = (row.case.name, show(row.case.promise));
        let (error, most) = (row.shown_error(), show(limit.today));
        let because = format!("{}: {}", row.case.about, limit.because);
        let _ = writeln!(page, "| `{name}` | {promise} | {error} | {most} | {because} |");
    }
    page += "\n## Where the bounds come from\n\n";
    let mut reasons: Vec<(&str, Vec<&str>)> = Vec::new();
    for row in rows {
        match reasons.iter_mut().find(|(why, _)| *why == row.case.why) {
            Some((_, names)) => names.push(row.case.name),
            None => reasons.push((row.case.why, vec![row.case.name])),
        }
    }
    for (why, names) in reasons {
        let names = names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        let _ = writeln!(page, "* {names}: {why}.");
    }
    page
}

/// Writes the page, where no promise is broken.
pub fn write(rows: &[Measured]) -> Result<(), String> {
    if rows.iter().any(|row| row.verdict() == Verdict::Broken) {
        return Err("docs/hard-cases.md is not written while promises are broken".into());
    }
    std::fs::write(path(), render(rows)).map_err(|e| format!("docs/hard-cases.md: {e}"))
}

/// Compares the page with what it would be now.
pub fn check(rows: &[Measured]) -> Result<(), String> {
    let found = std::fs::read_to_string(path()).map_err(|e| format!("docs/hard-cases.md: {e}"))?;
    let expected = render(rows);
    let differs = found.lines().zip(expected.lines()).find(|(a, b)| a != b);
    match differs {
        None if found == expected => Ok(()),
        None => {
            Err("docs/hard-cases.md: rows are missing or too many; cargo xtask bless hard-cases"
                .into())
        }
        Some((old, new)) => Err(format!(
            "docs/hard-cases.md is not what is measured; cargo xtask bless hard-cases writes it\n  it says  {old}\n  measured {new}"
        )),
    }
}
