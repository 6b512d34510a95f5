//! The bar of a replay.

use std::fmt::Write;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

use crate::table::number;

/// Least time between two looks at the error.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// The error may cost at most this share of the time.
const LOOK_SHARE: u32 = 20;

/// A bar with rate and current error; nothing when nobody is looking.
#[derive(Debug)]
pub(crate) struct Progress {
    bar: Option<ProgressBar>,
    looked: Instant,
    pause: Duration,
}

impl Progress {
    pub(crate) fn new(steps: usize, shown: bool) -> Self {
        let bar = shown.then(|| {
            let style = "{bar:10} {pos}/{len} steps, {rate}, {eta} left{msg}";
            let style = ProgressStyle::with_template(style)
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            // Without the decimals of `per_sec`.
            let rate = |state: &ProgressState, out: &mut dyn Write| {
                // A bar that cannot be drawn is no reason to stop.
                let _ = write!(out, "{:.0}/s", state.per_sec());
            };
            ProgressBar::new(steps as u64).with_style(style.with_key("rate", rate))
        });
        Self { bar, looked: Instant::now(), pause: LOOK_EVERY }
    }

    /// A step is done; `error` is called now and then.
    pub(crate) fn step<E>(&mut self, error: impl FnOnce() -> Result<f64, E>) {
        let Some(bar) = &self.bar else { return };
        if self.looked.elapsed() >= self.pause {
            let start = Instant::now();
            // An error that cannot be told is no reason to stop; whoever needs it hears of that.
            if let Ok(error) = error() {
                bar.set_message(format!(", error {}", number(error)));
            }
            self.pause = LOOK_EVERY.max(start.elapsed() * LOOK_SHARE);
            self.looked = Instant::now();
        }
        bar.inc(1);
    }

    /// A step is done that has no error to show.
    pub(crate) fn tick(&self) {
        if let Some(bar) = &self.bar {
            bar.inc(1);
        }
    }

    /// Says what is going on after the last step.
    pub(crate) fn say(&self, text: &'static str) {
        if let Some(bar) = &self.bar {
            bar.set_message(format!(", {text}"));
            bar.tick();
        }
    }

    /// Takes the bar away.
    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
