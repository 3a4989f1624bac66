//! Memory: how much there is, and how much this process has used. Linux tells; elsewhere nothing is known.

use std::fs::read_to_string;

/// Most memory this process has held at once, in bytes.
pub fn peak_memory() -> Option<u64> {
    kibibytes_of("/proc/self/status", "VmHWM:")
}

/// Memory that can still be had without swapping, in bytes: the machine's, or the control group's where that is less.
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

/// The number of kibibytes on the line of a `/proc` file that starts with `key`, in bytes.
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
