//! Memory: how much a header may promise, and how much a run has used. Linux tells; elsewhere nothing is known.

use super::Context;
use crate::error::{Error, Result};
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

impl Context {
    /// Refuses work that is expected to take more memory than `--max-memory`, or than the machine has free.
    ///
    /// # Errors
    /// When `needed` bytes are more than that; `what` says of what (a file and a figure), `next` how to need less.
    pub fn check_memory(&self, needed: f64, what: &str, next: &str) -> Result<()> {
        let (limit, whose) = match (self.common.max_memory, available_memory()) {
            (Some(limit), _) => (limit, "--max-memory allows"),
            (None, Some(limit)) => (limit, "this machine has free"),
            (None, None) => return Ok(()),
        };
        self.verbose(format!("memory expected: {} of {}", in_words(needed), in_words(limit as f64)));
        if needed <= limit as f64 {
            return Ok(());
        }
        Err(Error::input(
            format!("{what}: that takes about {} of memory", in_words(needed)),
            format!("{whose} {}; the run would be killed, or take hours on a swapping disk", in_words(limit as f64)),
            format!("{next}; or --max-memory {:.0}G if the memory is there all the same", (needed / GIB).ceil()),
        ))
    }
}

/// Most memory that the stages hold for so many particles on a grid of so many nodes, bytes: `reconstruct` needs most, up to 1,403 bytes a particle
/// (`docs/performance.md`, real volumes), and 15.5 a node (`stages/distfield/benches/costs.py`).
pub fn particles_bytes(particles: f64, nodes: usize) -> f64 {
    1403.0 * particles + 15.5 * nodes as f64
}

const GIB: f64 = (1u64 << 30) as f64;

/// Bytes as a person reads them.
fn in_words(bytes: f64) -> String {
    if bytes >= GIB { format!("{:.1} GiB", bytes / GIB) } else { format!("{:.0} MiB", bytes / (1u64 << 20) as f64) }
}

/// The number of kibibytes on the line of a `/proc` file that starts with `key`, in bytes.
fn kibibytes_of(path: &str, key: &str) -> Option<u64> {
    let text = read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    use super::super::Context;

    #[test]
    fn what_takes_more_than_allowed_is_refused_with_the_figure() {
        let mut context = Context::silent("seed");
        context.common.max_memory = Some(3 << 29);
        assert!(context.check_memory(1e9, "a.vti: 7 particles", "use a larger h").is_ok());
        let error = context.check_memory(3e9, "a.vti: 7 particles", "use a larger h").expect_err("too much");
        assert_eq!(error.what, "a.vti: 7 particles: that takes about 2.8 GiB of memory");
        assert!(error.why.starts_with("--max-memory allows 1.5 GiB"), "{error}");
        assert!(error.next.contains("use a larger h; or --max-memory 3G"), "{error}");
        context.common.max_memory = None;
        assert_eq!(context.check_memory(1e18, "", "").is_err(), super::available_memory().is_some());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn linux_tells_both() {
        let peak = super::peak_memory().expect("VmHWM");
        assert!(peak > 100_000, "{peak}");
        assert!(super::available_memory().expect("MemAvailable") > 1_000_000);
    }
}
