//! The names that the facade offers: none goes or comes unnoticed.

/// Every name that `lib.rs` makes public, sorted.
fn public_names(source: &str) -> Vec<String> {
    let mut names = Vec::new();
    for statement in source.split(';') {
        let Some(at) = statement.rfind("pub use ").or_else(|| statement.rfind("pub mod ")) else {
            continue;
        };
        let path = &statement[at + "pub use ".len()..];
        let list =
            path.split_once('{').map_or(path, |(_, list)| list.trim_end().trim_end_matches('}'));
        let last = |item: &str| item.rsplit([' ', ':']).next().unwrap_or_default().to_owned();
        names.extend(list.split(',').map(str::trim).filter(|item| !item.is_empty()).map(last));
    }
    names.sort();
    names
}

#[test]
fn public_names_are_those_listed() {
    let found = public_names(include_str!("../src/lib.rs"));
    let listed: Vec<&str> = include_str!("public_names.txt").lines().collect();
    assert!(found.len() > 40, "{found:?}");
    assert_eq!(
        found, listed,
        "a name that is gone breaks others' programs: say so in CHANGELOG.md, and list the names anew"
    );
}
