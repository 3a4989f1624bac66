//! The interface through which algorithms report progress and check for stop requests. The
//! algorithms therefore do not depend on the program that runs them.

/// The computation was interrupted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{by}: interrupted")]
pub struct Interrupted {
    /// Name of the program or computation.
    pub by: String,
}

/// Receives the progress of a computation. Algorithms take a `&dyn Monitor`; pass [`Silent`] to
/// disable reports.
pub trait Monitor: Sync {
    /// Fails if the computation should stop. Long loops call this function regularly.
    ///
    /// # Errors
    /// If a stop was requested.
    fn check(&self) -> Result<(), Interrupted>;

    /// Starts a phase of the computation, such as "triangulate". The phase ends when the returned
    /// guard is dropped.
    fn phase<'a>(&'a self, name: &str) -> Box<dyn Phase + 'a>;

    /// Reports a detail for verbose output. `_detail` is called only if the detail is shown.
    fn note(&self, _detail: &dyn Fn() -> String) {}

    /// Starts a progress counter, which shows a percentage if `total` is known. The counter ends
    /// when the returned guard is dropped.
    fn counter<'a>(&'a self, label: &str, total: Option<u64>) -> Box<dyn Counter + 'a>;
}

/// A running phase of a computation. The phase ends when this guard is dropped.
pub trait Phase {}

/// Counts completed work.
pub trait Counter: Sync {
    /// Increases the count by `amount`. Loops call this function once per slice or chunk, not once
    /// per voxel.
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
