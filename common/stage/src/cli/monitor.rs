//! Implements [`Monitor`] for the context of a stage. Phases appear in the closing table, counters
//! appear as progress, and signals or the listener interrupt the run.

use super::{Context, Progress, Step};
use isoparticles_file::monitor::{Counter, Interrupted, Monitor, Phase};

impl Monitor for Context {
    fn check(&self) -> Result<(), Interrupted> {
        if self.interrupted() { Err(Interrupted { by: self.tool.to_owned() }) } else { Ok(()) }
    }

    fn phase<'a>(&'a self, name: &str) -> Box<dyn Phase + 'a> {
        Box::new(self.step(name))
    }

    fn note(&self, detail: &dyn Fn() -> String) {
        if self.common.verbose > 0 {
            self.verbose(detail());
        }
    }

    fn counter<'a>(&'a self, label: &str, total: Option<u64>) -> Box<dyn Counter + 'a> {
        Box::new(self.progress(total, label))
    }
}

impl Phase for Step<'_> {}

impl Counter for Progress {
    fn add(&self, amount: u64) {
        Self::add(self, amount);
    }
}
