//! Refuses runs that are expected to need more memory than is available or allowed.

use super::Context;
use crate::error::{Error, Result};
use isoparticles_file::memory::available_memory;

impl Context {
    /// Refuses a run that is expected to need more than `--max-memory` or, without this option,
    /// more than the free memory of the machine.
    ///
    /// # Errors
    /// If `needed` (in bytes) exceeds the limit. In the message, `what` names the data that needs
    /// the memory, such as a file and its number of particles, and `next` states how to reduce the
    /// memory use.
    pub fn check_memory(&self, needed: f64, what: &str, next: &str) -> Result<()> {
        let (limit, whose) = match (self.common.max_memory, available_memory()) {
            (Some(limit), _) => (limit, "MAX_MEMORY (--max-memory) allows"),
            (None, Some(limit)) => (limit, "the free memory of this machine is"),
            (None, None) => return Ok(()),
        };
        self.verbose(format!("memory expected: {} of {}", in_words(needed), in_words(limit as f64)));
        if needed <= limit as f64 {
            return Ok(());
        }
        Err(Error::input(
            format!("{what}: this needs about {} of memory", in_words(needed)),
            format!("{whose} {}; the run would be killed, or swap to disk for hours", in_words(limit as f64)),
            format!(
                "{next}; or set MAX_MEMORY={:.0}G (--max-memory) if this machine has that much memory",
                (needed / GIB).ceil()
            ),
        ))
    }
}

/// Estimates the memory use of `reconstruct` in bytes from the number of particles and the number
/// of grid nodes. Each particle needs at most 1,403 bytes, as measured on the real volumes in
/// `docs/developer/performance.md`. Each node needs 15.5 bytes, as measured by
/// `stages/distfield/benches/costs.py`.
pub fn particles_bytes(particles: f64, nodes: usize) -> f64 {
    1403.0 * particles + 15.5 * nodes as f64
}

/// Number of bytes in a GiB.
const GIB: f64 = (1u64 << 30) as f64;

/// Formats a number of bytes in GiB or MiB, for messages.
fn in_words(bytes: f64) -> String {
    if bytes >= GIB { format!("{:.1} GiB", bytes / GIB) } else { format!("{:.0} MiB", bytes / (1u64 << 20) as f64) }
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
        assert_eq!(error.what, "a.vti: 7 particles: this needs about 2.8 GiB of memory");
        assert!(error.why.starts_with("MAX_MEMORY (--max-memory) allows 1.5 GiB"), "{error}");
        assert!(error.next.contains("use a larger h; or set MAX_MEMORY=3G (--max-memory)"), "{error}");
        context.common.max_memory = None;
        assert_eq!(context.check_memory(1e18, "", "").is_err(), super::available_memory().is_some());
    }
}
