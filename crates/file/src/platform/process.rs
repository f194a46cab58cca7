//! What the process holds and has used, as the system counts it: Linux tells in `/proc`.

/// Most bytes this process had in memory at once since it started (`VmHWM`), shared libraries and
/// code included; none where the system does not tell.
#[must_use]
pub fn peak_resident_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

/// Bytes this process has in memory now (`VmRSS`); none where the system does not tell.
#[must_use]
pub fn resident_bytes() -> Option<u64> {
    status_bytes("VmRSS:")
}

/// What this process has used so far; none where the system does not tell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProcessUse {
    /// Seconds of all its threads in its own code.
    pub user_seconds: f64,
    /// Seconds of all its threads in the system's code.
    pub system_seconds: f64,
    /// Bytes it asked the system to read, from disk or not.
    pub read_bytes: u64,
    /// Bytes it asked the system to write.
    pub written_bytes: u64,
}

/// What this process has used so far (`/proc/self/stat` and `/proc/self/io`).
#[must_use]
pub fn process_use() -> Option<ProcessUse> {
    let (stat, io) = (read_own("stat")?, read_own("io")?);
    let (user_seconds, system_seconds) = parse_times(&stat)?;
    let bytes = |name: &str| io.lines().find_map(|l| l.strip_prefix(name))?.trim().parse().ok();
    Some(ProcessUse {
        user_seconds,
        system_seconds,
        read_bytes: bytes("rchar:")?,
        written_bytes: bytes("wchar:")?,
    })
}

/// Seconds of all threads of this process so far, in its own code and the system's, to hundredths; none where the system does not tell.
#[must_use]
pub fn processor_seconds() -> Option<f64> {
    let (user_seconds, system_seconds) = parse_times(&read_own("stat")?)?;
    Some(user_seconds + system_seconds)
}

/// What Linux tells of this process under a name.
fn read_own(name: &str) -> Option<String> {
    if !cfg!(target_os = "linux") {
        return None;
    }
    std::fs::read_to_string(format!("/proc/self/{name}")).ok()
}

/// User and system time in seconds: fields 14 and 15, in hundredths. The name, field 2, may hold anything.
fn parse_times(stat: &str) -> Option<(f64, f64)> {
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace().skip(11);
    let mut seconds = || fields.next()?.parse::<u64>().ok().map(|ticks| ticks as f64 / 100.0);
    Some((seconds()?, seconds()?))
}

fn status_bytes(field: &str) -> Option<u64> {
    parse_status(&read_own("status")?, field)
}

/// The value of `field`, which Linux states in KiB.
fn parse_status(status: &str, field: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_in_bytes() {
        let status = "Name:\tx\nVmHWM:\t  12345 kB\nVmRSS:\t 7 kB\n";
        assert_eq!(parse_status(status, "VmHWM:"), Some(12345 * 1024));
        assert_eq!(parse_status(status, "VmRSS:"), Some(7 * 1024));
        assert_eq!(parse_status(status, "VmSwap:"), None);
    }

    #[test]
    fn times_follow_a_name_of_any_kind() {
        let stat = "7 (a) b (c) R 1 2 3 4 5 6 7 8 9 10 123 456 0 0";
        assert_eq!(parse_times(stat), Some((1.23, 4.56)));
        assert_eq!(parse_times("7 (cut"), None);
        assert!(process_use().is_none_or(|used| used.read_bytes > 0));
        assert_eq!(processor_seconds().is_some(), process_use().is_some());
    }

    #[test]
    fn peaks_never_fall_below_what_is_held() {
        let now = resident_bytes();
        assert_eq!(now.is_some(), cfg!(target_os = "linux"));
        let Some(now) = now else { return };
        assert!(now > 0 && peak_resident_bytes().is_some_and(|peak| peak >= now / 2));
    }
}
