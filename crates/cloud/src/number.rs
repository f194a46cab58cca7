//! Numbers as programs print them.

/// The number a word says, with the spellings of infinity and "not a number" of all common C libraries: `-nan(ind)`, `1.#IND`,
/// `-1.#INF`. `None` if it is no number.
#[must_use]
pub fn parse_number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| parse_special(word))
}

fn parse_special(word: &str) -> Option<f64> {
    let lower = word.to_ascii_lowercase();
    let (sign, unsigned) = match lower.strip_prefix(['+', '-']) {
        Some(rest) => (if lower.starts_with('-') { -1.0 } else { 1.0 }, rest),
        None => (1.0, lower.as_str()),
    };
    let is_nan =
        |text: &str| ["ind", "qnan", "snan", "nan", "j"].iter().any(|n| text.starts_with(n));
    match unsigned.strip_prefix("1.#") {
        Some(rest) if rest.starts_with("inf") => Some(sign * f64::INFINITY),
        Some(rest) if is_nan(rest) => Some(f64::NAN),
        Some(_) => None,
        None if unsigned.starts_with("nan(") && unsigned.ends_with(')') => Some(f64::NAN),
        None if ["qnan", "snan", "nanq", "nans"].contains(&unsigned) => Some(f64::NAN),
        None => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_compilers_are_understood() {
        for word in [
            "nan",
            "-nan",
            "NaN",
            "-nan(ind)",
            "nan(snan)",
            "-1.#IND",
            "1.#QNAN",
            "1.#IND00",
            "1.#J",
            "1.#SNAN",
            "+nan(0x8000)",
        ] {
            assert!(parse_number(word).is_some_and(f64::is_nan), "{word}");
        }
        for (word, number) in [
            ("1.#INF", f64::INFINITY),
            ("-1.#INF00", f64::NEG_INFINITY),
            ("-inf", f64::NEG_INFINITY),
            ("1.5e3", 1500.0),
            ("+.5", 0.5),
        ] {
            assert_eq!(parse_number(word), Some(number));
        }
        for word in ["", "x", "1.#", "1.#x", "nanny", "nan(", "-", "1,5", "0x10"] {
            assert_eq!(parse_number(word), None, "{word}");
        }
    }
}
