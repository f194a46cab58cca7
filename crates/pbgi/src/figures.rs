//! Figures as people read them.

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
}
