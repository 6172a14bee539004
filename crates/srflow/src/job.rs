//! What every job has in common.

use std::fmt;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Error, Watch};

/// A job: a struct whose fields are its settings. As JSON it is what Python passes and what configurations hold; with the feature
/// `clap` its fields are the options of the command of its name.
pub trait Job: Serialize + DeserializeOwned {
    /// The words of its command, e.g. `mer run`.
    const NAME: &'static str;
    /// What happens to unfinished work when the job is stopped.
    const WHEN_STOPPED: WhenStopped = WhenStopped::Lost;

    type Report: Report;

    /// The settings that a preset chosen in this job starts from, as JSON; settings that are given win over them.
    fn preset_defaults(&self) -> Option<serde_json::Value> {
        None
    }

    /// What happens to unfinished work of this job; for jobs whose settings decide.
    fn when_stopped(&self) -> WhenStopped {
        Self::WHEN_STOPPED
    }

    /// Does the work.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a setting that is out of range or does not fit the others, found before
    /// any work; otherwise what went wrong, with the file.
    fn run(&self, watch: &Watch) -> Result<Self::Report, Error> {
        Ok(self.work(watch)?)
    }

    /// What [`run`](Self::run) does, with any error.
    #[doc(hidden)]
    fn work(&self, watch: &Watch) -> anyhow::Result<Self::Report>;
}

/// What happens to unfinished work when a job is stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenStopped {
    /// Running the job again starts over.
    Lost,
    /// Finished units are kept, and running the job again continues. It may be ended at any moment.
    UnitsKept,
    /// The job saves a checkpoint when [`Watch::stop`] asks it to, which may take seconds, and continues from there.
    Saved,
}

/// The result of a job: JSON for programs, text for people. `{:#}` is the text with colours for a terminal.
pub trait Report: Serialize + fmt::Display {
    /// Whether the job was stopped before its end; running it again continues.
    fn stopped(&self) -> bool {
        false
    }

    /// What the job found wrong, such as problems of a dataset that was checked: its command prints the report and then fails.
    fn failure(&self) -> Option<String> {
        None
    }

    /// What begins once the report is printed and lasts until it is stopped, such as serving a page.
    fn follow_up(self) -> Option<FollowUp>
    where
        Self: Sized,
    {
        None
    }
}

/// Work that lasts until its argument, which is called now and then, returns `true`.
pub type FollowUp = Box<dyn FnOnce(&dyn Fn() -> bool) -> Result<(), Error> + Send>;
