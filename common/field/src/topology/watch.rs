//! Reports progress and checks for interruption, slice by slice.

pub(super) use isoparticles_file::monitor::Interrupted;
use isoparticles_file::monitor::{Counter, Monitor};

/// Counts progress and checks for interruption in a computation that makes several passes over the
/// slices of a volume.
pub(super) struct Watch<'a> {
    monitor: &'a dyn Monitor,
    counter: Box<dyn Counter + 'a>,
}

impl<'a> Watch<'a> {
    /// Starts the progress counter. `slices` is the number of slices, summed over all passes.
    pub(super) fn new(monitor: &'a dyn Monitor, slices: usize) -> Self {
        Self { monitor, counter: monitor.counter("topology", Some(slices as u64)) }
    }

    /// Counts the start of a slice. Returns an error if the monitor interrupts the work.
    pub(super) fn slice(&self) -> Result<(), Interrupted> {
        self.monitor.check()?;
        self.counter.add(1);
        Ok(())
    }
}
