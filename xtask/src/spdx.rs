//! SPDX license expressions, as far as manifests use them.

/// Whether what the expression asks for can be met by licenses that `is_allowed`: one side of each `OR`, both sides of each `AND`. A slash,
/// which old manifests have, is an `OR`. A license and its exception count as one.
///
/// # Errors
///
/// If it is no expression.
pub fn is_met(expression: &str, is_allowed: &dyn Fn(&str) -> bool) -> Result<bool, String> {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut parser = Parser { words: &words, is_allowed };
    let found = parser.any().ok_or_else(|| format!("`{expression}` is no license expression"))?;
    match parser.words {
        [] => Ok(found),
        [word, ..] => Err(format!("`{expression}` is no license expression: `{word}` is left")),
    }
}

/// The words yet to be read.
struct Parser<'a> {
    words: &'a [&'a str],
    is_allowed: &'a dyn Fn(&str) -> bool,
}

impl<'a> Parser<'a> {
    fn take(&mut self, word: &str) -> bool {
        let is_next = self.words.first() == Some(&word);
        if is_next {
            self.words = &self.words[1..];
        }
        is_next
    }

    fn any(&mut self) -> Option<bool> {
        let mut met = self.all()?;
        while self.take("OR") {
            met |= self.all()?;
        }
        Some(met)
    }

    fn all(&mut self) -> Option<bool> {
        let mut met = self.one()?;
        while self.take("AND") {
            met &= self.one()?;
        }
        Some(met)
    }

    fn one(&mut self) -> Option<bool> {
        if self.take("(") {
            let met = self.any()?;
            return self.take(")").then_some(met);
        }
        let name = self.name()?;
        if !self.take("WITH") {
            return Some((self.is_allowed)(name));
        }
        let exception = self.name()?;
        Some((self.is_allowed)(&format!("{name} WITH {exception}")))
    }

    fn name(&mut self) -> Option<&'a str> {
        let (word, rest) = self.words.split_first()?;
        if ["OR", "AND", "WITH", "(", ")"].contains(word) {
            return None;
        }
        self.words = rest;
        Some(word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions_are_met_by_one_side_of_or_and_both_of_and() {
        let allowed = ["MIT", "Unicode-3.0", "Apache-2.0 WITH LLVM-exception"];
        let met = |expression: &str| is_met(expression, &|name| allowed.contains(&name)).unwrap();
        for expression in [
            "MIT",
            "GPL-3.0 OR MIT",
            "MIT/Apache-2.0",
            "(MIT OR GPL-3.0) AND Unicode-3.0",
            "Apache-2.0 WITH LLVM-exception OR GPL-3.0",
            "GPL-3.0 OR MIT AND Unicode-3.0",
        ] {
            assert!(met(expression), "{expression}");
        }
        for expression in [
            "GPL-3.0",
            "MIT AND GPL-3.0",
            "(MIT OR GPL-3.0) AND GPL-2.0",
            "Apache-2.0",
            "MIT WITH LLVM-exception",
        ] {
            assert!(!met(expression), "{expression}");
        }
    }

    #[test]
    fn what_is_no_expression_is_refused() {
        for expression in ["", "MIT OR", "(MIT", "MIT)", "MIT MIT", "AND MIT", "MIT WITH"] {
            assert!(is_met(expression, &|_| true).is_err(), "{expression}");
        }
    }
}
