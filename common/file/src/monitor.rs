//! How algorithms report progress and learn of a request to stop, independent of the program around
//! them.

/// The computation was interrupted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{by}: interrupted")]
pub struct Interrupted {
    /// Name of the program or computation.
    pub by: String,
}

/// Receives the progress of a computation. Algorithms take `&dyn Monitor`; use [`Silent`] if no
/// reports are needed.
pub trait Monitor: Sync {
    /// Fails if the computation should stop. Long loops call this regularly.
    ///
    /// # Errors
    /// [`Interrupted`] if a stop was requested.
    fn check(&self) -> Result<(), Interrupted>;

    /// Starts a phase of the computation, such as "triangulate". It ends when the returned value is
    /// dropped.
    fn phase<'a>(&'a self, name: &str) -> Box<dyn Phase + 'a>;

    /// A detail for verbose output. `_detail` is called only if it is shown.
    fn note(&self, _detail: &dyn Fn() -> String) {}

    /// Starts a counter. It shows a percentage if `total` is known, and ends when the returned
    /// value is dropped.
    fn counter<'a>(&'a self, label: &str, total: Option<u64>) -> Box<dyn Counter + 'a>;
}

/// A phase of the computation, which lasts until this is dropped.
pub trait Phase {}

/// Counts completed work.
pub trait Counter: Sync {
    /// Adds to the count. Cheap, but call it per slice or chunk, not per voxel.
    fn add(&self, amount: u64);
}

/// A monitor that reports nothing and never interrupts.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Phase for Silent {}

impl Counter for Silent {
    fn add(&self, _amount: u64) {}
}

impl Monitor for Silent {
    fn check(&self) -> Result<(), Interrupted> {
        Ok(())
    }

    fn phase<'a>(&'a self, _name: &str) -> Box<dyn Phase + 'a> {
        Box::new(Self)
    }

    fn counter<'a>(&'a self, _label: &str, _total: Option<u64>) -> Box<dyn Counter + 'a> {
        Box::new(Self)
    }
}
