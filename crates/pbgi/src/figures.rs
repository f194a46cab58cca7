//! Figures as people read and write them.

/// A count with three digits and a decimal suffix: `1.23 M`.
#[must_use]
pub fn format_count(count: f64) -> String {
    for (scale, suffix) in [(1e9, " G"), (1e6, " M"), (1e3, " k")] {
        // 999.5 and more would round to four digits below.
        if count >= scale * 0.9995 {
            return format!("{}{suffix}", format_digits(count / scale));
        }
    }
    if count.fract() == 0.0 { format!("{count:.0}") } else { format_digits(count) }
}

fn format_digits(value: f64) -> String {
    match value {
        v if v < 9.995 => format!("{v:.2}"),
        v if v < 99.95 => format!("{v:.1}"),
        v => format!("{v:.0}"),
    }
}

/// A number of bytes with a binary suffix: `512 MiB`.
#[must_use]
pub fn format_bytes(bytes: u64) -> String {
    for (shift, suffix) in [(40, "TiB"), (30, "GiB"), (20, "MiB"), (10, "KiB")] {
        if bytes >= 1 << shift {
            let value = bytes as f64 / (1u64 << shift) as f64;
            let text =
                if value.fract() == 0.0 { format!("{value:.0}") } else { format_digits(value) };
            return format!("{text} {suffix}");
        }
    }
    format!("{bytes} bytes")
}

/// A duration: `0.35 s`, `12 s`, `3 min 20 s`, `2 h 5 min`.
#[must_use]
pub fn format_seconds(seconds: f64) -> String {
    let whole = seconds.round().max(0.0) as u64;
    match whole {
        0..10 => format!("{seconds:.2} s"),
        10..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

/// Lines of labels and values, the values aligned.
#[must_use]
pub fn format_table(rows: &[(impl AsRef<str>, String)]) -> String {
    let width = rows.iter().map(|(label, _)| label.as_ref().chars().count()).max().unwrap_or(0);
    rows.iter().map(|(label, value)| format!("{:<width$}  {value}\n", label.as_ref())).collect()
}

/// A number of bytes: `4GiB`, `512M`, `1.5g`, `100000`. K, M, G, T and KiB … are powers of 1024,
/// kB, MB, GB and TB powers of 1000.
///
/// # Errors
///
/// Says what is expected.
///
/// ```
/// assert_eq!(pbgi::figures::parse_bytes("1.5GiB"), Ok(3 << 29));
/// ```
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let expected = || format!("`{text}` is no size; expected one such as 512MiB or 4G");
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (digits, suffix) = text.split_at(end);
    let binary = ["", "k", "m", "g", "t"];
    let suffix = suffix.trim_start().to_ascii_lowercase();
    let stem = suffix.strip_suffix("ib").or(suffix.strip_suffix('b'));
    let is_decimal = stem.is_some_and(|s| !s.is_empty()) && !suffix.ends_with("ib");
    let power = binary.iter().position(|&s| s == stem.unwrap_or(&suffix)).ok_or_else(expected)?;
    let base: f64 = if is_decimal { 1000.0 } else { 1024.0 };
    scale_number(digits, base.powi(power as i32)).ok_or_else(expected)
}

/// A count: `2M`, `1.5G`, `250k`, `1000`, `1e6`, `1_000_000`; the suffixes are powers of 1000.
///
/// # Errors
///
/// Says what is expected.
///
/// ```
/// assert_eq!(pbgi::figures::parse_count("1.5M"), Ok(1_500_000));
/// ```
pub fn parse_count(text: &str) -> Result<u64, String> {
    let expected = || format!("`{text}` is no count; expected one such as 2M, 5e5 or 500000");
    let text = text.replace('_', "");
    let (digits, factor) = match text.char_indices().last() {
        Some((end, 'k' | 'K')) => (&text[..end], 1e3),
        Some((end, 'm' | 'M')) => (&text[..end], 1e6),
        Some((end, 'g' | 'G')) => (&text[..end], 1e9),
        _ => (&text[..], 1.0),
    };
    let (digits, factor) = match digits.split_once(['e', 'E']) {
        Some((digits, power)) => (digits, factor * ten_to(power).ok_or_else(expected)?),
        None => (digits, factor),
    };
    scale_number(digits, factor).ok_or_else(expected)
}

/// A power of ten, of one digit or two.
fn ten_to(power: &str) -> Option<f64> {
    let digits = power.strip_prefix('+').unwrap_or(power);
    let is_short = (1..=2).contains(&digits.len()) && digits.bytes().all(|b| b.is_ascii_digit());
    is_short.then(|| digits.parse().ok()).flatten().map(|power| 10f64.powi(power))
}

/// `digits` times `factor`, rounded; only unsigned decimal numbers below 2⁵³ pass.
fn scale_number(digits: &str, factor: f64) -> Option<u64> {
    if !digits.bytes().all(|b| b.is_ascii_digit() || b == b'.') {
        return None;
    }
    let value = (digits.parse::<f64>().ok()? * factor).round();
    (value < (1u64 << 53) as f64).then_some(value as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        let texts =
            [0.0, 7.0, 999.0, 999.6, 1234.0, 999_499.0, 999_999.0, 2.5e10].map(format_count);
        assert_eq!(texts, ["0", "7", "999", "1.00 k", "1.23 k", "999 k", "1.00 M", "25.0 G"]);
        let texts = [0, 1023, 1024, 1_500_000, 1 << 30].map(format_bytes);
        assert_eq!(texts, ["0 bytes", "1023 bytes", "1 KiB", "1.43 MiB", "1 GiB"]);
        let texts = [0.351, 12.34, 200.0, 7500.0].map(format_seconds);
        assert_eq!(texts, ["0.35 s", "12.3 s", "3 min 20 s", "2 h 5 min"]);
    }

    #[test]
    fn tables_are_aligned() {
        let table = format_table(&[("surfels", "3".to_owned()), ("Σ", "4".to_owned())]);
        assert_eq!(table, "surfels  3\nΣ        4\n");
    }

    #[test]
    fn sizes_are_read() {
        for (text, bytes) in [
            ("1000", 1000),
            ("4GiB", 4 << 30),
            ("2M", 2 << 20),
            ("2 MiB", 2 << 20),
            ("0.5g", 1 << 29),
            ("3kB", 3000),
            ("2GB", 2_000_000_000),
            ("10b", 10),
            ("1T", 1 << 40),
        ] {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "M", "-1", "4XiB", "1..2", "1e9", "é", "ib", "99999999999999999T"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
    }

    #[test]
    fn counts_are_read() {
        assert_eq!(parse_count("250k"), Ok(250_000));
        assert_eq!(parse_count("1.25G"), Ok(1_250_000_000));
        assert_eq!(parse_count("1e6"), Ok(1_000_000));
        assert_eq!(parse_count("2.5E+3"), Ok(2500));
        assert_eq!(parse_count("1_000_000"), Ok(1_000_000));
        for text in
            ["1e", "1e-3", "1e999", "e6", "_", "1e16", "1e6.5", "", "M", "-2M", "two", "nan", "é"]
        {
            assert!(parse_count(text).is_err(), "{text}");
        }
    }
}
