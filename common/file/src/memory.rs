//! Free memory of the machine and peak memory of this process. Both are known only on Linux.

use std::fs::read_to_string;

/// Returns the peak resident memory of this process in bytes, or `None` if it is unknown.
pub fn peak_memory() -> Option<u64> {
    kibibytes_of("/proc/self/status", "VmHWM:")
}

/// Returns the memory in bytes that can be allocated without swapping: the smaller of the machine's
/// free memory and the control group's remaining memory. Returns `None` if both are unknown.
pub fn available_memory() -> Option<u64> {
    let machine = kibibytes_of("/proc/meminfo", "MemAvailable:");
    let number = |path: &str| read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let group = number("/sys/fs/cgroup/memory.max")
        .zip(number("/sys/fs/cgroup/memory.current"))
        .map(|(most, now)| most.saturating_sub(now));
    match (machine, group) {
        (Some(machine), Some(group)) => Some(machine.min(group)),
        (machine, group) => machine.or(group),
    }
}

/// Finds the line of a `/proc` file that starts with `key`, and returns its value converted from
/// KiB to bytes.
fn kibibytes_of(path: &str, key: &str) -> Option<u64> {
    let text = read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    #[test]
    #[cfg(target_os = "linux")]
    fn linux_tells_both() {
        let peak = super::peak_memory().expect("VmHWM");
        assert!(peak > 100_000, "{peak}");
        assert!(super::available_memory().expect("MemAvailable") > 1_000_000);
    }
}
