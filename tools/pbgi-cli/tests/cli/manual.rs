//! Help, completions and manual pages.

use crate::support::succeed_in;
use std::path::Path;

const COMMANDS: [&str; 4] = ["bake", "shade", "info", "demo"];

#[test]
fn help_and_version_are_there() {
    let here = Path::new(".");
    let help = succeed_in(here, &["help"]).stdout;
    for command in COMMANDS {
        assert!(help.contains(&format!("\n  {command} ")), "{help}");
        let long = succeed_in(here, &[command, "--help"]).stdout;
        assert!(long.contains("Exit codes:") && long.contains("130"), "{long}");
        assert!(long.contains(&format!("Usage: pbgi {command}")), "{long}");
    }
    let version = succeed_in(here, &["--version"]).stdout;
    assert_eq!(version.trim(), concat!("pbgi ", env!("CARGO_PKG_VERSION")));
}

#[test]
fn every_command_fits_a_screen_and_shows_what_is_looked_for() {
    let here = Path::new(".");
    for command in COMMANDS {
        let help = succeed_in(here, &[command, "-h"]).stdout;
        assert!(help.lines().count() <= 60, "{} lines:\n{help}", help.lines().count());
    }
    let help = succeed_in(here, &["shade", "-h"]).stdout;
    for option in ["--aov-names <PRESET>", "--quality <PRESET>", "--target-error"] {
        assert!(help.contains(option), "{option} is not in\n{help}");
    }
}

/// An option that two commands have is called the same, takes the same and is told in the same words.
#[test]
fn options_have_one_unit_across_commands() {
    let here = Path::new(".");
    let mut known: Vec<(String, String)> = Vec::new();
    for command in COMMANDS {
        let help = succeed_in(here, &[command, "--help"]).stdout;
        let lines = help.lines().map(str::trim).filter(|line| line.starts_with('-'));
        let options = lines.filter_map(|line| {
            let (name, value) = line[line.find("--")?..].split_once(' ')?;
            Some((name.to_owned(), value.to_owned()))
        });
        for (name, value) in options {
            match known.iter().find(|(other, _)| *other == name) {
                Some((_, other)) => assert_eq!(value, *other, "{name} of {command}"),
                None => known.push((name, value)),
            }
        }
    }
    assert!(known.iter().any(|(name, value)| name == "--env-rotate" && value == "<DEGREES>"));
}

#[test]
fn completions_and_pages_are_written() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let text = succeed_in(folder.path(), &["completions", shell]).stdout;
        assert!(text.contains("env-rotate"), "{shell}");
    }
    succeed_in(folder.path(), &["man", "--out", "man/pages"]);
    for page in ["pbgi.1", "pbgi-bake.1", "pbgi-shade.1", "pbgi-info.1", "pbgi-demo.1"] {
        let text = std::fs::read_to_string(folder.path().join("man/pages").join(page)).unwrap();
        assert!(text.contains(".TH"), "{page}");
    }
}
