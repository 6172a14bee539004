//! Progress of features and folds.

use std::sync::{Mutex, PoisonError};

use srflow_mer::RunEvent;

use crate::Watch;
use crate::watch::Count;

/// One stage for each part of a run, one after another.
pub struct RunProgress<'a> {
    watch: &'a Watch<'a>,
    stage: Mutex<Option<Count<'a>>>,
}

impl<'a> RunProgress<'a> {
    pub fn new(watch: &'a Watch<'a>) -> Self {
        Self { watch, stage: Mutex::new(None) }
    }

    /// Reports the event; may be called from any thread.
    pub fn show(&self, event: RunEvent) {
        let mut stage = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            RunEvent::Apexes { clips } => *stage = Some(self.watch.count("apexes", clips as u64)),
            RunEvent::Features { method, clips } => {
                let features = self.watch.count("features", clips as u64);
                features.message(method);
                *stage = Some(features);
            }
            RunEvent::Training { clip_epochs } => {
                *stage = Some(self.watch.count("clip epochs", clip_epochs));
            }
            RunEvent::Folds { set, method } => {
                if let Some(stage) = &*stage {
                    stage.message(format!("{set}, {method}"));
                }
            }
            RunEvent::Clip => add(&stage, 1),
            RunEvent::Trained { clip_epochs } | RunEvent::Resumed { clip_epochs } => add(&stage, clip_epochs),
        }
    }
}

fn add(stage: &Option<Count>, units: u64) {
    if let Some(stage) = stage {
        stage.add(units);
    }
}
