//! Progress on stderr: a percentage if the total is known, a message, and the elapsed time.

use super::{Listener, ProgressState};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Minimum time between two progress lines, which limits a log to 720 lines per hour.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// Progress of one computation. Several threads may share it. The display ends when the value is
/// dropped.
pub struct Progress {
    label: String,
    total: Option<u64>,
    done: AtomicU64,
    started: Instant,
    shown: Display,
}

enum Display {
    Bar(ProgressBar),
    Lines(Mutex<Lines>),
    Listener(Told),
    Nothing,
}

struct Lines {
    last: Instant,
    message: String,
}

/// The listener of a stage that runs as a library.
struct Told {
    listener: Arc<Listener>,
    stage: &'static str,
    message: Mutex<String>,
}

impl Progress {
    pub(super) fn bar(bars: &MultiProgress, label: &str, total: Option<u64>) -> Self {
        let (bar, template) = match total {
            Some(total) => (ProgressBar::new(total), "{prefix} [{bar:30}] {percent:>3}% {elapsed} {msg}"),
            None => (ProgressBar::new_spinner(), "{prefix} {spinner} {elapsed} {msg}"),
        };
        let bar = bars.add(bar);
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(label.to_owned());
        bar.enable_steady_tick(Duration::from_millis(250));
        Self::new(label, total, Display::Bar(bar))
    }

    pub(super) fn lines(label: &str, total: Option<u64>) -> Self {
        let lines = Lines { last: Instant::now(), message: String::new() };
        Self::new(label, total, Display::Lines(Mutex::new(lines)))
    }

    pub(super) fn told(listener: &Arc<Listener>, stage: &'static str, label: &str, total: Option<u64>) -> Self {
        let told = Told { listener: Arc::clone(listener), stage, message: Mutex::new(String::new()) };
        let progress = Self::new(label, total, Display::Listener(told));
        progress.show(0);
        progress
    }

    pub(super) fn nothing(label: &str, total: Option<u64>) -> Self {
        Self::new(label, total, Display::Nothing)
    }

    fn new(label: &str, total: Option<u64>, shown: Display) -> Self {
        Self { label: label.to_owned(), total, done: AtomicU64::new(0), started: Instant::now(), shown }
    }

    /// Adds `amount` to the completed work. Loops call this function once per slice or chunk, not
    /// once per voxel.
    pub fn add(&self, amount: u64) {
        let done = self.done.fetch_add(amount, Ordering::Relaxed).saturating_add(amount);
        self.show(done);
    }

    /// Sets the amount of completed work.
    pub fn set(&self, done: u64) {
        self.done.store(done, Ordering::Relaxed);
        self.show(done);
    }

    /// Sets the message next to the percentage, such as "iteration 12, energy 0.712, 11209
    /// particles".
    pub fn message(&self, text: impl Into<String>) {
        match &self.shown {
            Display::Bar(bar) => bar.set_message(text.into()),
            Display::Lines(lines) => {
                if let Ok(mut lines) = lines.lock() {
                    lines.message = text.into();
                }
                self.show(self.done.load(Ordering::Relaxed));
            }
            Display::Listener(told) => {
                *told.message.lock().unwrap_or_else(PoisonError::into_inner) = text.into();
                self.show(self.done.load(Ordering::Relaxed));
            }
            Display::Nothing => {}
        }
    }

    fn show(&self, done: u64) {
        match &self.shown {
            Display::Bar(bar) => bar.set_position(done),
            Display::Lines(lines) => {
                let Ok(mut lines) = lines.try_lock() else { return };
                if lines.last.elapsed() < LINE_INTERVAL {
                    return;
                }
                lines.last = Instant::now();
                let text = line(&self.label, self.total, done, self.started.elapsed(), &lines.message);
                let _ = writeln!(std::io::stderr(), "{text}");
            }
            Display::Listener(told) => {
                let message = told.message.lock().unwrap_or_else(PoisonError::into_inner).clone();
                let (step, total) = (self.label.clone(), self.total);
                told.listener.show(ProgressState { stage: told.stage, step, done, total, message });
            }
            Display::Nothing => {}
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Display::Bar(bar) = &self.shown {
            bar.finish_and_clear();
        }
    }
}

/// Formats one plain progress line.
fn line(label: &str, total: Option<u64>, done: u64, elapsed: Duration, message: &str) -> String {
    let mut text = match total {
        Some(total) if total > 0 => format!("{label}: {:.0} %", 100.0 * done.min(total) as f64 / total as f64),
        _ => format!("{label}:"),
    };
    if !message.is_empty() {
        text = format!("{text} {message},");
    }
    format!("{text} {:.0} s", elapsed.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::line;
    use std::time::Duration;

    #[test]
    fn a_line_has_a_percentage_only_where_the_total_is_known() {
        let elapsed = Duration::from_secs(12);
        assert_eq!(line("sweep", Some(8), 2, elapsed, ""), "sweep: 25 % 12 s");
        assert_eq!(line("settle", None, 7, elapsed, "iteration 7"), "settle: iteration 7, 12 s");
        assert_eq!(line("sweep", Some(0), 2, elapsed, ""), "sweep: 12 s");
    }
}
