//! Free memory of the machine and peak memory of this process. Known on Linux only.

use std::fs::read_to_string;

/// Peak resident memory of this process in bytes; `None` if unknown.
pub fn peak_memory() -> Option<u64> {
    kibibytes_of("/proc/self/status", "VmHWM:")
}

/// Memory available without swapping, in bytes: the minimum of the machine's and the control
/// group's. `None` if unknown.
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

/// The value of the line of a `/proc` file that starts with `key`, converted from KiB to bytes.
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
