//! Parts of the documentation that a run writes.

use anyhow::{Context, Result};
use std::path::Path;

/// Replaces what stands between the marks of `part` in a text: `<!-- truth: part -->` and `<!-- end -->`, each a line of its own.
///
/// # Errors
///
/// If the file cannot be read or written, or has no such marks.
pub fn replace(path: &Path, part: &str, with: &str) -> Result<()> {
    let place = || path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(place)?;
    let text = replaced(&text, part, with).with_context(|| {
        format!(
            "{}: no part {part}, expected it between <!-- truth: {part} --> and <!-- end -->",
            place()
        )
    })?;
    std::fs::write(path, text).with_context(place)
}

fn replaced(text: &str, part: &str, with: &str) -> Option<String> {
    let (before, rest) = text.split_once(&format!("<!-- truth: {part} -->\n"))?;
    let (_, after) = rest.split_once("<!-- end -->\n")?;
    let with = with.trim_end();
    Some(format!("{before}<!-- truth: {part} -->\n{with}\n<!-- end -->\n{after}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_part_between_its_marks_changes() {
        let text =
            "a\n<!-- truth: one -->\nold\n<!-- end -->\nb\n<!-- truth: two -->\n<!-- end -->\n";
        let once = replaced(text, "one", "new\nlines\n").unwrap();
        assert_eq!(once, text.replace("old", "new\nlines"));
        assert_eq!(replaced(&once, "one", "old").unwrap(), text);
        assert!(replaced(text, "two", "x").unwrap().ends_with("two -->\nx\n<!-- end -->\n"));
        assert_eq!(replaced(text, "three", "x"), None);
    }
}
