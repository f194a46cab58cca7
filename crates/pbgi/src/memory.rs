//! What the process holds in memory, as the system counts it.

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

fn status_bytes(field: &str) -> Option<u64> {
    parse_status(&std::fs::read_to_string("/proc/self/status").ok()?, field)
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
    fn peaks_never_fall_below_what_is_held() {
        let Some(now) = resident_bytes() else { return };
        assert!(now > 0 && peak_resident_bytes().is_some_and(|peak| peak >= now / 2));
    }
}
