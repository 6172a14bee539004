//! Runs a job: draws its progress, listens for signals, prints its report.

use std::sync::{Mutex, PoisonError};

use indicatif::ProgressBar;
use srflow::{Error, Job, Progress, Report, Watch, WhenStopped};

use crate::Context;
use crate::interrupt::{self, Continuable};
use crate::output::{exit_stopped, is_coloured, print_json, print_text};
use crate::progress::{Lines, bar};

/// Runs `job` and prints its report. A job that was stopped ends the process with exit code 75.
///
/// # Errors
/// Those of the job, what its report says is wrong, and when standard output cannot be written to.
pub fn run<J: Job>(job: &J, context: &Context) -> anyhow::Result<()> {
    let report = watched(job)?;
    print(&report, context)?;
    match job.when_stopped() {
        // The report says how to continue.
        WhenStopped::Saved if report.stopped() => exit_stopped()?,
        _ => exit_if_stopped(report.stopped())?,
    }
    if let Some(failure) = report.failure() {
        return Err(anyhow::Error::msg(failure));
    }
    match report.follow_up() {
        Some(follow_up) => Ok(follow_up(&interrupt::requested)?),
        None => Ok(()),
    }
}

/// Prints the report as JSON or as text.
///
/// # Errors
/// When standard output cannot be written to.
pub fn print(report: &impl Report, context: &Context) -> anyhow::Result<()> {
    if context.json {
        print_json(report)
    } else if is_coloured() {
        print_text(&format!("{report:#}"))
    } else {
        print_text(&report.to_string())
    }
}

/// Exits the program if the run was stopped.
pub fn exit_if_stopped(stopped: bool) -> anyhow::Result<()> {
    if stopped {
        match interrupt::requested() {
            true => note!("stopped by a signal; the same command continues"),
            false => note!("stopped on request; the same command without --stop-after continues"),
        }
        exit_stopped()?;
    }
    Ok(())
}

/// Runs `job` with a progress bar on standard error; lines where it is no terminal.
pub fn watched<J: Job>(job: &J) -> Result<J::Report, Error> {
    watching(job.when_stopped(), |watch| job.run(watch))
}

/// What `work` returns, which is watched as a job is.
pub fn watching<T>(when_stopped: WhenStopped, work: impl FnOnce(&Watch) -> T) -> T {
    let continuable = match when_stopped {
        WhenStopped::Lost => None,
        WhenStopped::UnitsKept => Some(Continuable::dropping(|| BARS.left())),
        WhenStopped::Saved => Some(Continuable::saved()),
    };
    let result = work(&WATCH);
    drop(continuable);
    BARS.finish();
    result
}

/// Draws the progress of the one job that a process runs, and stops it on a signal.
pub static WATCH: Watch<'static> =
    Watch { on_progress: &|progress| BARS.show(progress), stop: &interrupt::requested };

static BARS: Bars = Bars(Mutex::new(None));

/// Prints with `print` above the bar.
pub fn above_the_bar(print: impl FnOnce()) {
    BARS.suspend(print);
}

/// The progress bar of the stage that runs.
struct Bars(Mutex<Option<Stage>>);

struct Stage {
    unit: String,
    bar: ProgressBar,
    lines: Lines,
}

impl Bars {
    fn show(&self, progress: &Progress) {
        let mut stage = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let event = progress.facts.get("event");
        let is_event = |name: &str| event.is_some_and(|event| event == name);
        if is_event("started") || stage.as_ref().is_none_or(|stage| stage.unit != progress.unit) {
            if let Some(last) = stage.take() {
                last.bar.finish_and_clear();
            }
            *stage = Some(Stage::new(&progress.unit, progress.done));
        }
        let Some(Stage { unit, bar, lines }) = stage.as_ref() else { return };
        match progress.total {
            Some(total) => bar.set_length(total),
            None => bar.unset_length(),
        }
        bar.set_position(progress.done);
        bar.set_message(progress.message.clone());
        match event {
            Some(_) if is_event("step") => lines.of_training(bar, unit),
            Some(_) => {}
            None => lines.now_and_then(bar, unit),
        }
    }

    fn suspend(&self, print: impl FnOnce()) {
        match self.0.try_lock().ok().as_ref().and_then(|stage| stage.as_ref()) {
            Some(stage) => stage.bar.suspend(print),
            None => print(),
        }
    }

    /// What is left of the stage, in words.
    fn left(&self) -> String {
        let stage = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(Stage { unit, bar, .. }) = stage.as_ref() else { return "nothing was begun".to_owned() };
        match bar.length() {
            None | Some(0) if bar.position() == 0 => format!("no {unit} were begun"),
            Some(all) if all == bar.position() => {
                format!("all {all} {unit} are complete, the files of the whole are not")
            }
            Some(all) => format!("{} of {all} {unit} are left", all.saturating_sub(bar.position())),
            None => format!("{} {unit} are done", bar.position()),
        }
    }

    fn finish(&self) {
        if let Some(stage) = self.0.lock().unwrap_or_else(PoisonError::into_inner).take() {
            stage.bar.finish_and_clear();
        }
    }
}

impl Stage {
    fn new(unit: &str, done: u64) -> Self {
        let template = format!("{{wide_bar}} {{pos}}/{{len}} {unit}  {{msg}}  {{eta}} left");
        let bar = bar(None, &template);
        // What an earlier run has done says nothing about the speed of this one.
        bar.set_position(done);
        bar.reset_eta();
        Self { unit: unit.to_owned(), bar, lines: Lines::new() }
    }
}
