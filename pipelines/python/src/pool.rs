//! Runs jobs on a thread pool while the calling Python thread polls for signals and progress.

use isoparticles_stage::cli::{Listener, STACK_BYTES};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Time between two polls. A user notices delays above about 100 ms.
const POLL: Duration = Duration::from_millis(50);

/// Maximum number of threads per core. On 2 cores, `distance_field` of 60^3 voxels takes 0.2 s with
/// `threads=8`, 0.9 s with 300, and more than 2 minutes with 5000.
const MOST_PER_CORE: usize = 4;

/// The idle pool of the process. If another job uses it, a job creates its own pool: in a shared
/// pool, a waiting thread could start the second job and delay the first.
static IDLE: Mutex<Option<Pool>> = Mutex::new(None);

/// A thread pool, and the process to which its threads belong.
struct Pool {
    threads: ThreadPool,
    count: usize,
    process: u32,
}

impl Pool {
    /// Takes the idle pool, or creates a pool of `count` threads. 0 means one thread per core.
    fn take(count: usize) -> PyResult<Self> {
        let process = std::process::id();
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let count = count.min(MOST_PER_CORE * cores);
        // after a fork, the mutex may be locked forever
        match IDLE.try_lock().ok().and_then(|mut idle| idle.take()) {
            Some(pool) if pool.process == process && pool.count == count => return Ok(pool),
            // a fork does not copy threads, so there are none to stop
            Some(pool) if pool.process != process => std::mem::forget(pool),
            _ => {}
        }
        let threads = ThreadPoolBuilder::new().num_threads(count).stack_size(STACK_BYTES).build();
        let threads = threads.map_err(|error| PyRuntimeError::new_err(format!("cannot start threads: {error}")))?;
        Ok(Self { threads, count, process })
    }

    /// Keeps the pool for the next job.
    fn put_back(self) {
        if let Ok(mut idle) = IDLE.try_lock() {
            *idle = Some(self);
        }
    }
}

/// Runs a job on the pool and returns its result. Meanwhile, passes the latest progress to the
/// callback `progress` and handles Python's signals. If the callback or a signal handler raises an
/// exception, cancels the job, waits for its end and returns the exception.
///
/// # Errors
/// If the job panics, or if the threads cannot be started.
pub(crate) fn run<T: Send + 'static>(
    py: Python<'_>,
    threads: usize,
    listener: &Arc<Listener>,
    progress: Option<&Bound<'_, PyAny>>,
    job: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let pool = Pool::take(threads)?;
    let (sender, mut receiver) = sync_channel(1);
    pool.threads.spawn(move || drop(sender.send(catch_unwind(AssertUnwindSafe(job)))));
    let mut raised = None;
    let ended = loop {
        let polled;
        (receiver, polled) = py.detach(move || {
            let polled = receiver.recv_timeout(POLL);
            (receiver, polled)
        });
        if raised.is_none()
            && let Err(error) = py.check_signals().and_then(|()| show(listener, progress))
        {
            raised = Some(error);
            listener.cancel();
        }
        match polled {
            Err(RecvTimeoutError::Timeout) => {}
            Ok(ended) => break Some(ended),
            Err(RecvTimeoutError::Disconnected) => break None,
        }
    };
    pool.put_back();
    match (raised, ended) {
        (Some(error), _) => Err(error),
        (None, Some(Ok(result))) => Ok(result),
        (None, Some(Err(panic))) => Err(PyRuntimeError::new_err(format!("internal error: {}", message(&*panic)))),
        (None, None) => Err(PyRuntimeError::new_err("internal error: the job has ended without a result")),
    }
}

/// Passes the latest progress, if it is new, to the callback.
fn show(listener: &Listener, progress: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
    let (Some(progress), Some(latest)) = (progress, listener.latest()) else { return Ok(()) };
    progress.call1((latest.stage, latest.step, latest.done, latest.total, latest.message)).map(drop)
}

fn message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("panic")
}
