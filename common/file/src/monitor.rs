//! How work tells how far it is, and learns that it shall stop: one way for every algorithm, whoever watches.

/// The work was asked to stop.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{by}: interrupted")]
pub struct Interrupted {
    /// Name of the program or of the work.
    pub by: String,
}

/// Watches over a piece of work. Algorithms take `&dyn Monitor`; [`Silent`] is for those whom nobody watches.
pub trait Monitor: Sync {
    /// Fails when the work shall stop; long loops call it every so often.
    ///
    /// # Errors
    /// [`Interrupted`].
    fn check(&self) -> Result<(), Interrupted>;

    /// A part of the work begins, such as "triangulate"; it ends when the value is dropped.
    fn phase<'a>(&'a self, name: &str) -> Box<dyn Phase + 'a>;

    /// A detail for those who want to hear everything; made only where they do.
    fn note(&self, _detail: &dyn Fn() -> String) {}

    /// Something is counted, with a percentage where the total is known; it ends when the value is dropped.
    fn counter<'a>(&'a self, label: &str, total: Option<u64>) -> Box<dyn Counter + 'a>;
}

/// A part of the work that lasts until it is dropped.
pub trait Phase {}

/// Counts what has been done.
pub trait Counter: Sync {
    /// Adds to it. Cheap, but call it once a slice or a chunk, not once a voxel.
    fn add(&self, amount: u64);
}

/// Nobody watches, and the work is never stopped.
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
